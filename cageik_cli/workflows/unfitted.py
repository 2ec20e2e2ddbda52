"""Measure a clip with the weights before the fit, so that a report can show both."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.metrics import check_finite, measure
from cageik_cli.store.unfitted import UnfittedClip, UnfittedErrors, UnfittedShapes
from cageik_cli.util.arrays import Floats, Integers, Workspace, spread_evenly

MAX_FRAMES = 64
"""Evenly spread frames that are measured; the key frames are measured beside them."""


@dataclass(frozen=True, slots=True, eq=False)
class FramesToCompare:
    """The frames that are measured with the weights before the fit.

    Attributes
    ----------
    known : (k,) int64
        Numbers of the frames that were not skipped.
    key_frames : sequence of int
        Those that the result keeps in full.
    read : callable
        Reads a frame, (m, 3), by its number.
    """

    known: Integers
    key_frames: Sequence[int]
    read: Callable[[int], Floats]

    def choose(self) -> list[int]:
        """Return at most `MAX_FRAMES` evenly spread frames, and the key frames, ascending."""
        places = spread_evenly(len(self.known), MAX_FRAMES)
        return sorted({*self.known[places].tolist(), *self.key_frames})


def measure_unfitted(
    solver: DualLaplacianSolver, fitted: Binding, frames: FramesToCompare
) -> UnfittedClip:
    """Measure frames with the weights before the fit, one by one.

    Parameters
    ----------
    solver : DualLaplacianSolver
        With the weights before the fit.

    Raises
    ------
    InputError
        When a frame cannot be read.
    NumericalError
        When the solve gives numbers that are not finite or too large.
    """
    rest, workspace = solver.binding.rest, Workspace()
    chosen, misses = frames.choose(), {}
    rms = np.empty(len(chosen))
    for place, k in enumerate(chosen):
        frame = frames.read(k)[None]
        solution = solver.solve(frame, workspace)
        rebuilt = solution.reconstructions
        metrics = measure(rest, frame, rebuilt, solver.data_vertices, workspace).metrics
        check_finite(k, solution.cages, metrics)
        rms[place] = metrics.rms[0]
        if k in frames.key_frames:
            misses[k] = (frame[0] - rebuilt[0]) / rest.diagonal
    vertex = find_changed_vertex(solver.binding.weights, fitted.weights)
    influence = solver.binding.weights[:, vertex].copy()
    shown = np.stack([misses[k] for k in frames.key_frames])
    return UnfittedClip(
        UnfittedErrors(np.array(chosen, np.int64), rms), UnfittedShapes(shown, vertex, influence)
    )


def find_changed_vertex(before: Floats, after: Floats) -> int:
    """Return the cage vertex whose weights differ most, by the norm of its column of (m, n)."""
    changes = [np.linalg.norm(new - old) for old, new in zip(before.T, after.T, strict=True)]
    return int(np.argmax(changes))
