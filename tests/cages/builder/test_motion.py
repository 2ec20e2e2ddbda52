"""What splits and collapses change in the error of a motion, against a solve with them made."""

import numpy as np
import pytest

from cageik_cli.cages.builder import shift as shift_module
from cageik_cli.cages.builder.collapse import Motion
from cageik_cli.cages.builder.shift import EditGains, split_edges
from cageik_cli.method.weights.harmonic import harmonic_weights
from tests.shapes import ball


@pytest.fixture
def bent():
    """A ball in a ball, and a motion that bends it."""
    rest = ball(2, 0.4).vertices
    x, y, z = rest.T
    posed = np.stack([[x + z**2, y, z], [x, y + 2 * x * z, z], [x, y, z + x**2]])
    return ball(1), Motion(rest, posed.transpose(0, 2, 1))


def penalty(cage, points):
    """The smoothness of a cage, as a matrix with a row per vertex."""
    count, ends = len(cage.vertices), cage.edges.ends
    joined = np.zeros((count, count))
    joined[ends[:, 0], ends[:, 1]] = joined[ends[:, 1], ends[:, 0]] = 1
    laplacian = np.eye(count) - joined / joined.sum(axis=1, keepdims=True)
    return np.sqrt(1e-3 * points / count) * laplacian


def solve(columns, smoothness, motion):
    """The least value of the error with its penalty, by a general solver."""
    target = np.concatenate(
        [motion.displacements, np.zeros((len(smoothness), motion.displacements.shape[1]))]
    )
    matrix = np.concatenate([columns, smoothness])
    found = np.linalg.lstsq(matrix, target)[0]
    return ((matrix @ found - target) ** 2).sum()


def test_the_rest_pose_is_no_pose_of_a_motion_whatever_moves_round():
    rest = ball(2, 0.4).vertices
    frames = np.stack([rest + 7.3, rest + 1e-12 * rest[:, ::-1], 1.1 * rest])
    assert len(Motion(rest, frames).poses) == 1


def test_a_motion_keeps_the_sizes_of_the_displacements():
    rest = ball(1).vertices
    posed = np.stack([rest * 1.5, rest * [1, 1, 2]])
    motion = Motion(rest, posed)
    assert (motion.displacements**2).sum() == pytest.approx(((posed - rest) ** 2).sum(), rel=1e-12)


def test_a_collapse_costs_what_tied_vertices_cost(bent):
    cage, motion = bent
    edits = EditGains(cage, motion)
    assert len(edits.gains) == 0
    weights = harmonic_weights(cage, motion.points, "preview").values
    smooth = penalty(cage, len(motion.points))
    before = solve(weights, smooth, motion)
    for k in (0, 3, 17):
        first, second = edits.edges[k]
        tie = np.delete(np.eye(len(cage.vertices)), second, axis=1)
        tie[second, first] = 1
        after = solve(weights @ tie, smooth @ tie, motion)
        assert edits.losses[k] == pytest.approx(after - before, rel=1e-6)


def test_a_split_gains_what_a_new_vertex_gains(bent, monkeypatch):
    cage, motion = bent
    squares = EditGains(cage, motion).squares
    monkeypatch.setattr(shift_module, "MAX_SPLIT_SHARE", 1 / len(cage.vertices))
    edits = EditGains(cage, motion, squares)
    assert len(edits.splits) == 1
    divided = split_edges(cage, edits.splits)
    weights = harmonic_weights(divided, motion.points, "preview").values
    own, hat = weights[:, :-1].copy(), weights[:, -1:]
    own[:, edits.splits[0]] += 0.5 * hat
    smooth = penalty(cage, len(motion.points))
    wider = np.concatenate([smooth, np.zeros((len(smooth), 1))], axis=1)
    gain = solve(own, smooth, motion) - solve(np.concatenate([own, hat], axis=1), wider, motion)
    assert edits.gains[0] == pytest.approx(gain, rel=1e-6)
    assert gain > 0


def test_no_more_splits_are_measured_than_weights_can_be_computed_of(bent, monkeypatch):
    cage, motion = bent
    monkeypatch.setattr(shift_module, "MAX_HARMONIC_FACES", len(cage.faces) + 5)
    edits = EditGains(cage, motion, EditGains(cage, motion).squares)
    assert len(edits.splits) == 2


def test_splits_leave_the_surface_where_it_is(bent):
    cage, motion = bent
    edits = EditGains(cage, motion, EditGains(cage, motion).squares)
    divided = split_edges(cage, edits.splits)
    assert len(edits.splits) == int(0.4 * len(cage.vertices))
    assert len(divided.vertices) == len(cage.vertices) + len(edits.splits)
    assert divided.is_closed
    assert divided.volume == pytest.approx(cage.volume, rel=1e-12)
