"""Polygons cut into triangles that cover them, and nothing twice."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.base import mesh_data
from cageik_cli.formats.base.mesh_data import (
    FileMesh,
    _project_to_plane,
    check_vertex_order,
    describe_folded,
)
from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import FormatError, InputError
from tests.shapes import QUADS, ball, box, rotation

DART = [[0, 0], [2, 0], [0.5, 0.5], [0, 2]]
ELL = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
COMB = [[0, 0], [7, 0], [7, 3], [6, 3], [6, 1], [5, 1], [5, 3], [4, 3], [4, 1], [3, 1], [3, 3],
        [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]]  # fmt: skip
SPIRAL = [[0, 0], [5, 0], [5, 5], [1, 5], [1, 2], [3, 2], [3, 3], [2, 3], [2, 4], [4, 4], [4, 1],
          [0, 1]]  # fmt: skip
KEYHOLE = [[0, 0], [6, 0], [6, 6], [0, 6], [0, 0], [2, 2], [2, 4], [4, 4], [4, 2], [2, 2]]


def cut(points, start=0, seed=0):
    """The triangles of one polygon, somewhere in space, from its corner `start`; its normal."""
    turn = rotation(seed)
    flat = np.column_stack([points, np.zeros(len(points))])
    order = np.roll(np.arange(len(points)), -start)
    mesh = FileMesh.from_polygons(flat @ turn.T + [5, -3, 2], [order]).make_mesh()
    return mesh, turn[:, 2]


def area(points):
    x, y = np.array(points, float).T
    return (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def signed_areas(mesh, normal):
    a, b, c = (mesh.vertices[corner] for corner in mesh.faces.T)
    return np.cross(b - a, c - a) @ normal / 2


def assert_covered(points, start, seed):
    """Triangles that all face as the polygon does and have its area neither fold nor overlap."""
    mesh, normal = cut(points, start, seed)
    areas = signed_areas(mesh, normal)
    whole = area(points)
    assert len(areas) == len(points) - 2
    assert (areas >= -1e-9 * whole).all()
    assert areas.sum() == pytest.approx(whole, rel=1e-9)
    assert set(mesh.faces.ravel()) == set(range(len(points)))


@pytest.mark.parametrize("points", [DART, ELL, COMB, SPIRAL, KEYHOLE])
def test_concave_polygons_are_covered_once_from_whatever_corner(points):
    for start in range(len(points)):
        assert_covered(points, start, seed=start)


@given(
    st.lists(st.floats(0.1, 3.0), min_size=4, max_size=12),
    st.integers(0, 11),
    st.integers(0, 100),
)
def test_stars_are_covered_once(radii, start, seed):
    angles = np.linspace(0, 2 * np.pi, len(radii), endpoint=False)
    points = np.column_stack([np.cos(angles), np.sin(angles)]) * np.array(radii)[:, None]
    assert_covered(points, start % len(radii), seed)


def test_a_fan_would_have_folded():
    """The checks above must be able to fail: fans fail them."""
    turn = rotation(0)
    flat = np.column_stack([DART, np.zeros(4)]) @ turn.T
    fans = FileMesh.from_polygons(flat, [np.roll(np.arange(4), -1)]).fans
    assert signed_areas(TriMesh(flat, fans), turn[:, 2]).min() < 0


@pytest.mark.parametrize("corners", [3, 4, 5, 9])
def test_convex_polygons_stay_fans(corners):
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    mesh, _ = cut(np.column_stack([np.cos(angles), np.sin(angles)]), start=1)
    expected = [[1, (k + 1) % corners, (k + 2) % corners] for k in range(1, corners - 1)]
    np.testing.assert_array_equal(mesh.faces, expected)


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0], [1, 0], [2, 0], [2, 2]],  # a corner within a side
        [[0, 0], [2, 2], [2, 0], [0, 2]],  # crosses itself, and has no area
        [[0, 0], [1, 1], [1, 1], [0, 0]],  # a line
        [[0, 0], [4, 0], [0, 3], [4, 3], [2, 5]],  # crosses itself
    ],
)
def test_degenerate_polygons_give_as_many_triangles_of_their_corners(points):
    for start in range(len(points)):
        mesh, _ = cut(points, start)
        assert len(mesh.faces) == len(points) - 2
        assert set(mesh.faces.ravel()) <= set(range(len(points)))


def make_star(count, inner=0.01):
    """A polygon of long rays."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    radii = np.where(np.arange(count) % 2, 1, inner)
    return np.column_stack([np.cos(angles), np.sin(angles)]) * radii[:, None]


