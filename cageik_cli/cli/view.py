"""`cageik view`: a page in the browser that plays a clip and poses its model."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cageik_cli.cli.command import GroupedCommand, option
from cageik_cli.cli.group import spell_option
from cageik_cli.cli.options import CACHE_OPTIONS, WEIGHT_NAMES, common_options, jobs_option
from cageik_cli.cli.options.group import (
    OptionGroup,
    is_on_command_line,
    list_options,
    refuse_options,
)
from cageik_cli.cli.output import ProgressBar, show_progress
from cageik_cli.inputs.settings import BUILD_OPTIONS
from cageik_cli.run.settings import ViewSettings
from cageik_cli.util.messages import Hint, spell
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.settings import HelpGroup

if TYPE_CHECKING:
    from cageik_cli.view.server import Rows


def make_view_settings(**values: Any) -> ViewSettings:
    """Make the settings of a view; options that contradict each other are wrong usage."""
    from cageik_cli.inputs.source import holds_caged_model
    from cageik_cli.store.binding_file import is_binding

    target, weight_names = values["target"], WEIGHT_NAMES
    is_result = holds_caged_model(target) and not is_binding(target)
    if holds_caged_model(target):
        names = ["cage", "given_in", "exclude", "binding", *BUILD_OPTIONS, *weight_names]
        if not is_result:
            _reject(names, "a binding has its cage and weights")
        else:
            _reject([*names, "cage_output"], "a result has its cage and weights")
    elif values["binding"] is not None:
        _reject([*BUILD_OPTIONS, *weight_names], "a binding has its cage and weights")
    elif values["cage"] is not None:
        _reject([*BUILD_OPTIONS], "it is for a cage that is built, and --cage gives one")
    if values["edits_cage"]:
        names = [
            "binding",
            "handles",
            "cage_edits",
            "cage_output",
            "handles_output",
            "cage_edits_output",
        ]
        if not is_result:
            names.append("clip")
        refuse_options(names, "{}: --edit-cage changes the cage alone; leave it out")
    return ViewSettings(**values)


def _reject(names: list[str], reason: str) -> None:
    """Refuse options on the command line; a file of options may have them for other targets."""
    refuse_options(names, "{}: " + f"{reason}; leave it out", is_on_command_line)


@click.command("view", cls=GroupedCommand)
@OptionGroup(
    "settings",
    make_view_settings,
    *list_options(ViewSettings, cache=CACHE_OPTIONS, jobs=jobs_option),
)
@option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    show_default="any that is free",
    help="Port of the server, on this machine only.",
    group=HelpGroup.RUNNING,
)
@option(
    "--no-browser",
    is_flag=True,
    help="Print the address, and open no browser.",
    group=HelpGroup.RUNNING,
)
@common_options
def view_command(settings: ViewSettings, port: int, no_browser: bool, quiet: bool) -> None:
    """Play a clip or pose a model in the browser.

    TARGET is a result, a binding of cageik bind, or a model. The page is served on this machine
    only, until Ctrl-C. With -o, Apply in the page solves in full precision and writes the outputs;
    without it, Save as writes a new file beside TARGET.

    \b
    cageik view cages.h5 -o edited.h5 --handles-out handles.json
    cageik view rest.obj --cage cage.obj -o posed.obj
    cageik view rest.obj --cage cage.obj --edit-cage -o mended.obj
    cageik view cages.h5 --edit-cage
    """  # noqa: D301
    from cageik_cli.util.text import format_block
    from cageik_cli.view.run import run_view
    from cageik_cli.view.session import PageSession, open_session

    with show_progress(not quiet, None, settings.overwrite) as progress:
        session: PageSession
        if settings.edits_cage:
            from cageik_cli.view.rest_cage import open_rest_cage

            session = open_rest_cage(settings, progress)
        else:
            session = open_session(settings, progress)
    if not quiet:
        click.echo(format_block(str(settings.target), progress.make_rows()), err=True)
    listener = TerminalListener(settings, not no_browser, quiet)
    try:
        run_view(session, port, listener)
    except KeyboardInterrupt:
        click.echo("stopped", err=True)


class TerminalListener:
    """Prints the address and the edits; a `ViewListener`."""

    def __init__(self, settings: ViewSettings, opens_browser: bool, is_quiet: bool) -> None:
        self._settings, self._is_quiet = settings, is_quiet
        self._opens_browser = opens_browser
        self._progress = ProgressBar(is_drawn=False)

    def spell_hint(self, hint: Hint) -> str:
        """Write a hint as an option of the command that does what the page does."""
        from cageik_cli.cli.check import check_command
        from cageik_cli.cli.pose import pose_command

        if hint.name == "clip":
            return spell_option(hint, view_command)
        return spell_option(hint, check_command if self._settings.edits_cage else pose_command)

    def open(self, address: str) -> None:
        """Print the address, whatever else is printed, and open it."""
        click.echo(address)
        if not self._is_quiet:
            click.echo("serving on this machine; stop with Ctrl-C", err=True)
        if self._opens_browser:
            import webbrowser

            with suppress(webbrowser.Error):  # without a browser, the address is enough
                webbrowser.open(address)

    @contextmanager
    def show_edit(self) -> Iterator[ProgressListener]:
        """Show the progress of an edit; say so if it is dropped."""
        try:
            with show_progress(not self._is_quiet, None, False) as self._progress:
                yield self._progress
        except KeyboardInterrupt:
            click.echo("the edit was dropped; files are complete, or as before it", err=True)
            raise

    def show_applied(self, rows: "Rows", written: Sequence[Path]) -> None:
        """Print what came of the edit."""
        from cageik_cli.util.text import format_block

        if not self._is_quiet:
            rows = [*rows, *self._progress.make_rows()]
            spelled = [(label, spell(text, self.spell_hint)) for label, text in rows]
            click.echo(format_block(str(written[0]), spelled), err=True)
            click.echo(f"wrote {', '.join(map(str, written))}", err=True)

    def show_failed(self, error: str) -> None:
        """Print why nothing was written."""
        click.echo(f"Error: {error}", err=True)
