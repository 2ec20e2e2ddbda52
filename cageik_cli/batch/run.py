"""A batch: its jobs are run, in processes of this machine or by another scheduler, and reported."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from cageik_cli.batch.jobs import (
    CLIPS_FOLDER,
    ClipJob,
    ClipState,
    Outcome,
    Scheduler,
    make_failed_outcome,
    run_clip,
)
from cageik_cli.batch.shared_fit import share_fits
from cageik_cli.report.figures import format_percent
from cageik_cli.report.html.index import render_index
from cageik_cli.report.overview import ClipEntry, Overview, shorten_names
from cageik_cli.report.views.data import format_junit, format_overview_csv, format_overview_json
from cageik_cli.report.views.front import describe_doubt
from cageik_cli.report.views.markdown import format_markdown
from cageik_cli.run.extraction import Extraction
from cageik_cli.store.result import checkpoint_path, is_result
from cageik_cli.util.errors import (
    CageikError,
    ClusterError,
    OutputError,
    add_remark,
    make_write_error,
)
from cageik_cli.util.files import open_locked, remove_locked
from cageik_cli.util.messages import Row, Spelling, say, spell_keyword
from cageik_cli.util.outputs import make_folder, write_text
from cageik_cli.util.processes import Subprocess, SubprocessError, wait_for_any
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.util.threads import count_processors

REPORT_FILES = {
    "index.html": render_index,
    "report.json": format_overview_json,
    "clips.csv": format_overview_csv,
    "junit.xml": format_junit,
    "report.md": format_markdown,
}
"""The reports over all clips, by file name."""

WEIGHT_CACHE_FOLDER = ".cageik-weights"
"""The weight cache of a batch that uses no other; it is deleted at the end."""

FAULT_LABEL = "would fail"

LOCK_FILE = ".cageik-batch.lock"

PRELOAD = "cageik_cli.batch.preload"
PRELOAD_PAGE = f"{PRELOAD}_page"
"""Modules for the process from which others are forked; importing them never fails."""


@dataclass(frozen=True, slots=True)
class BatchPlan:
    """The jobs of a batch, and the clips that have none.

    Attributes
    ----------
    output : Path
        The folder of all results.
    rejected : tuple of ClipEntry
        Clips that cannot be started, and why.
    order : tuple of str
        Names of all clips, as reports list them.
    inputs : tuple of Path
        The files that the jobs read.
    notes : tuple of str
        On files that are no clips.
    shares_fit : bool
        Whether the clips of a model have one set of weights, fitted to all of them.
    """

    output: Path
    jobs: tuple[ClipJob, ...]
    rejected: tuple[ClipEntry, ...]
    order: tuple[str, ...]
    inputs: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    shares_fit: bool = False


def run_batch(
    batch: BatchPlan,
    scheduler: Scheduler,
    progress: ProgressListener,
    spelling: Spelling = spell_keyword,
    *,
    is_timed: bool = False,
) -> Overview:
    """Run all jobs, and write the report over all clips; it lists failures, which raise no error.

    Each clip is noted as it ends, under its name.

    Parameters
    ----------
    spelling : callable
        Writes the settings that messages of failures and notes name.
    is_timed : bool
        Whether JUnit shows how long each clip took; else the same clips give the same bytes.

    Raises
    ------
    InputError
        When the folder of results cannot be written, or another batch is writing to it.
    """
    entries = {entry.name: entry for entry in batch.rejected}
    labels = dict(zip(batch.order, shorten_names(batch.order), strict=True))
    width = min(max(map(len, labels.values()), default=0), 60)  # of the column with the names
    done: list[Outcome] = []
    with _folder_lock(batch.output):
        make_folder(batch.output / CLIPS_FOLDER)
        try:
            if batch.shares_fit:
                threads = count_processors()
                shared, unfitted = share_fits(
                    batch.jobs, batch.output, progress, spelling=spelling, count=threads
                )
                rejected = (*batch.rejected, *unfitted)
                batch = replace(batch, jobs=tuple(shared), rejected=rejected)
                entries |= {entry.name: entry for entry in unfitted}
            with progress.stage("batch"), scheduler as active_scheduler:
                for entry in batch.rejected:
                    label = f"{labels[entry.name]:<{width}}"
                    progress.note(label, _describe_outcome(Outcome(entry, ClipState.FAILED)))
                jobs = [replace(job, spelling=spelling) for job in batch.jobs]
                for outcome in active_scheduler.run_jobs(jobs):
                    seconds = outcome.seconds if is_timed else 0.0
                    entries[outcome.entry.name] = replace(outcome.entry, seconds=seconds)
                    done.append(outcome)
                    label = f"{labels[outcome.entry.name]:<{width}}"
                    progress.note(label, _describe_outcome(outcome))
                    progress.update(len(done), len(batch.jobs))
                if any(outcome.has_bad_frame for outcome in done):
                    progress.note(
                        "note", say("`on_bad_frame=skip` leaves out frames that cannot be read")
                    )
        except BaseException as error:
            add_remark(
                error,
                f"{len(done)} of {len(batch.jobs)} clips are done; "
                + say("continue with `resume=True`"),
            )
            raise
        if any(job.settings.cache == batch.output / WEIGHT_CACHE_FOLDER for job in batch.jobs):
            shutil.rmtree(batch.output / WEIGHT_CACHE_FOLDER, ignore_errors=True)
        limits = {job.name: job.limits for job in batch.jobs}
        overview = Overview([entries[name] for name in batch.order], batch.notes, limits)
        with progress.stage("write"):
            for name, view in REPORT_FILES.items():
                write_text(batch.output / name, view(overview), overwrite=True)
    return overview


def describe_batch(batch: BatchPlan) -> dict[str, list[Row]]:
    """Describe, in labelled lines, what a batch would do with each clip; nothing is done.

    That is its frames, its cage, where its result goes and what is there; of a clip that would
    fail, the only label is `FAULT_LABEL`.
    """
    rejected: dict[str, list[Row]] = {
        entry.name: [(FAULT_LABEL, str(entry.fault))] for entry in batch.rejected
    }
    planned = {job.name: _describe_job(job, batch.shares_fit) for job in batch.jobs}
    return {name: (rejected | planned)[name] for name in batch.order}


def _describe_job(job: ClipJob, shares_fit: bool) -> list[Row]:
    settings, extraction = job.settings, Extraction(job.settings)
    try:
        extraction.open()
    except CageikError as error:
        return [(FAULT_LABEL, error.text)]
    if extraction.existing is not None:
        state = "up to date, nothing to do"
    elif settings.resume and checkpoint_path(settings.output).exists():
        state = "would continue from its checkpoint"
    elif settings.output.exists():
        state = "would be replaced"
    else:
        state = "would be new"
    sequence = extraction.sequence
    vertices = len(sequence.first.vertices)
    cage = str(settings.cage or settings.binding)
    if settings.builds_cage:
        weights = "fitted" if extraction.fit is not None else "not fitted"
        weights = "fitted to all clips of its model" if shares_fit else weights
        count = format_count(settings.build.vertices, "vertex")
        cage = f"would be built, of {count}; weights {weights}"
    return [
        (
            "frames",
            f"{group_digits(len(sequence))} of {group_digits(vertices)} vertices, from "
            f"{sequence.names[0]}",
        ),
        ("cage", cage),
        ("result", f"{settings.output}, {state}"),
    ]


def check_folder_empty(folder: Path) -> None:
    """Refuse a folder of results that holds files."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; give a folder for the results")
    if any(not path.is_dir() for path in folder.rglob("*")):
        raise OutputError(
            f"{folder}: holds files already; "
            + say(
                "continue with `resume=True`, start over with `overwrite=True`, or choose "
                "another folder"
            )
        )


