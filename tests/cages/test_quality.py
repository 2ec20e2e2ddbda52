import numpy as np
import pytest

from cageik_cli.cages.enclosure import place
from cageik_cli.cages.quality import (
    LARGEST,
    NEAREST,
    SHARPEST,
    THINNEST_PART,
    WEAKEST,
    clearance_findings,
    crossing_findings,
    influence_findings,
    needle_findings,
    size_findings,
    thin_findings,
)
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import ball, box, concave, finer


def scaled(mesh, *factors):
    return TriMesh(mesh.vertices * factors, mesh.faces)


def only(findings):
    (finding,) = findings
    assert finding.severity == "usable"
    return finding


@pytest.mark.parametrize(("share", "found"), [(0.9, True), (1.1, False)])
def test_angles_below_the_limit_are_needles(share, found):
    """The walls of a long box have the angle whose tangent is its height over its length."""
    length = 1 / np.tan(np.radians(share * SHARPEST))
    findings = list(needle_findings(scaled(box(), length, 1, 1)))
    assert len(findings) == found
    if found:
        needle = only(findings)
        assert needle.value == pytest.approx(share * SHARPEST)
        assert needle.numbers.tolist() == list(range(4, 12))
        assert "angles below 2 degrees at 8 faces" in needle.message
        assert "the smallest 1.8 degrees at face" in needle.message


def test_a_face_without_a_plane_is_no_needle():
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    a, b, c = mesh.faces[0]
    vertices[a] = (vertices[b] + vertices[c]) / 2
    flat = TriMesh(vertices, mesh.faces)
    assert not any(0 in finding.numbers for finding in needle_findings(flat))


@pytest.mark.parametrize(("share", "found"), [(0.9, True), (1.1, False)])
def test_sheets_nearer_than_the_limit_are_thin(share, found):
    """A slab of 16 faces a side, each of area 1/2."""
    slab = scaled(finer(box(), 1), 1, 1, share * THINNEST_PART * np.sqrt(0.5) / 2)
    findings = list(thin_findings(slab))
    assert len(findings) == found
    if found:
        thin = only(findings)
        assert thin.value == pytest.approx(share * THINNEST_PART)
        heights = slab.vertices[slab.faces[thin.numbers]][..., 2].mean(axis=2)
        np.testing.assert_array_equal(np.sign(heights[:, 0]), -np.sign(heights[:, 1]))
        assert len(np.unique(thin.numbers, axis=0)) == len(thin.numbers)


@pytest.mark.parametrize(("share", "found"), [(0.9, True), (1.1, False), (0.0, True)])
def test_vertices_near_the_cage_are_found(share, found):
    rest = ball(1, 0.5)
    vertices = rest.vertices.copy()
    reach = NEAREST * share * np.linalg.norm(np.ptp(vertices, axis=0))
    for _ in range(20):  # the diagonal depends on the vertex that is moved
        vertices[4, 0] = 1 - reach
        vertices[4, 1:] = [0.1, 0.2]
        reach = NEAREST * share * np.linalg.norm(np.ptp(vertices, axis=0))
    moved = TriMesh(vertices, rest.faces)
    findings = list(clearance_findings(place(box(), moved), moved))
    assert len(findings) == found
    if found:
        near = only(findings)
        assert near.numbers.tolist() == [4]
        assert near.value == pytest.approx(100 * NEAREST * share, rel=1e-6)
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


def test_a_surface_that_leaves_between_its_vertices_is_found():
    rest = across_the_corner(0.5)
    placement = place(concave(), rest)
    assert len(placement.far) == 0
    crossing = only(crossing_findings(placement, rest))
    assert set(crossing.numbers[:, 0].tolist()) <= set(range(2, 8))
    walls = concave().vertices[concave().faces[np.unique(crossing.numbers[:, 1])]]
    assert ((walls[:, :, 0] == 1).all(axis=1) | (walls[:, :, 1] == 1).all(axis=1)).all()
    assert crossing.value == len(crossing.numbers)
    assert "pairs of a rest and a cage face" in crossing.message


def test_a_surface_inside_does_not_cross():
    rest = TriMesh(0.4 * across_the_corner(0.3).vertices + 0.05, across_the_corner(0.3).faces)
    assert list(crossing_findings(place(concave(), rest), rest)) == []


def test_faces_with_a_vertex_outside_are_no_crossing_of_their_own():
    rest = TriMesh(ball(1, 0.9).vertices * 1.5, ball(1).faces)
    placement = place(box(), rest)
    outside = set(placement.far.tolist())
    assert outside
    for finding in crossing_findings(placement, rest):
        assert not outside & set(rest.faces[finding.numbers[:, 0]].ravel().tolist())


def test_vertices_without_influence_are_found():
    weak = only(influence_findings(np.array([0.5, 0.9 * WEAKEST, 1.1 * WEAKEST, 0.2 * WEAKEST])))
    assert weak.numbers.tolist() == [1, 3]
    assert weak.value == pytest.approx(0.2 * WEAKEST)
    assert "2 vertices (1, 3), the weakest with 0.01 vertex 3" in weak.message
    assert list(influence_findings(np.array([0.5, 1.1 * WEAKEST]))) == []


@pytest.mark.parametrize(("share", "found"), [(1.1, True), (0.9, False)])
def test_a_cage_in_another_unit_is_found(share, found):
    findings = list(size_findings(box(share * LARGEST), box(1.0)))
    assert len(findings) == found
    if found:
        large = only(findings)
        assert large.value == pytest.approx(share * LARGEST)
        assert large.message == "the cage is 5.5 times as large as the model, expected at most 5"
        assert large.remedy.startswith("export both in one unit")
