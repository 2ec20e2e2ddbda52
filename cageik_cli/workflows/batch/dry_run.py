"""What a batch would do, without doing it."""

from collections.abc import Iterator

from cageik_cli.store.result import partial_name
from cageik_cli.util.errors import CageikError
from cageik_cli.util.text import page
from cageik_cli.workflows.batch.jobs import ClipJob
from cageik_cli.workflows.batch.run import Batch
from cageik_cli.workflows.extract import held_result

FAULT = "would fail"


def listed(batch: Batch) -> Iterator[str]:
    """A few lines a clip: what it is, its cage, where its result would be and what is there."""
    refused = {entry.name: entry.fault for entry in batch.refused}
    jobs = {job.name: job for job in batch.jobs}
    failing = 0
    for name in batch.order:
        rows = [(FAULT, str(refused[name]))] if name in refused else _rows(jobs[name])
        failing += rows[0][0] == FAULT
        yield page(name, rows)
    yield f"{len(batch.order)} clips, of which {failing} would fail at once"


def _rows(job: ClipJob) -> list[tuple[str, str]]:
    settings = job.settings
    try:
        inputs, held = held_result(settings)
    except CageikError as error:
        return [(FAULT, str(error))]
    if held is not None:
        state = "is whole and unchanged, and stays"
    elif partial_name(settings.output).exists():
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
