from fractions import Fraction

import numpy as np
import pytest

from cageik_cli.geometry import intersections
from cageik_cli.geometry.intersections import (
    crossing_face_pairs,
    segments_meet,
    self_intersections,
    triangles_meet,
)
from cageik_cli.geometry.mesh import TriMesh
from tests.exact import common_points, improper_pairs, meet_improperly
from tests.shapes import ball, box, concave, finer, rotation

SHARING = {
    "nothing": np.array([[0, 1, 2], [3, 4, 5]]),
    "a vertex": np.array([[0, 1, 2], [4, 3, 0]]),
    "an edge": np.array([[0, 1, 2], [1, 0, 3]]),
}


def have_area(vertices, faces):
    a, b, c = (vertices[:, faces[:, k]] for k in range(3))
    return (np.cross(b - a, c - a) != 0).any(axis=2).all(axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("faces", SHARING.values(), ids=SHARING)
@pytest.mark.parametrize("size", [2, 3, 4])
def test_pairs_on_a_grid_are_judged_as_rational_arithmetic_does(faces, size):
    """A small grid is full of corners on edges, edges on edges, and planes that are one."""
    vertices = np.random.default_rng(size).integers(0, size, (150, faces.max() + 1, 3))
    vertices = vertices[have_area(vertices, faces)].astype(float)
    expected = [meet_improperly(v, *faces) for v in vertices]
    found = [len(self_intersections(TriMesh(v, faces))) == 1 for v in vertices]
    assert found == expected
    assert 3 <= sum(expected) <= len(expected) - 3


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e6])
def test_pairs_that_touch_but_for_rounding_are_judged_exactly(offset):
    """A corner of one near the other's plane, side or within: rounded, it is on either side."""
    random = np.random.default_rng(7)
    a, b = random.normal(size=(2, 300, 3, 3)) + offset
    share = random.dirichlet([1, 1, 1], 300)
    share[100:200, 2] = 0
    b[:200, 0] = np.einsum("kc,kcx->kx", share[:200], a[:200])
    middle = (a[200:, 0] + a[200:, 1]) / 2
    b[200:, 1] = 2 * middle - b[200:, 0]
    expected = [bool(common_points(p, q)) for p, q in zip(a, b, strict=True)]
    np.testing.assert_array_equal(triangles_meet(a, b), expected)
    np.testing.assert_array_equal(triangles_meet(b, a), expected)
    assert 0 < sum(expected[:200]) < 200


@pytest.mark.parametrize("size", [3, 5, 9])
def test_a_soup_gives_every_pair(size):
    random = np.random.default_rng(size)
    vertices = random.integers(0, size, (30, 3)).astype(float)
    faces = np.array([random.choice(30, 3, replace=False) for _ in range(25)])
    faces = faces[[have_area(vertices[None], face[None])[0] for face in faces]]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    soup = TriMesh(vertices, faces[first])
    assert self_intersections(soup).tolist() == improper_pairs(soup)


@pytest.mark.slow
def test_blocks_change_nothing():
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    vertices[8:] *= -1.5
    crossed = TriMesh(vertices, mesh.faces)
    whole = self_intersections(crossed)
    np.testing.assert_array_equal(self_intersections(crossed, block_size=7), whole)
    assert whole.tolist() == improper_pairs(crossed)


@pytest.mark.parametrize("mesh", [box(), finer(box(), 2), concave(), finer(concave(), 1), ball(2)])
def test_clean_surfaces_do_not_meet_themselves(mesh):
    """With neighbours in a plane, at a sharp edge, at a common vertex; turned and far away too."""
    for vertices in (mesh.vertices, mesh.vertices @ rotation(1).T, mesh.vertices + 1e6):
        assert self_intersections(TriMesh(vertices, mesh.faces)).shape == (0, 2)


@pytest.mark.parametrize("gap", [1e-6, 1e-15])
def test_sheets_close_to_each_other_do_not_meet(gap):
    flat = TriMesh(finer(box(), 1).vertices * [1, 1, gap], finer(box(), 1).faces)
    assert len(self_intersections(flat)) == 0


def test_degenerate_triangles_meet_by_their_edges():
    """A triangle without area is a segment: it meets where the segment does."""
    needle = np.array([[[0.0, 0, -1], [0, 0, 1], [0, 0, 0.5]], [[0.0, 0, 1], [0, 0, 2], [0, 0, 3]]])
    plane = np.array([[[-1.0, -1, 0], [2, -1, 0], [-1, 2, 0]]] * 2)
    np.testing.assert_array_equal(triangles_meet(needle, plane), [True, False])
    np.testing.assert_array_equal(triangles_meet(plane, needle), [True, False])


