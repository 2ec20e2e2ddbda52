"""Viewpoints, also of a region, and edges of a cage before and behind its model."""

import numpy as np
import pytest

from cageik_cli.report.render.model_views import (
    REGION_TURNS,
    VIEW_TURN,
    choose_turn,
    find_region_vertices,
    fit_close_up,
    project_surface,
    render_with_cage,
    view_axes,
)
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import MESH_COLOURS, parse_colour
from tests.shapes import ball, box, quad_box

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
        picture = render_with_cage(surface, camera, cage)
        blue = (
            np.abs(picture[:3] - parse_colour(MESH_COLOURS["cage"])[:, None, None]).max(axis=0)
            < 0.1
        )
        shares.append(blue.sum())
        assert (picture[3] > 0).sum() >= (surface.depth < np.inf).sum()
    assert shares[0] > 200
    assert shares[1] == 0


def test_no_line_is_drawn_within_a_polygon():
    """Quads have their four sides; those that are cut have a diagonal, too."""
    model, lines = ball(levels=1, size=0.1), []
    for cage in (quad_box(), box()):
        camera = ParallelCamera.fit(view_axes("Y", VIEW_TURN), 1.3 * cage.vertices, SIZE)
        surface = project_surface(camera, model.vertices, model.faces)
        lines.append(render_with_cage(surface, camera, cage)[3] > 0)
    quads, triangles = lines
    assert (quads <= triangles).all()
    assert triangles.sum() > 1.3 * quads.sum()


def test_colours_are_parsed():
    np.testing.assert_allclose(parse_colour("#ff8000"), [1, 128 / 255, 0])


BALL = ball(3)
VIEWS = {turn: view_axes("Y", turn) for turn in REGION_TURNS}


def choose(direction, vertices=BALL.vertices, faces=BALL.faces):
    chosen = np.zeros(len(vertices), bool)
    chosen[: len(BALL.vertices)] = BALL.vertices @ np.asarray(direction, float) > 0.4
    return choose_turn(vertices, faces, chosen, "Y")


@pytest.mark.parametrize("turn", REGION_TURNS)
def test_a_region_is_seen_from_its_own_side(turn):
    found = choose(VIEWS[turn][2])
    assert VIEWS[found][2] @ VIEWS[turn][2] > 0.5


def test_the_usual_view_is_kept_if_it_shows_the_region():
    assert REGION_TURNS[0] == VIEW_TURN
    assert choose([0, 1, 0]) == VIEW_TURN
    assert choose(view_axes("Y", VIEW_TURN + 10)[2]) == VIEW_TURN


def test_a_region_is_not_looked_at_through_another_part():
    """A wall before the side on which the region is: it is seen past the wall."""
    towards = VIEWS[VIEW_TURN][2]
    right, up = VIEWS[VIEW_TURN][:2]
    corners = [0.8 * towards + x * right + y * up for x in (-0.6, 0.6) for y in (-0.6, 0.6)]
    vertices = np.concatenate([BALL.vertices, corners])
    count = len(BALL.vertices)
    wall = np.array([[0, 1, 2], [1, 3, 2]]) + count
    found = choose(towards, vertices, np.concatenate([BALL.faces, wall]))
    assert found != VIEW_TURN


def test_a_region_without_faces_is_seen_in_the_usual_view():
    vertices = np.concatenate([BALL.vertices, [[0.0, 0, 2]]])
    chosen = np.arange(len(vertices)) == len(BALL.vertices)
    assert choose_turn(vertices, BALL.faces, chosen, "Y") == VIEW_TURN


def test_turns_go_around_the_model():
    angles = np.sort(np.mod(REGION_TURNS, 360))
    assert np.diff(np.append(angles, angles[0] + 360)).max() < 70


def test_vertices_around_the_worst_that_deviate_are_the_region():
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [0.5, 0, 0]])
    deviation = np.array([4.0, 2.0, 1.9, 4.0, np.nan])
    chosen = find_region_vertices(rest, deviation, worst=0, size=2.0)
    assert chosen.tolist() == [True, True, False, False, False]
    alone = find_region_vertices(rest, np.full(5, np.nan), worst=2, size=0.0)
    assert alone.tolist() == [False, False, True, False, False]


def test_a_close_up_holds_the_region_and_something_around_it():
    points = np.array([[0.0, 0, 0], [2, 0, 0]])
    centre, extent = fit_close_up(points, 1.0, 10.0)
    np.testing.assert_array_equal(centre, [1, 0, 0])
    assert 2 * extent == 4
    _, extent = fit_close_up(points[:1], 0.0, 10.0)
    assert extent == 0.25 * 10 / 2
