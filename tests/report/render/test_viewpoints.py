"""Where a region is seen from, and what a close-up shows."""

import numpy as np
import pytest

from cageik_cli.report.render.model_views import (
    REGION_TURNS,
    VIEW_TURN,
    choose_turn,
    find_region_vertices,
    fit_close_up,
    view_axes,
)
from tests.shapes import ball

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
