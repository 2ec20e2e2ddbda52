"""The one place where errors become messages and exit codes."""

import io
import sys
import traceback
from typing import Any

import click

from cageik_cli.cli.lazy import LazyCommands
from cageik_cli.util.errors import format_error


class CageikGroup(click.Group):
    """A command group that shows an error as one sentence; with -vv also its traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; the exit code is 1 for an error, 2 for wrong usage."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")  # file names may have any bytes
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise  # nobody reads our output any more; click ends without a message
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except (Exception, KeyboardInterrupt) as error:
            from cageik_cli.cli.options.common import get_verbosity

            if get_verbosity() > 1:
                click.echo(traceback.format_exc(), err=True)
            raise click.ClickException(format_error(error)) from error  # its exit code is 1

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands with their summaries; no command is imported."""
        if isinstance(self.commands, LazyCommands):
            with formatter.section("Commands"):
                formatter.write_dl(sorted(self.commands.summaries.items()))
