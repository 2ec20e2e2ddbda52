from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli.cages.bind import bind
from cageik_cli.formats.ply_points import parse_points, place_positions, place_splats, read_splats
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import PointCloud
from cageik_cli.method.points.field import HarmonicField
from cageik_cli.method.points.motion import PointMotion
from cageik_cli.method.points.oriented import Oriented
from cageik_cli.method.weights.bem.panels import Panels
from cageik_cli.method.weights.binding import Poses
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.errors import FormatError, SettingError
from tests.shapes import ball
from tests.splats import covariances, encode_rows, make_splat_rows

CAGE = ball(1, 1.0)
COUNT = 3000


@pytest.fixture(scope="module")
def rows():
    """In double precision, so that the file's types lose nothing."""
    held = make_splat_rows(ball(2, 0.8), COUNT, 1)
    return held.astype([(name, "<f8") for name in held.dtype.names])


@pytest.fixture(scope="module")
def points(rows):
    return parse_points(encode_rows(rows))


@pytest.fixture(scope="module")
def binding(points):
    settings = BindSettings(accuracy="preview")
    return bind(PointCloud.from_points(points.positions), CAGE, settings)


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr("cageik_cli.method.points.motion.MAX_MOVED_POINTS", 700)
    monkeypatch.setattr("cageik_cli.method.points.motion.MAX_GRADIENT_BYTES", 2 * 24 * 18 * 700)


def move(motion, points, cage):
    out = points.rows.copy()
    faults = Counter()
    for chosen in motion.blocks:
        places, oriented, found = motion.move(chosen, Poses(cage[None]))
        place_positions(out[chosen], places[0].T)
        place_splats(out[chosen], oriented[0].splats)
        faults += found
    return out, faults


def move_splats(binding, points, cage, jobs=1):
    """The rows of splats that a cage moves, and the faults of its maps."""
    return move(
        PointMotion(binding, Oriented(splats=read_splats(points)), 1 << 30, jobs), points, cage
    )


def assert_covariances(found, expected, tolerance=1e-9):
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(covariances(found) / size, expected / size, rtol=0, atol=tolerance)


AFFINE = {
    "turn": Rotation.from_rotvec([0.4, -0.8, 2.0]).as_matrix(),
    "stretch": np.diag([2.0, 1.0, 0.25]),
    "shear": np.array([[1, 0.7, 0], [0, 1, -0.4], [0.2, 0, 1.0]]),
}


