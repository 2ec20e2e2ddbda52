import numpy as np
import pytest
import trimesh

from cageik_cli.geometry import surface
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import (
    closest_points,
    winding_numbers,
)
from cageik_cli.util import compiled
from tests.shapes import ball, box, concave

needs_core = pytest.mark.skipif(compiled.kernel is None, reason="the core was not compiled")


def test_nearest_point_of_a_box_is_that_of_the_formula(core):
    points = np.random.default_rng(0).uniform(-2, 2, (200, 3))
    nearest = closest_points(box(), points)
    outside = np.linalg.norm(np.maximum(np.abs(points) - 1, 0), axis=1)
    depth = 1 - np.abs(points).max(axis=1)
    expected = np.where(depth > 0, depth, outside)
    np.testing.assert_allclose(nearest.distance, expected, atol=1e-12)


def test_weights_give_the_nearest_point(core):
    mesh = concave()
    points = np.random.default_rng(1).uniform(-1, 3, (100, 3))
    nearest = closest_points(mesh, points)
    chosen = np.arange(100) % 2 == 0
    weights = nearest.barycentric_weights(chosen)
    np.testing.assert_allclose(weights @ mesh.vertices, nearest.position[chosen], atol=1e-12)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
    assert nearest.barycentric_weights(np.zeros(100, bool)).shape == (0, len(mesh.vertices))


def test_winding_numbers_tell_inside_as_trimesh_does(core):
    mesh = ball(2, 1.0)
    points = np.random.default_rng(2).uniform(-1.2, 1.2, (500, 3))
    radius = np.linalg.norm(points, axis=1)
    clear = (radius < 0.9) | (radius > 1.01)
    found = winding_numbers(mesh, points) > 0.5
    np.testing.assert_array_equal(found[clear], radius[clear] < 0.95)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight
    np.testing.assert_allclose(winding_numbers(mesh.flip(), np.zeros((1, 3))), -1, atol=1e-12)


def places_around(mesh):
    """Points off a mesh, on its faces, edges and vertices, and far from it."""
    generator = np.random.default_rng(5)
    corner = mesh.vertices[mesh.faces]
    return np.concatenate(
        [
            generator.uniform(-3, 3, (333, 3)),
            corner.mean(axis=1),
            corner[:, :2].mean(axis=1),
            mesh.vertices,
            1e4 * generator.normal(size=(20, 3)),
        ]
    )


def shuffled(mesh):
    """The same faces without any order of place."""
    return TriMesh(mesh.vertices, np.random.default_rng(8).permutation(mesh.faces))


@needs_core
@pytest.mark.parametrize(
    "mesh",
    [box(), concave(), ball(1), shuffled(ball(4))],
    ids=["box", "concave", "ball", "shuffled"],
)
def test_the_compiled_bodies_give_what_the_trees_give(mesh, monkeypatch):
    points = places_around(mesh)
    off = closest_points(mesh, points).distance > 1e-9
    found, windings = closest_points(mesh, points), winding_numbers(mesh, points[off])
    monkeypatch.setattr(surface, "MAX_WINDING_PAIRS", 0)
    monkeypatch.setattr(surface, "MAX_BOXED_PAIRS", 0)
    expected = closest_points(mesh, points)
    np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-12, atol=1e-14)
    at = np.linalg.norm(found.position - points, axis=1)
    np.testing.assert_allclose(at, expected.distance, rtol=1e-12, atol=1e-14)
    weights = found.barycentric_weights(np.ones(len(points), bool))
    np.testing.assert_allclose(weights @ mesh.vertices, found.position, atol=1e-11)
    np.testing.assert_allclose(windings, winding_numbers(mesh, points[off]), atol=1e-12)


@needs_core
def test_blocks_of_points_change_nothing(monkeypatch):
    mesh = ball(2)
    points = places_around(mesh)
    whole = closest_points(mesh, points), winding_numbers(mesh, points)
    monkeypatch.setattr(surface, "MAX_THREAD_PAIRS", 7 * len(mesh.faces))
    monkeypatch.setattr(surface, "MAX_THREAD_POINTS", 7)
    parts = closest_points(mesh, points), winding_numbers(mesh, points)
    np.testing.assert_array_equal(whole[0].position, parts[0].position)
    np.testing.assert_array_equal(whole[0].face, parts[0].face)
    np.testing.assert_array_equal(whole[1], parts[1])


