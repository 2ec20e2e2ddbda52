"""What a run reports while it goes: its progress, and notes, some of which are warnings."""

from contextlib import AbstractContextManager, nullcontext

WARNING_MARK = "warning: "
"""Begins a note that is a warning."""


class ProgressListener:
    """Receives the progress of a run; this one ignores it."""

    def stage(self, name: str) -> AbstractContextManager[object]:
        """Return a context that is entered while the stage `name` runs."""
        return nullcontext()

    def update(self, done: int, total: int) -> None:
        """Take how much of the current stage, or of the frames, is done."""

    def note(self, topic: str, text: str) -> None:
        """Take a note on the run for the user."""


def ignore_progress(done: int, total: int) -> None:
    """Ignore how much of a computation is done."""


def mark_warning(sentence: str) -> str:
    """Return a note that is a warning."""
    return WARNING_MARK + sentence


def locate_note(name: str, note: str) -> str:
    """Return a note with the name of the file that it is about."""
    label, text = label_note(note)
    located = f"{name}: {text}"
    return located if label == "note" else mark_warning(located)


def label_note(note: str) -> tuple[str, str]:
    """Return the label of a note, `note` or `warning`, and its text."""
    if note.startswith(WARNING_MARK):
        return "warning", note.removeprefix(WARNING_MARK)
    return "note", note
