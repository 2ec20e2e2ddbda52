"""What a batch would do, listed without doing it."""

from collections.abc import Iterator

from cageik_cli.store.result import checkpoint_path
from cageik_cli.util.errors import CageikError
from cageik_cli.util.text import format_block
from cageik_cli.workflows.batch.jobs import ClipJob
from cageik_cli.workflows.batch.run import BatchPlan
from cageik_cli.workflows.extract_settings import ExtractSettings
from cageik_cli.workflows.plan import plan_extraction

FAULT_LABEL = "would fail"


def dry_run_lines(batch: BatchPlan) -> Iterator[str]:
    """Yield a few lines per clip: its frames, its cage, where its result goes and what is there."""
    rejected = {entry.name: entry.fault for entry in batch.rejected}
    jobs = {job.name: job for job in batch.jobs}
    failing = 0
    for name in batch.order:
        rows = (
            [(FAULT_LABEL, str(rejected[name]))] if name in rejected else _describe_job(jobs[name])
        )
        failing += rows[0][0] == FAULT_LABEL
        yield format_block(name, rows)
    count = len(batch.order)
    yield f"{failing} of {count} clip{'s' * (count != 1)} would fail"


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