@pytest.mark.parametrize(
    ("start", "stop", "meets"),
    [
        ([-2, 0, 0], [-1, 0, 0], False),
        ([-2, 0, 0], [0, 0, 0], True),
        ([-2, 0, 0], [9, 0, 0], True),
        ([5, 0, 0], [9, 0, 0], False),
        ([1, 1, 0], [1, 1, 0], True),
        ([9, 9, 0], [9, 9, 0], False),
        ([-1, 1, 0], [1, -1, 0], True),
        ([-1, 0.5, 0], [0.5, -1, 0], False),
    ],
)
def test_segments_in_the_plane(start, stop, meets):
    triangle = np.array([[[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]])
    for axes in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):
        ends = (np.array([end], float)[:, axes] for end in (start, stop))
        assert segments_meet(*ends, triangle[:, :, axes]).tolist() == [meets]


def test_crossings_are_the_pairs_that_pass_through_each_other():
    turned = TriMesh(1.1 * box().vertices @ rotation(4).T, box().faces)
    pairs = [
        [i, j]
        for i in range(12)
        for j in range(12)
        if common_points(turned.vertices[turned.faces[i]], box().vertices[box().faces[j]])
    ]
    assert len(pairs) > 10
    assert crossing_face_pairs(turned, box(), 0.0).tolist() == pairs


@pytest.mark.parametrize("lift", [-1e-9, 0, 1e-9])
def test_surfaces_that_touch_but_for_rounding_do_not_cross(lift):
    inner = TriMesh(finer(box(), 1).vertices * (1 + lift), finer(box(), 1).faces)
    assert len(crossing_face_pairs(inner, box(), 1e-8)) == 0


def test_faces_that_straddle_each_other_and_meet_in_a_point_do_not_cross():
    """As at a vertex where faces of a surface meet that are no neighbours."""
    tip = np.zeros((1, 3))
    one = TriMesh(np.vstack([tip, [[1.0, 1, 0], [1, -1, 0]]]), [[0, 1, 2]])
    other = TriMesh(np.vstack([tip, [[-1.0, 0, 1], [-1, 0, -1]]]), [[0, 1, 2]])
    assert len(crossing_face_pairs(one, other, 0.0)) == 0
    moved = TriMesh(other.vertices + np.array([1e-3, 0, 0]), other.faces)
    assert crossing_face_pairs(one, moved, 0.9e-3).tolist() == [[0, 0]]
    assert len(crossing_face_pairs(one, moved, 1.1e-3)) == 0


def test_a_surface_divided_on_itself_does_not_cross_itself():
    mesh = concave()
    turned = TriMesh(mesh.vertices @ rotation(3).T, mesh.faces)
    assert len(crossing_face_pairs(finer(turned, 2), turned, 1e-8)) == 0


def test_surfaces_apart_have_no_crossings():
    assert crossing_face_pairs(box(0.5), box(), 0.0).shape == (0, 2)


@pytest.mark.parametrize("limit", [0, 1000])
@pytest.mark.parametrize(
    "mesh", [ball(2), concave(), finer(box(), 2)], ids=["ball", "concave", "box"]
)
def test_boxes_and_the_tree_find_the_same_pairs(mesh, limit, monkeypatch):
    """Two meshes in one, that pass through each other."""
    moved = mesh.vertices @ rotation(3).T * 0.9 + 0.1
    faces = np.concatenate([mesh.faces, mesh.faces + len(moved)])
    both = TriMesh(np.concatenate([mesh.vertices, moved]), faces)
    expected = self_intersections(both)
    monkeypatch.setattr(intersections, "MAX_COMPARED_FACES", limit)
    np.testing.assert_array_equal(self_intersections(both), expected)
    assert len(expected)


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1.0, 1e30])
@pytest.mark.parametrize("step", [0.0, 2.0**-52, 1e-14])
def test_the_side_of_a_plane_is_exact_where_rounding_would_decide(scale, step):
    """Points in a plane, and moved off it by less than the products of coordinates round."""
    generator = np.random.default_rng(5)
    a, b, c = generator.normal(size=(3, 400, 3))
    share = generator.uniform(size=(2, 400, 1))
    point = a + share[0] * (b - a) + share[1] * (c - a)
    point[:, 0] *= 1 + step
    rows = [scale * p for p in (a, b, c, point)]
    found = intersections._side_of_plane(*rows)
    expected = [_exact_side(*corners) for corners in zip(*rows, strict=True)]
    assert found.tolist() == expected
    assert len(set(expected)) > 1


def _exact_side(*points):
    """The sign of a determinant of rational numbers."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz), (x, y, z) = (
        [Fraction(float(number)) for number in point] for point in points
    )
    ax, ay, az, bx, by, bz = ax - x, ay - y, az - z, bx - x, by - y, bz - z
    cx, cy, cz = cx - x, cy - y, cz - z
    value = cx * (ay * bz - az * by) + cy * (az * bx - ax * bz) + cz * (ax * by - ay * bx)
    return (value > 0) - (value < 0)
