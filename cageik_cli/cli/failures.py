"""The one place where errors become sentences and exit codes."""

import io
import sys
import traceback
from typing import Any, NoReturn

import click

from cageik_cli.cli.options import verbosity
from cageik_cli.errors import CageikError


class CageikGroup(click.Group):
    """A command group that shows what went wrong in a sentence; a traceback only with -vv."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; 1 on failure, 2 on wrong usage."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")  # names of files may be any bytes
        try:
            return super().invoke(ctx)
        except CageikError as error:
            _fail(str(error))
        except BrokenPipeError:
            raise  # the reader of our output has gone; click ends without a word
        except KeyboardInterrupt:
            _fail("interrupted")
        except OSError as error:
            _fail(f"{error.filename or 'the system'}: {error.strerror or error}")
        except MemoryError:
            _fail("out of memory; use a coarser cage, or a smaller --memory")
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Exception as error:
            _fail(
                f"a fault of cageik itself ({type(error).__name__}: {error}); "
                "please report it with the output of the same command with -vv"
            )


def _fail(message: str) -> NoReturn:
    if verbosity() > 1:
        click.echo(traceback.format_exc(), err=True)
    raise click.ClickException(" ".join(message.split()))  # its exit code is 1
