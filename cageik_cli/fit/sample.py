"""Which frames weights are fitted to, a sample spread over the poses of the clips, and held out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from cageik_cli.fit.problem import Displacements, estimate_memory
from cageik_cli.fit.settings import MAX_HELD_OUT_BLOCKS
from cageik_cli.geometry.points import choose_farthest
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.util.arrays import Floats, Integers, Mask, count_frames
from cageik_cli.util.errors import ConnectivityError, InputError, MissingFrameError
from cageik_cli.util.threads import OrderedMap

MAX_FITTED_FRAMES = 200
"""Frames that weights are fitted to; more hardly lower the error of the others."""

MIN_FITTED_FRAMES = 10
"""Frames of a long clip that a fit which nobody asked for needs: of fewer, poses are missing."""

MAX_COPY_DISTANCE = 0.01
"""Frames nearer to another than this share of the motion are its copies."""

MAX_DESCRIPTOR_VERTICES = 64
"""Vertices whose displacements describe a pose."""


class FrameReader(Protocol):
    """A clip, or any other source of frames of the rest pose's connectivity."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def read_frame(self, index: int) -> Floats:
        """Read the vertices of a frame, (m, 3)."""


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

    @property
    def in_held_out_block(self) -> Mask:
        """Which frames are in every second block of their clip, (k,) bool."""
        lengths = np.array(self.lengths)[self.clips]
        blocks = self.frames * np.minimum(lengths, MAX_HELD_OUT_BLOCKS) // lengths
        return np.asarray(blocks % 2 == 1)

    @property
    def in_last_third(self) -> Mask:
        """Which frames are in the last third of their clip, (k,) bool."""
        lengths = np.array(self.lengths)[self.clips]
        return np.asarray(self.frames >= np.ceil(2 / 3 * lengths))

    @property
    def held_out_masks(self) -> tuple[Mask, Mask]:
        """Which frames are in every second block of their clip, and which in its last third."""
        return self.in_held_out_block, self.in_last_third

    @property
    def can_hold_out(self) -> bool:
        """Return whether some frames are in a block that is held out, and some are not."""
        is_held = self.in_held_out_block
        return bool(is_held.any() and not is_held.all())

    def count_copies(self, solver: DualLaplacianSolver, rms_percent: float) -> int:
        """Count the frames of held-out blocks that are near to a frame which is not held out.

        Near is below `rms_percent`, the root mean square distance of the vertices in percent of
        the rest pose's diagonal, and below 5 % of the motion. Missing vertices of the solver do
        not count.
        """
        is_held = self.in_held_out_block
        poses, size = self._describe_poses(solver)
        vertices = poses.shape[1] // 3
        radius = rms_percent / 100 * solver.binding.rest.diagonal * np.sqrt(vertices)
        radius = min(radius, 0.05 * size)
        seen = poses[~is_held]
        if not len(seen):
            return 0
        nearest = [np.linalg.norm(seen - pose, axis=1).min() for pose in poses[is_held]]
        return int(np.count_nonzero(np.array(nearest) <= radius))

    def count_distinct(self, solver: DualLaplacianSolver) -> int:
        """Count frames that are not near to a frame before them, or to the rest pose.

        Near is below `MAX_COPY_DISTANCE` of the motion.
        """
        poses, size = self._describe_poses(solver)
        known = np.zeros((1, poses.shape[1]))
        for pose in poses:
            if np.linalg.norm(known - pose, axis=1).min() > MAX_COPY_DISTANCE * size:
                known = np.vstack([known, pose])
        return len(known) - 1

    def _describe_poses(self, solver: DualLaplacianSolver) -> tuple[Floats, float]:
        """Return displacements of a few vertices, (k, 3s), and how large they are: a mean."""
        vertices = choose_vertices(solver)
        columns = np.hstack([block[vertices] for block in self.target.blocks()])
        poses = columns.reshape(len(vertices), -1, 3).transpose(1, 0, 2).reshape(len(self), -1)
        poses /= np.sqrt(self.target.shares[self.target.frames])[:, None]
        return poses, float(np.sqrt(np.square(poses).sum(axis=1).mean()))


