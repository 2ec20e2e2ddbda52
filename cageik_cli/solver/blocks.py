"""Frames through the solver, in blocks, measured."""

import threading
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.base.sequence import Block, MeshSequence, ReadAhead
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.metrics import (
    FIGURES,
    WHOLE_FIGURES,
    FrameFigures,
    Measured,
    measure,
    refuse_unsound,
)
from cageik_cli.util.arrays import Floats, Integers, Scratch
from cageik_cli.util.progress import Observer
from cageik_cli.util.text import printable
from cageik_cli.util.threads import InOrder


@dataclass(frozen=True, slots=True, eq=False)
class SolvedBlock:
    """Consecutive frames, solved and measured.

    Attributes
    ----------
    start : int
        Number of the first.
    cages : (k, n, 3) float64
        nan for a frame that was skipped.
    figures : FrameFigures
    squares : (m,) float64
        Of each vertex, |v̂ − v|² summed over the frames that were not skipped; nan for missing data.
    digests : tuple of bytes
        SHA-256 of the file of each frame; zeros for one that cannot be read.
    faults : dict
        By number in the clip, why a frame was skipped.
    """

    start: int
    cages: Floats
    figures: FrameFigures
    squares: Floats
    digests: tuple[bytes, ...]
    faults: dict[int, str]

    @property
    def stop(self) -> int:
        """Number of the frame after the last."""
        return self.start + len(self.cages)

    def cage(self, frame: int) -> Floats:
        """That of the frame of this number in the clip, (n, 3)."""
        return np.asarray(self.cages[frame - self.start])


def solved(
    block: Block, cages: Floats, measured: Measured, digests: tuple[bytes, ...]
) -> SolvedBlock:
    """A block's cages and figures; those of frames that could not be read become gaps."""
    faults = {k: printable(str(error)) for k, error in block.faults.items()}
    figures, squares = measured.figures, measured.squares
    if faults:
        gaps = np.array(list(faults)) - block.start
        squares = np.delete(squares, gaps, axis=0)
        columns = {name: getattr(figures, name).copy() for name in FIGURES}
        for name, column in columns.items():
            column[gaps] = -1 if name in WHOLE_FIGURES else np.nan
        cages, figures = cages.copy(), FrameFigures(**columns)
        cages[gaps] = np.nan
    return SolvedBlock(block.start, cages, figures, squares.sum(axis=0), digests, faults)


LARGEST_BLOCK = 16
"""Frames solved together at most; the product gains nothing from more right-hand sides."""

ARRAYS_PER_FRAME = 12
"""Arrays (m, 3) that a frame has at once: read, moved, target, rebuilt, measured."""

LARGEST_QUEUE = 1 << 24
"""Bytes of frames read in advance at most, and an eighth of the memory."""


@dataclass(frozen=True, slots=True)
class Budget:
    """How a run keeps within its memory.

    Attributes
    ----------
    block : int
        Frames solved together; the number of threads does not change it, nor any figure.
    solvers : int
        Blocks that are solved at once.
    queue : int
        Frames that are read in advance.
    """

    block: int
    solvers: int
    queue: int

    @staticmethod
    def of(memory: int, binding: Binding, jobs: int) -> "Budget":
        """What the weights and frames have room for in `memory` bytes, with `jobs` threads."""
        frame = ARRAYS_PER_FRAME * 24 * len(binding.rest.vertices)
        left = memory - binding.weights.nbytes
        block = int(np.clip(left // frame, 1, LARGEST_BLOCK))
        solvers = int(np.clip(left // (block * frame), 1, jobs))
        queue = min(memory // 8, LARGEST_QUEUE) // binding.rest.vertices.nbytes
        return Budget(block, solvers, max(1, queue))


class BlockSolver:
    """Solves and measures blocks of a clip.

    Parameters
    ----------
    sequence : MeshSequence
    solver : DualLaplacianSolver
    skip : bool
        Leave a gap for a frame that cannot be read; else it is refused.
    watch : Observer

    All are attributes, too.
    """

    def __init__(
        self, sequence: MeshSequence, solver: DualLaplacianSolver, skip: bool, watch: Observer
    ) -> None:
        self.sequence, self.solver, self.watch = sequence, solver, watch
        self._own = threading.local()
        self.skip = skip

    def solved(self, block: Block) -> SolvedBlock:
        """The cages and figures of a block.

        Raises
        ------
        InputError
            When a frame could not be read and is not to be skipped.
        NumericalError
            When the solve gives numbers that are not finite, or too large.
        """
        if not self.skip:
            block.refuse_faults()
        scratch = self._own.__dict__.setdefault("scratch", Scratch())
        with self.watch.stage("solve"):
            solution = self.solver.solve(block.positions, scratch)
        with self.watch.stage("measure"):
            rest, counted = self.solver.binding.rest, self.solver.counted
            rebuilt = solution.reconstructions
            measured = measure(rest, block.positions, rebuilt, counted, scratch)
        refuse_unsound(block.start, solution.cages, measured.figures)
        stamps = tuple(map(self.sequence.stamp, range(block.start, block.stop)))
        return solved(block, solution.cages, measured, stamps)


class Crew(Protocol):
    """Who solves the blocks of a clip."""

    def solving(
        self, work: BlockSolver, starts: range, budget: Budget
    ) -> AbstractContextManager[Iterator[SolvedBlock]]:
        """The blocks that begin at `starts`, in order, solved before they are asked for."""


@dataclass(frozen=True, slots=True)
class Threads:
    """Threads of this process, which read frames ahead and solve blocks beside each other."""

    jobs: int

    @contextmanager
    def solving(
        self, work: BlockSolver, starts: range, budget: Budget
    ) -> Iterator[Iterator[SolvedBlock]]:
        """The blocks that begin at `starts`, in order."""
        frames = range(starts.start, starts.stop)
        with (
            ReadAhead(work.sequence, self.jobs, budget.queue, frames) as read,
            InOrder(
                work.solved,
                _awaited(read.blocks(starts.step), work.watch),
                budget.solvers,
                budget.solvers,
            ) as made,
        ):
            yield made


def _awaited(blocks: Iterator[Block], watch: Observer) -> Iterator[Block]:
    """Blocks, the time that is spent waiting for them taken as the stage `read`."""
    while True:
        with watch.stage("read"):
            block = next(blocks, None)
        if block is None:
            return
        yield block


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What a log of F frames tells of them together.

    Attributes
    ----------
    skipped : dict
        By number in the clip, why a frame was.
    digests : list of bytes
        SHA-256 of the file of each frame.
    vertex_rms : (m,) float64
        sqrt(mean |v̂ − v|²) over the frames that were not skipped; nan for missing data.
    posed : (3,) int64
        Numbers of the worst, the median and the best frame, by rms.
    """

    skipped: dict[int, str]
    digests: list[bytes]
    vertex_rms: Floats
    posed: Integers


def told_of(blocks: Iterable[SolvedBlock]) -> Told:
    """Gather what all blocks of a clip tell."""
    skipped: dict[int, str] = {}
    digests: list[bytes] = []
    squares, rms = np.zeros(()), []
    for block in blocks:
        skipped |= block.faults
        digests += block.digests
        squares = squares + block.squares
        rms.append(block.figures.rms)
    ranked = np.argsort(np.concatenate(rms), kind="stable")[: len(digests) - len(skipped)]
    posed = ranked[[-1, (len(ranked) - 1) // 2, 0]] if len(ranked) else ranked
    return Told(skipped, digests, np.sqrt(squares / max(1, len(ranked))), posed)
