"""The jobs of a batch, one per clip, and their outcomes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from cageik_cli.report.limits import Limits
from cageik_cli.report.overview import ClipEntry
from cageik_cli.workflows.settings import ExtractSettings

CLIPS_FOLDER = "clips"
"""The folder of the clips' results, inside the output folder."""


@dataclass(frozen=True, slots=True)
class ClipJob:
    """The work on one clip of a batch.

    Attributes
    ----------
    name : str
        Its path under the folder of the batch, with forward slashes; unique.
    settings : ExtractSettings
        All paths are absolute. With `resume`, an interrupted run is continued; with `overwrite`,
        results of other files or settings are replaced.
    has_page : bool
        Whether a page is written beside the result.
    has_player : bool
        Whether the page plays the clip.
    """

    name: str
    settings: ExtractSettings
    limits: Limits = field(default_factory=Limits)
    has_page: bool = True
    has_player: bool = False


class ClipState(Enum):
    """How a clip ended in this run."""

    DONE = "done"
    UNCHANGED = "unchanged"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a job.

    Attributes
    ----------
    entry : ClipEntry
        What the report over all clips shows; it does not depend on interruptions of the batch.
    """

    entry: ClipEntry
    state: ClipState


class Scheduler(Protocol):
    """Runs jobs; a context manager that leaves no process and no connection behind."""

    def __enter__(self) -> "Scheduler": ...

    def __exit__(self, *error: object) -> None: ...

    def run_jobs(self, jobs: Sequence[ClipJob]) -> Iterator[Outcome]:
        """Yield the outcome of each job, as they end."""
