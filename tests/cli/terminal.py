"""The command as it is at a terminal."""

import io
import os
import threading
from contextlib import redirect_stderr, redirect_stdout

import pytest

from cageik_cli.cli import main


def on_a_terminal(*words):
    """Run the command with a terminal as its stderr; return its exit code and what it drew."""
    with io.TextIOWrapper(io.BytesIO()) as printed:
        code, drawn = _run_on_terminal(words, printed)
        printed.flush()
        assert printed.buffer.getvalue() == b""
    return code, drawn


def print_on_terminal(*words):
    """Run the command with a terminal as its stdout and stderr; return what it drew."""
    return _run_on_terminal(words, None)[1]


def _run_on_terminal(words, stdout):
    pty, termios = pytest.importorskip("pty"), pytest.importorskip("termios")
    reader, terminal = pty.openpty()
    termios.tcsetwinsize(terminal, (24, 100))
    drawn = []

    def read():
        try:
            while data := os.read(reader, 4096):
                drawn.append(data)
        except OSError:  # how Linux says that the other end is closed
            pass

    listener = threading.Thread(target=read)
    listener.start()
    try:
        with (
            open(terminal, "w", buffering=1, errors="backslashreplace") as screen,
            redirect_stdout(stdout or screen),
            redirect_stderr(screen),
            pytest.raises(SystemExit) as end,
        ):
            main(words)
    finally:
        listener.join()
        os.close(reader)
    return end.value.code, b"".join(drawn).decode()
