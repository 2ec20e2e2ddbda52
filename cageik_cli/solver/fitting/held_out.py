"""The error of fitted weights on frames that they were not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.fitting.displacements import Displacements
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.fitting.alternate import CageSolve
from cageik_cli.solver.fitting.models import ModelFit
from cageik_cli.solver.fitting.sample import Sample, choose_vertices
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import SettingError
from cageik_cli.util.threads import OrderedMap

HELD_OUT_BLOCKS = 10
"""Each clip is cut into so many blocks of consecutive frames; every second one is held out."""

SEEN_SHARE = 2 / 3
"""Frames after this share of each clip are the last third, which is unseen."""

REPORTED_PERCENTILE = 99

COPY_SHARE = 0.05
"""Frames are copies only if they are nearer than this share of the motion, as root mean squares."""


@dataclass(frozen=True, slots=True)
class FitError:
    """Distances of reconstructions from frames, in percent of the rest pose's diagonal.

    Attributes
    ----------
    rms : float
        Root mean square over vertices and frames; a frame of the sample counts as many times as
        there are frames it stands for.
    percentile : float
        99th percentile over the vertices of the sample's frames.
    largest : float
        Largest over the vertices of the sample's frames.
    """

    rms: float
    percentile: float
    largest: float

    def __post_init__(self) -> None:
        for name in ("rms", "percentile", "largest"):
            if not getattr(self, name) >= 0:
                raise SettingError(f"{name} is {getattr(self, name)}, expected zero or above")


@dataclass(frozen=True, slots=True)
class Comparison:
    """The errors of fitted weights, and of the weights they were fitted from, on the same frames.

    Attributes
    ----------
    frames : int
        Frames of the sample that were measured.
    """

    fitted: FitError
    unfitted: FitError
    frames: int

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise SettingError(f"frames is {self.frames}, expected 1 or more")


def measure_weights(cage_solve: CageSolve, weights: Floats, target: Displacements) -> FitError:
    """Measure the error of `weights`, (m, n), on frames whose cages are solved for them."""
    solver = cage_solve.prepare(weights)
    distances, squares = [], 0.0
    scales = iter(np.sqrt(target.shares[target.frames]))
    for columns in target.blocks():
        error = weights @ solver.solve_displacements(columns)
        error -= columns
        error = error[solver.data_vertices]
        squares += float(np.vdot(error, error))
        lengths = np.sqrt(np.square(error).reshape(len(error), -1, 3).sum(axis=2))
        lengths /= [next(scales) for _ in range(lengths.shape[1])]
        distances.append(lengths.astype(np.float32).ravel())
    every = np.concatenate(distances)
    percent = 100 / cage_solve.binding.rest.diagonal
    mean = squares / (target.weight * len(every) / len(target))
    return FitError(
        float(percent * np.sqrt(mean)),
        float(percent * np.percentile(every, REPORTED_PERCENTILE)),
        float(percent * every.max()),
    )


def hold_out_blocks(sample: Sample) -> NDArray[np.bool_]:
    """Return which frames of the sample are in every second block of their clip, (k,) bool."""
    lengths = np.array(sample.lengths)[sample.clips]
    blocks = sample.frames * np.minimum(lengths, HELD_OUT_BLOCKS) // lengths
    return np.asarray(blocks % 2 == 1)


def hold_out_last_third(sample: Sample) -> NDArray[np.bool_]:
    """Return which frames of the sample are in the last third of their clip, (k,) bool."""
    lengths = np.array(sample.lengths)[sample.clips]
    return np.asarray(sample.frames >= np.ceil(SEEN_SHARE * lengths))


def count_copies(
    sample: Sample, is_held: NDArray[np.bool_], solver: DualLaplacianSolver, percent: float
) -> int:
    """Count held-out frames of a sample that are near to a frame which is not held out.

    Parameters
    ----------
    is_held : (k,) bool
    solver : DualLaplacianSolver
        Its missing vertices do not count.
    percent : float
        Root mean square distance of the vertices, in percent of the rest pose's diagonal, below
        which frames are near, unless this is more than `COPY_SHARE` of the motion.
    """
    vertices = choose_vertices(solver)
    columns = np.hstack([block[vertices] for block in sample.target.blocks()])
    poses = columns.reshape(len(vertices), -1, 3).transpose(1, 0, 2).reshape(len(sample), -1)
    poses /= np.sqrt(sample.target.shares)[:, None]
    size = np.sqrt(np.square(poses).sum(axis=1).mean())
    radius = percent / 100 * solver.binding.rest.diagonal * np.sqrt(len(vertices))
    radius = min(radius, COPY_SHARE * size)
    seen = poses[~is_held]
    if not len(seen):
        return 0
    nearest = [np.linalg.norm(seen - pose, axis=1).min() for pose in poses[is_held]]
    return int(np.count_nonzero(np.array(nearest) <= radius))


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Measures fits on frames that they did not see.

    Attributes
    ----------
    cage_solve : CageSolve
        Its binding's weights are compared with.
    jobs : int
        Fits at the same time.
    """

    cage_solve: CageSolve
    sample: Sample
    jobs: int

    def compare(
        self, cases: Sequence[tuple[NDArray[np.bool_], ModelFit]]
    ) -> list[Comparison | None]:
        """Fit to the frames that are not held out, and measure those that are, for each case.

        None where all or no frames are held out.
        """
        with OrderedMap(self._compare_case, cases, self.jobs, self.jobs) as found:
            return list(found)

    def _compare_case(self, case: tuple[NDArray[np.bool_], ModelFit]) -> Comparison | None:
        is_held, fit = case
        if is_held.all() or not is_held.any():
            return None
        seen = self.sample.target.take(np.flatnonzero(~is_held))
        return self.measure(fit(seen).weights, self.sample.target.take(np.flatnonzero(is_held)))

    def measure(self, weights: Floats, target: Displacements) -> Comparison:
        """Measure `weights`, (m, n), and those of the binding."""
        unfitted = self.cage_solve.binding.weights
        return Comparison(
            measure_weights(self.cage_solve, weights, target),
            measure_weights(self.cage_solve, unfitted, target),
            len(target),
        )
