"""The jobs of a batch in processes of this machine."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import replace
from multiprocessing.context import BaseContext
from queue import SimpleQueue

from cageik_cli.batch.jobs import ClipJob, Outcome, make_failed_outcome, run_clip
from cageik_cli.util.errors import ClusterError
from cageik_cli.util.messages import say
from cageik_cli.util.threads import use_one_blas_thread

PRELOAD = "cageik_cli.batch.preload"
PRELOAD_PAGE = f"{PRELOAD}_page"
"""Modules for the process from which others are forked; importing them never fails."""


class ProcessScheduler:
    """Run jobs in processes of this machine, one clip at a time in each.

    A process that crashes costs its clip one attempt; other clips are not affected.

    Parameters
    ----------
    jobs : int
        Number of processes.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._workers: list[_Worker] = []

    def __enter__(self) -> "ProcessScheduler":
        return self

    def __exit__(self, kind: object = None, *error: object) -> None:
        for worker in self._workers:
            worker.stop(is_immediate=kind is not None)

    def run_jobs(self, jobs: Sequence[ClipJob]) -> Iterator[Outcome]:
        """Yield the outcome of each job, as they end."""
        count = max(1, min(self._jobs, len(jobs)))
        share = max(1, self._jobs // count)
        has_pages = any(job.has_page for job in jobs)
        context = _make_process_context([PRELOAD, *([PRELOAD_PAGE] if has_pages else [])])
        self._workers = [_Worker(context) for _ in range(count)]
        free: SimpleQueue[_Worker] = SimpleQueue()
        for worker in self._workers:
            free.put(worker)

        def run_on_free_worker(job: ClipJob) -> Outcome:
            worker = free.get()
            try:
                return worker.run_job(replace(job, settings=replace(job.settings, jobs=share)))
            finally:
                free.put(worker)

        pool = ThreadPoolExecutor(count)
        try:
            for future in as_completed([pool.submit(run_on_free_worker, job) for job in jobs]):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


class _Worker:
    """A process that is started again when it has crashed."""

    def __init__(self, context: BaseContext) -> None:
        self._context = context
        self._is_stopped, self._lock = False, threading.Lock()
        self._start()

    def run_job(self, job: ClipJob) -> Outcome:
        """Run a job in the process; again, once, if the process crashes."""
        for _ in range(2):
            try:
                return self._pool.submit(run_clip, job).result()
            except BrokenProcessPool:
                if not self._try_restart():
                    raise
        fault = say(
            "worker process crashed twice (killed, out of memory, or a corrupt file); "
            "try fewer `jobs=`"
        )
        return make_failed_outcome(job, fault)

    def stop(self, is_immediate: bool) -> None:
        """End the process, at once if `is_immediate`; its run can be resumed."""
        with self._lock:  # none is started after this
            self._is_stopped = True
        with suppress(BrokenProcessPool):
            pid = self._pid.result()
            for child in multiprocessing.active_children() if is_immediate else ():
                if child.pid == pid:
                    child.kill()
        self._pool.shutdown()

    def _try_restart(self) -> bool:
        """Start a new process in place of a crashed one, unless the worker is stopped."""
        with self._lock:
            if not self._is_stopped:
                self._pool.shutdown()
                self._start()
            return not self._is_stopped

    def _start(self) -> None:
        self._pool = ProcessPoolExecutor(1, self._context, _initialize_process)
        try:
            self._pid = self._pool.submit(os.getpid)
        except EOFError as error:  # the process from which they are forked has died
            raise ClusterError(
                "no process can be started on this machine; check the memory that is free and "
                "the limits of processes and of open files (ulimit -a)"
            ) from error


def _make_process_context(modules: list[str]) -> BaseContext:
    """Choose how processes start: on Linux, forked from one that has imported the modules."""
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(modules)
    return context


def _initialize_process() -> None:
    """Let a new process end with its parent, and use one thread in the linear algebra."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent gets it, and ends this process
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    use_one_blas_thread()


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
