"""How many frames are solved together, and how a run stays within its memory limit."""

from dataclasses import dataclass

from cageik_cli.coordinates.binding import Binding
from cageik_cli.util.arrays import DEFAULT_MEMORY, fit_frames

MAX_BLOCK_FRAMES = 16
"""Largest number of frames solved together; more right-hand sides are not faster."""

MAX_BLOCK_BYTES = DEFAULT_MEMORY // 4
"""Largest size of a block of more than one frame.

Products and sums over blocks depend on their size in the last digits, so that the memory of a run
must not change it.
"""

ARRAYS_PER_FRAME = 12
"""Arrays (m, 3) in memory per frame: read, aligned, target, reconstructed, measured."""

MAX_QUEUE_BYTES = 1 << 24
"""Largest size of frames read ahead, which is also at most an eighth of the memory."""


def choose_block_size(vertex_count: int) -> int:
    """Return how many frames of a model are solved together."""
    return min(fit_frames(MAX_BLOCK_BYTES, vertex_count, ARRAYS_PER_FRAME), MAX_BLOCK_FRAMES)


@dataclass(frozen=True, slots=True)
class MemoryPlan:
    """How a run stays within its memory limit.

    Attributes
    ----------
    block_size : int
        Frames solved together; it does not depend on the memory and the number of threads.
    max_parallel_blocks : int
        Blocks solved in parallel.
    max_queued_frames : int
        Frames read ahead.
    """

    block_size: int
    max_parallel_blocks: int
    max_queued_frames: int

    @staticmethod
    def fit(memory: int, binding: Binding, jobs: int) -> "MemoryPlan":
        """Plan for `memory` bytes, the weights included, and `jobs` threads; one block at least."""
        count, left = len(binding.rest.vertices), memory - binding.weights.nbytes
        block = choose_block_size(count)
        solvers = min(fit_frames(left, block * count, ARRAYS_PER_FRAME), jobs)
        queue = fit_frames(min(memory // 8, MAX_QUEUE_BYTES), count)
        return MemoryPlan(block, solvers, queue)
