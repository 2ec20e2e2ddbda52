"""The run: blocks of frames through the solver, measured, into the result file."""

import hashlib
from dataclasses import asdict
from typing import Any

import numpy as np

from cageik_cli.binding import Binding
from cageik_cli.dual_laplacian import DualLaplacianSolver
from cageik_cli.errors import InputError
from cageik_cli.inputs import ExtractSettings, Inputs, bound_of, opened
from cageik_cli.observer import Observer
from cageik_cli.resuming import forget, going_on, prepare_result, take_up, whole_already
from cageik_cli.scene import Scene
from cageik_cli.sequence import LoadedMesh, MeshSequence
from cageik_cli.solving import BlockSolver, Budget
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.partial import PartialResult, Plan
from cageik_cli.store.result import Result, partial_name, read_result
from cageik_cli.store.result_writer import Header, create
from cageik_cli.threads import blas_threads


def extract(settings: ExtractSettings, observer: Observer | None = None) -> Result:
    """Extract the cage of every frame and write the result file.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the system is singular or the weights cannot be trusted.
    """
    watch = observer or Observer()
    prepare_result(settings.output, settings.overwrite, settings.resume)
    with watch.stage("open"):
        inputs = opened(settings)
    with watch.stage("bind"):
        bound = bound_of(inputs, settings, watch)
    # One thread: the matrix is small, and threads that wait for each other take longer.
    with watch.stage("factor"), blas_threads(1):
        solver = DualLaplacianSolver(bound.binding, settings.solve, inputs.vertex_weights)
    sources, sequence = inputs.sources | bound.sources, inputs.sequence
    header = _header(settings, inputs, bound, solver)
    budget = Budget.of(settings.memory, bound.binding, settings.jobs)
    plan = _plan(header, sources, inputs, budget.block)
    log = partial_name(settings.output)
    if settings.resume and not settings.overwrite:
        result = whole_already(settings, header, sequence, sources)
        if result is not None:
            forget(log, plan)
            watch.remark("resumed", "the result is whole already")
            return result
    work = BlockSolver(sequence, solver, settings.on_bad_frame == "skip", watch)
    # One thread for the products: blocks are solved, and frames read, beside each other.
    with going_on(log, plan, settings.resume, settings.overwrite) as partial, blas_threads(1):
        with watch.stage("read"):
            take_up(partial, sequence, work.skip, settings.jobs, watch)
        work.solve_all(partial, budget, settings.jobs)
        with watch.stage("write"):
            _compose(partial, header, sources | {"frames": sequence.source()}, settings)
    return read_result(settings.output)


def _header(
    settings: ExtractSettings, inputs: Inputs, bound: StoredBinding, solver: DualLaplacianSolver
) -> Header:
    return Header(
        binding=bound.binding,
        quality=solver.quality,
        frames=inputs.sequence.names,
        scene=settings.scene.applied(inputs.sequence.scene.applied(Scene())),
        settings=_recorded(settings, bound.binding),
        notes=_notes(inputs.sequence, inputs.rest, bound, solver.missing),
        keep_weights=settings.keep_weights,
    )


def _plan(header: Header, sources: dict[str, Any], inputs: Inputs, block: int) -> Plan:
    binding, weights = header.binding, inputs.vertex_weights
    arrays = [binding.rest.vertices, binding.rest.faces, binding.cage.vertices, binding.cage.faces]
    arrays += [binding.weights] if weights is None else [binding.weights, weights]
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return Plan(
        frames=list(header.frames),
        settings=header.settings,
        sources=sources,
        key=digest.hexdigest(),
        cage_vertices=len(binding.cage.vertices),
        block=block,
    )


def _compose(
    partial: PartialResult, header: Header, sources: dict[str, Any], settings: ExtractSettings
) -> None:
    """Write the result from the log, in one pass."""
    output = settings.output
    beside = output.with_name(f"{output.name}.whole.partial")
    skipped: dict[int, str] = {}
    for block in partial.blocks():
        skipped |= block.faults
    if len(skipped) == len(header.frames):
        raise InputError(f"no frame can be read, the first: {skipped[0]}")
    replaces = settings.overwrite or settings.resume
    with create(output, header, replaces, beside) as result:
        for block in partial.blocks():
            result.append(block.cages, block.figures)
        result.complete(sources, skipped)


def _recorded(settings: ExtractSettings, binding: Binding) -> dict[str, Any]:
    """The settings on which the numbers depend."""
    solve = settings.solve
    return {
        "alpha": solve.alpha,
        "beta": solve.beta,
        "align": solve.align,
        **asdict(binding.settings),
        "rest_frame": settings.rest_frame if settings.rest is None else None,
        "vertex_weights": settings.vertex_weights is not None,
    }


def _notes(
    sequence: MeshSequence, rest: LoadedMesh, bound: StoredBinding, missing: int
) -> tuple[str, ...]:
    cage = bound.sources["cage"]["name"]
    notes = [
        *(f"{cage}: {note}" for note in bound.binding.notes),
        *(f"{rest.source['name']}: {note}" for note in rest.notes),
        *sequence.notes,
    ]
    if not rest.mesh.is_closed:
        holes = np.count_nonzero(~rest.mesh.edges.is_balanced)
        notes.append(
            f"the model is open ({holes} edges without a counterpart), so its volume is not "
            "defined and volume figures are left out"
        )
    elif missing:
        notes.append(
            f"{missing} vertices of weight 0 are missing data, so volumes of frames are not "
            "known and volume figures are left out"
        )
    return tuple(notes)
