"""The jobs of a batch on a Dask cluster."""

import asyncio
import logging
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import Any
from uuid import uuid4

from cageik_cli import __version__
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import checkpoint_path
from cageik_cli.util.errors import InputError, format_error, require_optional
from cageik_cli.util.outputs import open_locked
from cageik_cli.workflows.batch.clip_task import check_clip, make_failed_outcome, run_clip
from cageik_cli.workflows.batch.dask_pieces import (
    MIN_PIECE_SECONDS,
    ClusterExecutor,
    WeightsTask,
    describe_killed_worker,
)
from cageik_cli.workflows.batch.dask_worker import configure_worker
from cageik_cli.workflows.batch.jobs import ClipJob, Outcome

PACKAGE_NAME = "cageik"
"""As it is called where packages are installed."""

CONNECT_TIMEOUT = 10.0
"""For the scheduler to answer."""

DEFAULT_WORKER_TIMEOUT = 60.0
"""Seconds without any worker after which a batch gives up."""

CHECKPOINT_TIMEOUT = 30.0
"""A worker that the scheduler has given up may go on for a moment, and have the log of a clip."""

POLL_SECONDS = 0.1
"""Seconds between two looks at such a log."""

NOISY_LOGGERS = ("distributed", "tornado", "asyncio")
"""Loggers that speak of what is told in sentences here."""