def make_coil(count):
    """A band of four turns."""
    angles = np.linspace(0, 8 * np.pi, count // 2)
    band = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.concatenate([band * (4 + angles)[:, None], (band * (2 + angles)[:, None])[::-1]])


@pytest.mark.parametrize("make", [make_star, make_coil])
def test_polygons_of_many_corners_are_covered_once(make):
    assert_covered(make(2000), start=1, seed=0)
    mesh, _ = cut(make(2000), start=1)
    assert describe_folded(mesh) == []


def test_a_fan_that_folds_over_is_noted(monkeypatch):
    crossing, _ = cut([[0, 0], [4, 0], [0, 3], [4, 3], [2, 5]])
    monkeypatch.setattr(mesh_data, "MAX_STEPS", 1)
    monkeypatch.setattr(mesh_data, "MAX_CORNER_STEPS", 1)
    winding, _ = cut(SPIRAL, start=5)
    for mesh in (crossing, winding):
        (note,) = describe_folded(mesh)
        assert str(note).startswith("of 1 polygon, some triangles lie over others")


def test_a_bent_quad_stays_a_fan():
    vertices = np.array([[0, 0, 0], [1, 0, 0.4], [1, 1, 0], [0, 1, 0.4]])
    mesh = FileMesh.from_polygons(vertices, [[0, 1, 2, 3]]).make_mesh()
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])


def test_the_smallest_area_has_a_direction():
    """Of a polygon that crosses itself, positive and negative parts may cancel down to it."""
    flat = _project_to_plane(
        np.array([[0, 0, 7], [1, 0, 7], [1, 1, 7.0]]), np.array([0, 0, 5e-324])
    )
    np.testing.assert_allclose(np.linalg.norm(flat, axis=1), [0, 1, np.sqrt(2)])
    assert np.linalg.det(flat[1:]) > 0


def test_triangles_stay_in_the_place_of_their_polygon():
    flat = np.column_stack([DART, np.zeros(4)])
    vertices = np.concatenate([flat, flat + np.array([9, 0, 0])])
    read = FileMesh.from_polygons(vertices, [[0, 1, 2], [5, 6, 7, 4], [0, 2, 3]])
    np.testing.assert_array_equal(read.corner_counts, [3, 4, 3])
    mesh = read.make_mesh()
    np.testing.assert_array_equal(mesh.faces[[0, 3]], read.fans[[0, 3]])
    assert {frozenset(face) for face in mesh.faces[1:3].tolist()} == {
        frozenset((4, 5, 6)),
        frozenset((4, 6, 7)),
    }


def test_a_polygon_of_two_corners_is_refused():
    with pytest.raises(FormatError, match="face 1 has 2 corners, expected 3 or more"):
        FileMesh.from_polygons(np.zeros((3, 3)), [[0, 1, 2], [0, 1]]).make_mesh()


@pytest.fixture
def refusal(tmp_path, write_obj):
    """What is said against a frame of these faces in place of a mesh; empty if it is taken."""

    def of(vertices, faces, expected):
        path = write_obj(tmp_path / "frame.obj", vertices, np.asarray(faces))
        try:
            check_vertex_order(open_sequence([str(path)]).first, expected, "the result's cage")
        except InputError as error:
            return str(error)
        return ""

    return of


def fanned(quads):
    return np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def test_the_same_faces_are_taken(refusal):
    mesh = ball(levels=1, size=1.0)
    assert refusal(3 * mesh.vertices, mesh.faces, mesh) == ""


def test_faces_in_another_order_turned_and_rotated_are_the_same(refusal):
    mesh = ball(levels=1, size=1.0)
    random = np.random.default_rng(1)
    faces = random.permutation([np.roll(f, random.integers(3)) for f in mesh.faces])
    assert refusal(mesh.vertices, faces, mesh) == ""
    assert refusal(mesh.vertices, faces[:, ::-1], mesh) == ""


@pytest.mark.parametrize("seed", range(5))
def test_quads_may_be_cut_along_either_diagonal(refusal, seed):
    cage = box(1.0)
    random = np.random.default_rng(seed)
    expected = TriMesh(cage.vertices, fanned(QUADS))
    turned = [tuple(np.roll(quad, random.integers(4))) for quad in QUADS]
    assert refusal(cage.vertices, random.permutation(turned), expected) == ""


def test_vertices_in_another_order_are_refused(refusal):
    mesh = ball(levels=1, size=1.0)
    order = np.random.default_rng(2).permutation(len(mesh.vertices))
    said = refusal(mesh.vertices[order], np.argsort(order)[mesh.faces], mesh)
    assert said.startswith("as many vertices and triangles as the result's cage")


def test_two_vertices_swapped_are_enough(refusal):
    mesh = ball(levels=1, size=1.0)
    order = np.arange(len(mesh.vertices))
    order[[3, 7]] = 7, 3
    said = refusal(mesh.vertices, order[mesh.faces], mesh)
    assert "in another order" in said


def test_quads_in_another_order_are_refused(refusal):
    cage = box(1.0)
    order = np.array([1, 0, 2, 3, 4, 5, 6, 7])
    expected = TriMesh(cage.vertices, fanned(QUADS))
    assert refusal(cage.vertices, order[np.array(QUADS)], expected) != ""


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda v, f: (v[:-1], f % (len(v) - 1)), "17 vertices, the result's cage has 18"),
        (lambda v, f: (v, f[:-1]), "31 triangles, the result's cage has 32"),
        (
            lambda v, f: (v, np.where(f == f[0, 0], f[-1, 1], f)),
            r"triangle 0 joins vertices .*, in the result's cage ",
        ),
    ],
)
def test_another_mesh_is_refused(refusal, change, says):
    mesh = ball(levels=1, size=1.0)
    assert re.search(says, refusal(*change(mesh.vertices, mesh.faces), mesh))
