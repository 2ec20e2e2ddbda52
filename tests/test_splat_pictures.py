"""Splats that a cage moves, looked at: pictures say what single numbers do not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli.cages.bind import bind
from cageik_cli.formats.ply_points import parse_points, read_splats
from cageik_cli.geometry.points import PointCloud
from cageik_cli.inputs.reconstruction import PointReconstruction
from cageik_cli.method.points.motion import PointMotion
from cageik_cli.method.points.oriented import Oriented
from cageik_cli.method.weights.binding import Poses
from cageik_cli.method.weights.settings import BindSettings
from tests.shapes import ball
from tests.splat_renderer import Camera, render
from tests.splats import encode_rows, make_splat_rows

CAGE = ball(1, 1.0)
CAMERA = Camera(Rotation.from_rotvec([0.2, 0.5, 0.1]).as_matrix(), np.zeros(3), 2.2)
TURN = Rotation.from_rotvec([1.1, -0.4, 0.7]).as_matrix()


@pytest.fixture(scope="module")
def scene():
    points = parse_points(encode_rows(make_splat_rows(ball(2, 0.8), 800)))
    cloud = PointCloud.from_points(points.positions)
    binding = bind(cloud, CAGE, BindSettings(accuracy="preview"))
    return points, PointMotion(binding, Oriented(splats=read_splats(points)), 1 << 30, 1)


def move(scene, cage):
    points, motion = scene
    rows = points.rows.copy()
    PointReconstruction(motion, 1).fill_rows(rows[None], Poses(cage[None]))
    return rows


def test_a_turned_model_looks_the_same_to_a_turned_camera(scene):
    """Places, shapes and colours, which depend on the direction, turn together."""
    rest = scene[0].rows
    before = render(rest, CAMERA, 120)
    assert before.min() < 0.5
    turned = move(scene, CAGE.vertices @ TURN.T)
    camera = CAMERA.turn(TURN, np.zeros(3))
    np.testing.assert_allclose(render(turned, camera, 120), before, rtol=0, atol=1e-3)
    for kept in ("rot_", "f_rest_"):
        wrong = turned.copy()
        for name in rest.dtype.names:
            if name.startswith(kept):
                wrong[name] = rest[name]
        assert abs(render(wrong, camera, 120) - before).max() > 0.05


def test_a_stretched_model_has_no_gaps(scene):
    """Splats of their old size leave more of the background to be seen."""
    stretch = np.diag([1.0, 2.5, 1.0])
    stretched = move(scene, CAGE.vertices @ stretch)
    small = stretched.copy()
    for name in small.dtype.names:
        if name.startswith(("scale_", "rot_")):
            small[name] = scene[0].rows[name]
    for rows in (stretched, small):
        for name in rows.dtype.names:
            if name.startswith("f_"):
                rows[name] = -10 if name.startswith("f_dc") else 0  # black, on white
    camera = Camera(np.eye(3), np.zeros(3), 4.5)
    y, x = (np.indices((120, 120)) - 59.5) * 4.5 / 120
    is_inside = (x / 0.7) ** 2 + (y / 1.75) ** 2 < 1
    seen = [float(render(rows, camera, 120)[is_inside].mean()) for rows in (stretched, small)]
    assert seen[0] < 0.5 * seen[1]