class DaskScheduler:
    """A Dask cluster that is there already.

    Every clip is a task, and the weights that clips share are one; the scheduler brings them to
    each worker once. Long clips are solved in pieces, by all workers. What a worker that dies had
    under way is done again by another: a clip from where its log ends.

    Parameters
    ----------
    address : str
        Of the scheduler: "tcp://host:8786".
    patience : float
        Seconds to wait for a first worker, or for another when the last has gone.
    piece_seconds : float
        Work of a piece of a clip, at least.
    """

    def __init__(
        self,
        address: str,
        worker_timeout: float = DEFAULT_WORKER_TIMEOUT,
        piece_seconds: float = MIN_PIECE_SECONDS,
    ) -> None:
        self._address, self._worker_timeout, self._piece_seconds = (
            address,
            worker_timeout,
            piece_seconds,
        )
        self._stack = ExitStack()

    def __enter__(self) -> "DaskScheduler":
        """Connect.

        Raises
        ------
        InputError
            When the scheduler does not answer, or the workers are none or not fit.
        """
        with require_optional("distributed", "dask", f"the scheduler {self._address}"):
            import distributed  # noqa: F401  its loggers are there from now on
        with self._stack as stack:
            stack.enter_context(_silence_loggers())
            self._client = stack.enter_context(self._connect())
            self._check_workers()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def run_jobs(self, jobs: Sequence[ClipJob]) -> Iterator[Outcome]:
        """What came of each job, as they end.

        Raises
        ------
        InputError
            When the scheduler, or all workers, are gone.
        """
        by_key: dict[str, list[ClipJob]] = {}
        for job, seen in self._iterate_results(self._submit_checks(jobs)):
            if isinstance(seen, Outcome):
                yield seen
            else:
                by_key.setdefault(seen, []).append(job)
        for _, outcome in self._iterate_results(self._submit_clips(by_key)):
            yield outcome

    def _submit_checks(self, jobs: Iterable[ClipJob]) -> Iterator[tuple[ClipJob, Any]]:
        for job in jobs:
            # A worker has one processor; others are there for other clips.
            alone = replace(job, settings=replace(job.settings, jobs=1))
            yield alone, self._client.submit(check_clip, alone, pure=False)

    def _submit_clips(self, by_key: dict[str, list[ClipJob]]) -> Iterator[tuple[ClipJob, Any]]:
        """Tasks of jobs, those with the same weights one after the other."""
        for jobs in by_key.values():
            # The weights are kept as long as this future, or a task that needs them.
            task = WeightsTask(f"weights-{uuid4().hex}", jobs[0])
            weights = task.submit(self._client)
            for job in jobs:
                arguments = (job, weights, task, self._piece_seconds)
                yield job, self._client.submit(run_clip_task, *arguments, pure=False)

    def _iterate_results(
        self, tasks: Iterator[tuple[ClipJob, Any]]
    ) -> Iterator[tuple[ClipJob, Any]]:
        """Jobs and what their tasks gave, as they end; twice as many as workers are under way."""
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
        """Those that have ended, at least one."""
        from distributed import wait

        while True:
            try:
                # `wait` asks the client that is current, which may be another's.
                with self._wrap_connection_errors(), self._client.as_current():
                    done = wait(
                        futures, timeout=self._worker_timeout, return_when="FIRST_COMPLETED"
                    ).done
            except TimeoutError:
                self._wait_for_worker()
            else:
                return list(done)

    def _get_result(self, job: ClipJob, future: Any) -> Any:
        """What a task gave, or the outcome of a job whose task failed."""
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
        """A client, if there is a scheduler."""
        from distributed import Client
        from distributed.comm import connect

        async def reach() -> None:
            await (await connect(self._address, timeout=CONNECT_TIMEOUT)).close()

        try:
            asyncio.run(reach())  # a client that cannot connect would not end cleanly
            with warnings.catch_warnings(action="ignore"):  # on versions, which are compared below
                client = Client(self._address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{self._address}: no Dask scheduler answers ({error}); give the address that "
                "`dask scheduler` prints when it starts, as tcp://HOST:8786"
            ) from error
        with client:
            yield client

    @contextmanager
    def _wrap_connection_errors(self) -> Iterator[None]:
        """Make a sentence of a connection that is lost; not of a wait that takes too long."""
        from distributed import CancelledError

        try:
            yield
        except TimeoutError:
            raise
        except (OSError, CancelledError) as error:
            raise InputError(
                f"{self._address}: the scheduler is gone, or has dropped what it was given; see "
                "its log, start it again, and go on with --resume"
            ) from error

    def _wait_for_worker(self) -> None:
        try:
            with self._wrap_connection_errors():
                self._client.wait_for_workers(1, timeout=self._worker_timeout)
        except TimeoutError as error:
            raise InputError(
                f"{self._address}: the scheduler has had no worker for {self._worker_timeout:g} "
                f"s; start "
                f"some with `dask worker {self._address} --nthreads 1 --nworkers N`, and go on "
                "with --resume"
            ) from error

    def _check_workers(self) -> None:
        """Refuse workers of other versions, and those whose threads would share a clip's limits."""
        self._wait_for_worker()
        with self._wrap_connection_errors():
            threads = self._client.nthreads()
            versions = self._client.run(metadata.version, PACKAGE_NAME, on_error="return")
        for worker, count in threads.items():
            if count > 1:
                raise InputError(
                    f"worker {worker} has {count} threads, expected 1, since the threads of a "
                    "process share one setting of the linear algebra, on which last digits "
                    "depend; start more workers instead: `dask worker --nthreads 1 --nworkers "
                    f"{count}`"
                )
        for worker, version in versions.items():
            if version != __version__:
                is_there = isinstance(version, str)
                raise InputError(
                    f"worker {worker} has {f'cageik {version}' if is_there else 'no cageik'} "
                    f"({'' if is_there else f'{version}; '}here is {__version__}); install the "
                    "same version in the environment of all workers"
                )


def run_clip_task(
    job: ClipJob,
    stored_binding: StoredBinding | None,
    weights_task: WeightsTask,
    piece_seconds: float,
) -> Outcome:
    """A task: what came of a job, pieces of which take `piece_seconds` at least."""
    configure_worker()
    wait_for_checkpoint(checkpoint_path(job.settings.output), CHECKPOINT_TIMEOUT)
    return run_clip(job, stored_binding, ClusterExecutor(job.settings, weights_task, piece_seconds))


def wait_for_checkpoint(path: Path, timeout: float) -> None:
    """Wait until no other process has a clip's log, but not for long: who wants it then, says so.

    A worker that the scheduler has given up may still be at it.
    """
    end = time.monotonic() + timeout
    while path.exists() and time.monotonic() < end:
        file = open_locked(path)
        if file is not None:
            file.close()
            return
        time.sleep(POLL_SECONDS)


@contextmanager
def _silence_loggers() -> Iterator[None]:
    """Keep other libraries' logs from the terminal."""
    names = [
        name for name in logging.root.manager.loggerDict if name.split(".")[0] in NOISY_LOGGERS
    ]
    levels = {name: logging.getLogger(name).level for name in {*names, *NOISY_LOGGERS}}
    for name in levels:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
