"""How well a cage expresses an animation: its error on spread frames, at preview accuracy."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.bind import bind
from cageik_cli.cages.build import Clip
from cageik_cli.coordinates.binding import reconstruct
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.settings import SolveSettings
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.errors import CageikError
from cageik_cli.util.threads import limit_blas_threads

MAX_MEASURED_FRAMES = 32
"""Frames of an animation on which candidates are compared, at most."""


def make_measured_clip(
    rest: TriMesh, frame_count: int, read_frame: Callable[[int], Floats], jobs: int
) -> Clip:
    """Read evenly spaced frames of an animation, for which a cage is to be built.

    Parameters
    ----------
    read_frame : callable
        Returns the positions (m, 3) of a frame, by its number.
    jobs : int
        Threads.
    """
    chosen = spread_evenly(frame_count, MAX_MEASURED_FRAMES)
    poses = np.stack([read_frame(int(k)) for k in chosen])
    return Clip(poses, _Measure(rest, poses, jobs))


@dataclass(frozen=True, slots=True, eq=False)
class _Measure:
    """The error of a cage on frames of an animation."""

    rest: TriMesh
    frames: Floats
    jobs: int

    def __call__(self, cage: TriMesh) -> float:
        """Return the rms distance, in percent of the diagonal; infinite for a poor cage."""
        try:
            binding = bind(self.rest, cage, BindSettings(accuracy="preview"), self.jobs)
        except CageikError:
            return float("inf")
        with limit_blas_threads(1):
            cages = DualLaplacianSolver(binding, SolveSettings()).solve(self.frames).cages
        squares = ((reconstruct(binding.weights, cages) - self.frames) ** 2).sum(axis=2)
        return float(100 * np.sqrt(squares.mean()) / self.rest.diagonal)
