"""The jobs of a batch in processes of this machine."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from cageik_cli.batch.jobs import ClipJob, Outcome, make_failed_outcome, run_clip
from cageik_cli.util.errors import ClusterError
from cageik_cli.util.processes import Subprocess, SubprocessError, wait_for_any

PRELOAD = "cageik_cli.batch.preload"
PRELOAD_PAGE = f"{PRELOAD}_page"
"""Modules for the process from which others are forked; importing them never fails."""


class ProcessScheduler:
    """Run jobs in processes of this machine, one clip at a time in each.

    A process that crashes costs its clip one attempt; other clips are not affected. On an error,
    all processes are ended at once: their runs can be resumed.

    Parameters
    ----------
    jobs : int
        Number of processes.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._processes: list[Subprocess] = []

    def __enter__(self) -> "ProcessScheduler":
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._processes:
            process.end()

    def run_jobs(self, jobs: Sequence[ClipJob]) -> Iterator[Outcome]:
        """Yield the outcome of each job, as they end; one whose process crashes is begun twice."""
        count = max(1, min(self._jobs, len(jobs)))
        share = max(1, self._jobs // count)
        preload = [PRELOAD, *([PRELOAD_PAGE] if any(job.has_page for job in jobs) else [])]
        waiting = [replace(job, settings=replace(job.settings, jobs=share)) for job in jobs[::-1]]
        running: dict[Subprocess, ClipJob] = {}
        crashed: set[str] = set()

        def begin_next(process: Subprocess) -> None:
            if waiting:
                running[process] = waiting.pop()
                process.begin(run_clip, running[process])

        for _ in range(min(count, len(jobs))):
            begin_next(self._start(preload))
        while running:
            process = wait_for_any(running)
            job, outcome = running.pop(process), None
            try:
                outcome = process.finish()
            except SubprocessError:
                process = self._start(preload)
                if job.name in crashed:
                    fault = (
                        "worker process crashed twice (killed, out of memory, or a corrupt file); "
                        "try fewer `jobs=`"
                    )
                    outcome = make_failed_outcome(job, fault)
                else:
                    crashed.add(job.name)
                    waiting.append(job)
            begin_next(process)
            if outcome is not None:
                yield outcome

    def _start(self, preload: Sequence[str]) -> Subprocess:
        """Start a process, which ends with the batch at the latest."""
        try:
            self._processes.append(Subprocess(preload=preload))
        except OSError as error:
            raise ClusterError(
                "no process can be started on this machine; check the memory that is free and "
                "the limits of processes and of open files (ulimit -a)"
            ) from error
        return self._processes[-1]
