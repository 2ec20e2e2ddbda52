from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.pose.anchors import (
    Anchor,
    anchor_matrix,
    anchor_positions,
    closest_point,
    pick,
    point_at_vertex,
    point_on_face,
)
from cageik_cli.method.pose.camera import Camera
from cageik_cli.util.errors import HandlesError
from tests.method.pose.test_camera import orthographic, stand
from tests.shapes import ball, box, changed, finer, octahedron, rotation

WALKER = Path(__file__).parents[3] / "data_fixtures/walker/frames/walker_1.obj"
BALL = ball(2, 1.0)


def distant_camera(mesh, direction, width=200, height=150):
    """A camera that sees all of a mesh from a direction."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    place = middle + 1.5 * mesh.diagonal * np.asarray(direction) / np.linalg.norm(direction)
    return stand(place, middle, np.array([0.1, 1.0, 0.2]), width=width, height=height)


def parallel_camera(mesh, direction):
    camera, reach = distant_camera(mesh, direction), 0.6 * mesh.diagonal
    projection = orthographic(-reach, reach, -reach, reach, 1e-3 * reach, 10 * reach)
    return Camera(camera.view, projection, camera.width, camera.height)


def test_a_point_at_a_vertex_has_its_row_and_position():
    point = point_at_vertex(BALL, 5)
    weights = np.random.default_rng(0).random((len(BALL.vertices), 7))
    np.testing.assert_array_equal(point.cage_weights(weights), weights[5])
    np.testing.assert_array_equal(point.position(BALL.vertices), BALL.vertices[5])


@given(st.integers(0, len(BALL.faces) - 1), st.floats(0, 1), st.floats(0, 1))
def test_a_point_of_a_face_is_the_mean_of_its_corners(face, first, second):
    """Savoye and Franco 2010, eqs. 3 and 4: in space, and in cage space."""
    shares = [first, (1 - first) * second, (1 - first) * (1 - second)]
    point = point_on_face(BALL, face, shares)
    weights = np.random.default_rng(0).dirichlet(np.ones(7), len(BALL.vertices))
    cage = np.random.default_rng(1).normal(size=(7, 3))
    corners = BALL.vertices[BALL.faces[face]]
    expected = sum(s * c for s, c in zip(shares, corners, strict=True))
    np.testing.assert_allclose(point.position(BALL.vertices), expected, atol=1e-15)
    assert point.barycentric.sum() == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(
        point.cage_weights(weights) @ cage, point.position(weights @ cage), atol=1e-14
    )


def test_rows_and_positions_of_several_anchors_and_poses():
    anchors = [
        Anchor("a", point_at_vertex(BALL, 3)),
        Anchor("b", point_on_face(BALL, 2, [0.2, 0.3, 0.5])),
    ]
    weights = np.random.default_rng(0).random((len(BALL.vertices), 7))
    poses = np.stack([BALL.vertices, 2 * BALL.vertices])
    assert anchor_matrix(anchors, weights).shape == (2, 7)
    found = anchor_positions(anchors, poses)
    assert found.shape == (2, 2, 3)
    np.testing.assert_allclose(found[1], 2 * anchor_positions(anchors, BALL.vertices), atol=1e-15)
    assert anchor_matrix([], weights).shape == (0, 7)
    assert anchor_positions([], poses).shape == (2, 0, 3)


def test_sums_off_by_rounding_are_normalised():
    point = point_on_face(BALL, 0, [0.3333333, 0.3333333, 0.3333333])
    np.testing.assert_allclose(point.barycentric, 1 / 3, rtol=1e-15)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: point_at_vertex(BALL, 66), "vertex 66; .* has 66, .* 0 to 65"),
        (lambda: point_at_vertex(BALL, -1), "vertex -1; .* has 66"),
        (lambda: point_on_face(BALL, 128, [1, 0, 0]), "face 128; .* 128 triangles, .* 0 to 127"),
        (lambda: point_on_face(BALL, -1, [1, 0, 0]), "face -1; .* 128 triangles"),
        (lambda: point_on_face(BALL, 0, [1, 0]), r"barycentric is \[1, 0\]"),
        (lambda: point_on_face(BALL, 0, [1, 0, np.nan]), r"barycentric is \[1.0, 0.0, nan\]"),
        (lambda: point_on_face(BALL, 0, [np.inf, 0, 0]), r"barycentric is \[inf, 0.0, 0.0\]"),
        (lambda: point_on_face(BALL, 0, [0.2, 0.3, 0.4]), "barycentric .* 0.9, expected 1"),
        (lambda: point_on_face(BALL, 0, [1.2, -0.2, 0]), "barycentric .* -0.2, expected 0"),
        (lambda: Anchor("hand", point_at_vertex(BALL, 0), 0.0), "'hand': weight is 0,"),
        (lambda: Anchor("hand", point_at_vertex(BALL, 0), -1.0), "'hand': weight is -1,"),
        (lambda: Anchor("hand", point_at_vertex(BALL, 0), np.nan), "'hand': weight is nan,"),
        (lambda: Anchor("hand", point_at_vertex(BALL, 0), np.inf), "'hand': weight is inf,"),
    ],
)
def test_invalid_anchors_are_refused(make, says):
    with pytest.raises(HandlesError, match=says):
        make()


@given(st.tuples(*[st.floats(-2, 2)] * 3).map(np.array))
def test_the_closest_point_is_on_the_surface_and_none_is_closer(position):
    point = closest_point(BALL, position)
    assert point.barycentric.min() >= 0
    assert point.barycentric.sum() == pytest.approx(1)
    found = np.linalg.norm(point.position(BALL.vertices) - position)
    faces = trimesh.Trimesh(BALL.vertices, BALL.faces, process=False)
    nearest = trimesh.triangles.closest_point(
        faces.triangles, np.tile(position, (len(BALL.faces), 1))
    )
    assert found == pytest.approx(np.linalg.norm(nearest - position, axis=1).min(), abs=1e-12)


@pytest.mark.parametrize(
    "position", [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -1e200], [0, 0], [[0, 0, 0]]]
)
def test_a_position_that_is_no_place_has_no_closest_point(position):
    with pytest.raises(HandlesError, match="is no place; expected three finite numbers"):
        closest_point(BALL, np.array(position))


@pytest.mark.parametrize("third", [[0.5, 0, 0], [0.0, 0, 0], [2.0, 0, 0]])
def test_the_closest_point_may_be_on_a_face_without_area(third):
    flat = TriMesh([[0.0, 0, 0], [1, 0, 0], third], [[0, 1, 2]])
    point = closest_point(flat, np.array([0.3, 1.0, 0]))
    assert point.barycentric.min() >= 0
    assert point.barycentric.sum() == pytest.approx(1)
    np.testing.assert_allclose(point.position(flat.vertices), [0.3, 0, 0], atol=1e-12)


def first_hits(mesh, camera, pixels):
    """trimesh's ray caster: the first hit of each pixel's ray, NaN where there is none."""
    caster = trimesh.ray.ray_triangle.RayMeshIntersector(
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    )
    origins, directions, lengths = camera.cast_rays(pixels)
    points, ray, _ = caster.intersects_location(origins, directions)
    depths = ((points - origins[ray]) * directions[ray]).sum(axis=1)
    found = np.full((len(pixels), 3), np.nan)
    for k in np.lexsort((-depths, ray)):
        if 0 <= depths[k] <= lengths[ray[k]]:
            found[ray[k]] = points[k]
    return found


def pick_or_nan(mesh, camera, pixel):
    try:
        return pick(mesh, camera, pixel).position(mesh.vertices)
    except HandlesError:
        return np.full(3, np.nan)


WALKING = load_mesh(WALKER).mesh
MESHES = {
    "closed": WALKING,
    "open": changed(WALKING, WALKING.faces[WALKING.vertices[WALKING.faces[:, 0], 0] > 0]),
    "inside out": WALKING.flip(),
}


@pytest.mark.slow
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("see", [distant_camera, parallel_camera])
def test_picking_agrees_with_the_ray_caster_of_trimesh(mesh, see):
    camera = see(mesh, [0.5, 0.3, 0.8])
    generator = np.random.default_rng(6)
    pixels = generator.uniform([0, 0], [camera.width, camera.height], (200, 2))
    pixels = np.concatenate([pixels, generator.normal([100, 75], 20, (150, 2))])
    expected = first_hits(mesh, camera, pixels)
    found = np.array([pick_or_nan(mesh, camera, pixel) for pixel in pixels])
    assert 30 < np.count_nonzero(np.isfinite(expected[:, 0])) < 330
    np.testing.assert_allclose(found, expected, atol=1e-9 * mesh.diagonal)


def test_faces_before_the_near_plane_are_not_picked():
    """A camera within a box sees the wall ahead, and not the one behind; trimesh agrees."""
    mesh = finer(box(1.0), 1)
    projection = orthographic(-2, 2, -2, 2, 0.5, 3.0)
    camera = Camera(np.eye(4), projection, 100, 100)
    found = pick(mesh, camera, np.array([51.0, 47.0])).position(mesh.vertices)
    np.testing.assert_allclose(found, [0.04, 0.12, -1], atol=1e-12)
    expected = first_hits(mesh, camera, np.array([[51.0, 47.0]]))[0]
    np.testing.assert_allclose(found, expected, atol=1e-9)


@settings(max_examples=60)
@given(st.integers(0, 10**6))
def test_a_visible_point_is_picked_in_its_pixel(seed):
    generator = np.random.default_rng(seed)
    direction = generator.normal(size=3)
    camera = distant_camera(BALL, direction)
    face = int((BALL.vertices[BALL.faces].mean(axis=1) @ direction).argmax())
    point = point_on_face(BALL, face, generator.dirichlet(np.ones(3)))
    seen = camera.project(point.position(BALL.vertices))
    found = pick(BALL, camera, seen[:2])
    np.testing.assert_array_equal(found.corners, BALL.faces[face])
    np.testing.assert_allclose(found.barycentric, point.barycentric, atol=1e-9)


@pytest.mark.parametrize("turn", [np.eye(3), rotation(1), rotation(2)])
def test_rays_through_edges_and_vertices_hit_the_mesh(turn):
    """Where faces meet on a ray, one of them is hit, at the point in which they meet."""
    mesh = changed(octahedron(1.0), vertices=octahedron(1.0).vertices @ turn.T)
    camera = Camera(np.eye(4), orthographic(-1.25, 1.25, -1.25, 1.25, -5, 5), 160, 160)
    ends = mesh.vertices[mesh.edges.ends]
    points = np.concatenate([mesh.vertices, ends.mean(axis=1), ends[:, 0]])
    for seen in camera.project(0.999999 * points)[:, :2]:
        assert np.isfinite(pick_or_nan(mesh, camera, seen)).all()


def test_faces_seen_edge_on_are_not_hit():
    mesh = TriMesh([[0, 0, 0], [0, 1, 0], [0, 0, 1], [1.0, 0, -3], [-1, 1, -3], [-1, -1, -3]],
                   [[0, 1, 2], [3, 4, 5]])  # fmt: skip
    camera = Camera(np.eye(4), orthographic(-1, 1, -1, 1, -5, 5), 100, 100)
    assert pick(mesh, camera, np.array([50.0, 45.0])).corners.tolist() == [3, 4, 5]


@pytest.mark.parametrize("pixel", [(0.0, 0.0), (-50.0, 20.0), (np.nan, 3.0)])
def test_a_pixel_that_misses_is_refused_by_name(pixel):
    camera = distant_camera(BALL, [0, 0, 1])
    says = rf"pixel \({pixel[0]:g}, {pixel[1]:g}\) of 200 x 150 misses .* x 60 to 140, y 35 to 115"
    with pytest.raises(HandlesError, match=says):
        pick(BALL, camera, np.array(pixel))


def test_a_camera_with_the_mesh_behind_it_is_named():
    position, target, up = np.array([[0.0, 0, 5], [0, 0, 9], [0, 1, 0]])
    camera = stand(position, target, up, width=100, height=100)
    with pytest.raises(HandlesError, match="part of the mesh is behind it"):
        pick(BALL, camera, np.array([50.0, 50.0]))


@pytest.mark.parametrize(("near", "far"), [(3.0, 9.0), (-9.0, -2.5)])
def test_a_pixel_beyond_the_near_and_far_planes_is_refused(near, far):
    camera = Camera(np.eye(4), orthographic(-2, 2, -2, 2, near, far), 100, 100)
    says = r"\(50, 50\) of 100 x 100 meets the mesh, .* near and far planes"
    with pytest.raises(HandlesError, match=says):
        pick(BALL, camera, np.array([50.0, 50.0]))
