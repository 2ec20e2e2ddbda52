"""The cages of an animation, and the mesh animation that they give."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import cycle

import numpy as np

from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.method.solve.alignment import best_rotations
from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.store.result import StoredAnimation, read_cages
from cageik_cli.util.arrays import Floats, Integers, fill_gaps
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
    """

    count: int
    known: Integers
    read: Callable[[int], Floats]
    blocks: Callable[[int], Iterator[Floats]]

    @staticmethod
    def from_result(result: StoredAnimation) -> "CageFrames":
        """Return the cages of a result, whose gaps are filled."""
        count = len(result.frames)
        return CageFrames(
            count=count,
            known=np.setdiff1d(np.arange(count), result.gaps),
            read=lambda frame: next(read_cages(result, 1, frame))[0],
            blocks=lambda size: read_cages(result, size),
        )

    def convert(self, conversion: SceneConversion) -> "CageFrames":
        """Return the cages in another scene."""
        if not conversion:
            return self
        return CageFrames(
            count=self.count,
            known=self.known,
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


@dataclass(frozen=True, slots=True, eq=False)
class RebuiltFrames:
    """Consecutive frames: their cages (k, n, 3), rotations (k, 3, 3), and meshes (k, m, 3)."""

    cages: Floats
    rotations: Floats
    meshes: Floats


class Reconstruction:
    """The mesh animation that cages give; a source of frames for a fit, without filled gaps.

    Parameters
    ----------
    rotations : (F, 3, 3) float64, optional
        Of the rest pose to each frame, for a binding that has offsets; else they are those of the
        cages.
    """

    def __init__(
        self, binding: Binding, cages: CageFrames, rotations: Floats | None = None
    ) -> None:
        self.binding, self.cages, self._rotations = binding, cages, rotations

    def __len__(self) -> int:
        return len(self.cages.known)

    def read_frame(self, index: int) -> Floats:
        """Return the mesh (m, 3) of a frame that fills no gap."""
        frame = int(self.cages.known[index])
        return np.asarray(self._rebuild(frame, self.cages.read(frame)[None]).meshes[0])

    def blocks(self, size: int) -> Iterator[RebuiltFrames]:
        """Yield all frames in order, in blocks of at most `size`."""
        start = 0
        for cages in self.cages.blocks(size):
            yield self._rebuild(start, cages)
            start += len(cages)

    def stream_meshes(self, size: int, jobs: int) -> Iterator[Floats]:
        """Yield the meshes (k, m, 3) of all frames in order, of at most `size` at once.

        A thread computes the next ones, with `jobs` threads, while these are used. An array is
        overwritten after the next one is taken: the caller uses one at a time.
        """
        shape = (min(size, self.cages.count), len(self.binding.rest.vertices), 3)
        buffers = cycle([np.empty(shape) for _ in range(2)])

        def rebuild(item: tuple[int, Floats, Floats]) -> Floats:
            start, cages, meshes = item
            rotations = self._turn(start, cages) if self.binding.has_offsets else None
            return reconstruct_frames(self.binding, cages, rotations, meshes[: len(cages)], jobs)

        with OrderedMap(rebuild, self._pair(size, buffers), 1, 1) as blocks:
            yield from blocks

    def _pair(self, size: int, buffers: Iterator[Floats]) -> Iterator[tuple[int, Floats, Floats]]:
        """Yield the number of the first frame of each block, its cages, and a buffer."""
        start = 0
        for cages in self.cages.blocks(size):
            yield start, cages, next(buffers)
            start += len(cages)

    def _rebuild(self, start: int, cages: Floats) -> RebuiltFrames:
        """Return the meshes of the cages of frames from `start` on."""
        rotations = self._turn(start, cages)
        return RebuiltFrames(cages, rotations, reconstruct_frames(self.binding, cages, rotations))

    def _turn(self, start: int, cages: Floats) -> Floats:
        """Return the rotations (k, 3, 3) of frames from `start` on."""
        if self._rotations is None:
            rest = self.binding.cage.vertices
            centred = cages - cages.mean(axis=1, keepdims=True)
            return best_rotations(centred, rest - rest.mean(axis=0), np.ones(len(rest)))
        return self._rotations[start : start + len(cages)]
