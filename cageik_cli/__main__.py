"""The command `cageik`, and `python -m cageik_cli`.

Nothing is imported before `main` runs but what Python itself has loaded, so that a system which
cannot open files or has no memory is reported as any other error is.
"""

import os
import sys
from contextlib import suppress


def main() -> None:
    """Run the command line.

    What fails while the command is imported, before it can report errors itself, becomes a
    sentence and exit code 1. That is the system or the installation, never an input. So does an
    interruption before or after the command.
    """
    _open_closed_streams()
    # Threads of the linear algebra wait for each other, which takes long beside other programs.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        try:
            from cageik_cli.cli import main as run_command_line
            from cageik_cli.util.trial import trials

            trials.are_wanted = True
        except (OSError, ImportError, MemoryError) as error:
            what = str(error) or type(error).__name__
            sys.exit(f"Error: cageik cannot be loaded: {what}; {_ADVICE}")
        run_command_line()
    except KeyboardInterrupt:
        sys.exit("Error: interrupted")


def _open_closed_streams() -> None:
    """Open standard streams that are closed to nowhere: else files that are opened get their place.

    What is printed, also by libraries, would be written to these files.
    """
    with suppress(OSError):  # no file can be opened: what comes next says so
        while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
            os.set_inheritable(descriptor, True)
        os.close(descriptor)


_ADVICE = (
    "check the memory and the disk space that are free, the limit of open files (ulimit -n), and "
    "the installation"
)


if __name__ == "__main__":
    main()
