"""Make every fixture from nothing, byte for byte.

Usage: ``python data_fixtures/make_fixtures.py [OUT_FOLDER]``; without a folder the fixtures go
beside this file. Nothing here depends on chance, on the clock or on the machine; the bytes
of the three broken HDF5 results alone depend on the version of h5py.
"""

from __future__ import annotations

import sys
from pathlib import Path

from broken import write_broken
from handles import write_handles
from posed import write_posed
from walker import write_walker


def make_all(folder: Path) -> None:
    """Write all fixtures below a folder."""
    write_walker(folder / "walker")
    write_handles(folder / "walker")
    write_posed(folder / "posed")
    write_broken(folder / "broken")


def main(arguments: list[str]) -> int:
    """Run the command line; return its exit code."""
    if len(arguments) > 1 or any(argument.startswith("-") for argument in arguments):
        print(__doc__)
        return 2
    make_all(Path(arguments[0]) if arguments else Path(__file__).resolve().parent)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
