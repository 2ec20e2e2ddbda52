import numpy as np
import pytest

from cageik_cli.cages.bind import bind, judge_binding
from cageik_cli.cages.builder.build import build_cage
from cageik_cli.cages.check.enclosure import locate_vertices
from cageik_cli.cages.check.quality import (
    MIN_ANGLE,
    MIN_CLEARANCE,
    MIN_INFLUENCE,
    MIN_MODEL_VERTICES,
    MIN_SHEET_RATIO,
    find_looseness_faults,
    find_low_clearance,
    find_needle_faces,
    find_surface_crossings,
    find_thin_parts,
    find_weak_vertices,
    is_too_loose,
)
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.cages.transform import MAX_SIZE_RATIO
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.settings import BindSettings
from tests.cages.check.test_sections import trousers
from tests.shapes import ball, box, concave, finer, rotation
from tests.texts import texts


def scaled(mesh, *factors):
    return TriMesh(mesh.vertices * factors, mesh.faces)


def only(findings):
    (finding,) = findings
    assert finding.severity == "warning"
    return finding


@pytest.mark.parametrize(("share", "found"), [(0.9, True), (1.1, False)])
def test_faces_with_small_angles_are_found(share, found):
    """The walls of a long box have the angle whose tangent is its height over its length."""
    length = 1 / np.tan(np.radians(share * MIN_ANGLE))
    findings = list(find_needle_faces(scaled(box(), length, 1, 1)))
    assert len(findings) == found
    if found:
        needle = only(findings)
        assert needle.value == pytest.approx(share * MIN_ANGLE)
        assert needle.numbers.tolist() == list(range(4, 12))
        assert "angles below 2 degrees at 8 faces" in needle.message
        assert "the smallest 1.8 degrees at face" in needle.message


def test_a_degenerate_face_is_no_needle():
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    a, b, c = mesh.faces[0]
    vertices[a] = (vertices[b] + vertices[c]) / 2
    flat = TriMesh(vertices, mesh.faces)
    assert not any(0 in finding.numbers for finding in find_needle_faces(flat))


@pytest.mark.parametrize(("share", "found"), [(0.9, True), (1.1, False)])
def test_sheets_close_to_each_other_are_found(share, found):
    """A slab of 16 faces a side, each of area 1/2."""
    slab = scaled(finer(box(), 1), 1, 1, share * MIN_SHEET_RATIO * np.sqrt(0.5) / 2)
    findings = list(find_thin_parts(slab))
    assert len(findings) == found
    if found:
        thin = only(findings)
        assert thin.value == pytest.approx(share * MIN_SHEET_RATIO)
        heights = slab.vertices[slab.faces[thin.numbers]][..., 2].mean(axis=2)
        np.testing.assert_array_equal(np.sign(heights[:, 0]), -np.sign(heights[:, 1]))
        assert len(np.unique(thin.numbers, axis=0)) == len(thin.numbers)


@pytest.mark.parametrize(("share", "found"), [(0.9, True), (1.1, False), (0.0, True)])
def test_vertices_near_the_cage_are_found(share, found):
    rest = ball(1, 0.5)
    vertices = rest.vertices.copy()
    reach = MIN_CLEARANCE * share * np.linalg.norm(np.ptp(vertices, axis=0))
    for _ in range(20):  # the diagonal depends on the vertex that is moved
        vertices[4, 0] = 1 - reach
        vertices[4, 1:] = [0.1, 0.2]
        reach = MIN_CLEARANCE * share * np.linalg.norm(np.ptp(vertices, axis=0))
    moved = TriMesh(vertices, rest.faces)
    findings = list(find_low_clearance(locate_vertices(box(), moved)))
    assert len(findings) == found
    if found:
        near = only(findings)
        assert near.numbers.tolist() == [4]
        assert near.value == pytest.approx(100 * MIN_CLEARANCE * share, rel=1e-6)
        face = int(near.message.rsplit(" ", 1)[1])
        assert (box().vertices[box().faces[face]][:, 0] == 1).all()


def across_the_corner(depth):
    """A slim prism from one arm of the L to the other; its vertices are inside the cage."""
    ring = np.array([[0.0, 0], [0.05, 0], [0, 0.05]]) + 0.3
    start = np.column_stack([np.full(3, 1.9), ring + np.array([depth, 0])])
    stop = np.column_stack([ring[:, 0] + depth, np.full(3, 1.9), ring[:, 1]])
    sides = [
        f
        for k in range(3)
        for f in ([k, (k + 1) % 3, k + 3], [(k + 1) % 3, (k + 1) % 3 + 3, k + 3])
    ]
    return TriMesh(np.concatenate([start, stop]), np.array([[0, 2, 1], [3, 4, 5], *sides]))


def test_a_surface_that_crosses_the_cage_is_found():
    rest = across_the_corner(0.5)
    placement = locate_vertices(concave(), rest)
    assert len(placement.outside_indices) == 0
    crossing = only(find_surface_crossings(placement))
    assert set(crossing.numbers[:, 0].tolist()) <= set(range(2, 8))
    walls = concave().vertices[concave().faces[np.unique(crossing.numbers[:, 1])]]
    assert ((walls[:, :, 0] == 1).all(axis=1) | (walls[:, :, 1] == 1).all(axis=1)).all()
    assert crossing.value == len(crossing.numbers)
    assert "pairs of a rest and a cage face" in crossing.message


def test_a_surface_inside_does_not_cross():
    rest = TriMesh(0.4 * across_the_corner(0.3).vertices + 0.05, across_the_corner(0.3).faces)
    assert list(find_surface_crossings(locate_vertices(concave(), rest))) == []