def check_batch_folder(folder: Path) -> None:
    """Refuse to resume in a folder with report files that are not of a batch."""
    for name in REPORT_FILES:
        if (folder / name).exists() and not (folder / CLIPS_FOLDER).is_dir():
            raise OutputError(
                f"{folder}: holds {name} but no batch to resume; "
                + say("start over with `overwrite=True`, or choose another folder")
            )


def check_is_result(path: Path) -> None:
    """Refuse to resume over a file that is not a result of cageik."""
    if path.exists() and not is_result(path):
        raise OutputError(
            f"{path}: is not a result of cageik extract; "
            + say("move it away, or replace it with `overwrite=True`")
        )


def _describe_outcome(outcome: Outcome) -> str:
    """Say in a line how good a clip is, by the data that counts, or that it has no result."""
    entry, state = outcome.entry, outcome.state
    if entry.report is None:
        return state.value
    known = f"{state.value}, " if state is ClipState.UNCHANGED else ""
    percent = format_percent(entry.report.counted.rms_percent)
    doubt = describe_doubt(entry.report)
    over = (f" ({doubt})" if doubt else "") + (", over a limit" if entry.exceeds_limit else "")
    again = f"; replaces the result of {outcome.replaced}" if outcome.replaced else ""
    earlier = entry.report.baseline_name
    renamed = f"; in the baseline as {earlier}" if earlier not in (None, entry.name) else ""
    return (
        f"{known}{entry.report.verdict}: {percent} % of the size on average{over}{renamed}{again}"
    )


@contextmanager
def _folder_lock(folder: Path) -> Iterator[None]:
    """Create a folder, and be the only batch that writes to it."""
    make_folder(folder)
    path = folder / LOCK_FILE
    try:
        lock = open_locked(path)
    except OSError as error:
        raise make_write_error(path, error) from error
    if lock is None:
        raise OutputError(f"{folder}: another batch is writing to it; wait for it, or stop it")
    try:
        yield
    finally:
        remove_locked(path, lock)


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
                    fault = say(
                        "worker process crashed twice (killed, out of memory, or a "
                        "corrupt file); try fewer `jobs=`"
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
