import numpy as np
import pytest

from cageik_cli.alignment import best_rigid_motions, no_motions
from tests.shapes import ball, concave, rotation


@pytest.fixture
def rest():
    vertices = concave().vertices
    return vertices - vertices.mean(axis=0)


def test_known_motions_are_found_and_undone(rest):
    frames = np.stack([rest @ rotation(k).T + [k, 5.0, -k] for k in range(6)])
    motions = best_rigid_motions(frames, rest, np.ones(len(rest)))
    np.testing.assert_allclose(motions.to_rest(frames), np.tile(rest, (6, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(motions.from_rest(motions.to_rest(frames)), frames, atol=1e-14)
    turns = motions.rotations
    np.testing.assert_allclose(turns, [rotation(k).T for k in range(6)], atol=1e-14)


def test_a_mirrored_frame_is_not_mirrored_back(rest):
    motions = best_rigid_motions((rest * [-1, 1, 1])[None], rest, np.ones(len(rest)))
    assert np.linalg.det(motions.rotations[0]) == pytest.approx(1)


def test_no_nearby_motion_is_better():
    rest = ball(1).vertices * [1, 2, 3]
    generator = np.random.default_rng(4)
    frame = rest @ rotation(1).T + 0.1 * generator.normal(size=rest.shape)
    weights = generator.uniform(0.1, 1, len(rest))
    weights *= len(rest) / weights.sum()
    rest = rest - weights @ rest / weights.sum()
    motions = best_rigid_motions(frame[None], rest, weights)

    def energy(points):
        return (weights * ((points - rest) ** 2).sum(axis=1)).sum()

    best = energy(motions.to_rest(frame[None])[0])
    for k in range(20):
        axis = 1e-3 * generator.normal(size=3)
        skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        turn = np.linalg.solve(np.eye(3) - skew / 2, np.eye(3) + skew / 2)
        nudged = motions.to_rest(frame[None])[0] @ turn.T + 1e-3 * generator.normal(size=3) * (
            k % 2
        )
        assert energy(nudged) > best


def test_a_vertex_of_weight_zero_does_not_count(rest):
    weights = np.ones(len(rest))
    weights[3] = 0
    rest = rest - weights @ rest / weights.sum()
    frame = rest @ rotation(2).T + 4
    frame[3] = 1e6
    motions = best_rigid_motions(frame[None], rest, weights)
    moved = np.delete(motions.to_rest(frame[None])[0], 3, axis=0)
    np.testing.assert_allclose(moved, np.delete(rest, 3, axis=0), atol=1e-12)


def test_no_motion_moves_nothing(rest):
    centre = np.array([1.0, 2, 3])
    motions = no_motions(2, centre)
    np.testing.assert_array_equal(motions.to_rest(np.stack([rest, rest]))[1], rest - centre)
    np.testing.assert_array_equal(motions.from_rest(np.stack([rest, rest]))[0], rest + centre)
