import numpy as np

from cageik_cli.cages.building.bridges import measure_segment_distance
from cageik_cli.cages.building.distance_grid import DistanceGrid


def test_distances_from_segments_are_exact_as_far_as_they_are_needed():
    grid = DistanceGrid(np.zeros((30, 20, 10)), np.array([-1.0, 0, 1]), 0.1, 0.3)
    segments = np.array([[[0.03, 0.52, 1.5], [0.75, 1.01, 1.2]], [[-3.0, 0, 1], [-1, 0, 1]]])
    found = measure_segment_distance(grid, segments, reach=0.35)
    nodes = grid.positions(np.argwhere(grid.distance == 0))
    share = np.linspace(0, 1, 2001)[:, None]
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
    grid = DistanceGrid(np.zeros((3, 4, 5)), np.zeros(3), 0.1, 0.3)
    assert np.isinf(measure_segment_distance(grid, np.zeros((0, 2, 3)), 0.3)).all()
