import numpy as np
import pytest

from cageik_cli.cages.builder.collapse import euler_characteristic
from cageik_cli.cages.builder.shell import (
    DistanceGrid,
    describe_closings,
    make_shell,
    measure_segment_distance,
)
from cageik_cli.geometry.surface import closest_points, winding_numbers
from tests.cages.torture import sheet, torus
from tests.shapes import ball, changed, letter_c, merged, moved


def shell_of(mesh, offset=0.05, closing=0.05, cell=0.03):
    return make_shell(DistanceGrid(mesh, cell, 0.3), offset, closing)


def test_a_shell_keeps_its_offset_and_is_a_sphere_around_a_sphere():
    shell = shell_of(ball(4))
    assert euler_characteristic(shell.surface) == 2
    radius = np.linalg.norm(shell.surface.vertices, axis=1)
    np.testing.assert_allclose(radius, 0.555, atol=0.015)
    assert shell.surface.volume > 0


def test_a_shell_closes_around_a_sheet():
    shell = shell_of(sheet())
    assert (winding_numbers(shell.surface, sheet().vertices) > 0.5).all()
    assert closest_points(shell.surface, sheet().vertices).distance.min() > 0.03


def test_a_ring_keeps_its_hole_until_the_closing_fills_it():
    assert euler_characteristic(shell_of(torus(0.5, 0.3)).surface) == 0
    assert euler_characteristic(shell_of(torus(0.5, 0.3), 0.08, 0.2).surface) == 2


def test_an_open_hollow_is_filled_only_when_its_mouth_is_narrow():
    height = ball(4).vertices[ball(4).faces][..., 2].min(axis=1)
    cup, bottle = (
        shell_of(changed(ball(4), faces=ball(4).faces[height < rim])).surface
        for rim in (0.2, 0.485)
    )
    assert winding_numbers(cup, np.zeros((1, 3)))[0] < 0.5
    assert winding_numbers(bottle, np.zeros((1, 3)))[0] > 0.5


def test_parts_that_lie_apart_are_joined_where_they_are_nearest():
    shell = shell_of(merged(ball(3), moved(ball(3), (3, 0, 0))))
    assert len(np.unique(shell.surface.components)) == 1
    np.testing.assert_allclose(shell.bridges, [[1.5, 0, 0]], atol=0.15)
    assert (len(shell.hollows), len(shell.webs)) == (0, 0)  # a bridge is neither


def test_distances_on_the_grid_are_those_from_the_surface():
    grid = DistanceGrid(ball(4), 0.05, 0.3)
    grid.measure(0.3)
    nodes = np.argwhere(grid.distance < 0.3)
    expected = np.abs(np.linalg.norm(grid.positions(nodes), axis=1) - 0.5)
    np.testing.assert_allclose(grid.distance[tuple(nodes.T)], expected, atol=0.003)
    beyond = np.argwhere(grid.distance >= 0.3)
    far = np.abs(np.linalg.norm(grid.positions(beyond), axis=1) - 0.5)
    assert far.min() == pytest.approx(0.3, abs=0.01)


def test_distances_from_segments_are_exact_as_far_as_they_are_needed():
    grid = DistanceGrid(ball(1), 0.1, 0.6)
    segments = np.array([[[0.03, 0.52, 0.5], [0.75, 1.01, 0.2]], [[-3.0, 0, 0], [-1, 0, 0]]])
    found = measure_segment_distance(grid, segments, reach=0.35)
    nodes = grid.positions(np.argwhere(np.isfinite(grid.distance)))
    share = np.linspace(0, 1, 401)[:, None]
    sampled = np.min(
        [
            np.linalg.norm(nodes - place, axis=1)
            for start, stop in segments
            for place in start + share * (stop - start)
        ],
        axis=0,
    ).reshape(found.shape)
    near = sampled <= 0.35
    assert near.sum() > 100
    np.testing.assert_allclose(found[near], sampled[near], rtol=0, atol=2e-3)
    assert (found[~near] > 0.35 - 2e-3).all()
    # The work does not grow with the grid.
    assert np.isinf(found[sampled > 1.2]).all()


def test_without_segments_all_nodes_are_infinitely_far():
    grid = DistanceGrid(ball(1), 0.1, 0.3)
    assert np.isinf(measure_segment_distance(grid, np.zeros((0, 2, 3)), 0.3)).all()


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "count"), [(0.003, 0), (0.02, 1)])
def test_a_slit_is_named_where_it_is_and_rounding_to_the_grid_nowhere(gap, count):
    """A slit that is narrower than the offset has no node that the shell would not hold anyway."""
    letter = letter_c(gap)
    grid = DistanceGrid(moved(letter, scale=1 / letter.diagonal), 0.007, 0.04)
    shell = make_shell(grid, 0.006, 0.010)
    assert euler_characteristic(shell.surface) == 0
    assert len(shell.webs) == count
    assert all(np.linalg.norm(web - [1 / letter.diagonal, 0, 0]) < 0.1 for web in shell.webs)
    (note,) = describe_closings(shell, lambda places: places, 0, is_closed=True)
    assert "(1)" in note
    assert (", at (" in note) == (count > 0)