def test_faces_with_a_vertex_outside_are_no_crossings():
    rest = TriMesh(ball(1, 0.9).vertices * 1.5, ball(1).faces)
    placement = locate_vertices(box(), rest)
    outside = set(placement.outside_indices.tolist())
    assert outside
    for finding in find_surface_crossings(placement):
        assert not outside & set(rest.faces[finding.numbers[:, 0]].ravel().tolist())


def test_vertices_without_influence_are_found():
    weak = only(
        find_weak_vertices(
            np.array([0.5, 0.9 * MIN_INFLUENCE, 1.1 * MIN_INFLUENCE, 0.2 * MIN_INFLUENCE])
        )
    )
    assert weak.numbers.tolist() == [1, 3]
    assert weak.value == pytest.approx(0.2 * MIN_INFLUENCE)
    assert "2 vertices (1, 3), the smallest, 0.01, at vertex 3" in weak.message
    assert list(find_weak_vertices(np.array([0.5, 1.1 * MIN_INFLUENCE]))) == []


def placed(mesh, factor, middle):
    return TriMesh(factor * mesh.vertices + middle, mesh.faces)


def room_faults(cage, rest):
    return [finding.kind for finding in find_looseness_faults(cage, rest)]


MODEL = ball(4)


@pytest.mark.parametrize(("size", "found"), [(1.06, []), (1.15, ["loose"])])
def test_a_loose_cage_is_found(size, found):
    assert room_faults(scaled(ball(3), *[size] * 3), MODEL) == found


def test_a_loose_cage_that_was_built_needs_more_vertices():
    (given,), (built,) = (find_looseness_faults(box(2.0), MODEL, is_built=b) for b in (False, True))
    assert given.message == built.message
    assert "cageik cage" in given.remedy
    assert built.remedy == "raise `cage_vertices=`"


def test_the_warning_has_the_ratio_of_volumes_and_what_a_built_cage_has():
    (loose,) = find_looseness_faults(box(2.0), MODEL)
    assert loose.severity == "warning"
    ratio = 64 / MODEL.volume
    assert f"{ratio:.3g} times the model's volume" in loose.message
    # 16.5 % / sqrt(60) of the diagonal, all over a sphere of this area and volume.
    gap = 0.165 / np.sqrt(60)
    layer = 3 * gap * MODEL.diagonal / 0.5
    assert (
        f"of 60 vertices typically has {1 + layer:.2g} times and {100 * gap:.2g} %" in loose.message
    )
    assert 150 < loose.value * MODEL.diagonal < 300


def test_an_open_model_has_a_mean_gap_only():
    opened = TriMesh(MODEL.vertices, MODEL.faces[1:])
    (loose,) = find_looseness_faults(box(2.0), opened)
    assert "volume" not in loose.message


def test_a_closed_model_that_is_flat_has_a_mean_gap_only():
    flat = TriMesh(MODEL.vertices * [1, 1, 0] @ rotation(1).T, MODEL.faces)
    assert flat.volume != 0
    (loose,) = find_looseness_faults(box(2.0), flat)
    assert "volume" not in loose.message


def test_a_model_of_few_vertices_is_not_judged():
    assert len(ball(2).vertices) < MIN_MODEL_VERTICES
    assert room_faults(box(2.0), ball(2)) == []


@pytest.mark.parametrize(("share", "found"), [(1.1, True), (0.9, False)])
def test_a_cage_in_another_unit_is_found(share, found):
    findings = list(find_looseness_faults(box(share * MAX_SIZE_RATIO), box(1.0)))
    assert len(findings) == found
    if found:
        (large,) = findings
        assert large.value == pytest.approx(share * MAX_SIZE_RATIO)
        assert "5.5 times" in large.message


def test_the_unit_of_a_cage_that_fits_otherwise_is_named():
    (large,) = find_looseness_faults(scaled(ball(2), 110.0, 110.0, 110.0), ball(3))
    assert "in centimetres instead of metres" in large.remedy


@pytest.mark.parametrize(("gap", "found"), [(0.5, True), (0.02, False)])
def test_limbs_in_one_loop_are_found_where_they_are(gap, found):
    model = finer(trousers(gap), 4)
    cage = placed(box(), 1.4, [1 + gap / 2, 1, 0.5])
    shared = [
        finding for finding in find_looseness_faults(cage, model) if finding.kind == "shared-loop"
    ]
    assert bool(shared) == found
    if found:
        assert shared[0].severity == "warning"
        assert "2 limbs" in shared[0].message
        np.testing.assert_allclose(shared[0].place, [1.25, 0.4, 0.5], rtol=0, atol=0.15)


@pytest.mark.slow
def test_a_built_cage_has_no_fault():
    model = finer(trousers(0.5), 4)
    assert room_faults(build_cage(model, BuildSettings(vertices=120)).cage, model) == []


def test_a_binding_has_the_warnings_unless_vertices_are_outside():
    settings = BindSettings("mean-value", outside="project")
    binding = bind(MODEL, box(1.5), settings)
    expected = tuple(fault.sentence for fault in find_looseness_faults(box(1.5), MODEL))
    assert tuple(note.text for note in judge_binding(binding).cage_warnings) == expected
    assert texts(binding.notes) == ()
    moved = placed(box(), 1.5, [1.2, 0, 0])
    assert judge_binding(bind(MODEL, moved, settings)).cage_warnings == ()


@pytest.mark.parametrize("scale", [1.5, 1.05])
def test_a_binding_knows_whether_its_cage_is_loose(scale):
    binding = bind(MODEL, box(scale), BindSettings("mean-value"))
    assert judge_binding(binding).has_loose_cage is is_too_loose(box(scale), MODEL)