@pytest.mark.parametrize("name", AFFINE)
def test_affine_motions_move_covariances(small_blocks, binding, points, rows, name):
    linear, shift = AFFINE[name], np.array([10.0, -3, 5])
    out, _ = move_splats(binding, points, CAGE.vertices @ linear.T + shift, jobs=2)
    places = np.stack([out[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(places, points.positions @ linear.T + shift, rtol=0, atol=1e-11)
    expected = linear @ covariances(rows) @ linear.T
    assert_covariances(out, expected)


def bend(cage):
    x, y, z = cage.T
    return np.stack([x + 0.3 * y * y, y + 0.2 * x * z, z - 0.2 * x * y], axis=1)


def difference_maps(binding, some, bent):
    """The derivative of the deformation, by differences of weights at points beside `some`."""
    field = HarmonicField.solve(CAGE, binding.rest.vertices, "preview")
    step = 1e-4
    columns = [
        (field.evaluate(some + s) - field.evaluate(some - s)) @ bent / (2 * step)
        for s in step * np.eye(3)
    ]
    return np.stack(columns, axis=2)


def test_a_bent_cage_moves_them_by_its_derivative(binding, points, rows):
    bent = bend(CAGE.vertices)
    out, faults = move_splats(binding, points, bent, jobs=2)
    maps = difference_maps(binding, points.positions[:50], bent)
    expected = maps @ covariances(rows[:50]) @ maps.swapaxes(1, 2)
    assert_covariances(out[:50], expected, 1e-5)
    assert not faults


@pytest.fixture(scope="module")
def normals():
    held = np.random.default_rng(2).standard_normal((3, COUNT))
    return held / np.linalg.norm(held, axis=0)


def turn_normals(binding, normals, cage):
    motion = PointMotion(binding, Oriented(normals), 1 << 30, 2)
    assert not motion.moves_splats
    blocks = [motion.move(chosen, Poses(cage[None])) for chosen in motion.blocks]
    return np.concatenate([oriented[0].normals for _, oriented, _ in blocks], axis=1)


@pytest.mark.parametrize("name", AFFINE)
def test_affine_motions_turn_normals_by_the_inverse_transpose(small_blocks, binding, normals, name):
    linear = AFFINE[name]
    moved = turn_normals(binding, normals, CAGE.vertices @ linear.T + [10.0, -3, 5])
    expected = np.linalg.inv(linear).T @ normals
    expected /= np.linalg.norm(expected, axis=0)
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-10)


def test_a_bent_cage_turns_normals_by_its_derivative(binding, normals):
    bent = bend(CAGE.vertices)
    maps = difference_maps(binding, binding.rest.vertices[:50], bent)
    expected = np.linalg.solve(maps.swapaxes(1, 2), normals.T[:50, :, None])[:, :, 0]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    moved = turn_normals(binding, normals, bent)
    np.testing.assert_allclose(moved[:, :50], expected.T, rtol=0, atol=1e-5)
    assert abs(moved - normals).max() > 0.1


def test_colours_turn_with_the_splats(binding, points, rows):
    turn = AFFINE["turn"]
    out, _ = move_splats(binding, points, CAGE.vertices @ turn.T, jobs=2)
    # In the first band, the coefficients are the components -y, z, -x of a vector.
    before = np.stack([-rows["f_rest_2"], -rows["f_rest_0"], rows["f_rest_1"]])
    after = np.stack([-out["f_rest_2"], -out["f_rest_0"], out["f_rest_1"]])
    np.testing.assert_allclose(after, turn @ before, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("linear", "expected"),
    [
        (np.diag([1, 1, -1.0]), {"mirrored": COUNT}),
        (np.diag([1, 1, 0.0]), {"flat": COUNT}),
        (np.diag([1, 1, -1e-12]), {"flat": COUNT}),
    ],
)
def test_lost_shapes_are_counted(binding, points, linear, expected):
    out, faults = move_splats(binding, points, CAGE.vertices @ linear)
    assert faults == expected
    assert all(np.isfinite(out[name]).all() for name in out.dtype.names)


def test_a_temporary_file_gives_the_same_bytes(small_blocks, binding, points):
    oriented = Oriented(splats=read_splats(points))
    held, mapped = (PointMotion(binding, oriented, room, 2) for room in (1 << 30, 0))
    assert not isinstance(held._stored, np.memmap)
    assert isinstance(mapped._stored, np.memmap)
    cage = CAGE.vertices @ AFFINE["shear"]
    assert move(held, points, cage)[0].tobytes() == move(mapped, points, cage)[0].tobytes()


@pytest.mark.parametrize("depth", [1e-13, 1e-11, 1e-9])
def test_splats_outside_by_rounding_move_as_those_on_the_cage(rows, depth):
    """They count as on the cage, and so are not refused."""
    near = rows[:200].copy()
    centre = CAGE.vertices[CAGE.faces].mean(axis=1)
    outward = Panels(CAGE.vertices, CAGE.faces).normals
    for axis, values in zip("xyz", (centre + depth * outward).T, strict=True):
        near[axis][: len(centre)] = values
    points = parse_points(encode_rows(near))
    binding = bind(PointCloud.from_points(points.positions), CAGE, BindSettings(accuracy="preview"))
    linear = AFFINE["shear"]
    out, _ = move_splats(binding, points, CAGE.vertices @ linear.T)
    expected = linear @ covariances(near) @ linear.T
    assert_covariances(out, expected)


def test_splats_outside_move_with_the_nearest_point_of_the_cage(rows):
    outer = rows[:100].copy()
    for axis in "xyz":
        outer[axis][0] *= 1.6
    points = parse_points(encode_rows(outer))
    cloud = PointCloud.from_points(points.positions)
    binding = bind(cloud, CAGE, BindSettings(accuracy="preview", outside="project"))
    assert binding.projected == 1
    linear = AFFINE["shear"]
    out, _ = move_splats(binding, points, CAGE.vertices @ linear.T)
    expected = linear @ covariances(outer) @ linear.T
    assert_covariances(out, expected)


def test_weights_without_gradients_are_refused(points):
    cloud = PointCloud.from_points(points.positions)
    binding = bind(cloud, CAGE, BindSettings("mean-value"))
    with pytest.raises(SettingError, match="`coordinates=harmonic`"):
        PointMotion(binding, Oriented(splats=read_splats(points)), 1 << 30, 1)


def test_a_cloud_is_a_mesh_without_faces():
    cloud = PointCloud.from_points(CAGE.vertices)
    assert repr(cloud) == "<PointCloud: 18 points>"
    assert not cloud.is_closed
    with pytest.raises(ValueError, match="read-only"):
        cloud.vertices[0] = 1
    with pytest.raises(FormatError, match="has no faces"):
        PointCloud(CAGE.vertices, CAGE.faces)
    assert isinstance(cloud, TriMesh)
