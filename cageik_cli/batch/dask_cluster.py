"""The jobs of a batch on a Dask cluster.

One worker writes the checkpoint of a long clip, and others solve pieces of it.
"""

import asyncio
import ctypes
import io
import logging
import pickle
import sys
import time
import warnings
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import Any
from uuid import uuid4

from cageik_cli.batch.jobs import (
    ClipJob,
    Outcome,
    bind_clip,
    check_clip,
    make_failed_outcome,
    run_clip,
)
from cageik_cli.captured.frames import CapturedBlockSolver, FrameWeights
from cageik_cli.captured.robust import RobustSolver
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.inputs.clip import open_clip_and_choose_rest
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.method.solve.blocks import BlockSolver, SolvedBlock
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.weights.binding import Binding
from cageik_cli.run.executor import MemoryPlan, run_in_threads
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import checkpoint_path
from cageik_cli.util.errors import ClusterError, FileAccessError, format_error, require_optional
from cageik_cli.util.files import open_locked
from cageik_cli.util.messages import Text, say
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import use_one_blas_thread
from cageik_cli.util.version import __version__

PACKAGE_NAME = "cageik"
"""The name under which packages are installed."""

CONNECT_TIMEOUT = 10.0
"""Seconds in which the scheduler must answer."""

MIN_PIECE_SECONDS = 0.5
"""Seconds of work in a piece, at least; the scheduler takes a hundredth of it per task."""


class DaskScheduler:
    """Run jobs on a Dask cluster that is running already.

    Every clip is a task, and so are the weights that clips share, which are sent to each worker
    once. Long clips are solved in pieces, by all workers. Work of a lost worker is retried on
    others; a clip resumes from its checkpoint.

    Parameters
    ----------
    address : str
        Of the scheduler: "tcp://host:8786".
    worker_timeout : float
        Seconds to wait for a first worker, or for another when the last one is lost.
    piece_seconds : float
        Seconds of work in a piece of a clip, at least.
    """

    def __init__(
        self,
        address: str,
        worker_timeout: float = 60.0,
        piece_seconds: float = MIN_PIECE_SECONDS,
    ) -> None:
        self._address, self._worker_timeout, self._piece_seconds = (
            address,
            worker_timeout,
            piece_seconds,
        )
        self._stack = ExitStack()

    def __enter__(self) -> "DaskScheduler":
        """Connect."""
        with require_optional("distributed", f"the scheduler {self._address}"):
            import distributed  # noqa: F401  creates its loggers
        with self._stack as stack:
            stack.enter_context(_silence_loggers())
            self._client = stack.enter_context(self._connect())
            self._check_workers()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def run_jobs(self, jobs: Sequence[ClipJob]) -> Iterator[Outcome]:
        """Yield the outcome of each job, as they end."""
        by_key: dict[str, list[ClipJob]] = {}
        # A worker uses one thread, as other workers run other clips.
        alone = [replace(job, settings=replace(job.settings, jobs=1)) for job in jobs]
        checks = ((job, self._client.submit(check_clip, job, pure=False)) for job in alone)
        for job, checked in self._iterate_results(checks):
            if isinstance(checked, Outcome):
                yield checked
            else:
                by_key.setdefault(checked, []).append(job)
        for _, outcome in self._iterate_results(self._submit_clips(by_key)):
            yield outcome

    def _submit_clips(self, by_key: dict[str, list[ClipJob]]) -> Iterator[tuple[ClipJob, Any]]:
        """Submit the tasks of jobs, those with the same weights after each other."""
        for jobs in by_key.values():
            # The cluster keeps the weights as long as this future, or a task that needs them.
            key = f"weights-{uuid4().hex}"
            weights = self._client.submit(compute_weights, jobs[0], key=key)
            for job in jobs:
                arguments = (job, weights, key, self._piece_seconds)
                yield job, self._client.submit(run_clip_task, *arguments, pure=False)

    def _iterate_results(
        self, tasks: Iterator[tuple[ClipJob, Any]]
    ) -> Iterator[tuple[ClipJob, Any]]:
        """Yield jobs with the results of their tasks; twice as many run at once as workers."""
        pending: dict[Any, ClipJob] = {}
        try:
            while True:
                with self._wrap_connection_errors():
                    room = 2 * max(1, len(self._client.nthreads())) - len(pending)
                    pending |= {future: job for job, future in islice(tasks, max(0, room))}
                if not pending:
                    return
                for future in self._wait_for_any(list(pending)):
                    job = pending.pop(future)
                    yield job, self._get_result(job, future)
        finally:
            self._client.cancel(list(pending))

    def _wait_for_any(self, futures: list[Any]) -> list[Any]:
        """Wait for at least one future, and return those that have ended."""
        from distributed import wait

        while True:
            try:
                # `wait` uses the current client, which may be another one.
                with self._wrap_connection_errors(), self._client.as_current():
                    done = wait(
                        futures, timeout=self._worker_timeout, return_when="FIRST_COMPLETED"
                    ).done
            except TimeoutError:
                self._wait_for_worker()
            else:
                return list(done)

    def _get_result(self, job: ClipJob, future: Any) -> Any:
        """Return the result of a task, or the outcome of a job whose task failed."""
        from distributed import KilledWorker

        with self._wrap_connection_errors():
            if future.status != "error":
                return future.result()
            error = future.exception()
        is_killed = isinstance(error, KilledWorker)
        return make_failed_outcome(
            job, describe_killed_worker(error) if is_killed else format_error(error)
        )

    @contextmanager
    def _connect(self) -> Iterator[Any]:
        """Open a client, if the scheduler answers."""
        from distributed import Client
        from distributed.comm import connect
        from distributed.security import Security

        async def reach() -> None:
            # The certificates that the settings of Dask name.
            certificates = Security().get_connection_args("client")
            comm = await connect(self._address, timeout=CONNECT_TIMEOUT, **certificates)
            await comm.close()

        try:
            asyncio.run(reach())  # a client that cannot connect would not end cleanly
            with warnings.catch_warnings(action="ignore"):  # on versions, which are compared below
                client = Client(self._address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"{self._address}: no Dask scheduler answers ({error}); give the address that "
                "`dask scheduler` prints when it starts, as tcp://HOST:8786"
            ) from error
        with client:
            yield client

    @contextmanager
    def _wrap_connection_errors(self) -> Iterator[None]:
        """Convert errors of a lost connection, but not timeouts."""
        from distributed import CancelledError

        try:
            yield
        except TimeoutError:
            raise
        except (OSError, CancelledError) as error:
            raise ClusterError(
                f"{self._address}: the scheduler is lost, or has dropped its tasks; "
                + say("see its log, start it again, and continue with `resume=True`")
            ) from error

    def _wait_for_worker(self) -> None:
        try:
            with self._wrap_connection_errors():
                self._client.wait_for_workers(1, timeout=self._worker_timeout)
        except TimeoutError as error:
            raise ClusterError(
                f"{self._address}: no worker for {self._worker_timeout:g} s; start some with "
                f"`dask worker {self._address} --nthreads 1 --nworkers N`, "
                + say("and continue with `resume=True`")
            ) from error

    def _check_workers(self) -> None:
        """Refuse workers of other versions, and workers with several threads."""
        self._wait_for_worker()
        with self._wrap_connection_errors():
            threads = self._client.nthreads()
            versions = self._client.run(metadata.version, PACKAGE_NAME, on_error="return")
        for worker, count in threads.items():
            if count > 1:
                raise ClusterError(
                    f"worker {worker} has {count} threads, expected 1 (the last digits of results "
                    "depend on it); start more workers instead: `dask worker --nthreads 1 "
                    f"--nworkers {count}`"
                )
        for worker, version in versions.items():
            if version != __version__:
                is_installed = isinstance(version, str)
                found = f"cageik {version}" if is_installed else f"no cageik ({version})"
                raise ClusterError(
                    f"worker {worker} has {found}, expected cageik {__version__}; install that "
                    "version in the environment of all workers"
                )


