"""The command as it is at a terminal."""

import os
import subprocess
import sys
import threading

import pytest


def on_a_terminal(*words):
    """Run the command with a terminal as its stderr, and give what it drew there."""
    done, drawn = _run_on_terminal(words, has_stdout=False)
    assert done.stdout == b""
    return done.returncode, drawn


def print_on_terminal(*words):
    """Run the command with a terminal as its stdout and stderr; return what it drew."""
    return _run_on_terminal(words, has_stdout=True)[1]


def _run_on_terminal(words, has_stdout):
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
        process = [sys.executable, "-m", "cageik_cli", *words]
        stdout = terminal if has_stdout else subprocess.PIPE
        done = subprocess.run(process, stdout=stdout, stderr=terminal, timeout=120)
    finally:
        os.close(terminal)
        listener.join()
        os.close(reader)
    return done, b"".join(drawn).decode()
