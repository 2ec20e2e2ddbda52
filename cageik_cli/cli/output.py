"""What a run shows: its progress, the views that it writes or prints, and the limits it exceeds."""

import json
import os
import shlex
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, NoReturn

import click

from cageik_cli.cli.command import get_verbosity
from cageik_cli.cli.group import spell_message
from cageik_cli.util.errors import CageikError, OutputError
from cageik_cli.util.json_files import JsonFormat, read_json
from cageik_cli.util.messages import Row, Said
from cageik_cli.util.outputs import check_no_overlap, check_writable, write_bytes, write_text
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import format_block, format_row, single_line

if TYPE_CHECKING:
    from tqdm import tqdm

    from cageik_cli.report.overview import Overview
    from cageik_cli.store.result import StoredAnimation

MAX_SUMMARY_BYTES = 1 << 20
"""Largest size of the page of a step; GitHub shows no larger one."""

MAX_TIMINGS_BYTES = 1 << 16
"""Largest size of a file of `--timings`, which has a dozen stages."""


class ProgressBar(ProgressListener):
    """Measures the time of the stages, and draws bars when asked.

    Attributes
    ----------
    is_drawn : bool
        Whether there are bars: they are asked for, and stderr is a terminal.
    seconds : dict
        Time in each stage so far, of all threads; `read` is the time spent waiting for frames
        that threads read ahead.
    """

    def __init__(self, is_drawn: bool) -> None:
        self.seconds: dict[str, float] = {}
        self.notes: list[tuple[str, str]] = []
        context = click.get_current_context(silent=True)  # there is none in other threads
        self._command = None if context is None else context.command
        self._start = time.perf_counter()
        self._lock = Lock()
        self._bar: tqdm[NoReturn] | None = None
        self._label = ""
        self.is_drawn = is_drawn and sys.stderr is not None and sys.stderr.isatty()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of a stage; open its bar, if it has one."""
        units = {
            "cage": "candidates",
            "bind": "steps",
            "read": "frames",
            "edit": "frames",
            "export": "frames",
            "batch": "clips",
            "film": "pictures",
        }
        label = "frames" if name == "read" else name
        if self.is_drawn and name in units and label != self._label:
            self._open_bar(label, units[name])
        start = time.perf_counter()
        try:
            yield
        finally:
            with self._lock:  # stages of several blocks run in parallel
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def update(self, done: int, total: int) -> None:
        """Move the bar."""
        if self._bar is not None:
            self._bar.total = total
            self._bar.update(done - self._bar.n)

    def note(self, topic: str, text: Said) -> None:
        """Keep a note for the end, as a line would break the bar; a repeated note is kept once."""
        note = topic, spell_message(text, self._command)
        if note not in self.notes:
            self.notes.append(note)

    def close(self) -> None:
        """Close the bar, and record the time in all as `total`."""
        if self._bar is not None:
            self._bar.close()
        self.seconds["total"] = time.perf_counter() - self._start

    def make_rows(self) -> list[tuple[str, str]]:
        """Return the notes and the seconds as labelled lines."""
        stages = ", ".join(f"{name} {value:.2f}" for name, value in self.seconds.items())
        return [*self.notes, ("seconds", stages)]

    def _open_bar(self, label: str, unit: str) -> None:
        from tqdm import tqdm  # slow to import, and only terminals show bars

        if self._bar is not None:
            self._bar.close()
        self._label = label
        self._bar = tqdm(desc=label, unit=unit, file=sys.stderr, dynamic_ncols=True)


class LineLogger(ProgressBar):
    """Prints each note at once on a line of its own."""

    def __init__(self, is_drawn: bool) -> None:
        super().__init__(is_drawn)
        self._is_shown = is_drawn

    def note(self, topic: str, text: Said) -> None:
        """Print the note."""
        if self._is_shown:
            from tqdm import tqdm

            # Else an interruption within `write` finds no lock to release.
            tqdm.get_lock()  # type: ignore[no-untyped-call]
            tqdm.write(format_row((topic, spell_message(text, self._command))), file=sys.stderr)


@contextmanager
def show_progress(
    is_drawn: bool,
    timings: Path | None,
    overwrite: bool,
    listener_type: type[ProgressBar] = ProgressBar,
    *,
    resume: bool = False,
) -> Iterator[ProgressBar]:
    """Show the progress of the block inside; write its seconds if the block succeeds.

    A run that resumes replaces the seconds of an earlier one, but no other file.
    """
    if timings is not None:
        overwrite = overwrite or (resume and timings.is_file() and _holds_seconds(timings))
        check_writable(timings, overwrite)
    progress = listener_type(is_drawn)
    try:
        yield progress
    finally:
        progress.close()
    if timings is not None:
        write_text(timings, json.dumps(progress.seconds, indent=1) + "\n", overwrite)


def _holds_seconds(path: Path) -> bool:
    """Return whether a file was written by `--timings`."""
    try:
        seconds = read_json(path, JsonFormat("a file of --timings", MAX_TIMINGS_BYTES))
    except CageikError:
        return False  # and so it is not replaced
    return (
        isinstance(seconds, dict)
        and "total" in seconds
        and all(isinstance(each, float | int) for each in seconds.values())
    )


def check_views(
    views: Sequence[Path | None],
    inputs: Sequence[Path | None],
    overwrite: bool,
    others: Sequence[Path | None] = (),
) -> None:
    """Refuse, before any work, views that cannot be written or overlap with other outputs.

    `-` is stdout, which may be closed.
    """
    check_no_overlap([*others, *views], inputs)
    for path in views:
        if str(path) == "-" and sys.stdout is None:
            raise OutputError("-: standard output is closed; name a file")
        if path is not None and str(path) != "-":
            check_writable(path, overwrite)


def list_files(paths: Iterable[Path | None]) -> list[str]:
    """List the paths that are given, and not stdout."""
    return [str(path) for path in paths if path is not None and str(path) != "-"]


def write_or_print(view: str | bytes, target: Path, overwrite: bool) -> None:
    """Write to a file, or the same bytes to stdout for the name `-`.

    On a terminal, text is printed as all text is, without control characters.
    """
    data = view.encode() if isinstance(view, str) else view
    if str(target) == "-":
        is_shown = sys.stdout is not None and sys.stdout.isatty()
        click.echo(view if is_shown else data, nl=False)
    else:
        write_bytes(target, data, overwrite)


def echo_exceeded_limits(overview: "Overview") -> None:
    """Print on stderr which figures are above their limits, one line each."""
    from cageik_cli.report.views.text import format_check_row

    for entry in overview.clips:
        for check in entry.gates:
            if check.passed is False:
                row = ": ".join(format_check_row(check, entry.vocabulary))
                click.echo(f"{entry.label}: {row}", err=True)
    echo_gaps(overview)


def echo_gaps(overview: "Overview") -> None:
    """Print on stderr which clips the run or its baseline lacks, one line each."""
    for gap in overview.gaps:
        accept = "--allow-new" if gap.is_new else "--allow-missing"
        click.echo(single_line(f"{gap.name}: {gap.text} ({accept} accepts this)"), err=True)


def format_command_output(
    headline: str,
    rows: Iterable[Row],
    command: click.Command | None = None,
    after: int = 1,
) -> str:
    """Return what a command prints: with -v all of it, else few lines, with those `after` it."""
    from cageik_cli.report.views.front import format_brief

    spelled = spell_rows(rows, command)
    return (
        format_block(headline, spelled)
        if get_verbosity()
        else format_brief(headline, spelled, after, source="-v")
    )


def spell_rows(rows: Iterable[Row], command: click.Command | None = None) -> list[tuple[str, str]]:
    """Return labelled rows with the options of a command."""
    return [(label, spell_message(text, command)) for label, text in rows]


def list_next_steps(result: "StoredAnimation") -> list[str]:
    """Return lines with the commands that show a result, and take it to another program."""
    from cageik_cli.report.views.front import format_front_row
    from cageik_cli.store.result import has_weights

    path = str(result.path)
    name, export = shlex.quote(path), shlex.quote(path.removesuffix(".h5") + ".usdc")
    page = shlex.quote(path.removesuffix(".h5") + ".html")
    # Nothing moves the model without weights.
    is_whole = has_weights(result)
    steps = (
        ("see it", f"cageik view {name}" if is_whole else f"cageik report {name} --html {page}"),
        ("use it", f"cageik export {name} {export}{' --with-model' * is_whole}"),
    )
    return list(map(format_front_row, steps))


def exit_with_code(overview: "Overview") -> None:
    """End with the exit code of a run, if that is not 0."""
    if overview.exit_code:
        raise click.exceptions.Exit(overview.exit_code)


def append_step_summary(text: str) -> None:
    """Append Markdown to the file that GITHUB_STEP_SUMMARY names, if it is set.

    A failure is only a warning: the work is done by then, and its exit code stays.
    """
    named = os.environ.get("GITHUB_STEP_SUMMARY")
    if not named:
        return
    try:
        size = _append_summary(Path(named), f"{text}\n".encode())
    except OSError as error:
        _warn_of_summary(named, f"cannot be written ({error.strerror or error})")
        return
    if size > MAX_SUMMARY_BYTES:
        too_large = f"would have {size} bytes, more than {MAX_SUMMARY_BYTES}; nothing was added"
        _warn_of_summary(named, too_large)


def _append_summary(path: Path, data: bytes) -> int:
    """Append all of it if it fits, else nothing; return the size it has or would have."""
    if path.exists() and not path.is_file():
        raise OSError("not a plain file")  # a pipe would wait for its reader
    size = (path.stat().st_size if path.exists() else 0) + len(data)
    if size <= MAX_SUMMARY_BYTES:
        with path.open("ab") as stream:
            stream.write(data)
    return size


def _warn_of_summary(named: str, what: str) -> None:
    click.echo(f"Warning: {named} (GITHUB_STEP_SUMMARY): {what}", err=True)
