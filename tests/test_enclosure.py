import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.enclosure import TOUCHING, cage_findings, check_enclosure, checked_cage
from cageik_cli.errors import InputError
from cageik_cli.mesh import TriMesh
from tests.exact import improper_pairs
from tests.shapes import ball, box, concave, finer, octahedron, rotation


def changed(mesh, faces=None, vertices=None):
    return TriMesh(
        mesh.vertices if vertices is None else vertices, mesh.faces if faces is None else faces
    )


def two_boxes(shift):
    a = box()
    return TriMesh(
        np.concatenate([a.vertices, a.vertices + shift]), np.concatenate([a.faces, a.faces + 8])
    )


def pinched():
    """Two boxes that share one corner: every edge has two faces, the corner two fans."""
    mesh = two_boxes(np.array([2.0, 2, 2]))
    shared = int(np.flatnonzero((mesh.vertices[:8] == 1).all(axis=1))[0])
    other = 8 + int(np.flatnonzero((mesh.vertices[8:] == 1).all(axis=1))[0])
    faces = np.where(mesh.faces == other, shared, mesh.faces)
    faces = np.where(faces > other, faces - 1, faces)
    return TriMesh(np.delete(mesh.vertices, other, axis=0), faces)


def zero_area():
    """A divided box with the middle of an edge moved onto its end's line, beside a corner."""
    mesh = finer(box(), 1)
    a, b, c = mesh.faces[0]
    vertices = mesh.vertices.copy()
    vertices[a] = (vertices[b] + vertices[c]) / 2
    return changed(mesh, vertices=vertices)


def crossed():
    """A divided box whose top middle is pulled out through the bottom."""
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    vertices[(vertices == [0, 0, 1]).all(axis=1), 2] = -1.5
    return changed(mesh, vertices=vertices)


def folded():
    """A box with a flat fin, neighbours on the same side of their edge."""
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    vertices[(vertices == [0, 0, 1]).all(axis=1)] = [1.5, 0, 1]
    return changed(mesh, vertices=vertices)


def unmerged():
    """A box whose faces have vertices of their own."""
    return TriMesh(box().vertices[box().faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))


FAULTS = {
    "open": (changed(box(), box().faces[2:]), r"is open: no second face at 4 edges \(.*\); close"),
    "doubled face": (
        changed(box(), np.vstack([box().faces, box().faces[:1]])),
        "has faces that repeat others: face 12; delete it",
    ),
    "third face at an edge": (
        TriMesh(np.vstack([box().vertices, [[3.0, 0, 0]]]), np.vstack([box().faces, [[0, 1, 8]]])),
        "more than two faces meet at edge 0-1",
    ),
    "repeated vertex": (
        changed(box(), np.vstack([box().faces, [[0, 0, 1]]])),
        "has a vertex twice in a face: face 12; delete it",
    ),
    "no area": (zero_area(), "degenerate, corners on a line, at face 0"),
    "two components": (two_boxes(np.array([5.0, 0, 0])), r"has 2 components \(of 8, 8 vertices\)"),
    "turned face": (
        changed(box(), np.vstack([box().faces[:1, ::-1], box().faces[1:]])),
        "has neighbours facing opposite ways at 3 edges",
    ),
    "lone vertex": (
        changed(box(), vertices=np.vstack([box().vertices, [[0, 0, 0]]])),
        "can move nothing: vertex 8; delete it",
    ),
    "pinched": (pinched(), "parts touch in a point at vertex 7"),
    "crossed": (crossed(), r"crosses or touches itself at 18 face pairs .*; move vertices until"),
    "folded": (folded(), "crosses or touches itself at"),
    "no volume": (
        changed(octahedron(), vertices=octahedron().vertices * [1, 1, 0]),
        r"bounds no volume \(0 in an area of 1\); give it thickness",
    ),
    "unmerged": (unmerged(), "36 edges .*; merge the vertices that lie at one place"),
}


@pytest.mark.parametrize(("cage", "says"), FAULTS.values(), ids=FAULTS.keys())
def test_every_fault_has_its_sentence(cage, says):
    with pytest.raises(InputError, match=says) as caught:
        checked_cage(cage)
    assert "\n" not in str(caught.value)


