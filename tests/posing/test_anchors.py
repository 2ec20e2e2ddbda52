from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.formats.mesh_file import load_mesh
from cageik_cli.geometry.camera import Camera, LookAt
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.posing.anchors import (
    Anchor,
    anchor_matrix,
    anchor_positions,
    closest_point,
    pick,
    point_at_vertex,
    point_on_face,
)
from cageik_cli.util.errors import InputError
from tests.geometry.test_camera import orthographic
from tests.shapes import ball, box, changed, finer, octahedron, rotation

WALKER = Path(__file__).parents[2] / "data_fixtures/walker/frames/walker_1.obj"
BALL = ball(2, 1.0)


def from_afar(mesh, direction, width=200, height=150):
    """A camera that sees all of a mesh from a direction."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    place = middle + 1.5 * mesh.diagonal * np.asarray(direction) / np.linalg.norm(direction)
    return Camera.from_look_at(LookAt(place, middle, np.array([0.1, 1.0, 0.2])), 40, width, height)


def in_parallel(mesh, direction):
    camera, reach = from_afar(mesh, direction), 0.6 * mesh.diagonal
    projection = orthographic(-reach, reach, -reach, reach, 1e-3 * reach, 10 * reach)
    return Camera(camera.view, projection, camera.width, camera.height)


def test_a_vertex_is_its_row_and_its_position():
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


def test_rows_and_positions_of_several_in_several_poses():
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


def test_sums_that_are_off_by_rounding_are_divided():
    point = point_on_face(BALL, 0, [0.3333333, 0.3333333, 0.3333333])
    np.testing.assert_allclose(point.barycentric, 1 / 3, rtol=1e-15)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: point_at_vertex(BALL, 66), "no vertex 66; the mesh has 66, numbered from 0 to 65"),
        (lambda: point_at_vertex(BALL, -1), "no vertex -1; the mesh has 66"),
        (lambda: point_on_face(BALL, 128, [1, 0, 0]), "no face 128; .* 128 triangles, .* 0 to 127"),
        (lambda: point_on_face(BALL, -1, [1, 0, 0]), "no face -1; the mesh has 128 triangles"),
        (
            lambda: point_on_face(BALL, 0, [1, 0]),
            "barycentric coordinates are not three finite numb",
        ),
        (
            lambda: point_on_face(BALL, 0, [1, 0, np.nan]),
            "barycentric coordinates are not three finit",
        ),
        (
            lambda: point_on_face(BALL, 0, [np.inf, 0, 0]),
            "barycentric coordinates are not three finit",
        ),
        (
            lambda: point_on_face(BALL, 0, [0.2, 0.3, 0.4]),
            "barycentric coordinates sum to 0.9, exp",
        ),
        (
            lambda: point_on_face(BALL, 0, [1.2, -0.2, 0]),
            "a barycentric coordinate is -0.2, expected",
        ),
        (
            lambda: Anchor("hand", point_at_vertex(BALL, 0), 0.0),
            "weight of 'hand' is 0, expected a num",
        ),
        (
            lambda: Anchor("hand", point_at_vertex(BALL, 0), -1.0),
            "weight of 'hand' is -1, expected",
        ),
        (
            lambda: Anchor("hand", point_at_vertex(BALL, 0), np.nan),
            "weight of 'hand' is nan, expected",
        ),
        (
            lambda: Anchor("hand", point_at_vertex(BALL, 0), np.inf),
            "weight of 'hand' is inf, expected",
        ),
    ],
)
def test_what_is_no_anchor_is_refused(make, says):
    with pytest.raises(InputError, match=says):
        make()


@given(st.tuples(*[st.floats(-2, 2)] * 3).map(np.array))
def test_the_nearest_point_is_on_the_surface_and_none_is_nearer(position):
    point = closest_point(BALL, position)
    assert point.barycentric.min() >= 0
    assert point.barycentric.sum() == pytest.approx(1)
    found = np.linalg.norm(point.position(BALL.vertices) - position)
    faces = trimesh.Trimesh(BALL.vertices, BALL.faces, process=False)
    nearest = trimesh.triangles.closest_point(
        faces.triangles, np.tile(position, (len(BALL.faces), 1))
    )
    assert found == pytest.approx(np.linalg.norm(nearest - position, axis=1).min(), abs=1e-12)


def test_a_point_of_the_surface_is_its_own_nearest():
    on_it = BALL.vertices[BALL.faces[17]].mean(axis=0)
    found = closest_point(BALL, on_it).position(BALL.vertices)
    np.testing.assert_allclose(found, on_it, atol=1e-15)


@pytest.mark.parametrize("third", [[0.5, 0, 0], [0.0, 0, 0], [2.0, 0, 0]])
def test_the_nearest_point_may_be_on_a_face_without_area(third):
    flat = TriMesh([[0.0, 0, 0], [1, 0, 0], third], [[0, 1, 2]])
    point = closest_point(flat, np.array([0.3, 1.0, 0]))
    assert point.barycentric.min() >= 0
    assert point.barycentric.sum() == pytest.approx(1)
    np.testing.assert_allclose(point.position(flat.vertices), [0.3, 0, 0], atol=1e-12)


def front_most(mesh, camera, pixels):
    """trimesh's ray caster: the first hit of each pixel's ray, NaN where there is none."""
    caster = trimesh.ray.ray_triangle.RayMeshIntersector(
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    )
    rays = camera.cast_rays(pixels)
    points, ray, _ = caster.intersects_location(rays.origins, rays.directions)
    depths = ((points - rays.origins[ray]) * rays.directions[ray]).sum(axis=1)
    found = np.full((len(pixels), 3), np.nan)
    for k in np.lexsort((-depths, ray)):
        if 0 <= depths[k] <= rays.lengths[ray[k]]:
            found[ray[k]] = points[k]
    return found


def picked_or_nan(mesh, camera, pixel):
    try:
        return pick(mesh, camera, pixel).position(mesh.vertices)
    except InputError:
        return np.full(3, np.nan)


WALKING = load_mesh(WALKER).mesh
MESHES = {
    "closed": WALKING,
    "open": changed(WALKING, WALKING.faces[WALKING.vertices[WALKING.faces[:, 0], 0] > 0]),
    "inside out": WALKING.flip(),
}


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("see", [from_afar, in_parallel])
def test_picking_agrees_with_the_ray_caster_of_trimesh(mesh, see):
    camera = see(mesh, [0.5, 0.3, 0.8])
    generator = np.random.default_rng(6)
    pixels = generator.uniform([0, 0], [camera.width, camera.height], (200, 2))
    pixels = np.concatenate([pixels, generator.normal([100, 75], 20, (150, 2))])
    expected = front_most(mesh, camera, pixels)
    found = np.array([picked_or_nan(mesh, camera, pixel) for pixel in pixels])
    assert 30 < np.count_nonzero(np.isfinite(expected[:, 0])) < 330
    np.testing.assert_allclose(found, expected, atol=1e-9 * mesh.diagonal)


def test_the_near_plane_cuts_what_is_before_it():
    """A camera within a box sees the wall ahead, and not the one behind; trimesh agrees."""
    mesh = finer(box(1.0), 1)
    projection = orthographic(-2, 2, -2, 2, 0.5, 3.0)
    camera = Camera(np.eye(4), projection, 100, 100)
    found = pick(mesh, camera, np.array([51.0, 47.0])).position(mesh.vertices)
    np.testing.assert_allclose(found, [0.04, 0.12, -1], atol=1e-12)
    expected = front_most(mesh, camera, np.array([[51.0, 47.0]]))[0]
    np.testing.assert_allclose(found, expected, atol=1e-9)


@settings(max_examples=60)
@given(st.integers(0, 10**6))
def test_what_is_seen_of_a_point_that_nothing_hides_is_the_point(seed):
    generator = np.random.default_rng(seed)
    direction = generator.normal(size=3)
    camera = from_afar(BALL, direction)
    face = int((BALL.vertices[BALL.faces].mean(axis=1) @ direction).argmax())
    point = point_on_face(BALL, face, generator.dirichlet(np.ones(3)))
    seen = camera.project(point.position(BALL.vertices))
    found = pick(BALL, camera, seen[:2])
    np.testing.assert_array_equal(found.corners, BALL.faces[face])
    np.testing.assert_allclose(found.barycentric, point.barycentric, atol=1e-9)


@pytest.mark.parametrize("turn", [np.eye(3), rotation(1), rotation(2)])
def test_rays_through_edges_and_vertices_do_not_slip_through(turn):
    """Where faces meet on a ray, one of them is hit, at the point in which they meet."""
    mesh = changed(octahedron(1.0), vertices=octahedron(1.0).vertices @ turn.T)
    camera = Camera(np.eye(4), orthographic(-1.25, 1.25, -1.25, 1.25, -5, 5), 160, 160)
    ends = mesh.vertices[mesh.edges.ends]
    points = np.concatenate([mesh.vertices, ends.mean(axis=1), ends[:, 0]])
    for seen in camera.project(0.999999 * points)[:, :2]:
        assert np.isfinite(picked_or_nan(mesh, camera, seen)).all()


def test_faces_seen_edge_on_are_not_hit():
    mesh = TriMesh([[0, 0, 0], [0, 1, 0], [0, 0, 1], [1.0, 0, -3], [-1, 1, -3], [-1, -1, -3]],
                   [[0, 1, 2], [3, 4, 5]])  # fmt: skip
    camera = Camera(np.eye(4), orthographic(-1, 1, -1, 1, -5, 5), 100, 100)
    assert pick(mesh, camera, np.array([50.0, 45.0])).corners.tolist() == [3, 4, 5]


@pytest.mark.parametrize("pixel", [(0.0, 0.0), (-50.0, 20.0), (np.nan, 3.0)])
def test_a_pixel_that_misses_is_refused_by_name(pixel):
    camera = from_afar(BALL, [0, 0, 1])
    says = rf"pixel \({pixel[0]:g}, {pixel[1]:g}\) of 200 x 150 misses the mesh; choose one where"
    with pytest.raises(InputError, match=says):
        pick(BALL, camera, np.array(pixel))


def test_where_the_mesh_is_seen_is_told():
    """A ball of radius 1, its vertices at all ends of the axes, in 100 pixels that show 4 units."""
    camera = Camera(np.eye(4), orthographic(-2, 2, -2, 2, -5, 5), 100, 100)
    with pytest.raises(InputError, match=r"seen: x 25 to 75, y 25 to 75$"):
        pick(BALL, camera, np.array([5.0, 5.0]))


def test_a_camera_that_has_the_mesh_behind_it_is_told():
    away = LookAt(np.array([0.0, 0, 5]), np.array([0.0, 0, 9]), np.array([0.0, 1, 0]))
    camera = Camera.from_look_at(away, 40, 100, 100)
    with pytest.raises(InputError, match="some of it is behind this one, whose view has to"):
        pick(BALL, camera, np.array([50.0, 50.0]))


@pytest.mark.parametrize(("near", "far"), [(3.0, 9.0), (-9.0, -2.5)])
def test_a_pixel_of_what_the_planes_cut_off_says_so(near, far):
    camera = Camera(np.eye(4), orthographic(-2, 2, -2, 2, near, far), 100, 100)
    says = r"\(50, 50\) of 100 x 100 meets the mesh, but only before the near or beyond the far"
    with pytest.raises(InputError, match=says):
        pick(BALL, camera, np.array([50.0, 50.0]))
