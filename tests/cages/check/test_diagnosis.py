import numpy as np
import pytest

from cageik_cli.cages.check import diagnosis as module
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.harmonic import harmonic_weights
from tests.cages.check.test_faults import pinched
from tests.cages.torture import torus
from tests.shapes import ball, box, changed, concave, finer, moved, octahedron, quad_box

pytestmark = pytest.mark.usefixtures("coarse_panels")


def kinds(diagnosis):
    return [(finding.severity, finding.kind) for finding in diagnosis.findings]


@pytest.mark.parametrize("cage", [box(), concave(), ball(2), finer(box(), 1)])
def test_clean_cages_are_fit(cage):
    found = diagnose(cage)
    assert (found.verdict, found.findings, found.rest) == ("fit", (), None)
    assert (found.cage.components, found.cage.genus) == (1, 0)
    assert found.cage.volume == pytest.approx(cage.volume)


def test_a_ring_is_fit_and_its_genus_stated():
    found = diagnose(torus(2, 0.5, 8, 5), torus(2, 0.2, 8, 5))
    assert found.verdict == "fit"
    assert found.cage.genus == 1


def test_facts_of_a_box_around_a_ball():
    rest = ball(1, 0.5)
    found = diagnose(box(), rest)
    assert (found.verdict, found.findings) == ("fit", ())
    cage, facts = found.cage, found.rest
    assert (cage.vertices, cage.faces, cage.volume) == (8, 12, pytest.approx(8))
    assert cage.smallest_angle == pytest.approx(45)
    assert (facts.vertices, facts.faces, facts.outside) == (18, 32, 0)
    assert facts.clearance == pytest.approx(100 * 0.5 / rest.diagonal)
    corner = box().vertices[box().faces[facts.clearance_face]]
    side = rest.vertices[facts.clearance_vertex]
    assert np.abs(corner.mean(axis=0) @ side) == pytest.approx(0.5)
    strongest = harmonic_weights(box(), rest.vertices, "preview").values.max(axis=0)
    assert facts.weakest_weights == pytest.approx(tuple(np.sort(strongest)[:3]))
    np.testing.assert_allclose(strongest[list(facts.weakest_vertices)], facts.weakest_weights)


def test_the_plane_of_a_symmetric_cage_is_stated():
    """The diagonals of a box are not mirrored; its quads are, and so is a ball."""
    facts = [diagnose(cage).cage.symmetry for cage in (quad_box(), ball(1), box(), concave())]
    assert facts == ["the plane x = 0", "the plane x = 0", None, None]


def test_an_inward_cage_is_usable():
    found = diagnose(box().flip(), ball(1, 0.5))
    assert found.verdict == "usable"
    assert kinds(found) == [("warning", "inward")]
    assert found.cage.volume == pytest.approx(-8)
    assert found.rest.outside == 0


def test_a_model_on_its_cage_is_usable():
    found = diagnose(box(), finer(box(), 1))
    assert kinds(found) == [("warning", "clearance")]
    assert found.rest.clearance == pytest.approx(0, abs=1e-12)
    assert found.findings[0].numbers.tolist() == list(range(26))


def test_a_cage_in_another_unit_is_usable():
    found = diagnose(box(100.0), ball(1, 0.5))
    assert kinds(found) == [("warning", "large")]
    assert found.findings[0].value == pytest.approx(box(100.0).diagonal / ball(1, 0.5).diagonal)


def test_a_cage_vertex_far_from_the_model_is_weak():
    """A spike on top of a box hardly moves a ball at the bottom."""
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    spike = int(np.flatnonzero((vertices == [0, 0, 1]).all(axis=1))[0])
    vertices[spike, 2] = 6
    rest = moved(ball(1, 0.3), (0, 0, -0.6))
    found = diagnose(TriMesh(vertices, mesh.faces), rest)
    (weak,) = (finding for finding in found.findings if finding.kind == "weak-vertex")
    assert spike in weak.numbers
    assert found.rest.weakest_vertices[0] in weak.numbers
    assert found.verdict == "usable"


