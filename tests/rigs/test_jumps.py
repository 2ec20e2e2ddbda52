"""Joints that jump: found, smoothed where the data does not hold them, and left where it does."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.rigs import jumps as module
from cageik_cli.rigs.joints import JointSolver
from cageik_cli.rigs.jumps import find_jumps, follow_frames, smooth_jumps
from tests.fitted import small_binding
from tests.shapes import rotation

BALL = small_binding()
JOINTS = JointSolver(DualLaplacianSolver(replace(BALL, has_offsets=True), SolveSettings()))
COUNT = 24


def crushed():
    """Frames pressed to a thread, which noise turns and mirrors from frame to frame."""
    noise = np.random.default_rng(0).normal(0, 0.02, (COUNT, *BALL.rest.vertices.shape))
    return BALL.rest.vertices * [0.1, 0.1, 1] + noise


def turned_inside_out():
    """Frames pressed flat and on into the mirror, whose best rotations must change once."""
    return BALL.rest.vertices * np.linspace([1, 1, 1], [-1, 1, 1], COUNT)[:, None]


def bent_slowly():
    x = BALL.rest.vertices
    angles = np.linspace(0, 0.5, COUNT)
    return np.stack([x + 0.3 * a * np.sin(2 * x[:, [1, 2, 0]] + a) for a in angles])


def follow(frames, size=8):
    """The turns (F, n, 3, 3), the meshes and the jumps that are left."""
    blocks = (frames[k : k + size] for k in range(0, len(frames), size))
    poses = list(follow_frames(JOINTS, blocks))
    return [
        np.concatenate([getattr(p, name) for p in poses]) for name in ("turns", "meshes", "jumps")
    ]


def distance(meshes, frames):
    return float(np.sqrt(np.square(meshes - frames).sum(axis=2).mean()))


def step_angles(turns):
    """Degrees by which rotations turn from frame to frame, by their vectors."""
    relative = np.einsum("knab,kncb->knac", turns[1:], turns[:-1])
    return np.degrees(np.arccos(((np.trace(relative, axis1=2, axis2=3) - 1) / 2).clip(-1, 1)))


@pytest.mark.parametrize("size", [1, 5, 8, 16, 100])
def test_joints_of_a_crushed_surface_do_not_jump_and_follow_it_as_well(size):
    frames = crushed()
    alone = JOINTS.solve(frames)
    assert find_jumps([alone]).sum() > 100
    turns, meshes, jumps = follow(frames, size)
    assert not jumps.any()
    assert step_angles(turns).max() < module.MIN_TURN
    assert distance(meshes, frames) < 1.01 * distance(JOINTS.pose(alone).meshes, frames)
    products = turns @ turns.swapaxes(2, 3)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), turns.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(turns), 1, rtol=1e-9)


def test_jumps_that_the_surface_needs_are_left_and_marked():
    frames = turned_inside_out()
    alone = JOINTS.solve(frames)
    turns, meshes, jumps = follow(frames)
    assert distance(meshes, frames) < 1.01 * distance(JOINTS.pose(alone).meshes, frames)
    assert jumps.any()
    assert (step_angles(turns)[jumps[1:]] > module.MIN_TURN).all()
    assert not jumps[0].any()


def test_a_larger_loss_would_smooth_them(monkeypatch):
    monkeypatch.setattr(module, "MAX_LOSS", np.inf)
    frames = turned_inside_out()
    _, meshes, jumps = follow(frames)
    assert not jumps.any()
    assert distance(meshes, frames) > 2 * distance(JOINTS.pose(JOINTS.solve(frames)).meshes, frames)


def test_a_clip_without_jumps_stays_as_it_is_to_the_bit():
    frames = bent_slowly()
    turns, meshes, jumps = follow(frames)
    assert not jumps.any()
    poses = [JOINTS.pose(JOINTS.solve(block)) for block in np.split(frames, 3)]
    np.testing.assert_array_equal(turns, np.concatenate([p.turns for p in poses]))
    np.testing.assert_array_equal(meshes, np.concatenate([p.meshes for p in poses]))


def test_frames_far_from_a_jump_stay_as_they_are_to_the_bit():
    frames = np.concatenate([bent_slowly(), crushed()[:2], bent_slowly()[::-1]])
    turns, _, _ = follow(frames)
    alone = np.concatenate(
        [JOINTS.solve(frames[k : k + 8]).turns for k in range(0, len(frames), 8)]
    )
    assert not np.array_equal(turns[COUNT : COUNT + 2], alone[COUNT : COUNT + 2])
    far = np.r_[: COUNT - 6, COUNT + 8 : len(frames)]
    np.testing.assert_array_equal(turns[far], alone[far])


def test_a_frame_that_is_done_stays():
    frames = crushed()
    first, second = JOINTS.solve(frames[:1]), JOINTS.solve(frames[1:])
    assert find_jumps([first, second])[1].any()
    (moved,) = smooth_jumps(JOINTS, [second], first)
    assert not find_jumps([first, moved]).any()


def test_a_surface_that_turns_itself_makes_no_jump():
    frames = np.stack([BALL.rest.vertices @ rotation(2 * k).T for k in range(6)])
    turns, meshes, jumps = follow(frames)
    assert step_angles(turns).max() > module.MIN_TURN
    assert not jumps.any()
    np.testing.assert_allclose(meshes, frames, atol=1e-10)


def test_the_surface_turns_as_the_best_rotation_of_what_follows():
    frames = crushed()
    found = JOINTS.solve(frames).surface
    for joint, weights in enumerate(BALL.weights.T):
        shares = weights[:, None] / weights.sum()
        rest = BALL.rest.vertices - (shares * BALL.rest.vertices).sum(axis=0)
        moved = frames - (shares * frames).sum(axis=1, keepdims=True)
        left, _, right = np.linalg.svd(rest.T @ (shares * moved))
        left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
        np.testing.assert_allclose(found[:, joint], left @ right, atol=1e-6)


def test_a_clip_without_frames_has_no_joints():
    assert list(follow_frames(JOINTS, [])) == []
