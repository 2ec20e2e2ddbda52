"""A batch: jobs done, and one report over all."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.report.figures import format_percent
from cageik_cli.report.html.index import render_index
from cageik_cli.report.overview import ClipEntry, Overview, build_overview
from cageik_cli.report.views.junit import format_junit
from cageik_cli.report.views.markdown import format_markdown
from cageik_cli.report.views.tables import format_overview_csv, format_overview_json
from cageik_cli.store.result import is_result
from cageik_cli.util.errors import InputError
from cageik_cli.util.outputs import make_folder, open_locked, remove_locked, write_text
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.batch.jobs import CLIPS_FOLDER, ClipJob, ClipState, Outcome, Scheduler

REPORT_FILES = {
    "index.html": render_index,
    "report.json": format_overview_json,
    "clips.csv": format_overview_csv,
    "junit.xml": format_junit,
    "report.md": format_markdown,
}
"""What is written over all clips, by the files' names."""

MAX_NAME_WIDTH = 60
"""Column of clips' names."""

WEIGHT_CACHE_FOLDER = ".cageik-weights"
"""The cache of a batch that is to use no other, deleted at its end."""

LOCK_FILE = ".cageik-batch.lock"


@dataclass(frozen=True, slots=True)
class BatchPlan:
    """What is to be done.

    Attributes
    ----------
    output : Path
        The folder of all results.
    jobs : tuple of ClipJob
    rejected : tuple of Entry
        Clips that cannot be begun, and why.
    order : tuple of str
        Names of all clips, as reports list them.
    """

    output: Path
    jobs: tuple[ClipJob, ...]
    rejected: tuple[ClipEntry, ...]
    order: tuple[str, ...]


def run_batch(batch: BatchPlan, scheduler: Scheduler, progress: ProgressListener) -> Overview:
    """Do all jobs, and write the report over all; failures are in it, and no error.

    The observer is told of each clip as it ends, in a remark by its name.

    Raises
    ------
    InputError
        When the folder of results cannot be written, or another batch has it.
    """
    entries = {entry.name: entry for entry in batch.rejected}
    width = min(max(map(len, batch.order), default=0), MAX_NAME_WIDTH)
    with _folder_lock(batch.output):
        make_folder(batch.output / CLIPS_FOLDER)
        with (
            progress.stage("batch"),
            _note_done_on_error(batch) as done,
            scheduler as active_scheduler,
        ):
            for entry in batch.rejected:
                _log_outcome(Outcome(entry, ClipState.FAILED), width, progress)
            for outcome in active_scheduler.run_jobs(batch.jobs):
                entries[outcome.entry.name] = outcome.entry
                done.append(outcome)
                _log_outcome(outcome, width, progress)
                progress.update(len(done), len(batch.jobs))
        if any(job.settings.cache == batch.output / WEIGHT_CACHE_FOLDER for job in batch.jobs):
            shutil.rmtree(batch.output / WEIGHT_CACHE_FOLDER, ignore_errors=True)
        overview = build_overview([entries[name] for name in batch.order])
        with progress.stage("write"):
            for name, view in REPORT_FILES.items():
                write_text(batch.output / name, view(overview), overwrite=True)
    return overview


def check_folder_empty(folder: Path) -> None:
    """Refuse a folder of results that holds something.

    Raises
    ------
    InputError
        Saying what to do.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file, expected the name of a folder for the results")
    if any(not path.is_dir() for path in folder.rglob("*")):
        raise InputError(
            f"{folder}: holds something already; go on with --resume, replace what is there with "
            "--overwrite, or choose another folder"
        )


def check_batch_folder(folder: Path) -> None:
    """Refuse to go on in a folder whose files of a report's names no batch has written.

    Raises
    ------
    InputError
        Saying what to do.
    """
    for name in REPORT_FILES:
        if (folder / name).exists() and not (folder / CLIPS_FOLDER).is_dir():
            raise InputError(
                f"{folder}: holds {name} and no results of a batch to go on with; replace what is "
                "there with --overwrite, or choose another folder"
            )


def check_is_result(path: Path) -> None:
    """Refuse to go on with a file that is no result of ours.

    Raises
    ------
    InputError
        Saying what to do.
    """
    if path.exists() and not is_result(path):
        raise InputError(
            f"{path}: is no result of cageik extract to go on with; move it away, or replace it "
            "with --overwrite"
        )


def _log_outcome(outcome: Outcome, width: int, progress: ProgressListener) -> None:
    """A line a clip, as it ends: its error over all frames, or why there is none."""
    entry, text = outcome.entry, outcome.state.value
    if entry.summary is not None:
        over = ", over a limit" if entry.exceeds_limit else ""
        text = f"{text}, error {format_percent(entry.summary.rms_percent)} %{over}"
    progress.note(f"{entry.name:<{width}}", entry.fault or text)


@contextmanager
def _note_done_on_error(batch: BatchPlan) -> Iterator[list[Outcome]]:
    """What is done so far; an error says how much of it there is."""
    done: list[Outcome] = []
    try:
        yield done
    except BaseException as error:
        error.add_note(f"{len(done)} of {len(batch.jobs)} clips were done; go on with --resume")
        raise


@contextmanager
def _folder_lock(folder: Path) -> Iterator[None]:
    """Be the only batch that writes to a folder, which is made."""
    make_folder(folder)
    path = folder / LOCK_FILE
    try:
        lock = open_locked(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    if lock is None:
        raise InputError(f"{folder}: another batch is writing to it; wait for it, or stop it")
    try:
        yield
    finally:
        remove_locked(path, lock)
