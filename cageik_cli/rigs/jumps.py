"""Joints that jump from one frame to the next: found, and smoothed over time.

Where the surface around a joint is flattened, or mirrored against the rest pose, rotations far
apart fit it nearly alike, and the best one changes from frame to frame. A joint jumps if it turns
in one step by more than `MIN_TURN`, and by `MIN_EXCESS` more than the surface around it: than the
rotation nearest to Σ_i w_i (x_i − x̄)ᵀ (v̂_i − v̄), which has no neighbours to agree with.

In steps that jump, and in those near to them, the sum that the joints minimise gets

    λ tr(I_j) |R_j(t) − R_j(t − 1)|²,

with I_j = E − e eᵀ/μ of `joints`, so that λ is relative. All joints of these frames move again, in
even and in odd frames by turns, so that each frame has the rotations before and after it. λ grows
where a joint still jumps, while the sum without this term stays within `MAX_LOSS` of what frames
solved for themselves have. Other frames, and clips without jumps, stay as they are.

The whole clip is streamed: two blocks are smoothed together, then the first of them is done.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from cageik_cli.rigs.joints import JointFrames, JointPoses, JointSolver
from cageik_cli.util.arrays import Floats, Mask

MIN_TURN, MIN_EXCESS = 60.0, 30.0
"""Degrees by which a joint that jumps turns in one step, and more than the surface around it."""

FIRST_PULL, PULL_GROWTH = 0.05, 2.0
"""λ at first, and its growth from round to round."""

STEPS_AROUND = 3
"""So many steps before and after a jump are smoothed with it."""

MAX_LOSS = 0.01
"""The sum that is minimised may grow by this share; where it would by more, a jump is left."""

MAX_SMOOTHINGS = 10
"""λ grows so many times at most; four rounds smooth all 39 jumps of a chicken that is run over."""

SMOOTHING_SWEEPS = 8
"""In a round, all joints of the frames that are smoothed move in turn so many times."""


def follow_frames(joints: JointSolver, blocks: Iterable[Floats]) -> Iterator[JointPoses]:
    """Yield the joints that follow blocks of consecutive frames, (k, m, 3), and smooth jumps.

    One block more is taken than is yielded. Jumps that are left are marked.
    """
    done: JointFrames | None = None
    held: JointFrames | None = None
    for block in chain(map(joints.solve, blocks), [None]):
        if held is not None:
            window = [held] if block is None else [held, block]
            held, *after = smooth_jumps(joints, window, done)
            jumps = find_jumps([held] if done is None else [done, held])
            yield replace(joints.pose(held), jumps=jumps[-len(held.rotations) :])
            done, block = _take_last(held), after[0] if after else None
        held = block


def find_jumps(blocks: list[JointFrames]) -> Mask:
    """Return which joints jump from the frame before, (k, n); none in the first."""
    turns = np.concatenate([block.turns for block in blocks])
    around = np.concatenate([block.surface for block in blocks])
    angles, least = _measure_steps(turns), _measure_steps(around) + MIN_EXCESS
    is_jump = np.zeros(turns.shape[:2], bool)
    is_jump[1:] = (angles > MIN_TURN) & (angles > least)
    return is_jump


def smooth_jumps(
    joints: JointSolver, blocks: list[JointFrames], done: JointFrames | None = None
) -> list[JointFrames]:
    """Return consecutive blocks whose joints jump less; the frame before them, `done`, stays."""
    blocks = blocks if done is None else [done, *blocks]
    first, n = int(done is not None), len(blocks[0].changes) // 4
    right = np.concatenate([block.right.reshape(4 * n, -1, 3) for block in blocks], axis=1)
    pulls = np.zeros((right.shape[1] + 1, n))  # of the steps before and after each frame
    for _ in range(MAX_SMOOTHINGS):
        is_jump = find_jumps(blocks)
        if not is_jump.any():
            break
        near = np.zeros_like(is_jump)
        for frame, joint in np.argwhere(is_jump):
            near[max(frame - STEPS_AROUND, 1) : frame + STEPS_AROUND + 1, joint] = True
        pulls[:-1][near] = np.maximum(FIRST_PULL, PULL_GROWTH * pulls[:-1][near])
        moved = _move_joints(joints, right, blocks, pulls, first)
        if _measure_loss(joints, moved[first:]) > MAX_LOSS:
            break
        blocks = moved
    return blocks[first:]


def _measure_loss(joints: JointSolver, blocks: list[JointFrames]) -> float:
    """Return by which share blocks fit worse than where each frame is solved for itself."""
    found = sum((b.still + joints.measure_gain(b.right, b.changes)).sum() for b in blocks)
    return float(found / max(sum(b.misfit.sum() for b in blocks), np.finfo(float).tiny)) - 1


def _move_joints(
    joints: JointSolver, right: Floats, blocks: list[JointFrames], pulls: Floats, first: int
) -> list[JointFrames]:
    """Return blocks whose joints move, in frames beside steps of λ > 0, (F + 1, n), from `first`.

    The right-hand sides, (4n, F, 3), are those of all blocks.
    """
    (rows, count, _), n = right.shape, pulls.shape[1]
    changes = np.concatenate([block.changes.reshape(rows, -1, 3) for block in blocks], axis=1)
    matrices = changes.reshape(n, 4, count, 3)[:, :3]
    moving = np.flatnonzero((pulls[:-1] + pulls[1:]).any(axis=1))
    moving = moving[moving >= first]
    for _ in range(SMOOTHING_SWEEPS):
        for chosen in (moving[moving % 2 == 0], moving[moving % 2 == 1]):
            drawn = np.zeros((n, 3, len(chosen), 3))
            for steps, beside in ((chosen, chosen - 1), (chosen + 1, (chosen + 1) % count)):
                turns = matrices[:, :, beside] + np.eye(3)[:, None]
                drawn += pulls[steps].T[:, None, :, None] * turns
            sides, held = (one[:, chosen].reshape(rows, -1) for one in (right, changes))
            moved = joints.sweep(sides, held, 1, drawn)
            changes[:, chosen] = moved.reshape(rows, -1, 3)
    bounds = np.cumsum([len(block.rotations) for block in blocks])[:-1]
    parts = np.split(changes, bounds, axis=1)
    return [
        replace(block, changes=np.ascontiguousarray(part).reshape(rows, -1))
        for block, part in zip(blocks, parts, strict=True)
    ]


def _take_last(block: JointFrames) -> JointFrames:
    """Return the last frame of a block, without its normals."""
    return JointFrames(
        right=block.right[:, -3:],
        changes=block.changes[:, -3:],
        still=block.still[-1:],
        misfit=block.misfit[-1:],
        centres=block.centres[-1:],
        rotations=block.rotations[-1:],
        surface=block.surface[-1:],
        normals=np.empty((0, 0, 3)),
    )


def _measure_steps(turns: Floats) -> Floats:
    """Return by how many degrees rotations (k, n, 3, 3) turn from frame to frame, (k − 1, n)."""
    traces = np.einsum("knab,knab->kn", turns[1:], turns[:-1])
    return np.asarray(np.degrees(np.arccos(((traces - 1) / 2).clip(-1, 1))))