def test_the_order_of_points_and_faces_changes_nothing(monkeypatch):
    mesh, points = ball(2), places_around(ball(2))
    found = []
    for most in (0, 10**9):
        monkeypatch.setattr(surface, "MAX_UNSORTED_PAIRS", most)
        found.append(closest_points(mesh, points))
    np.testing.assert_array_equal(found[0].distance, found[1].distance)
    np.testing.assert_array_equal(found[0].face, found[1].face)
    np.testing.assert_array_equal(found[0].position, found[1].position)


@needs_core
def test_of_faces_that_are_equally_close_the_first_is_named():
    mesh = box()
    for faces in (mesh.faces, mesh.faces[::-1]):
        turned = TriMesh(mesh.vertices, faces)
        corners = 2 * mesh.vertices
        first = [np.flatnonzero((faces == k).any(axis=1))[0] for k in range(8)]
        np.testing.assert_array_equal(closest_points(turned, corners).face, first)


@needs_core
def test_faces_in_far_boxes_are_not_looked_at():
    """A box that says that its faces are far hides them."""
    mesh = ball(2)
    faces, (names, boxes) = surface._box_faces(mesh.vertices, mesh.faces, is_sorted=True)
    points = 1.01 * mesh.vertices[:64]
    squares, nearest = np.empty(64), np.empty(64, np.int64)
    arguments = points, mesh.vertices, faces
    compiled.kernel.closest_points(*arguments, (names, boxes), squares, nearest, np.empty((64, 3)))
    hidden = np.unique(nearest)
    boxes[np.isin(names, hidden).reshape(-1, surface.FACES_PER_BOX).any(axis=1)] = 1e3
    other = np.empty(64, np.int64)
    compiled.kernel.closest_points(*arguments, (names, boxes), squares, other, np.empty((64, 3)))
    assert not np.isin(other, hidden).any()


