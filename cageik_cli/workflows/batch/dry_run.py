"""What a batch would do, without doing it."""

from collections.abc import Iterator

from cageik_cli.store.result import checkpoint_path
from cageik_cli.util.errors import CageikError
from cageik_cli.util.text import format_block
from cageik_cli.workflows.batch.jobs import ClipJob
from cageik_cli.workflows.batch.run import BatchPlan
from cageik_cli.workflows.extract import plan_extraction

FAULT_LABEL = "would fail"


def dry_run_lines(batch: BatchPlan) -> Iterator[str]:
    """A few lines a clip: what it is, its cage, where its result would be and what is there."""
    rejected = {entry.name: entry.fault for entry in batch.rejected}
    jobs = {job.name: job for job in batch.jobs}
    failing = 0
    for name in batch.order:
        rows = (
            [(FAULT_LABEL, str(rejected[name]))] if name in rejected else _describe_job(jobs[name])
        )
        failing += rows[0][0] == FAULT_LABEL
        yield format_block(name, rows)
    yield f"{len(batch.order)} clips, of which {failing} would fail at once"


def _describe_job(job: ClipJob) -> list[tuple[str, str]]:
    settings = job.settings
    try:
        inputs, existing = plan_extraction(settings)
    except CageikError as error:
        return [(FAULT_LABEL, str(error))]
    if existing is not None:
        state = "is whole and unchanged, and stays"
    elif checkpoint_path(settings.output).exists():
        state = "has been begun"
    elif settings.output.exists():
        state = "would be replaced"
    else:
        state = "would be new"
    vertices = len(inputs.sequence.first.vertices)
    return [
        ("frames", f"{len(inputs.sequence)} of {vertices} vertices, {inputs.sequence.names[0]} on"),
        ("cage", str(settings.cage or settings.binding)),
        ("result", f"{settings.output}, {state}"),
    ]