def run_clip_task(
    job: ClipJob,
    stored_binding: StoredBinding | None,
    weights_key: str,
    piece_seconds: float,
) -> Outcome:
    """Run a job as a task; pieces of it take `piece_seconds` at least."""
    configure_worker()
    wait_for_checkpoint(checkpoint_path(job.settings.output), timeout=30.0)
    executor = ClusterExecutor(job, weights_key, piece_seconds)
    return run_clip(job, stored_binding, executor.run_blocks)


def wait_for_checkpoint(path: Path, timeout: float) -> None:
    """Wait until no other process writes a checkpoint, or for `timeout` seconds.

    A worker that the scheduler has given up may still be writing it. Opening a checkpoint that is
    in use is an error of its own.
    """
    end = time.monotonic() + timeout
    while path.exists() and time.monotonic() < end:
        file = open_locked(path)
        if file is not None:
            file.close()
            return
        time.sleep(0.1)


@contextmanager
def _silence_loggers() -> Iterator[None]:
    """Keep the logs of other libraries off the terminal: messages here report what they do."""
    noisy = ("distributed", "tornado", "asyncio")
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in noisy]
    levels = {name: logging.getLogger(name).level for name in {*names, *noisy}}
    for name in levels:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


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
        self, block_solver: BlockSolver[MeshSequence], starts: range, memory_plan: MemoryPlan
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
        self, block_solver: BlockSolver[MeshSequence], starts: range, memory_plan: MemoryPlan
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
        self,
        block_solver: BlockSolver[MeshSequence],
        pieces: Iterator[range],
        memory_plan: MemoryPlan,
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
        self,
        settings: ExtractSettings,
        block_solver: BlockSolver[MeshSequence],
        memory_plan: MemoryPlan,
    ) -> None:
        self.settings, self.memory_plan = settings, memory_plan
        sequence = block_solver.sequence
        self._names, self._first_digest = sequence.names, sequence.digest_or_zeros(0)
        solvers: Solvers = block_solver.solver, None, None
        if isinstance(block_solver, CapturedBlockSolver):
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
        beside = settings.rest, settings.cage
        scene = CommonScene.of_clip(settings.scene, settings.given_in, beside)
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

    def build_block_solver(self, binding: Binding) -> BlockSolver[MeshSequence]:
        """Make the block solver, of the clip and the weights."""
        solver, robust, frame_weights = unpickle_with_weights(binding, self._solvers)
        progress, skips = ProgressListener(), self.settings.skips_bad_frames
        if robust is None:
            return BlockSolver(self.sequence, solver, progress, skips_bad_frames=skips)
        return CapturedBlockSolver(
            self.sequence,
            robust,
            progress,
            skips_bad_frames=skips,
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


def describe_killed_worker(error: Any) -> Text:
    """Say what to do about a task that crashes every worker."""
    return (
        f"{error.allowed_failures + 1} workers crashed on it (the last one "
        f"{error.last_worker.address}, see its log); "
        + say("give workers more memory, or use a coarser cage or a smaller `memory=`")
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
