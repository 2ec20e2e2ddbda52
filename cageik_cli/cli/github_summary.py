"""The summary page that GitHub Actions shows for a step."""

import os
from pathlib import Path

import click

MAX_BYTES = 1 << 20
"""Largest size of the page; GitHub shows no larger one."""


def append_step_summary(text: str) -> None:
    """Append Markdown to the file that GITHUB_STEP_SUMMARY names, if it is set.

    A failure is only a warning: the work is done by then, and its exit code stays.
    """
    named = os.environ.get("GITHUB_STEP_SUMMARY")
    if not named:
        return
    try:
        size = _append(Path(named), f"{text}\n".encode())
    except OSError as error:
        _warn(named, f"cannot be written ({error.strerror or error})")
        return
    if size > MAX_BYTES:
        _warn(named, f"would have {size} bytes, more than {MAX_BYTES}; nothing was added")


def _append(path: Path, data: bytes) -> int:
    """Append all of it if it fits, else nothing; return the size it has or would have."""
    if path.exists() and not path.is_file():
        raise OSError("not a plain file")  # a pipe would wait for its reader
    size = (path.stat().st_size if path.exists() else 0) + len(data)
    if size <= MAX_BYTES:
        with path.open("ab") as stream:
            stream.write(data)
    return size


def _warn(named: str, what: str) -> None:
    click.echo(f"Warning: {named} (GITHUB_STEP_SUMMARY): {what}", err=True)
