"""A long clip on a cluster: one worker writes its checkpoint, and others solve pieces of it."""

import ctypes
import io
import pickle
import sys
import time
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import islice
from typing import Any

from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.solver.blocks import BlockSolver, SolvedBlock
from cageik_cli.solver.captured import FrameWeights
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.executor import MemoryPlan, run_in_threads
from cageik_cli.solver.robust import RobustSolver
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.util.errors import ClusterError, FileAccessError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import use_one_blas_thread
from cageik_cli.workflows.batch.jobs import ClipJob, bind_clip
from cageik_cli.workflows.common_scene import CommonScene
from cageik_cli.workflows.rest_pose import open_clip_and_choose_rest
from cageik_cli.workflows.settings import ExtractSettings

MIN_PIECE_SECONDS = 0.5
"""Seconds of work in a piece, at least; the scheduler takes a hundredth of it per task."""


def compute_weights(job: ClipJob) -> StoredBinding | None:
    """Compute the weights of a job, as a task."""
    configure_worker()
    return bind_clip(job)


@dataclass(frozen=True, slots=True)
class ClusterExecutor:
    """Solve short clips on this worker, and pieces of long ones on all workers.

    This worker solves for `min_seconds`; as many blocks as it solves in that time make a piece.

    Attributes
    ----------
    job : ClipJob
        Its files have the same paths on all workers.
    weights_key : str
        Of the task that computes the weights of all clips that share them; submitted again, it
        gives the same weights.
    """

    job: ClipJob
    weights_key: str
    min_seconds: float = MIN_PIECE_SECONDS

    def run_blocks(
        self, block_solver: BlockSolver, starts: range, memory_plan: MemoryPlan
    ) -> AbstractContextManager[Iterator[SolvedBlock]]:
        """Open an iterator over the blocks that begin at `starts`, in order."""
        return closing(
            self._solve_blocks(
                block_solver,
                starts,
                replace(memory_plan, jobs=1, max_parallel_blocks=1, max_queued_frames=starts.step),
            )
        )

    def _solve_blocks(
        self, block_solver: BlockSolver, starts: range, memory_plan: MemoryPlan
    ) -> Generator[SolvedBlock]:
        start_time, done = time.monotonic(), 0
        with run_in_threads(block_solver, starts, memory_plan) as local_blocks:
            for block in local_blocks:
                yield block
                done += 1
                is_long = len(starts) - done >= 3 * done  # a shorter one needs no other workers
                if is_long and time.monotonic() - start_time >= self.min_seconds:
                    break
        if done < len(starts):
            pieces = split_into_pieces(range(starts[done], starts.stop, starts.step), done)
            with closing(self._solve_on_workers(block_solver, pieces, memory_plan)) as blocks:
                yield from blocks

    def _solve_on_workers(
        self, block_solver: BlockSolver, pieces: Iterator[range], memory_plan: MemoryPlan
    ) -> Generator[SolvedBlock]:
        """Solve pieces as tasks, no more at once than keep all workers busy."""
        from distributed import KilledWorker, worker_client

        pending: deque[Any] = deque()
        with worker_client() as client:
            weights = client.submit(compute_weights, self.job, key=self.weights_key)
            context = client.scatter(
                ClipContext(self.job.settings, block_solver, memory_plan), hash=False
            )
            try:
                while True:
                    check_task_wanted(client)
                    room = max(0, 2 * len(client.nthreads()) - len(pending))
                    for piece in islice(pieces, room):
                        task = (solve_piece, context, weights, piece)
                        # A clip that was started ends before others start.
                        pending.append(client.submit(*task, priority=1, pure=False))
                    if not pending:
                        return
                    for block in pending.popleft().result():
                        block_solver.sequence.set_digests(block.start, block.digests)
                        yield block
            except KilledWorker as error:
                raise ClusterError(describe_killed_worker(error)) from error
            finally:
                client.cancel(list(pending))