def test_a_thin_cage_is_usable_and_does_not_cross_itself():
    found = diagnose(moved(finer(box(), 1), scale=[1, 1, 1e-6]))
    assert found.verdict == "usable"
    assert {finding.kind for finding in found.findings} == {"thin", "needle"}


def test_findings_are_sorted_from_the_worst():
    """Vertices far outside, a lone cage vertex, and faces inward; weights are not asked for."""
    cage = TriMesh(np.vstack([box().vertices, [[9.0, 9, 9]]]), box().flip().faces)
    rest = moved(ball(1, 0.5), (0.75, 0, 0))
    found = diagnose(cage, rest)
    assert found.verdict == "unfit"
    assert kinds(found) == [
        ("unfit", "outside"),
        ("unfit", "unreferenced-vertex"),
        ("warning", "inward"),
    ]
    beyond = np.flatnonzero(rest.vertices[:, 0] > 1)
    np.testing.assert_array_equal(found.findings[0].numbers, beyond)
    assert found.rest.outside == len(beyond)
    assert found.rest.weakest_vertices == ()


def test_the_worst_vertex_outside_is_measured():
    rest = moved(ball(1, 0.5), (0.75, 0, 0))
    (found,) = diagnose(box(), rest).findings
    assert found.kind == "outside"
    assert found.value == pytest.approx(100 * 0.25 / rest.diagonal)


def test_a_model_wholly_outside_has_no_clearance():
    found = diagnose(box(), moved(ball(1), (9, 0, 0)))
    assert found.rest.outside == 18
    assert found.rest.clearance is None


@pytest.mark.parametrize(
    "cage",
    [
        changed(box(), box().faces[1:]),
        changed(box(), np.vstack([box().faces, [0, 1, 1]])),
        moved(octahedron(3.0), scale=[1, 1, 0]),
    ],
    ids=["open", "a vertex twice", "no volume"],
)
def test_a_cage_without_an_inside_gives_no_facts_on_the_model(cage):
    found = diagnose(cage, ball(1, 0.5))
    assert found.verdict == "unfit"
    assert (found.rest.outside, found.rest.clearance) == (None, None)
    assert "outside" not in {finding.kind for finding in found.findings}


def test_a_pinched_cage_has_no_genus():
    assert diagnose(pinched()).cage.genus is None


def test_a_cage_of_degenerate_faces_has_no_smallest_angle():
    line = TriMesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), [[0, 1, 2]])
    facts = diagnose(line).cage
    assert (facts.smallest_angle, facts.smallest_angle_face) == (None, None)


def test_swapped_cage_and_model_are_one_finding():
    found = diagnose(ball(2), box())
    assert kinds(found) == [("unfit", "swapped")]
    assert "66 vertices is inside the other, of 8" in found.findings[0].message
    assert not found.is_repairable


def test_swapped_cage_and_model_are_suspected():
    found = diagnose(ball(2), changed(box(), vertices=box().vertices + 1.5))
    assert kinds(found)[-1] == ("note", "swapped")
    assert found.findings[-1].sentence == (
        "the cage has 66 vertices and the model 8; are they swapped?"
    )
    assert "swapped" not in {finding.kind for finding in diagnose(ball(2), box(0.2)).findings}


def test_too_many_faces_are_unfit(monkeypatch):
    monkeypatch.setattr(module, "MAX_HARMONIC_FACES", 11)
    found = diagnose(box(), ball(1, 0.5))
    assert kinds(found) == [("unfit", "too-many-faces")]
    assert found.findings[0].message == "the cage has 12 faces, at most 11 fit in memory"


def test_a_rest_pose_of_one_point_is_unfit():
    found = diagnose(box(), TriMesh(np.zeros((9, 3)), [[0, 1, 2]]))
    assert kinds(found) == [("unfit", "point")]


def test_no_repair_is_promised_to_a_cage_of_another_model():
    cage = ball(1)
    near = moved(ball(2, 0.5), (0.6, 0, 0))
    far = moved(ball(2, 0.5), (9, 2, 1), scale=[3, 0.2, 1])
    assert diagnose(cage, near).is_repairable
    misplaced = diagnose(cage, far)
    assert not misplaced.is_fit
    assert not misplaced.is_repairable
