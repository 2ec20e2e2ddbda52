"""What the server of a page serves, and how it refuses."""

import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from threading import Condition
from typing import Any

from cageik_cli.util.messages import Spelling, spell_keyword
from cageik_cli.util.progress import ProgressListener


class RefusedRequestError(Exception):
    """A request that is not answered: status and text."""

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


def make_busy_error() -> RefusedRequestError:
    """Return the refusal of a second edit."""
    text = "another edit is running; try again when it is done"
    return RefusedRequestError(HTTPStatus.CONFLICT, text)


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """What is served.

    Attributes
    ----------
    secret : str
        The first part of every path.
    page : bytes
        HTML.
    parse : callable, optional
        Makes an edit of a body and a rigidity; None if handles cannot be applied.
    answers : dict of str to callable
        What else may be sent, and the answer to a body and `spelling`, which is sent as JSON.
    spelling : callable
        Writes the settings that texts name, as who reads the page types them.
    """

    secret: str
    page: bytes
    board: "JobBoard"
    parse: Callable[[bytes, int], "Edit"] | None
    answers: Mapping[str, Callable[[bytes, Spelling], Any]] = field(default_factory=dict)
    spelling: Spelling = spell_keyword
    _turns: dict[str, threading.Lock] = field(
        default_factory=lambda: defaultdict(threading.Lock), init=False
    )

    @contextmanager
    def take_turn(self, name: str) -> Iterator[None]:
        """Refuse a second body at one address at a time: parsed, each takes a hundred megabytes."""
        turn = self._turns[name]
        if not turn.acquire(blocking=False):
            raise make_busy_error()
        try:
            yield
        finally:
            turn.release()


Edit = Callable[[ProgressListener], Any]
"""Applies what was sent and writes the outputs; what it returns, its session lists as rows."""


@dataclass(frozen=True, slots=True)
class JobStatus:
    """What is known of the last edit.

    Attributes
    ----------
    job : int
        Its number, from 1; 0 before the first.
    state : str
        "idle" before the first edit, then "running", "done" or "failed".
    stage : str
        What it does: "open", "pose", "edit" or "write".
    done, total : int
        Frames of that.
    rows : tuple of (label, text)
        What came of it, as `cageik pose` prints it.
    written : tuple of str
        Files that were written.
    error : str
        Why it failed.
    """

    job: int = 0
    state: str = "idle"
    stage: str = ""
    done: int = 0
    total: int = 0
    rows: tuple[tuple[str, str], ...] = ()
    written: tuple[str, ...] = ()
    error: str = ""


class JobBoard:
    """Holds the edit that is to be done or runs; a second one is refused."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._status = JobStatus()
        self._waiting: Edit | None = None

    @property
    def status(self) -> JobStatus:
        """What is known of the last edit."""
        with self._changed:
            return self._status

    def submit(self, edit: Edit) -> int | None:
        """Take an edit, and return its number; None while another one runs."""
        with self._changed:
            if self._status.state == "running":
                return None
            self._waiting = edit
            self._status = JobStatus(job=self._status.job + 1, state="running")
            self._changed.notify_all()
            return self._status.job

    def wait(self, seconds: float) -> Edit | None:
        """Wait for the next edit; None if there is none for so long."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None, seconds)
            edit, self._waiting = self._waiting, None
            return edit

    def change(self, **values: object) -> None:
        """Change what is known of the edit that runs."""
        with self._changed:
            self._status = replace(self._status, **values)  # type: ignore[arg-type]