class ClipContext:
    """What all pieces of a clip need; it is sent to a worker once, which opens the clip once."""

    def __init__(
        self, settings: ExtractSettings, block_solver: BlockSolver, memory_plan: MemoryPlan
    ) -> None:
        self.settings, self.memory_plan = settings, memory_plan
        sequence = block_solver.sequence
        self._names, self._first_digest = sequence.names, sequence.digest_or_zeros(0)
        solvers = block_solver.solver, block_solver.robust, block_solver.frame_weights
        self._solvers = pickle_without_weights(block_solver.solver.binding, solvers)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is sent; each worker opens the clip itself."""
        return {name: value for name, value in vars(self).items() if name != "sequence"}

    @cached_property
    def sequence(self) -> MeshSequence:
        """Open the clip, which must have the same frames as at the start of the run."""
        settings = self.settings
        # Any frame will do as rest pose: that of the run is in the solver.
        scene = CommonScene.of_run(settings)
        clip = replace(settings.clip, fps=settings.scene.fps)
        sequence, *_ = open_clip_and_choose_rest(settings.frames, clip, settings.rest, 0, scene)
        if sequence.names != self._names:
            raise FileAccessError(
                f"{settings.frames[0]}: has other frames than at the start of the run (found "
                f"{len(sequence)}, expected {len(self._names)}); let all workers see the same "
                "files, and run again"
            )
        sequence.set_digests(0, (self._first_digest,))
        return sequence

    def build_block_solver(self, binding: Binding) -> BlockSolver:
        """Make the block solver, of the clip and the weights."""
        solver, robust, frame_weights = unpickle_with_weights(binding, self._solvers)
        return BlockSolver(
            self.sequence,
            solver,
            ProgressListener(),
            skips_bad_frames=self.settings.skips_bad_frames,
            robust=robust,
            frame_weights=frame_weights,
            accepts_gaps=self.settings.accepts_gaps,
        )


def solve_piece(
    context: ClipContext, stored_binding: StoredBinding, starts: range
) -> list[SolvedBlock]:
    """Solve the blocks that begin at `starts`, as a task."""
    configure_worker()
    with run_in_threads(
        context.build_block_solver(stored_binding.binding), starts, context.memory_plan
    ) as blocks:
        return list(blocks)


@cache
def configure_worker() -> None:
    """Let this process use one thread in the linear algebra, and keep the memory that it frees.

    Dask makes the C library return every freed array to the system at once, so that each block of
    frames gets new pages, which takes half as long as the solve. These are the values that the
    library would reach by itself. They stay set, since the tasks of a worker follow each other.
    """
    use_one_blas_thread()
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:  # not every C library has it
            mmap_threshold, trim_threshold, most = -3, -1, 1 << 25  # of malloc.h; bytes at most
            mallopt(mmap_threshold, most)
            mallopt(trim_threshold, 2 * most)


def split_into_pieces(starts: range, size: int) -> Iterator[range]:
    """Divide the starts of blocks into pieces of `size` blocks, each of which ends at the next."""
    for first in range(starts.start, starts.stop, size * starts.step):
        yield range(first, min(first + size * starts.step, starts.stop), starts.step)


def check_task_wanted(client: Any) -> None:
    """Raise an error in a task that the cluster no longer assigns to this worker."""
    from distributed import get_worker

    worker = get_worker()
    address, key = worker.address, worker.get_current_task()
    if key not in client.processing([address]).get(address, ()):
        raise ClusterError("the batch was stopped, or another worker has taken over this clip")


def describe_killed_worker(error: Any) -> str:
    """Say what to do about a task that crashes every worker."""
    return (
        f"{error.allowed_failures + 1} workers crashed on it (the last one "
        f"{error.last_worker.address}, see its log); give workers more memory, or use a coarser "
        "cage or a smaller `memory=`"
    )


Solvers = tuple[DualLaplacianSolver, RobustSolver | None, FrameWeights | None]


def pickle_without_weights(binding: Binding, solver: Solvers) -> bytes:
    """Pickle solvers without their binding and weights."""
    stream = io.BytesIO()
    _WeightlessPickler(stream, binding).dump(solver)
    return stream.getvalue()


def unpickle_with_weights(binding: Binding, data: bytes) -> Solvers:
    """Unpickle the solvers of `pickle_without_weights`, with the same binding."""
    solver: Solvers = _WeightlessUnpickler(io.BytesIO(data), binding).load()
    return solver


class _WeightlessPickler(pickle.Pickler):
    def __init__(self, stream: io.BytesIO, binding: Binding) -> None:
        super().__init__(stream, pickle.HIGHEST_PROTOCOL)
        self._names = {id(binding): "binding", id(binding.weights): "weights"}

    def persistent_id(self, value: object) -> str | None:
        return self._names.get(id(value))


class _WeightlessUnpickler(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, binding: Binding) -> None:
        super().__init__(stream)
        self._values = {"binding": binding, "weights": binding.weights}

    def persistent_load(self, name: str) -> object:
        return self._values[name]
