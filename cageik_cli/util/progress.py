"""Who is told how a run goes on."""

from contextlib import AbstractContextManager, nullcontext


class ProgressListener:
    """Told what a run does; this one keeps quiet."""

    def stage(self, name: str) -> AbstractContextManager[object]:
        """Entered while the stage `name` runs."""
        return nullcontext()

    def update(self, done: int, total: int) -> None:
        """Called as the work of the current stage, or the frames of the run, go on."""

    def note(self, topic: str, text: str) -> None:
        """Called with what is worth knowing of this run, and no part of what it makes."""
