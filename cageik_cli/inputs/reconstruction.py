"""The cages of an animation, and the animation that they give: of a mesh, points or splats."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.fit.transferred import TransferredChange
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.ply_points import place_normals, place_positions, place_splats
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.method.points.motion import PointMotion
from cageik_cli.method.points.oriented import Oriented
from cageik_cli.method.solve.alignment import best_rotations
from cageik_cli.method.weights.binding import (
    FRAMES_PER_PRODUCT,
    Binding,
    Poses,
    reconstruct_frames,
)
from cageik_cli.rigs.joints import JointPoses
from cageik_cli.store.result import StoredAnimation, read_cages, read_rotations
from cageik_cli.util.arrays import Floats, Integers, fill_gaps
from cageik_cli.util.messages import Note
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import OrderedMap


@dataclass(frozen=True, slots=True, eq=False)
class CageFrames:
    """The cages of an animation.

    Attributes
    ----------
    count : int
        Frames, those included whose cages fill a gap.
    known : (k,) int64
        Numbers of the other frames.
    read : callable
        Reads the cage of a frame, (n, 3), by its number.
    blocks : callable
        Yields all cages in order, in blocks (k, n, 3) of at most the given number of frames.
    rotations : (F, 3, 3) float64, optional
        Of the rest pose to each frame, for a binding that has offsets.
    clip_counts : tuple of int, optional
        Frames of each clip, of several that follow each other.
    """

    count: int
    known: Integers
    read: Callable[[int], Floats]
    blocks: Callable[[int], Iterator[Floats]]
    rotations: Floats | None = None
    clip_counts: tuple[int, ...] | None = None

    def poses(self, size: int) -> Iterator[Poses]:
        """Yield all poses in order, in blocks of at most `size` frames."""
        start = 0
        for cages in self.blocks(size):
            yield self.make_poses(start, cages)
            start += len(cages)

    def make_poses(self, start: int, cages: Floats) -> Poses:
        """Return the poses of the cages of frames from `start` on."""
        stop = start + len(cages)
        return Poses(cages, None if self.rotations is None else self.rotations[start:stop])

    @staticmethod
    def from_result(result: StoredAnimation, binding: Binding | None = None) -> "CageFrames":
        """Return the cages of a result, whose gaps are filled, with what the binding needs."""
        count = len(result.frames)
        is_turned = binding is not None and binding.has_offsets
        return CageFrames(
            count=count,
            known=np.setdiff1d(np.arange(count), result.gaps),
            read=lambda frame: next(read_cages(result, 1, frame))[0],
            blocks=lambda size: read_cages(result, size),
            rotations=read_rotations(result) if is_turned else None,
        )

    @staticmethod
    def join(clips: "Sequence[CageFrames]") -> "CageFrames":
        """Return the cages of several clips of one binding, one after another."""
        if len(clips) == 1:
            return clips[0]
        ends = np.cumsum([clip.count for clip in clips])
        starts = [0, *ends[:-1].tolist()]

        def read(frame: int) -> Floats:
            k = int(np.searchsorted(ends, frame, side="right"))
            return clips[k].read(frame - starts[k])

        turned = [clip.rotations for clip in clips if clip.rotations is not None]
        return CageFrames(
            count=int(ends[-1]),
            known=np.concatenate([k + clip.known for k, clip in zip(starts, clips, strict=True)]),
            read=read,
            blocks=lambda size: chain.from_iterable(clip.blocks(size) for clip in clips),
            rotations=np.concatenate(turned) if turned else None,
            clip_counts=tuple(clip.count for clip in clips),
        )

    def convert(self, conversion: SceneConversion) -> "CageFrames":
        """Return the cages in another scene."""
        if not conversion:
            return self
        return replace(
            self,
            read=lambda frame: conversion.apply(self.read(frame)),
            blocks=lambda size: map(conversion.apply, self.blocks(size)),
        )

    @staticmethod
    def from_clip(clip: MeshSequence, jobs: int) -> "CageFrames":
        """Return the frames of a clip of cages, which threads read in advance; gaps are filled."""
        known = np.setdiff1d(np.arange(len(clip)), list(clip.missing))

        def blocks(size: int) -> Iterator[Floats]:
            with closing(clip.blocks(size, jobs)) as read:
                for block in read:
                    block.raise_read_errors(ignore_missing=True)
                    fill_gaps(block.positions, block.start, known, clip.read_frame)
                    yield block.positions

        return CageFrames(len(clip), known, clip.read_frame, blocks)


class Reconstruction:
    """The mesh animation that cages give; a source of frames for a fit, without filled gaps."""

    def __init__(self, binding: Binding, cages: CageFrames) -> None:
        self.binding, self.cages = binding, cages

    def __len__(self) -> int:
        return len(self.cages.known)

    def read_frame(self, index: int) -> Floats:
        """Return the mesh (m, 3) of a frame that fills no gap."""
        frame = int(self.cages.known[index])
        poses = self.cages.make_poses(frame, self.cages.read(frame)[None])
        return np.asarray(self._rebuild(poses).meshes[0])

    def hash_frames(self) -> str:
        """Return a digest of the cages of all frames, and of what turns with them."""
        digest = hashlib.sha256(np.asarray(self.cages.known, np.int64).tobytes())
        for poses in self.cages.poses(FRAMES_PER_PRODUCT):
            digest.update(np.ascontiguousarray(poses.cages, np.float64).tobytes())
            if poses.rotations is not None:
                digest.update(np.ascontiguousarray(poses.rotations, np.float64).tobytes())
        return digest.hexdigest()

    def blocks(self, size: int) -> Iterator[JointPoses]:
        """Yield all frames in order, in blocks of at most `size`; cage vertices are the joints.

        Where no rotations are known, they are those of the cages.
        """
        yield from map(self._rebuild, self.cages.poses(size))

    def stream_meshes(self, size: int, jobs: int) -> Iterator[Floats]:
        """Yield the meshes (k, m, 3) of all frames in order, of at most `size` at once.

        A thread computes the next ones, with `jobs` threads, while these are used. An array is
        overwritten after the next one is taken: the caller uses one at a time.
        """
        shape = (min(size, self.cages.count), len(self.binding.rest.vertices), 3)
        buffers = cycle([np.empty(shape) for _ in range(2)])

        def rebuild(item: tuple[Poses, Floats]) -> Floats:
            poses, meshes = item
            return self._rebuild(poses, meshes[: len(poses)], jobs).meshes

        pairs = zip(self.cages.poses(size), buffers, strict=False)
        with OrderedMap(rebuild, pairs, 1, 1) as blocks:
            yield from blocks

    def _rebuild(self, poses: Poses, out: Floats | None = None, jobs: int = 1) -> JointPoses:
        """Return poses with their meshes; `out` and `jobs` are as of `reconstruct`."""
        cages, rotations = poses.cages, poses.rotations
        if rotations is None:
            rest = self.binding.cage.vertices
            centred = cages - cages.mean(axis=1, keepdims=True)
            rotations = best_rotations(centred, rest - rest.mean(axis=0), np.ones(len(rest)))
        meshes = reconstruct_frames(self.binding, Poses(cages, rotations), out, jobs)
        return JointPoses(cages, rotations, meshes)


class PointReconstruction:
    """The frames of points that cages give, with their normals or as splats, as rows.

    Attributes
    ----------
    faults : Counter
        How often the points that were moved are where space has lost its shape; see
        `count_map_faults`.
    """

    def __init__(self, motion: PointMotion, jobs: int) -> None:
        self.faults = Counter[str]()
        self._motion, self._jobs = motion, jobs

    @staticmethod
    def prepare(
        binding: Binding,
        oriented: Oriented,
        *,
        memory: int,
        jobs: int,
        progress: ProgressListener,
        transferred: TransferredChange | None = None,
    ) -> "PointReconstruction":
        """Compute the gradients of the weights of points; raises as `PointMotion`.

        `transferred` is what was added to the weights from the fit of another model.
        """
        add = None if transferred is None else transferred.add_gradients_to
        with progress.stage("gradients"):
            room = max(0, memory - binding.weights.nbytes)
            motion = PointMotion(binding, oriented, room, jobs, progress.update, add)
            return PointReconstruction(motion, jobs)

    def stream_rows(
        self,
        rest: NDArray[Any],
        cages: CageFrames,
        note: Callable[[Note], None],
    ) -> Iterator[NDArray[Any]]:
        """Yield the rows (k, m) of all frames in order; they are overwritten by the next.

        At rest, they are `rest` (m,). At the end, `note` takes what is wrong, one sentence each.
        """
        size = min(FRAMES_PER_PRODUCT, cages.count)
        # The next frames are computed while these are written.
        held = cycle([np.repeat(rest[None], size, axis=0) for _ in range(2)])

        def fill(item: tuple[NDArray[Any], Poses]) -> NDArray[Any]:
            rows, poses = item[0][: len(item[1])], item[1]
            self.fill_rows(rows, poses)
            return rows

        with OrderedMap(fill, zip(held, cages.poses(size), strict=False), 1, 1) as blocks:
            yield from blocks
        self.note_faults(len(rest) * cages.count, note)

    def fill_rows(self, rows: NDArray[Any], poses: Poses) -> None:
        """Fill the rows (k, m) of the frames of poses, block by block in threads."""
        move = partial(_move_block, self._motion, rows, poses)
        with OrderedMap(move, self._motion.blocks, self._jobs, 2 * self._jobs) as blocks:
            for found in blocks:
                self.faults += found

    def note_faults(self, count: int, note: Callable[[Note], None]) -> None:
        """Note how many of `count` moved points are where space has lost its shape."""
        parts, mirrored = "points", "turned inside out"
        if self._motion.moves_splats:
            parts = "splats"
            mirrored += "; their colours are turned by the nearest rotation"
        for number, what in (
            (self.faults["mirrored"], mirrored),
            (self.faults["flat"], "flattened to a sheet, a line or a point"),
        ):
            if number:
                text = f"{number} of {count} moved {parts} are {what}: the cage folds over there"
                note(Note(text, "warning"))


def _move_block(
    motion: PointMotion, rows: NDArray[Any], poses: Poses, chosen: slice
) -> Counter[str]:
    places, oriented, faults = motion.move(chosen, poses)
    for row, place, turned in zip(rows, places, oriented, strict=True):
        part = row[chosen]
        place_positions(part, place.T)
        if turned.normals is not None:
            place_normals(part, turned.normals)
        if turned.splats is not None:
            place_splats(part, turned.splats)
    return faults
