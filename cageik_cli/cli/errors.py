"""The one place where errors become messages and exit codes."""

import traceback
from typing import Any

import click

from cageik_cli.cli.lazy import LazyCommands
from cageik_cli.cli.signals import interrupt_on_termination
from cageik_cli.cli.streams import printable_streams
from cageik_cli.cli.wording import word_options
from cageik_cli.util.errors import format_error
from cageik_cli.util.leftovers import listen_to_leftovers
from cageik_cli.util.text import single_line


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
            # Names may have lines.
            error.message = single_line(self._word(ctx, error.message))  # type: ignore[misc]
            raise
        except (click.exceptions.Exit, click.Abort):
            raise
        except (Exception, KeyboardInterrupt) as error:
            from cageik_cli.cli.options.common import get_verbosity

            if get_verbosity() > 1:
                click.echo(traceback.format_exc(), err=True)
            message = self._word(ctx, format_error(error))
            raise click.ClickException(message) from error  # its exit code is 1

    def _word(self, ctx: click.Context, message: str) -> str:
        """Return a message with the options of the command that runs."""
        return word_options(message, self.commands.get(ctx.invoked_subcommand or ""))

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
