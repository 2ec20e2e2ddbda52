"""A batch: jobs done, and one report over all."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.report.figures import percent_text
from cageik_cli.report.html.index import as_index
from cageik_cli.report.overview import Entry, Overview, overview_of
from cageik_cli.report.views.junit import as_junit
from cageik_cli.report.views.markdown import as_markdown
from cageik_cli.report.views.tables import overview_csv, overview_json
from cageik_cli.store.result import is_result
from cageik_cli.util.errors import InputError
from cageik_cli.util.outputs import make_folder, open_locked, remove_locked, write_text
from cageik_cli.util.progress import Observer
from cageik_cli.workflows.batch.jobs import CLIPS, ClipJob, Outcome, Scheduler, State

VIEWS = {
    "index.html": as_index,
    "report.json": overview_json,
    "clips.csv": overview_csv,
    "junit.xml": as_junit,
    "report.md": as_markdown,
}
"""What is written over all clips, by the files' names."""

WIDEST = 60
"""Column of clips' names."""

WEIGHTS = ".cageik-weights"
"""The cache of a batch that is to use no other, deleted at its end."""

LOCK = ".cageik-batch.lock"


@dataclass(frozen=True, slots=True)
class Batch:
    """What is to be done.

    Attributes
    ----------
    output : Path
        The folder of all results.
    jobs : tuple of ClipJob
    refused : tuple of Entry
        Clips that cannot be begun, and why.
    order : tuple of str
        Names of all clips, as reports list them.
    """

    output: Path
    jobs: tuple[ClipJob, ...]
    refused: tuple[Entry, ...]
    order: tuple[str, ...]


def run_batch(batch: Batch, scheduler: Scheduler, watch: Observer) -> Overview:
    """Do all jobs, and write the report over all; failures are in it, and no error.

    The observer is told of each clip as it ends, in a remark by its name.

    Raises
    ------
    InputError
        When the folder of results cannot be written, or another batch has it.
    """
    entries = {entry.name: entry for entry in batch.refused}
    width = min(max(map(len, batch.order), default=0), WIDEST)
    with _alone_in(batch.output):
        make_folder(batch.output / CLIPS)
        with watch.stage("batch"), _counted(batch) as done, scheduler as crew:
            for entry in batch.refused:
                _tell(Outcome(entry, State.FAILED), width, watch)
            for outcome in crew.outcomes(batch.jobs):
                entries[outcome.entry.name] = outcome.entry
                done.append(outcome)
                _tell(outcome, width, watch)
                watch.advance(len(done), len(batch.jobs))
        if any(job.settings.cache == batch.output / WEIGHTS for job in batch.jobs):
            shutil.rmtree(batch.output / WEIGHTS, ignore_errors=True)
        overview = overview_of([entries[name] for name in batch.order])
        with watch.stage("write"):
            for name, view in VIEWS.items():
                write_text(batch.output / name, view(overview), overwrite=True)
    return overview


def refuse_used(folder: Path) -> None:
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


def refuse_foreign(folder: Path) -> None:
    """Refuse to go on in a folder whose files of a report's names no batch has written.

    Raises
    ------
    InputError
        Saying what to do.
    """
    for name in VIEWS:
        if (folder / name).exists() and not (folder / CLIPS).is_dir():
            raise InputError(
                f"{folder}: holds {name} and no results of a batch to go on with; replace what is "
                "there with --overwrite, or choose another folder"
            )


def refuse_no_result(path: Path) -> None:
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


def _tell(outcome: Outcome, width: int, watch: Observer) -> None:
    """A line a clip, as it ends: its error over all frames, or why there is none."""
    entry, text = outcome.entry, outcome.state.value
    if entry.summary is not None:
        over = ", over a limit" if entry.exceeds else ""
        text = f"{text}, error {percent_text(entry.summary.rms_percent)} %{over}"
    watch.remark(f"{entry.name:<{width}}", entry.fault or text)


@contextmanager
def _counted(batch: Batch) -> Iterator[list[Outcome]]:
    """What is done so far; an error says how much of it there is."""
    done: list[Outcome] = []
    try:
        yield done
    except BaseException as error:
        error.add_note(f"{len(done)} of {len(batch.jobs)} clips were done; go on with --resume")
        raise


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Be the only batch that writes to a folder, which is made."""
    make_folder(folder)
    path = folder / LOCK
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
