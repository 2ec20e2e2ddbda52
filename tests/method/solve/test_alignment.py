import numpy as np
import pytest

from cageik_cli.method.solve.alignment import best_rotations, centroids
from tests.shapes import ball, concave, rotation


@pytest.fixture
def rest():
    vertices = concave().vertices
    return vertices - vertices.mean(axis=0)


def moved_to_rest(frames, rest, weights):
    """Every frame turned about its centroid onto the rest pose, which lies at the origin."""
    centred = frames - centroids(frames, weights)[:, None]
    return centred @ best_rotations(centred, rest, weights).swapaxes(1, 2)


def test_known_motions_are_found_and_undone(rest):
    ones = np.ones(len(rest))
    frames = np.stack([rest @ rotation(k).T + [k, 5.0, -k] for k in range(6)])
    np.testing.assert_allclose(moved_to_rest(frames, rest, ones), np.tile(rest, (6, 1, 1)),
                               atol=1e-14)  # fmt: skip
    centres = centroids(frames, ones)
    np.testing.assert_allclose(centres, [[k, 5, -k] for k in range(6)], atol=1e-14)
    turns = best_rotations(frames - centres[:, None], rest, ones)
    np.testing.assert_allclose(turns, [rotation(k).T for k in range(6)], atol=1e-14)
    np.testing.assert_allclose(rest @ turns + centres[:, None], frames, atol=1e-14)


def test_a_mirrored_frame_is_not_mirrored_back(rest):
    turns = best_rotations((rest * [-1, 1, 1])[None], rest, np.ones(len(rest)))
    assert np.linalg.det(turns[0]) == pytest.approx(1)


def test_no_nearby_motion_is_better():
    rest = ball(1).vertices * [1, 2, 3]
    generator = np.random.default_rng(4)
    frame = rest @ rotation(1).T + 0.1 * generator.normal(size=rest.shape)
    weights = generator.uniform(0.1, 1, len(rest))
    weights *= len(rest) / weights.sum()
    rest = rest - weights @ rest / weights.sum()
    (best,) = moved_to_rest(frame[None], rest, weights)

    def energy(points):
        return (weights * ((points - rest) ** 2).sum(axis=1)).sum()

    for k in range(20):
        axis = 1e-3 * generator.normal(size=3)
        skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        turn = np.linalg.solve(np.eye(3) - skew / 2, np.eye(3) + skew / 2)
        nudged = best @ turn.T + 1e-3 * generator.normal(size=3) * (k % 2)
        assert energy(nudged) > energy(best)


def test_a_vertex_of_weight_zero_does_not_count(rest):
    weights = np.ones(len(rest))
    weights[3] = 0
    rest = rest - weights @ rest / weights.sum()
    frame = rest @ rotation(2).T + 4
    frame[3] = 1e6
    (found,) = moved_to_rest(frame[None], rest, weights)
    np.testing.assert_allclose(np.delete(found, 3, axis=0), np.delete(rest, 3, axis=0), atol=1e-12)
