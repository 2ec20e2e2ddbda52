"""The command as it is at a terminal."""

import os
import subprocess
import sys
import threading

import pytest


def on_a_terminal(*words):
    """Run the command with a terminal as its stderr, and give what it drew there."""
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
        done = subprocess.run(process, stdout=subprocess.PIPE, stderr=terminal, timeout=120)
    finally:
        os.close(terminal)
        listener.join()
        os.close(reader)
    assert done.stdout == b""
    return done.returncode, b"".join(drawn).decode()
