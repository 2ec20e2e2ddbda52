"""Unfinished outputs: their names, and those that killed runs have left.

The name of an unfinished output holds the process that writes it, so that a later run can tell
whether that is still alive. Those of other machines are left alone.
"""

import os
import platform
import re
import secrets
import shutil
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path

Listener = Callable[[str], None]
_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)

_TOKEN = r"([0-9a-f]{8})([0-9a-f]{8})[0-9a-f]{8}"
"""Machine, process, and a random number."""


def make_unfinished_path(path: Path, suffix: str = "") -> Path:
    """Return a name for an unfinished output beside `path`, which no other run has.

    It ends in the suffix of `path` if that is given as `suffix`.
    """
    stem = path.name.removesuffix(suffix) if suffix else path.name
    token = f"{_identify_machine():08x}{os.getpid() & 0xFFFFFFFF:08x}{secrets.token_hex(4)}"
    return path.with_name(f"{stem}.{token}.partial{suffix}")


def make_displaced_path(path: Path) -> Path:
    """Return a name for the folder that an output replaces, until that has its place."""
    return make_unfinished_path(path).with_suffix(".replaced")


@contextmanager
def listen_to_leftovers(listener: Listener) -> Iterator[None]:
    """Pass a sentence on what is removed in the block to a listener."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def clear_leftovers(path: Path) -> None:
    """Remove what killed runs to the same output left, and put back a folder they displaced.

    Errors are ignored: the output itself can be written all the same.
    """
    with suppress(OSError):
        left = [file for file in path.parent.iterdir() if _is_left_over(file.name, path)]
        for file in sorted(left):
            _clear(file, path)


def _is_left_over(name: str, path: Path) -> bool:
    """Tell whether a name is that of an unfinished output of a process that is dead."""
    if not name.startswith(f"{path.stem}."):
        return False
    ends = rf"(?:\.partial|\.replaced|\.partial{re.escape(path.suffix)}(?:\.\w+)?|\.partial\.\w+)"
    found = re.fullmatch(
        rf"(?:{re.escape(path.name)}|{re.escape(path.stem)})\.{_TOKEN}{ends}", name
    )
    if found is None or int(found[1], 16) != _identify_machine():
        return False
    return not _is_alive(int(found[2], 16))


def _clear(file: Path, path: Path) -> None:
    is_folder = file.is_dir() and not file.is_symlink()
    # What is no folder was not displaced by a run, and would be written through.
    if file.name.endswith(".replaced") and is_folder and not os.path.lexists(path):
        file.rename(path)
        _tell(f"{path}: put back, as it was before a run that was killed")
        return
    if is_folder:
        shutil.rmtree(file)
    else:
        file.unlink()
    _tell(f"{file}: removed, a run that was killed had left it")


def _tell(sentence: str) -> None:
    listener = _LISTENER.get()
    if listener is not None:
        listener(sentence)


def _is_alive(process: int) -> bool:
    if os.name != "posix":
        return True  # there is no safe way to ask: os.kill would end it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


@cache
def _identify_machine() -> int:
    """Return a number of this machine, and of the container, in which processes are counted."""
    known = [platform.node()]
    with suppress(OSError):
        known.append(Path("/etc/machine-id").read_text().strip())
    with suppress(OSError):
        known.append(os.readlink("/proc/self/ns/pid"))
    return zlib.crc32(" ".join(known).encode())