NUMBERS = {
    "open": {"open-edge": [[0, 1], [1, 3], [2, 3], [0, 2]]},
    "doubled face": {"duplicate-face": [12]},
    "third face at an edge": {
        "non-manifold-edge": [[0, 1]],
        "open-edge": [[1, 8], [0, 8]],
        "self-intersection": None,
    },
    "repeated vertex": {"repeated-vertex": [12]},
    "no area": {"degenerate-face": None},
    "two components": {"components": list(range(8, 16))},
    "turned face": {"orientation": [[0, 1], [1, 3], [0, 3]]},
    "lone vertex": {"unreferenced-vertex": [8]},
    "pinched": {"pinched-vertex": [7]},
    "crossed": {"self-intersection": improper_pairs(crossed())},
    "folded": {"self-intersection": improper_pairs(folded())},
    "no volume": {"no-volume": [], "self-intersection": None},
    "unmerged": {"open-edge": None},
}


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_found_with_its_numbers_and_no_other(name):
    found = {finding.kind: finding for finding in cage_findings(FAULTS[name][0])}
    assert found.keys() == NUMBERS[name].keys()
    for kind, numbers in NUMBERS[name].items():
        assert found[kind].severity == "unfit"
        if numbers is not None:
            assert sorted(found[kind].numbers.tolist()) == sorted(numbers)
            assert found[kind].elements or not numbers


def test_all_faults_of_one_cage_are_found_at_once():
    """A cage with a hole, a repeated face, a lone vertex and a second component."""
    mesh = two_boxes(np.array([5.0, 0, 0]))
    faces = np.vstack([mesh.faces[1:], mesh.faces[5:6]])
    found = cage_findings(TriMesh(np.vstack([mesh.vertices, [[9.0, 9, 9]]]), faces))
    assert [(finding.kind, finding.value) for finding in found] == [
        ("duplicate-face", 1),
        ("unreferenced-vertex", 1),
        ("open-edge", 3),
        ("components", 2),
    ]
    assert found[0].numbers.tolist() == [23]


def test_nothing_is_left_of_a_cage_of_points():
    (found,) = cage_findings(TriMesh(box().vertices, [[0, 0, 1], [2, 2, 2]]))[:1]
    assert (found.kind, found.numbers.tolist()) == ("repeated-vertex", [0, 1])


def test_a_face_without_a_plane_does_not_count_as_crossing_its_neighbours():
    """Its corner lies on a neighbour's edge; what crosses elsewhere is still found."""
    kinds = [finding.kind for finding in cage_findings(zero_area())]
    assert kinds == ["degenerate-face"]


@pytest.mark.parametrize("shift", [1e-6, -1e-6])
def test_parts_that_nearly_touch_are_told_from_those_that_cross(shift):
    """A dent whose tip ends just before the wall opposite, or just behind it."""
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    vertices[(vertices == [0, 0, 1]).all(axis=1)] = [0.3, 0.2, -1 + shift]
    found = [finding.kind for finding in cage_findings(changed(mesh, vertices=vertices))]
    assert found == ([] if shift > 0 else ["self-intersection"])


@pytest.mark.parametrize("cage", [box(), concave(), ball(1)], ids=["box", "concave", "ball"])
def test_clean_cages_pass_unchanged(cage):
    checked, notes = checked_cage(cage)
    assert checked is cage
    assert notes == ()


def test_an_inward_cage_is_turned_and_said_so():
    checked, notes = checked_cage(concave().flipped())
    assert checked.volume == pytest.approx(3)
    assert len(notes) == 1
    assert "turned outward" in notes[0]


def test_many_numbers_are_cut_to_ten():
    cage = changed(box(), vertices=np.vstack([box().vertices, np.zeros((12, 3))]))
    with pytest.raises(
        InputError, match=r"nothing: 12 vertices \(8, 9, .*, 17, \.\.\.\); delete them$"
    ):
        checked_cage(cage)


def test_vertices_outside_are_counted_measured_and_named():
    rest = ball(2, 0.9)
    vertices = rest.vertices.copy()
    vertices[5] = [1.5, 0, 0]
    vertices[7] = [0, 1.1, 0]
    rest = changed(rest, vertices=vertices)
    with pytest.raises(InputError) as caught:
        check_enclosure(box(), rest)
    worst = f"{100 * 0.5 / rest.diagonal:.3g} %"
    assert re.match(
        rf"2 of {len(vertices)} vertices .* the worst, 5, by {worst} .* 5, 7 ", str(caught.value)
    )
    assert "swapped" not in str(caught.value)


