"""Calls of the system that a process makes, seen and answered by another process (Linux, x86-64).

A process that calls `install_filter` stops at each call of `CALLS` until the owner of the listener
lets it go on or refuses it with an error. The filter stays with all its threads and children.
This is far quicker than strace: nothing else of the process is slowed down.

References
----------
seccomp(2) and seccomp_unotify(2) of the Linux manual.
"""

import ctypes
import errno
import fcntl
import os
import platform
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

WRITES = {"write": 1, "pwrite64": 18, "writev": 20, "pwritev": 296}
SIZES = {"ftruncate": 77, "truncate": 76, "fallocate": 285}
SYNCS = {"fsync": 74, "fdatasync": 75}
OPENS = {"open": 2, "creat": 85, "openat": 257, "openat2": 437}
NAMES = {
    "rename": 82, "renameat": 264, "renameat2": 316, "link": 86, "linkat": 265, "symlink": 88,
    "symlinkat": 266, "mkdir": 83, "mkdirat": 258, "rmdir": 84, "unlink": 87, "unlinkat": 263,
}  # fmt: skip
CALLS = WRITES | SIZES | SYNCS | OPENS | NAMES
"""Numbers of the calls that change files or open them."""

_CALL_NAMES = {number: name for name, number in CALLS.items()}
_BY_DESCRIPTOR = {*WRITES, *SIZES, *SYNCS} - {"truncate"}
_PATH_WORDS = {
    "openat": (0, 1), "openat2": (0, 1), "renameat": (0, 1), "renameat2": (0, 1), "linkat": (2, 3),
    "symlinkat": (1, 2), "mkdirat": (0, 1), "unlinkat": (0, 1), "symlink": (None, 1),
    "link": (None, 1),
}  # fmt: skip
"""Which words of a call are the folder and the path; for others, the first word is the path."""

_SECCOMP, _PRCTL_NO_NEW_PRIVILEGES, _SET_FILTER = 317, 38, 1
_NEW_LISTENER, _WAIT_KILLABLE = 1 << 3, 1 << 5
_ALLOW, _NOTIFY, _ARCHITECTURE = 0x7FFF0000, 0x7FC00000, 0xC000003E
_RECEIVE, _SEND, _CONTINUE = 0xC0502100, 0xC0182101, 1
_NOTIFICATION, _RESPONSE = struct.Struct("<QIIiIQ6Q"), struct.Struct("<QqiI")
_AT_CWD = -100
_MAX_PATH = 4096


@dataclass(frozen=True)
class StoppedCall:
    """A call that waits for an answer, and the path of the file that it is about."""

    number: int
    thread: int
    name: str
    path: str


def is_supported() -> bool:
    """Return whether calls can be intercepted here."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return False
    action = ctypes.c_uint32(_NOTIFY)
    return ctypes.CDLL(None).syscall(_SECCOMP, 2, 0, ctypes.byref(action)) == 0


def install_filter() -> int:
    """Stop this process at each call from now on; return the descriptor of the listener."""
    numbers = sorted(CALLS.values())
    load, equal, give = 0x20, 0x15, 0x06
    program = [(load, 0, 0, 4), (equal, 0, len(numbers) + 1, _ARCHITECTURE), (load, 0, 0, 0)]
    program += [(equal, len(numbers) - k, 0, n) for k, n in enumerate(numbers)]
    program += [(give, 0, 0, _ALLOW), (give, 0, 0, _NOTIFY)]
    code = b"".join(struct.pack("<HBBI", *line) for line in program)
    buffer = ctypes.create_string_buffer(code, len(code))
    header = struct.pack("<HxxxxxxQ", len(program), ctypes.addressof(buffer))
    library = ctypes.CDLL(None, use_errno=True)
    library.prctl(_PRCTL_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    listener = library.syscall(_SECCOMP, _SET_FILTER, _NEW_LISTENER | _WAIT_KILLABLE, header)
    if listener < 0:
        raise OSError(ctypes.get_errno(), "calls cannot be intercepted")
    return int(listener)


class Listener:
    """The end at which stopped calls arrive and are answered."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor

    def receive(self) -> StoppedCall | None:
        """Return the next call; None if its thread has died meanwhile."""
        buffer = bytearray(_NOTIFICATION.size)
        try:
            fcntl.ioctl(self.descriptor, _RECEIVE, buffer)
            number, thread, _, call, _, _, *words = _NOTIFICATION.unpack(buffer)
            name = _CALL_NAMES[call]
            return StoppedCall(number, thread, name, _find_path(thread, name, words))
        except (FileNotFoundError, ProcessLookupError):
            return None

    def answer(self, call: StoppedCall, error: str = "") -> None:
        """Let the call go on, or let it fail with an error, such as ENOSPC."""
        code = -getattr(errno, error) if error else 0
        response = bytearray(_RESPONSE.pack(call.number, 0, code, 0 if error else _CONTINUE))
        try:
            fcntl.ioctl(self.descriptor, _SEND, response)
        except (FileNotFoundError, ProcessLookupError):
            return  # it has died


def _find_path(thread: int, name: str, words: list[int]) -> str:
    """Return the absolute path that a call is about, the first one if there are two."""
    if name in _BY_DESCRIPTOR:
        return os.readlink(f"/proc/{thread}/fd/{words[0]}")
    folder_word, path_word = _PATH_WORDS.get(name, (None, 0))
    folder = _AT_CWD
    if folder_word is not None:
        folder = ctypes.c_int32(words[folder_word] & 0xFFFFFFFF).value
    path = _read_text(thread, words[path_word])
    if path.startswith("/"):
        return os.path.normpath(path)
    start = "cwd" if folder == _AT_CWD else f"fd/{folder}"
    return os.path.normpath(os.path.join(os.readlink(f"/proc/{thread}/{start}"), path))


def _read_text(thread: int, address: int) -> str:
    with Path(f"/proc/{thread}/mem").open("rb", 0) as memory:
        memory.seek(address)
        return os.fsdecode(memory.read(_MAX_PATH).split(b"\0", 1)[0])
