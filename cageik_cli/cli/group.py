"""The group of all commands: imports them when they run, ends their errors, and guards terminals.

The one place where errors become messages and exit codes, and where a hint to a setting becomes an
option: that of `outside=project` is shown as --outside project.
"""

import codecs
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from types import FrameType
from typing import Any

import click

from cageik_cli.util.errors import CageikError, WrongUsageError, format_error
from cageik_cli.util.messages import Hint, Said, spell, spell_keyword
from cageik_cli.util.outputs import listen_to_leftovers
from cageik_cli.util.text import make_printable, single_line


def import_command(name: str) -> click.Command:
    """Import a command by its name; no module of the group imports one before it is asked for."""
    command: click.Command = getattr(import_module(f"cageik_cli.cli.{name}"), f"{name}_command")
    return command


class LazyCommands(Mapping[str, click.Command]):
    """The commands by their names; command NAME is `NAME_command` in the module `cli.NAME`.

    Parameters
    ----------
    summaries : mapping of str to str
        What each command does, in one line; the first line of its own help.
    """

    def __init__(self, summaries: Mapping[str, str]) -> None:
        self.summaries = summaries

    def __getitem__(self, name: str) -> click.Command:
        if name not in self.summaries:
            raise KeyError(name)
        return import_command(name)

    def __contains__(self, name: object) -> bool:
        return name in self.summaries

    def __iter__(self) -> Iterator[str]:
        return iter(self.summaries)

    def __len__(self) -> int:
        return len(self.summaries)


class CageikGroup(click.Group):
    """A command group that shows an error as one sentence; with -vv also its traceback."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command line; nothing that it prints controls the terminal."""
        with printable_streams(), interrupt_on_termination(), listen_to_leftovers(_show_note):
            return super().main(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; the exit code is 1 for an error, 2 for wrong usage."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise  # nobody reads our output any more; click ends without a message
        except click.ClickException as error:
            error.message = single_line(error.message)  # type: ignore[misc]  # names may have lines
            raise
        except (click.exceptions.Exit, click.Abort):
            raise
        except (Exception, KeyboardInterrupt) as error:
            from cageik_cli.cli.command import get_verbosity

            if get_verbosity() > 1:
                click.echo(traceback.format_exc(), err=True)
            command = self.commands.get(ctx.invoked_subcommand or "")
            message = spell_message(format_error(error), command)
            is_wrong_usage = isinstance(error, WrongUsageError)
            # The exit codes are 2 and 1.
            raise (click.UsageError if is_wrong_usage else click.ClickException)(message) from error

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands with their summaries; no command is imported."""
        if isinstance(self.commands, LazyCommands):
            with formatter.section("Commands"):
                formatter.write_dl(sorted(self.commands.summaries.items()))


def _show_note(sentence: str) -> None:
    """Print a note at once, unless the run is quiet."""
    context = click.get_current_context(silent=True)
    if context is None or not context.params.get("quiet"):
        click.echo(f"note: {single_line(sentence)}", err=True)


def spell_option(hint: Hint, command: click.Command | None = None) -> str:
    """Write a hint as what is typed for a command; a setting that it lacks is one of extract."""
    option = _find_option(hint.name, command)
    shown = "" if hint.value in ("", "True") else f" {hint.value}"
    return spell_keyword(hint) if option is None else f"{option}{shown}"


def spell_message(said: Said, command: click.Command | None = None) -> str:
    """Return a message with the options of a command."""
    return spell(said, partial(spell_option, command=command))


def spell_error(error: CageikError, ctx: click.Context | None = None) -> str:
    """Return an error with the options of the command that runs."""
    ctx = ctx or click.get_current_context(silent=True)
    return spell_message(error.text, None if ctx is None else ctx.command)


def _find_option(name: str, command: click.Command | None) -> str | None:
    """Return what is typed for a parameter: an option, or an argument in capitals."""
    from cageik_cli.cli.command import spell_param

    if name == "verbose":
        return "-v"  # as everybody types it
    for known in (command, import_command("extract")):
        for param in known.params if known is not None else ():
            if param.name == name or f"--{name.replace('_', '-')}" in param.opts:
                return spell_param(param)
    # Parameters that no option of this name sets.
    return {
        "repair": "cageik cage --repair",
        "keep_weights": "without --no-weights",
        "morphs": "--morphs",
        "has_normals": "--flat",
        "recentre": "--recentre",
    }.get(name)


@contextmanager
def interrupt_on_termination() -> Iterator[None]:
    """Raise KeyboardInterrupt in the block when the process is told to end; not under nohup."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {
        number: signal.signal(number, _interrupt)
        for number in numbers
        if signal.getsignal(number) == signal.SIG_DFL
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


class PrintableStream:
    """A text stream that replaces control characters; it hands all else to another stream.

    Bytes that are written to its `buffer`, such as a picture, are left as they are.

    Parameters
    ----------
    is_optional : bool
        Whether work goes on if nothing can be written to it.
    """

    def __init__(self, stream: io.TextIOWrapper, is_optional: bool) -> None:
        self._stream, self._is_optional = stream, is_optional

    def write(self, text: str) -> int:
        """Write text."""
        if not isinstance(text, str):
            raise TypeError(f"expected text, not {type(text).__name__}")
        with self._tolerate_errors():
            self._stream.write(make_printable(text))
        return len(text)

    def flush(self) -> None:
        """Write what is buffered."""
        with self._tolerate_errors():
            self._stream.flush()

    @contextmanager
    def _tolerate_errors(self) -> Iterator[None]:
        """After an error of an optional stream, let it lead nowhere."""
        try:
            yield
        except OSError:
            if not self._is_optional:
                raise
            with suppress(OSError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())  # what is buffered goes there, too
                os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def printable_streams() -> Iterator[None]:
    """Make the standard streams printable in the block."""
    streams = sys.stdout, sys.stderr
    try:
        # Messages may be lost, the answer may not.
        sys.stdout = _make_printable_stream(sys.stdout, is_optional=False)
        sys.stderr = _make_printable_stream(sys.stderr, is_optional=True)
        yield
    finally:
        sys.stdout, sys.stderr = streams


def _make_printable_stream(stream: Any, is_optional: bool) -> Any:
    """Return a stream that replaces control characters; None for one that was closed."""
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    # click would write past us to a stream of ASCII, which it takes for misconfigured.
    is_ascii = codecs.lookup(stream.encoding).name == "ascii"
    # File names may have any bytes.
    stream.reconfigure(encoding="utf-8" if is_ascii else None, errors="backslashreplace")
    return PrintableStream(stream, is_optional)
