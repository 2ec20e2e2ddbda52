"""Viewpoints, and edges of a cage before and behind its model."""

import numpy as np
import pytest

from cageik_cli.report.render.model_views import project_surface, render_with_cage, view_axes
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import MESH_COLOURS, parse_colour
from tests.shapes import ball, box

SIZE = 200


@pytest.mark.parametrize("turn", [0.0, 32.0, -75.0, 212.0])
@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_axes_are_a_rotation_that_keeps_up_upright(up_axis, turn):
    axes = view_axes(up_axis, turn)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1)
    up = np.eye(3)["XYZ".index(up_axis)]
    assert axes[0] @ up == pytest.approx(0)
    assert axes[1] @ up > 0.9


@pytest.mark.parametrize(("up_axis", "front"), [("Y", [0, 0, 1.0]), ("Z", [0, -1.0, 0])])
def test_the_viewpoint_is_in_front_and_to_the_right(up_axis, front):
    assert view_axes(up_axis, 0.0)[2] @ front > 0.9
    assert view_axes(up_axis, 0.0)[0] @ front == pytest.approx(0)
    assert view_axes(up_axis, 32.0)[0] @ front < 0


def test_a_cage_is_drawn_over_its_model_and_fainter_behind():
    """A box around a ball has four edges before it, seen from the front; a smaller box has none."""
    model = ball(levels=3, size=1.0)
    shares = []
    for size in (1.2, 0.5):
        cage = box(size)
        camera = ParallelCamera.fit(np.eye(3), 1.3 * model.vertices, SIZE)
        surface = project_surface(camera, model.vertices, model.faces)
        picture = render_with_cage(surface, camera, cage.vertices, cage.faces)
        blue = (
            np.abs(picture[:3] - parse_colour(MESH_COLOURS["cage"])[:, None, None]).max(axis=0)
            < 0.1
        )
        shares.append(blue.sum())
        assert (picture[3] > 0).sum() >= (surface.depth < np.inf).sum()
    assert shares[0] > 200
    assert shares[1] == 0


def test_colours_are_parsed():
    np.testing.assert_allclose(parse_colour("#ff8000"), [1, 128 / 255, 0])
