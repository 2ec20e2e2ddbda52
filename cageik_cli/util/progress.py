"""What a run reports while it goes: its progress, and notes."""

from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext

from cageik_cli.util.messages import Note, Said


class ProgressListener:
    """Receives the progress of a run; this one ignores it."""

    def stage(self, name: str) -> AbstractContextManager[object]:
        """Return a context that is entered while the stage `name` runs."""
        return nullcontext()

    def update(self, done: int, total: int) -> None:
        """Take how much of the current stage, or of the frames, is done."""

    def note(self, topic: str, text: Said) -> None:
        """Take a note on the run for the user."""


def ignore_progress(done: int, total: int) -> None:
    """Ignore how much of a computation is done."""


def note_all(progress: ProgressListener, notes: Iterable[Note], place: str = "") -> None:
    """Report notes, in a place if one is given."""
    for note in notes:
        progress.note(*(note.at(place) if place else note).row)
