"""The interface by which a run reports its progress."""

from contextlib import AbstractContextManager, nullcontext


class ProgressListener:
    """Receives the progress of a run; this one ignores it."""

    def stage(self, name: str) -> AbstractContextManager[object]:
        """Return a context that is entered while the stage `name` runs."""
        return nullcontext()

    def update(self, done: int, total: int) -> None:
        """Take how much of the current stage, or of the frames, is done."""

    def note(self, topic: str, text: str) -> None:
        """Take a note on the run for the user."""
