"""What the tests of the commands share."""

from typing import ClassVar

import pytest

import cageik_cli.cli.batch as command
from cageik_cli.batch.jobs import run_clip


class Here:
    """Does jobs in this process, one after the other, and remembers their names."""

    done: ClassVar[list[str]] = []

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def run_jobs(self, jobs):
        for job in jobs:
            self.done.append(job.name)
            yield run_clip(job)


@pytest.fixture
def here(monkeypatch) -> list[str]:
    """Jobs are done in this process; the names of those that were."""
    monkeypatch.setattr(command, "_choose_scheduler", lambda *options: Here())
    monkeypatch.setattr(Here, "done", [])
    return Here.done