def test_a_cage_finer_than_the_model_is_asked_whether_they_are_swapped():
    with pytest.raises(InputError, match="has 66 vertices and the model 8: are they swapped"):
        check_enclosure(ball(2), box())


def test_a_vertex_outside_by_rounding_is_moved_onto_the_cage():
    rest = box(1.0)
    vertices = rest.vertices * np.where(np.arange(8) == 3, 1 + 0.1 * TOUCHING, 0.5)[:, None]
    fitted = check_enclosure(box(), changed(rest, vertices=vertices))
    np.testing.assert_allclose(fitted.points[3], rest.vertices[3], rtol=1e-15)
    np.testing.assert_array_equal(np.delete(fitted.points, 3, 0), np.delete(vertices, 3, 0))
    vertices[3] = rest.vertices[3] * (1 + 10 * TOUCHING)
    with pytest.raises(InputError, match="1 of 8 vertices"):
        check_enclosure(box(), changed(rest, vertices=vertices))


def test_vertices_outside_get_the_nearest_points_when_that_is_asked_for():
    rest = ball(1, 0.9)
    vertices = rest.vertices.copy()
    vertices[5], vertices[7] = [1.5, 0.25, 0], [0, 0.5, -2]
    held = check_enclosure(box(), changed(rest, vertices=vertices), outside="project")
    assert held.projected.tolist() == [5, 7]
    np.testing.assert_allclose(held.points[[5, 7]], [[1, 0.25, 0], [0, 0.5, -1]], atol=1e-12)
    kept = np.delete(np.arange(len(vertices)), [5, 7])
    np.testing.assert_array_equal(held.points[kept], vertices[kept])
    (note,) = held.notes
    assert note.startswith("2 of 18 vertices of the rest pose are outside the cage")
    assert "numbers 5, 7 (from 0); they have the weights of the nearest points" in note


def test_projecting_when_nothing_is_outside_says_nothing():
    held = check_enclosure(box(), ball(1, 0.9), outside="project")
    assert (held.notes, held.projected.tolist()) == ((), [])


@pytest.mark.parametrize("diagonals", [1e5, 1e9])
def test_a_model_on_its_cage_is_held_however_far_from_the_origin(diagonals):
    """Rounding grows with the coordinates: a vertex is then outside by more than `TOUCHING`."""
    rest, turn = finer(box(), 2), rotation(1)

    def moved(mesh):
        return changed(mesh, vertices=(mesh.vertices + diagonals * box().diagonal) @ turn.T)

    assert check_enclosure(moved(box()), moved(rest)).notes == ()
    stretched = changed(rest, vertices=rest.vertices * 1.001)
    with pytest.raises(InputError, match="98 of 98 vertices"):
        check_enclosure(moved(box()), moved(stretched))


def test_a_rest_pose_of_one_point_is_refused():
    with pytest.raises(InputError, match="the rest pose is one point, expected a surface"):
        check_enclosure(box(), TriMesh(np.zeros((3, 3)), [[0, 1, 2]]))


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(1e-3, 1e3), st.floats(-100, 100))
def test_the_verdict_does_not_depend_on_place_turn_or_scale(seed, scale, shift):
    turn = rotation(seed)

    def moved(mesh):
        return changed(mesh, vertices=scale * (mesh.vertices @ turn.T + shift))

    assert len(check_enclosure(moved(box()), moved(octahedron(0.9))).points) == 6
    with pytest.raises(InputError, match="6 of 6 vertices"):
        check_enclosure(moved(box()), moved(octahedron(1.1)))


MISPLACED = {
    "other units": (1000.0, np.zeros(3), r"the cage is 0\.001 times as large .* in one unit"),
    "small, beside": (0.1, np.array([5.0, 0, 0]), r"the cage is .* move a model that is to be so"),
    "moved": (1.0, np.array([5.0, 0, 0]), "their boxes do not meet: move the cage"),
    "other scale": (3.0, np.zeros(3), "most of the model is outside: give the rest pose"),
}


@pytest.mark.parametrize(("scale", "shift", "says"), MISPLACED.values(), ids=MISPLACED)
@pytest.mark.parametrize("outside", ["refuse", "project"])
def test_a_model_most_of_which_is_outside_is_told_why_and_never_projected(
    scale, shift, says, outside
):
    rest = changed(octahedron(1.0), vertices=scale * octahedron(1.0).vertices + shift)
    with pytest.raises(InputError, match=f"6 of 6 vertices .*; {says}"):
        check_enclosure(box(), rest, outside)
