"""Frames through the solver, in blocks, measured, into the log of the run."""

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.dual_laplacian import DualLaplacianSolver
from cageik_cli.formats.base.sequence import Block, MeshSequence, ReadAhead
from cageik_cli.metrics import measure
from cageik_cli.store.partial import PartialResult
from cageik_cli.store.result_writer import refuse_unsound
from cageik_cli.store.solved_block import SolvedBlock, solved
from cageik_cli.util.arrays import Scratch
from cageik_cli.util.progress import Observer
from cageik_cli.util.threads import InOrder

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

    def solve_all(self, partial: PartialResult, budget: Budget, crew: "Crew") -> None:
        """Let the crew solve the frames that the log does not hold yet, and log them in order."""
        start, size = partial.done, partial.plan.block
        with crew.solving(self, range(start, len(self.sequence), size), budget) as made:
            for block in made:
                with self.watch.stage("write"):
                    partial.append(block)
                self.watch.advance(block.stop, len(self.sequence))

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
