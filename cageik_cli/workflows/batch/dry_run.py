"""What a batch would do, listed without doing it."""

from dataclasses import dataclass

from cageik_cli.store.result import checkpoint_path
from cageik_cli.util.errors import CageikError
from cageik_cli.util.text import format_block, format_count
from cageik_cli.workflows.batch.jobs import ClipJob
from cageik_cli.workflows.batch.run import BatchPlan
from cageik_cli.workflows.plan import plan_extraction
from cageik_cli.workflows.settings import ExtractSettings

FAULT_LABEL = "would fail"


@dataclass(frozen=True, slots=True)
class DryRun:
    """What a batch would do.

    Attributes
    ----------
    text : str
        A few lines per clip, and the count of those that would fail.
    failing : int
        Clips that would fail.
    """

    text: str
    failing: int


def describe_batch(batch: BatchPlan) -> DryRun:
    """Describe each clip: its frames, its cage, where its result goes and what is there."""
    rejected = {entry.name: [(FAULT_LABEL, str(entry.fault))] for entry in batch.rejected}
    planned = {job.name: _describe_job(job) for job in batch.jobs}
    rows = {name: (rejected | planned)[name] for name in batch.order}
    failing = sum(row[0][0] == FAULT_LABEL for row in rows.values())
    lines = [format_block(name, row) for name, row in rows.items()]
    lines.append(f"{failing} of {format_count(len(rows), 'clip')} would fail")
    return DryRun("\n".join(lines), failing)


def _describe_job(job: ClipJob) -> list[tuple[str, str]]:
    settings = job.settings
    try:
        plan = plan_extraction(settings)
    except CageikError as error:
        return [(FAULT_LABEL, str(error))]
    if plan.existing is not None:
        state = "up to date, nothing to do"
    elif settings.resume and checkpoint_path(settings.output).exists():
        state = "would continue from its checkpoint"
    elif settings.output.exists():
        state = "would be replaced"
    else:
        state = "would be new"
    sequence = plan.sequence
    vertices = len(sequence.first.vertices)
    return [
        ("frames", f"{len(sequence)} of {vertices} vertices, from {sequence.names[0]}"),
        ("cage", _describe_cage(settings)),
        ("result", f"{settings.output}, {state}"),
    ]


def _describe_cage(settings: ExtractSettings) -> str:
    if settings.builds_cage:
        return f"would be built, of {settings.build.vertices} vertices"
    return str(settings.cage or settings.binding)
