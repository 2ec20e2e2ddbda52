"""Frames of captured clips: vertices that are missing, or weigh less than others."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cageik_cli.solver.alignment import best_rotations
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.util.arrays import Floats


class FrameWeights(Protocol):
    """Weights of the vertices of each frame of a clip."""

    def read(self, start: int, stop: int) -> Floats:
        """Read the weights of frames `start` up to `stop`, exclusive: (k, m), from 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class CapturedFrames:
    """Frames with a position for every vertex, and how much it counts.

    Attributes
    ----------
    positions : (k, m, 3) float64
        Missing vertices are where the rest pose has them, moved rigidly onto the others.
    weights : (k, m) float64, optional
        From 0, for missing vertices, to 1; None if all are 1.
    """

    positions: Floats
    weights: Floats | None


def complete_frames(
    solver: DualLaplacianSolver, positions: Floats, given: Floats | None
) -> CapturedFrames:
    """Give missing vertices a position, and the weight 0.

    Parameters
    ----------
    positions : (k, m, 3)
        nan for missing vertices.
    given : (k, m), optional
        Weights of the frames.
    """
    is_missing = np.isnan(positions[..., 0])
    if not is_missing.any():
        return CapturedFrames(positions, given)
    weights = np.ones(is_missing.shape) if given is None else given.copy()
    weights[is_missing] = 0
    completed = positions.copy()
    for place in np.flatnonzero(is_missing.any(axis=1)):
        completed[place] = _complete_frame(solver, positions[place], weights[place])
    return CapturedFrames(completed, weights)


def _complete_frame(solver: DualLaplacianSolver, frame: Floats, weights: Floats) -> Floats:
    is_missing = np.isnan(frame[:, 0])
    rest = solver.binding.rest.vertices
    known = np.flatnonzero((weights > 0) & (solver.vertex_weights > 0) & ~is_missing)
    filled = frame.copy()
    if not solver.is_aligned or not len(known):
        filled[is_missing] = rest[is_missing]
        return filled
    centre, origin = frame[known].mean(axis=0), rest[known].mean(axis=0)
    turn = np.eye(3)
    if len(known) >= 3:  # fewer do not tell how the frame is turned
        ones = np.ones(len(known))
        turn = best_rotations((frame[known] - centre)[None], rest[known] - origin, ones)[0]
    filled[is_missing] = (rest[is_missing] - origin) @ turn + centre
    return filled
