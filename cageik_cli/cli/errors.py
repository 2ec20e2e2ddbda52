"""The one place where errors become sentences and exit codes."""

import io
import sys
import traceback
from typing import Any

import click

from cageik_cli.cli.options.common import get_verbosity
from cageik_cli.util.errors import format_error


class CageikGroup(click.Group):
    """A command group that shows what went wrong in a sentence; a traceback only with -vv."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; 1 on failure, 2 on wrong usage."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")  # names of files may be any bytes
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise  # the reader of our output has gone; click ends without a word
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except (Exception, KeyboardInterrupt) as error:
            if get_verbosity() > 1:
                click.echo(traceback.format_exc(), err=True)
            raise click.ClickException(format_error(error)) from error  # its exit code is 1