def test_a_face_without_area_is_a_segment_or_a_point(core):
    line = TriMesh([[0, 0, 0], [1, 0, 0], [3, 0, 0]], [[0, 1, 2]])
    point = TriMesh([[1, 2, 3]] * 3, [[0, 1, 2]])
    found = closest_points(line, np.array([[2.0, 1, 0], [-1, 0, 0], [5, 0, 0]]))
    np.testing.assert_allclose(found.position, [[2, 0, 0], [0, 0, 0], [3, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(closest_points(point, np.zeros((1, 3))).distance, np.sqrt(14))


def thin_face(kind, generator):
    """Three corners on a line, some at one place, or less than 10^-2 off that."""
    corners = generator.normal(size=3) + generator.normal(size=(3, 1)) * generator.normal(size=3)
    if kind in ("needle", "two at one place"):
        corners = generator.normal(size=(3, 3))
        first, second, _ = generator.permutation(3)
        corners[first] = corners[second]
    if kind == "one place":
        corners[:] = corners[0]
    if kind in ("sliver", "needle"):
        corners += 10 ** generator.uniform(-18, -2) * generator.normal(size=(3, 3))
    return TriMesh(corners, [[0, 1, 2]])


@pytest.mark.parametrize("kind", ["line", "two at one place", "one place", "sliver", "needle"])
def test_weights_in_thin_faces_give_the_nearest_point(core, kind):
    generator = np.random.default_rng(11)
    for _ in range(200):
        mesh = thin_face(kind, generator)
        within = generator.dirichlet([1, 1, 1], 20) @ mesh.vertices
        points = np.concatenate([3 * generator.normal(size=(20, 3)), within, mesh.vertices])
        nearest = closest_points(mesh, points)
        weights = nearest.barycentric_weights(np.ones(len(points), bool))
        np.testing.assert_allclose(weights @ mesh.vertices, nearest.position, atol=4e-12)
        np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
        assert weights.min() > -1e-9
        assert weights.max() < 1 + 1e-9


@needs_core
@pytest.mark.parametrize("kind", ["line", "two at one place", "one place", "sliver", "needle"])
def test_points_of_thin_faces_are_closest_to_themselves(kind):
    generator = np.random.default_rng(12)
    for _ in range(200):
        mesh = thin_face(kind, generator)
        points = np.concatenate([generator.dirichlet([1, 1, 1], 29) @ mesh.vertices, mesh.vertices])
        assert closest_points(mesh, points).distance.max() < 1e-14


def test_no_points_have_no_closest_points(core):
    found = closest_points(box(), np.zeros((0, 3)))
    assert found.position.shape == (0, 3)
    assert winding_numbers(box(), np.zeros((0, 3))).shape == (0,)


@needs_core
def test_the_compiled_functions_refuse_what_does_not_fit():
    points, mesh = np.zeros((4, 3)), box()
    vertices, beyond = mesh.vertices, mesh.faces + 1
    distances, results = np.empty(4), (np.empty(4, np.int64), np.empty((4, 3)))
    faces, (names, boxes) = surface._box_faces(mesh.vertices, mesh.faces, is_sorted=True)
    closest = compiled.kernel.closest_points
    for wanted, says in (
        ((beyond, (names, boxes), distances), "faces: number 8, expected 0 to 7"),
        ((faces, (names[1:], boxes), distances), "names: length 11"),
        ((faces, (names, boxes[1:]), distances), "boxes: length 1"),
        ((faces, (names, boxes), distances[1:]), "squares: length 3"),
        ((faces, (-1 - names, boxes), distances), "names: number -"),
    ):
        with pytest.raises(ValueError, match=says):
            closest(points, vertices, *wanted, *results)
    with pytest.raises(TypeError, match="tuple"):
        closest(points, vertices, faces, [names, boxes], distances, *results)
    fixed = np.empty(4)
    fixed.flags.writeable = False
    for kind, given, indices, winding, says in (
        (ValueError, points, beyond, distances, "faces: number 8, expected 0 to 7"),
        (ValueError, points, mesh.faces, distances[1:], "winding: length 3"),
        (TypeError, points.astype(int), mesh.faces, distances, "points: expected an array of floa"),
        (TypeError, np.zeros((3, 4)).T, mesh.faces, distances, "^points: expected a C-contiguous"),
        (TypeError, None, mesh.faces, distances, "^points: expected a C-contiguous array$"),
        (TypeError, points, mesh.faces, fixed, "^winding: .* array that can be written$"),
    ):
        with pytest.raises(kind, match=says):
            compiled.kernel.winding_numbers(given, vertices, indices, winding)


def differences(mesh, points, step):
    """How barycentric coordinates of the closest points change, by differences, (m, 3, 3)."""
    everything = np.ones(len(points), bool)
    pairs = [
        [
            closest_points(mesh, places).barycentric_coordinates(everything)
            for places in (points + s, points - s)
        ]
        for s in step * np.eye(3)
    ]
    return np.stack([(after - before) / (2 * step) for after, before in pairs], axis=2)


def test_coordinates_change_as_their_differences():
    """Above the face, beyond its sides and corners; with those of the face, the last two fail."""
    mesh = TriMesh([[0, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    points = np.array([[0.5, 0.3, 0.2], [1, -0.5, 0.1], [3, -0.1, 0]])
    nearest = closest_points(mesh, points)
    coordinates = nearest.barycentric_coordinates(np.ones(3, bool))
    found = nearest.differentiate_coordinates(coordinates)
    np.testing.assert_allclose(found, differences(mesh, points, 1e-4), rtol=0, atol=1e-9)
    assert not found[2].any()
    in_face = nearest.differentiate_coordinates(np.full((3, 3), 1 / 3))
    assert (abs(in_face - found).max(axis=(1, 2)) > 0.1).tolist() == [False, True, True]


@pytest.mark.parametrize("height", [0.0, 1e-12, 1e-200])
def test_coordinates_in_thin_faces_change_along_their_longest_side(height):
    mesh = TriMesh([[0, 0, 0], [1, height, 0], [2, 0, 0], [0, 5, 5]], [[0, 1, 2], [0, 0, 0]])
    nearest = closest_points(mesh, np.array([[0.5, 0, 0.1], [1.5, -0.1, 0.0]]))
    coordinates = nearest.barycentric_coordinates(np.ones(2, bool))
    found = nearest.differentiate_coordinates(coordinates)
    np.testing.assert_allclose(found[:, :, 0], [[-0.5, 0, 0.5]] * 2, rtol=0, atol=1e-9)
    assert abs(found).max() <= 0.5 + 1e-9
