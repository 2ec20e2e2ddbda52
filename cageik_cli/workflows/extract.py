"""The run: blocks of frames through the solver, measured, into the result file."""

import hashlib
from dataclasses import asdict
from typing import Any

import numpy as np

from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.solver.blocks import BlockSolver, Budget, Crew, Threads, told_of
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.checkpoint import PartialResult, Plan, forget
from cageik_cli.store.result import Result, partial_name, read_result
from cageik_cli.store.result_writer import Ending, Header, create
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError
from cageik_cli.util.progress import Observer
from cageik_cli.util.threads import blas_threads
from cageik_cli.workflows.extract_inputs import ExtractSettings, Inputs, bound_of, opened, scene_of
from cageik_cli.workflows.resume import going_on, prepare_result, take_up, whole_already


def extract(
    settings: ExtractSettings,
    observer: Observer | None = None,
    bound: StoredBinding | None = None,
    crew: Crew | None = None,
) -> Result:
    """Extract the cage of every frame and write the result file.

    Parameters
    ----------
    settings : ExtractSettings
    observer : Observer, optional
        Told how it goes on.
    bound : StoredBinding, optional
        The weights, if they are known: of this rest pose, cage and settings.
    crew : Crew, optional
        Who solves the blocks of frames; threads of this process by default.

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
        inputs, held = held_result(settings, bound)
    if held is not None:
        forget(partial_name(settings.output))
        watch.remark("unchanged", "the result is whole already")
        return held
    with watch.stage("bind"):
        bound = bound or bound_of(inputs, settings, watch)
    # One thread: the matrix is small, and threads that wait for each other take longer.
    with watch.stage("factor"), blas_threads(1):
        solver = DualLaplacianSolver(bound.binding, settings.solve, inputs.vertex_weights)
    header = Header(
        binding=bound.binding,
        quality=solver.quality,
        frames=inputs.sequence.names,
        scene=scene_of(settings, inputs),
        settings=_recorded(settings, inputs),
        notes=_notes(inputs, bound, solver.missing),
        keep_weights=settings.keep_weights,
    )
    budget = Budget.of(settings.memory, bound.binding, settings.jobs)
    log, plan = partial_name(settings.output), _plan(header, inputs, budget.block)
    work = BlockSolver(inputs.sequence, solver, settings.on_bad_frame == "skip", watch)
    # One thread for the products: blocks are solved, and frames read, beside each other.
    with going_on(log, plan, settings.resume, settings.overwrite) as partial, blas_threads(1):
        with watch.stage("read"):
            take_up(partial, inputs.sequence, work.skip, settings.jobs, watch)
        starts = range(partial.done, len(inputs.sequence), partial.plan.block)
        with (crew or Threads(settings.jobs)).solving(work, starts, budget) as made:
            for block in made:
                with watch.stage("write"):
                    partial.append(block)
                watch.advance(block.stop, len(inputs.sequence))
        with watch.stage("write"):
            _compose(partial, header, inputs, settings)
    return read_result(settings.output)


def held_result(
    settings: ExtractSettings, bound: StoredBinding | None = None
) -> tuple[Inputs, Result | None]:
    """What a run would be given; and the result, if there is a whole one of just that already.

    Raises
    ------
    InputError
        Naming the file at fault; or when there is another result that may not be overwritten.
    """
    inputs = opened(settings, bound)
    if not settings.resume:
        return inputs, None
    return inputs, whole_already(settings, inputs, _recorded(settings, inputs))


def _plan(header: Header, inputs: Inputs, block: int) -> Plan:
    binding, weights = header.binding, inputs.vertex_weights
    arrays = [binding.rest.vertices, binding.rest.faces, binding.cage.vertices, binding.cage.faces]
    arrays += [binding.weights] if weights is None else [binding.weights, weights]
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return Plan(
        frames=list(header.frames),
        settings=header.settings,
        sources=inputs.sources,
        key=digest.hexdigest(),
        vertices=len(binding.rest.vertices),
        cage_vertices=len(binding.cage.vertices),
        block=block,
    )


def _compose(
    partial: PartialResult, header: Header, inputs: Inputs, settings: ExtractSettings
) -> None:
    """Write the result from the log, which is gone through twice."""
    output = settings.output
    beside = output.with_name(f"{output.name}.whole.partial")
    told = told_of(partial.blocks())
    if len(told.skipped) == len(header.frames):
        raise InputError(f"no frame can be read, the first: {told.skipped[0]}")
    replaces = settings.overwrite or settings.resume
    with create(output, header, replaces, beside) as result:
        posed: dict[int, Floats] = {}
        for block in partial.blocks():
            result.append(block.cages, block.figures)
            posed |= {k: block.cage(k) for k in told.posed if block.start <= k < block.stop}
        misses = [
            _read_again(inputs.sequence, k, told.digests[k]) - header.binding.weights @ posed[k]
            for k in told.posed
        ]
        sources = inputs.sources | {"frames": inputs.sequence.source()}
        result.complete(
            Ending(sources, told.skipped, told.vertex_rms, told.posed, np.array(misses))
        )


def _read_again(sequence: MeshSequence, index: int, digest: bytes) -> Floats:
    """A frame that was solved, unless it is another by now."""
    vertices = sequence.frame(index)
    if sequence.digest(index) != digest:
        raise InputError(
            f"{sequence.place(index)}: changed while the run went on; run again with --resume"
        )
    return vertices


def _recorded(settings: ExtractSettings, inputs: Inputs) -> dict[str, Any]:
    """The settings on which the numbers depend."""
    solve = settings.solve
    return {
        "alpha": solve.alpha,
        "beta": solve.beta,
        "align": solve.align,
        **asdict(inputs.bind_settings(settings)),
        "rest_frame": settings.rest_frame if settings.rest is None else None,
        "vertex_weights": settings.vertex_weights is not None,
    }


def _notes(inputs: Inputs, bound: StoredBinding, missing: int) -> tuple[str, ...]:
    rest = inputs.rest
    cage = bound.sources["cage"]["name"]
    notes = [
        *(f"{cage}: {note}" for note in bound.binding.notes),
        *(f"{rest.source['name']}: {note}" for note in rest.notes),
        *inputs.sequence.notes,
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