def sample_frames(
    clips: Sequence[FrameReader],
    solver: DualLaplacianSolver,
    *,
    memory: int,
    jobs: int,
    skips_bad_frames: bool = False,
    max_frames: int = MAX_FITTED_FRAMES,
) -> Sample:
    """Sample at most so many frames of clips, and align them with the rest pose by the solver.

    All frames are read once if they fit in memory. Otherwise only a few vertices of each are kept,
    and the chosen frames are read again.

    Parameters
    ----------
    memory : int
        Limit in bytes for the fit, the weights included.
    skips_bad_frames : bool
        Whether frames that cannot be read are left out, as missing ones are; otherwise they are
        refused.

    Raises
    ------
    InputError
        When a frame cannot be read and must not be skipped, or no frame can be read.
    """
    m, n = solver.binding.weights.shape
    least = estimate_memory(m, n, jobs=1)
    left = memory - least
    places = [(c, f) for c, clip in enumerate(clips) for f in range(len(clip))]
    read = partial(_read_aligned, clips, solver, jobs=jobs, skips_bad_frames=skips_bad_frames)
    describe = _make_descriptor(solver)
    if count_frames(left, m, 2) >= len(places):  # the frames, and the chosen ones of them
        places, frames = read(places, lambda columns: columns)
        poses = np.stack([describe(columns) for columns in frames])
        chosen = spread_points(poses, max_frames)
        kept_places, kept = [places[k] for k in chosen], [frames[k] for k in chosen]
    else:
        places, descriptions = read(places, describe)
        poses = np.stack(descriptions)
        capacity = min(max_frames, count_frames(left, m, 2, itemsize=4))
        dtype = np.float64 if count_frames(left, m, 2) >= capacity else np.float32
        chosen = spread_points(poses, capacity)
        again = [places[k] for k in chosen]
        kept_places, kept = read(again, lambda columns: columns.astype(dtype))
    numbers = np.array(kept_places, np.int64)
    wanted = min(max_frames, len(places))
    return Sample(
        target=Displacements.join(kept, count_nearest(poses, chosen)),
        clips=numbers[:, 0],
        frames=numbers[:, 1],
        lengths=tuple(map(len, clips)),
        needed_memory=None if len(kept) == wanted else least + wanted * 2 * 3 * m * 4,
    )


def estimate_least_memory(m: int, n: int, count: int) -> int:
    """Return the bytes that a fit takes of (m, n) weights to a small sample of `count` frames."""
    return estimate_memory(m, n, jobs=1) + min(count, MIN_FITTED_FRAMES) * 2 * 3 * m * 4


def _read_aligned(
    clips: Sequence[FrameReader],
    solver: DualLaplacianSolver,
    places: Sequence[tuple[int, int]],
    keep: Callable[[Floats], Floats],
    *,
    jobs: int,
    skips_bad_frames: bool,
) -> tuple[list[tuple[int, int]], list[Floats]]:
    """Read frames at places, clip and frame, ahead by threads; align them with the rest pose.

    Returned are the places of the frames that can be read, and what `keep` returns of the
    displacements, (m, 3), of each.
    """
    expected = solver.binding.rest.vertices.shape

    def read_or_error(place: tuple[int, int]) -> Floats | InputError:
        clip, number = place
        try:
            return clips[clip].read_frame(number)
        except InputError as error:
            return error

    found, kept = [], []
    with OrderedMap(read_or_error, places, jobs, jobs) as frames:
        for place, frame in zip(places, frames, strict=True):
            if isinstance(frame, InputError):
                if not (isinstance(frame, MissingFrameError) or skips_bad_frames):
                    raise frame
                continue
            if frame.shape != expected:
                raise ConnectivityError(
                    f"frame {place[1]} of clip {place[0]} has shape {frame.shape}, the binding's "
                    f"rest pose {expected}; fit weights to clips of the model that is bound"
                )
            columns = solver.align(frame[None])[0]
            if np.abs(columns).max() <= 1e-12 * np.abs(frame).max():
                columns[:] = 0  # it does not move; weights would be fitted to rounding
            found.append(place)
            kept.append(keep(columns))
    if not found:
        raise InputError("no frame can be read; weights are fitted to at least one frame")
    return found, kept


def _make_descriptor(solver: DualLaplacianSolver) -> Callable[[Floats], Floats]:
    """Return the function that describes a pose, (m, 3), by a few numbers, (d,).

    They are the displacements of a few vertices, and sums of those of all vertices with random
    signs: frames that differ have other sums.
    """
    vertices, sums = choose_vertices(solver), 8
    counted = np.zeros(len(solver.binding.rest.vertices))
    counted[solver.data_vertices] = 1
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (sums, len(counted)))
    signs *= counted / np.sqrt(counted.sum())
    return lambda columns: np.concatenate([columns[vertices].ravel(), (signs @ columns).ravel()])


def choose_vertices(solver: DualLaplacianSolver) -> Integers:
    """Choose data vertices that are spread over the rest pose: they describe poses."""
    rest = solver.binding.rest.vertices
    numbers = np.arange(len(rest))[solver.data_vertices]
    points = rest[numbers] - rest[numbers].mean(axis=0)
    return np.asarray(numbers[spread_points(points, MAX_DESCRIPTOR_VERTICES)])


def spread_points(points: Floats, count: int) -> Integers:
    """Choose `count` points, (p, d), far from the origin and from each other, in ascending order.

    They are fewer if there are not so many different points. The first choice is the point
    farthest from the origin, the others as of `choose_farthest`.
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
