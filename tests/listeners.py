"""What tests hear of a run, and how they stop one."""

from cageik_cli.util.progress import ProgressListener


class Listener(ProgressListener):
    """Remembers what it was told; ends the run at one count (done, total), as Ctrl-C does."""

    def __init__(self, stop_at=None):
        self.stop_at = stop_at
        self.stages, self.counts, self.notes = [], [], []

    def stage(self, name):
        self.stages.append(name)
        return super().stage(name)

    def update(self, done, total):
        self.counts.append((done, total))
        if (done, total) == self.stop_at:
            raise KeyboardInterrupt

    def note(self, topic, text):
        self.notes.append((topic, text))
