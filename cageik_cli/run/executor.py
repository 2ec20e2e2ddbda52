"""How the blocks of a clip are solved: how many frames together, in threads, in how much memory."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from cageik_cli.formats.base.sequence import FramePrefetcher, MeshSequence
from cageik_cli.geometry.frames import Block
from cageik_cli.method.solve.blocks import BlockSolver, SolvedBlock
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import count_frames
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.settings import DEFAULT_MEMORY
from cageik_cli.util.threads import OrderedMap

MAX_BLOCK_FRAMES = 16
"""Largest number of frames solved together; more right-hand sides are not faster."""

MAX_BLOCK_BYTES = DEFAULT_MEMORY // 4
"""Largest size of a block of more than one frame.

Products and sums over blocks depend on their size in the last digits, so that the memory of a run
must not change it.
"""

ARRAYS_PER_FRAME = 12
"""Arrays (m, 3) in memory per frame: read, aligned, target, reconstructed, measured."""


def choose_block_size(vertex_count: int) -> int:
    """Return how many frames of a model are solved together."""
    return min(count_frames(MAX_BLOCK_BYTES, vertex_count, ARRAYS_PER_FRAME), MAX_BLOCK_FRAMES)


@dataclass(frozen=True, slots=True)
class MemoryPlan:
    """How a run stays within its memory limit.

    Attributes
    ----------
    block_size : int
        Frames solved together; it does not depend on the memory and the number of threads.
    jobs : int
        Threads that read frames.
    max_parallel_blocks : int
        Blocks solved in parallel.
    max_queued_frames : int
        Frames read ahead: in 16 MiB, and in an eighth of the memory.
    """

    block_size: int
    jobs: int
    max_parallel_blocks: int
    max_queued_frames: int

    @staticmethod
    def make(memory: int, binding: Binding, jobs: int) -> "MemoryPlan":
        """Plan for `memory` bytes, the weights included, and `jobs` threads; one block at least."""
        count, left = len(binding.rest.vertices), memory - binding.weights.nbytes
        block = choose_block_size(count)
        solvers = min(count_frames(left, block * count, ARRAYS_PER_FRAME), jobs)
        queue = count_frames(min(memory // 8, 1 << 24), count)
        return MemoryPlan(block, jobs, solvers, queue)


RunBlocks = Callable[
    [BlockSolver[MeshSequence], range, MemoryPlan], AbstractContextManager[Iterator[SolvedBlock]]
]
"""Opens an iterator of the blocks that begin at a range of frames, in order, solved ahead."""


@contextmanager
def run_in_threads(
    block_solver: BlockSolver[MeshSequence], starts: range, plan: MemoryPlan
) -> Iterator[Iterator[SolvedBlock]]:
    """Solve blocks in threads of this process, which also read frames ahead."""
    frames, count = range(starts.start, starts.stop), plan.max_parallel_blocks
    with (
        FramePrefetcher(block_solver.sequence, plan.jobs, plan.max_queued_frames, frames) as read,
        OrderedMap(
            block_solver.solve_block,
            _timed_reads(read.blocks(starts.step), block_solver.progress),
            count,
            count,
        ) as solved_blocks,
    ):
        yield solved_blocks


def _timed_reads(blocks: Iterator[Block], progress: ProgressListener) -> Iterator[Block]:
    """Yield blocks; the time of waiting for them counts as the stage `read`."""
    while True:
        with progress.stage("read"):
            block = next(blocks, None)
        if block is None:
            return
        yield block
