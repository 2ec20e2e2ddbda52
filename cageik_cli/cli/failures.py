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
            _fail(str(error), error)
        except BrokenPipeError:
            raise  # the reader of our output has gone; click ends without a word
        except KeyboardInterrupt as error:
            _fail("interrupted", error)
        except OSError as error:
            _fail(f"{error.filename or 'the system'}: {error.strerror or error}", error)
        except MemoryError as error:
            _fail("out of memory; use a coarser cage, or a smaller --memory", error)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Exception as error:
            _fail(
                f"a fault of cageik itself ({type(error).__name__}: {error}); "
                "please report it with the output of the same command with -vv",
                error,
            )


def _fail(message: str, error: BaseException) -> NoReturn:
    """Show the message, and what was noted on the error on its way (what is kept, how to go on)."""
    if verbosity() > 1:
        click.echo(traceback.format_exc(), err=True)
    raise click.ClickException(
        " ".join("; ".join([message, *getattr(error, "__notes__", ())]).split())
    )  # its exit code is 1
