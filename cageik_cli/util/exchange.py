"""Exchange two files or folders in one step, where the system can."""

import ctypes
import os
import sys
from pathlib import Path

_AT_CURRENT_FOLDER = -100
_EXCHANGE = 2


def exchange(one: Path, other: Path) -> bool:
    """Exchange the names of two files or folders in one step; False where that is not possible.

    Linux has it since 3.15 (`renameat2`), macOS since 10.12 (`renamex_np`), not for all kinds of
    disks.
    """
    names = os.fsencode(one), os.fsencode(other)
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, _EXCHANGE) == 0)
        first, second = ((_AT_CURRENT_FOLDER, name) for name in names)
        return bool(library.renameat2(*first, *second, _EXCHANGE) == 0)
    except (OSError, AttributeError, TypeError):
        return False  # a system without it
