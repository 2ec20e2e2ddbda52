"""The one edit that runs at a time, and what is known of it: shared by all threads."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import Condition

from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.view.session import Edit


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


class BoardProgress(ProgressListener):
    """Puts the progress of an edit on the board, and passes it on.

    Attributes
    ----------
    notes : list of (topic, text)
    """

    def __init__(self, board: JobBoard, inner: ProgressListener) -> None:
        self._board, self._inner = board, inner
        self.notes: list[tuple[str, str]] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Put the stage on the board."""
        self._board.change(stage=name)
        with self._inner.stage(name):
            yield

    def update(self, done: int, total: int) -> None:
        """Put the frames on the board."""
        self._board.change(done=done, total=total)
        self._inner.update(done, total)

    def note(self, topic: str, text: str) -> None:
        """Keep a note, and pass it on."""
        self.notes.append((topic, text))
        self._inner.note(topic, text)
