"""What a batch is to do, and what came of it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from cageik_cli.report.limits import Limits
from cageik_cli.report.overview import ClipEntry
from cageik_cli.workflows.plan import ExtractSettings

CLIPS_FOLDER = "clips"
"""The folder of the clips' results, in the batch's."""


@dataclass(frozen=True, slots=True)
class ClipJob:
    """One clip of a batch.

    Attributes
    ----------
    name : str
        Its path under the folder of the batch, with forward slashes; no other job has it.
    settings : ExtractSettings
        All paths are absolute. `resume` goes on with what this run has left; with `overwrite`,
        results of other files or settings are replaced.
    limits : Limits
    has_page : bool
        Whether a page is written beside the result.
    """

    name: str
    settings: ExtractSettings
    limits: Limits = field(default_factory=Limits)
    has_page: bool = True


class ClipState(Enum):
    """What became of a clip in this run."""

    DONE = "done"
    UNCHANGED = "unchanged"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a job.

    Attributes
    ----------
    entry : Entry
        What the report over all shows; it does not depend on how often the batch was interrupted.
    state : ClipState
    """

    entry: ClipEntry
    state: ClipState


class Scheduler(Protocol):
    """Who does jobs; a context manager, at whose end nothing of it is left."""

    def __enter__(self) -> "Scheduler": ...

    def __exit__(self, *error: object) -> None: ...

    def run_jobs(self, jobs: Sequence[ClipJob]) -> Iterator[Outcome]:
        """What came of each, as they end."""
