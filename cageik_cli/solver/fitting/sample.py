"""The frames that weights are fitted to: a sample in memory, spread over the poses of the clips."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from cageik_cli.coordinates.fitting.displacements import Displacements
from cageik_cli.coordinates.fitting.problem import estimate_memory
from cageik_cli.geometry.points import choose_farthest
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.util.arrays import DEFAULT_MEMORY, Floats, Integers, fit_frames
from cageik_cli.util.errors import ConnectivityError, InputError, MissingFrameError
from cageik_cli.util.threads import OrderedMap

MAX_FITTED_FRAMES = 100
"""Frames that weights are fitted to; more hardly lower the error of the others."""

STILL_TOL = 1e-12
"""Frames that move less than this share of their coordinates do not move."""

DESCRIPTOR_VERTICES = 64
"""Vertices whose displacements describe a pose."""

DESCRIPTOR_SUMS = 8
"""Sums of the displacements of all vertices, with random signs, that describe a pose, too: frames
that differ have other sums."""


class FrameReader(Protocol):
    """A clip, or any other source of frames of the rest pose's connectivity."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def read_frame(self, index: int) -> Floats:
        """Read the vertices of a frame, (m, 3).

        Raises
        ------
        InputError
        """


@dataclass(frozen=True, slots=True)
class SampleSettings:
    """How frames are sampled.

    Attributes
    ----------
    memory : int
        Limit in bytes for the fit, the weights included.
    jobs : int
        Threads.
    skips_bad_frames : bool
        Whether frames that cannot be read are left out, as missing ones are; otherwise they are
        refused.
    max_frames : int
        Most frames in the sample.
    """

    memory: int = DEFAULT_MEMORY
    jobs: int = 1
    skips_bad_frames: bool = False
    max_frames: int = MAX_FITTED_FRAMES


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Frames of one or several clips, aligned with the rest pose.

    Attributes
    ----------
    target : Displacements
        Of k frames.
    clips : (k,) int64
        Number of the clip of each frame.
    frames : (k,) int64
        Number of each frame in its clip.
    lengths : tuple of int
        Frames of each clip.
    needed_memory : int or None
        Bytes with which the sample would have as many frames as it may have; None if it has.
    """

    target: Displacements
    clips: Integers
    frames: Integers
    lengths: tuple[int, ...]
    needed_memory: int | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def take(self, chosen: Integers) -> "Sample":
        """Return some of the frames; shares the memory."""
        return replace(
            self,
            target=self.target.take(self.target.frames[chosen]),
            clips=self.clips[chosen],
            frames=self.frames[chosen],
        )


def sample_frames(
    clips: Sequence[FrameReader], solver: DualLaplacianSolver, settings: SampleSettings
) -> Sample:
    """Sample the frames of clips, and align them with the rest pose.

    All frames are read once if they fit in memory. Otherwise only a few vertices of each are kept,
    and the chosen frames are read again.

    Parameters
    ----------
    solver : DualLaplacianSolver
        It aligns the frames.

    Raises
    ------
    InputError
        When a frame cannot be read and must not be skipped, or no frame can be read.
    """
    m, n = solver.binding.weights.shape
    least = estimate_memory(m, n, jobs=1)
    left = settings.memory - least
    places = [(c, f) for c, clip in enumerate(clips) for f in range(len(clip))]
    reader = _Reader(clips, solver, settings)
    lengths = tuple(map(len, clips))
    describe = _make_descriptor(solver)
    if fit_frames(left, m, 2) >= len(places):  # the frames, and the chosen ones of them
        read = list(reader.read(places, lambda columns: columns))
        poses = np.stack([describe(frame.value) for frame in read])
        chosen = spread_points(poses, settings.max_frames)
        kept = [read[k] for k in chosen]
    else:
        read = list(reader.read(places, describe))
        poses = np.stack([frame.value for frame in read])
        capacity = min(settings.max_frames, fit_frames(left, m, 2, itemsize=4))
        dtype = np.float64 if fit_frames(left, m, 2) >= capacity else np.float32
        chosen = spread_points(poses, capacity)
        again = [read[k].place for k in chosen]
        kept = list(reader.read(again, lambda columns: columns.astype(dtype)))
    numbers = np.array([frame.place for frame in kept], np.int64)
    target = Displacements.join([frame.value for frame in kept], count_nearest(poses, chosen))
    wanted = min(settings.max_frames, len(read))
    needed = None if len(kept) == wanted else least + wanted * 2 * 3 * m * 4
    return Sample(target, numbers[:, 0], numbers[:, 1], lengths, needed)


@dataclass(frozen=True, slots=True, eq=False)
class _Read:
    """What is kept of a frame, and its place: clip and frame."""

    place: tuple[int, int]
    value: Floats


class _Reader:
    """Reads frames ahead by threads and aligns them."""

    def __init__(
        self, clips: Sequence[FrameReader], solver: DualLaplacianSolver, settings: SampleSettings
    ) -> None:
        self._clips, self._solver, self._settings = clips, solver, settings

    def read(
        self, places: Sequence[tuple[int, int]], keep: Callable[[Floats], Floats]
    ) -> Iterator[_Read]:
        """Yield what `keep` returns of the displacements, (m, 3), of each readable frame."""
        count = 0
        jobs = self._settings.jobs
        with OrderedMap(self._read_or_error, places, jobs, jobs) as frames:
            for place, frame in zip(places, frames, strict=True):
                if isinstance(frame, InputError):
                    is_missing = isinstance(frame, MissingFrameError)
                    if not (is_missing or self._settings.skips_bad_frames):
                        raise frame
                    continue
                count += 1
                self._check_shape(place, frame)
                columns = self._solver.align(frame[None]).columns
                if np.abs(columns).max() <= STILL_TOL * np.abs(frame).max():
                    columns[:] = 0  # weights would be fitted to rounding
                yield _Read(place, keep(columns))
        if not count:
            raise InputError("no frame can be read; weights are fitted to at least one frame")

    def _check_shape(self, place: tuple[int, int], frame: Floats) -> None:
        expected = self._solver.binding.rest.vertices.shape
        if frame.shape != expected:
            clip, number = place
            raise ConnectivityError(
                f"frame {number} of clip {clip} has shape {frame.shape}, the binding's rest pose "
                f"{expected}; fit weights to clips of the model that is bound"
            )

    def _read_or_error(self, place: tuple[int, int]) -> Floats | InputError:
        clip, frame = place
        try:
            return self._clips[clip].read_frame(frame)
        except InputError as error:
            return error


def _make_descriptor(solver: DualLaplacianSolver) -> Callable[[Floats], Floats]:
    """Return the function that describes a pose, (m, 3), by a few numbers, (d,)."""
    vertices = choose_vertices(solver)
    counted = np.zeros(len(solver.binding.rest.vertices))
    counted[solver.data_vertices] = 1
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (DESCRIPTOR_SUMS, len(counted)))
    signs *= counted / np.sqrt(counted.sum())
    return lambda columns: np.concatenate([columns[vertices].ravel(), (signs @ columns).ravel()])


def choose_vertices(solver: DualLaplacianSolver) -> Integers:
    """Choose data vertices that are spread over the rest pose."""
    rest = solver.binding.rest.vertices
    numbers = np.arange(len(rest))[solver.data_vertices]
    points = rest[numbers] - rest[numbers].mean(axis=0)
    return np.asarray(numbers[spread_points(points, DESCRIPTOR_VERTICES)])


def spread_points(points: Floats, count: int) -> Integers:
    """Choose `count` points, (p, d), far from the origin and from each other, in ascending order.

    Returns
    -------
    (min(count, p),) int64, fewer if there are not so many different points. The first choice is
    the point farthest from the origin, the others as of `choose_farthest`.
    """
    if count >= len(points):
        return np.arange(len(points))

    def measure(chosen: int) -> Floats:
        offsets = points - points[chosen]
        return np.asarray(np.einsum("pd,pd->p", offsets, offsets))

    first = int(np.argmax(np.einsum("pd,pd->p", points, points)))
    others = choose_farthest(count - 1, measure(first), measure)
    return np.sort(np.array([first, *others], np.int64))


def count_nearest(points: Floats, chosen: Integers) -> Floats:
    """Return how many points, (p, d), have each of the chosen ones as their nearest; float64."""
    if len(chosen) == len(points):
        return np.ones(len(points))
    distances = [np.square(points - points[k]).sum(axis=1) for k in chosen]
    nearest = np.argmin(distances, axis=0)
    return np.bincount(nearest, minlength=len(chosen)).astype(np.float64)
