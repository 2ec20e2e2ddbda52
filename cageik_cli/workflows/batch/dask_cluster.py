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
from cageik_cli.util.errors import ClusterError, format_error, require_optional
from cageik_cli.util.files import open_locked
from cageik_cli.workflows.batch.dask_pieces import (
    MIN_PIECE_SECONDS,
    ClusterExecutor,
    compute_weights,
    configure_worker,
    describe_killed_worker,
)
from cageik_cli.workflows.batch.jobs import (
    ClipJob,
    Outcome,
    check_clip,
    make_failed_outcome,
    run_clip,
)

PACKAGE_NAME = "cageik"
"""The name under which packages are installed."""

CONNECT_TIMEOUT = 10.0
"""Seconds in which the scheduler must answer."""


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
        for job, checked in self._iterate_results(self._submit_checks(jobs)):
            if isinstance(checked, Outcome):
                yield checked
            else:
                by_key.setdefault(checked, []).append(job)
        for _, outcome in self._iterate_results(self._submit_clips(by_key)):
            yield outcome

    def _submit_checks(self, jobs: Iterable[ClipJob]) -> Iterator[tuple[ClipJob, Any]]:
        for job in jobs:
            # A worker uses one thread, as other workers run other clips.
            alone = replace(job, settings=replace(job.settings, jobs=1))
            yield alone, self._client.submit(check_clip, alone, pure=False)

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
                f"{self._address}: the scheduler is lost, or has dropped its tasks; see its log, "
                "start it again, and continue with `resume=True`"
            ) from error

    def _wait_for_worker(self) -> None:
        try:
            with self._wrap_connection_errors():
                self._client.wait_for_workers(1, timeout=self._worker_timeout)
        except TimeoutError as error:
            raise ClusterError(
                f"{self._address}: no worker for {self._worker_timeout:g} s; start some with "
                f"`dask worker {self._address} --nthreads 1 --nworkers N`, and continue with "
                "`resume=True`"
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
