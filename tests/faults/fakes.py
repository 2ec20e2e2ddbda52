"""Commands that break one promise each, to see that the harness notices.

`python -m tests.faults.fakes` prints, as JSON, what it finds of each.
"""

import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from cageik_cli.util.outputs import write_text
from tests.faults import process
from tests.faults.bench import Bench, Case, Trial, find_unsynced
from tests.faults.commands import Command
from tests.faults.harness import choose_faults

OUTPUT = Path("out.txt")


def _say_error(error: Exception) -> None:
    sys.exit(f"Error: {error}")


def sound() -> None:
    """Keep all promises."""
    try:
        write_text(OUTPUT, sys.argv[1], overwrite=True)
    except Exception as error:
        _say_error(error)


def careless() -> None:
    """Write to the final name."""
    try:
        with OUTPUT.open("wb", 0) as file:
            file.write(sys.argv[1][:2].encode())
            file.write(sys.argv[1][2:].encode())
    except OSError as error:
        _say_error(error)


def hasty() -> None:
    """Rename a file that the disk may not have."""
    partial = OUTPUT.with_name(f"out.txt.{os.getpid()}.partial")
    try:
        partial.write_text(sys.argv[1])
        partial.replace(OUTPUT)
    except OSError as error:
        partial.unlink(missing_ok=True)
        _say_error(error)


def raw() -> None:
    """Let errors through."""
    write_text(OUTPUT, sys.argv[1], overwrite=True)


def silent() -> None:
    """Hide that nothing was written."""
    try:
        write_text(OUTPUT, sys.argv[1], overwrite=True)
    except Exception:
        return


def mute() -> None:
    """Fail, and do not say why."""
    try:
        write_text(OUTPUT, sys.argv[1], overwrite=True)
    except Exception:
        sys.exit(1)


def littering() -> None:
    """Leave a file behind that no later run removes."""
    litter = OUTPUT.with_name(f"litter{os.getpid()}")
    litter.touch()
    sound()
    litter.unlink()


def spoiling() -> None:
    """Write to an input."""
    sound()
    with Path("handles.json").open("a") as file:
        file.write(" ")


def stuck() -> None:
    """Never run again once a run has failed."""
    mark = _leave_mark()
    if mark is None:
        sys.exit("Error: a run has failed")
    sound()
    mark.unlink()


def unsteady() -> None:
    """Write something else once a run has failed."""
    mark = _leave_mark()
    if mark is None:
        sys.argv[1] += "!"
    sound()
    if mark is not None:
        mark.unlink()


def hanging() -> None:
    """Wait for ever for a disk with room."""
    while True:
        try:
            write_text(OUTPUT, sys.argv[1], overwrite=True)
        except Exception:
            time.sleep(0.1)
        else:
            return


def impatient() -> None:
    """Take a signal for an error."""
    lock = Path(os.environ["TMPDIR"], "lock")
    try:
        with lock.open("wb", 0) as file:
            file.truncate(3)
        lock.unlink()
    except OSError as error:
        _say_error(error)
    sound()


def whispering() -> None:
    """Lose what it prints."""
    sound()
    try:
        print(sys.argv[1], flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _leave_mark() -> Path | None:
    """Make a file in the folder of the user; None if it is there already."""
    mark = Path(os.environ["HOME"], "mark")
    if mark.exists():
        return None
    mark.touch()
    return mark


FAKES = (
    sound, careless, hasty, raw, silent, mute, littering, spoiling, stuck, unsteady, hanging,
    impatient, whispering,
)  # fmt: skip


def try_fake(bench: Bench, name: str) -> list[str]:
    """Return what is violated by all faults of a fake."""
    words, other = ("new",), (("new", "older"),)
    command = Command(name, words, ("out.txt",), other, main=f"tests.faults.fakes:{name}")
    case = Case(command, is_over_older=True)
    points = bench.prepare(case).points
    found = list(find_unsynced(points))
    for point in points:
        for fault in choose_faults(point):
            found += bench.judge(Trial(case, point, fault)).violations
    return found


def main() -> None:
    """Print what is violated by each fake."""
    process.MAX_SECONDS = 1.0
    folder = Path(tempfile.mkdtemp()).resolve()
    try:
        bench = Bench(folder)
        print(json.dumps({fake.__name__: try_fake(bench, fake.__name__) for fake in FAKES}))
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
