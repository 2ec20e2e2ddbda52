"""The run: blocks of frames through the solver, measured, into the result file."""

import hashlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.binding import Binding, BindSettings
from cageik_cli.binding_run import WeightSettings, from_file, made
from cageik_cli.dual_laplacian import DualLaplacianSolver, SolveSettings, normalised_weights
from cageik_cli.errors import InputError, located
from cageik_cli.mesh import Floats
from cageik_cli.metrics import measure
from cageik_cli.observer import Observer
from cageik_cli.resuming import forget, going_on, prepare_result, take_up, whole_already
from cageik_cli.scene import Scene, SceneHints
from cageik_cli.sequence import (
    ClipSettings,
    LoadedMesh,
    MeshSequence,
    clip_and_rest,
    load_mesh,
    load_vertex_weights,
)
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.partial import PartialResult, Plan
from cageik_cli.store.result import Result, partial_name, read_result
from cageik_cli.store.result_writer import Header, create, refuse_unsound
from cageik_cli.store.solved_block import solved
from cageik_cli.threads import blas_threads

LARGEST_BLOCK = 16
"""Frames solved together at most; the product gains nothing from more right-hand sides."""

ARRAYS_PER_FRAME = 12
"""Arrays (m, 3) that a frame has at once: read ahead, moved, target, rebuilt, measured."""


@dataclass(frozen=True, slots=True)
class ExtractSettings:
    """What to extract, from what, to where.

    Attributes
    ----------
    frames : tuple of str
        Files, folders and globs, or one file that holds a clip.
    cage : Path, optional
        Needed unless there is a binding.
    output : Path
    binding : Path, optional
        A binding file of this rest pose, and of `cage` if that is given; `bind` then says nothing.
    cache : Path, optional
        The folder of the cache of weights; none is used if absent.
    rest : Path, optional
        The rest pose; a frame of the clip if absent.
    rest_frame : int
        Which frame then, from 0.
    vertex_weights : Path, optional
        One number a vertex of the model.
    bind : BindSettings
    solve : SolveSettings
    clip : ClipSettings
        Which frames of what was named, and how they are to be taken.
    overwrite, keep_weights : bool
    resume : bool
        Go on where an interrupted run of the same plan ended; begin if there is none.
    on_bad_frame : str
        "stop", or "skip": leave a gap for a frame that cannot be read, and say so.
    scene : SceneHints
        Time and space, where they are not to be as the clip's files say.
    memory : int
        Bytes that the weights and blocks of frames may take.
    jobs : int
        Threads.
    """

    frames: tuple[str, ...]
    cage: Path | None
    output: Path
    binding: Path | None = None
    cache: Path | None = None
    rest: Path | None = None
    rest_frame: int = 0
    vertex_weights: Path | None = None
    bind: BindSettings = field(default_factory=BindSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    clip: ClipSettings = field(default_factory=ClipSettings)
    overwrite: bool = False
    resume: bool = False
    on_bad_frame: str = "stop"
    keep_weights: bool = True
    scene: SceneHints = field(default_factory=SceneHints)
    memory: int = 1 << 30
    jobs: int = 1


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
        inputs = _opened(settings)
    sequence = inputs.sequence
    with watch.stage("bind"):
        bound = _bound(inputs, settings, watch)
    sources = inputs.sources | bound.sources
    # One thread: the matrix is small, and threads that wait for each other take longer.
    with watch.stage("factor"), blas_threads(1):
        solver = DualLaplacianSolver(bound.binding, settings.solve, inputs.vertex_weights)
    header = _header(settings, inputs, bound, solver)
    plan = _plan(settings, header, sources, inputs.vertex_weights)
    log = partial_name(settings.output)
    if settings.resume and not settings.overwrite:
        with watch.stage("read"):
            result = whole_already(settings.output, header, sequence, sources)
        if result is not None:
            forget(log, plan)
            watch.remark("resumed", "the result is whole already")
            return result
    # One thread for the products: the others read ahead, which is most of the work.
    with going_on(log, plan, settings.resume) as partial, blas_threads(1):
        with watch.stage("read"):
            keep_gaps = settings.on_bad_frame == "skip"
            take_up(partial, sequence, keep_gaps, settings.jobs, watch)
        _solve_all(sequence, solver, partial, settings, watch)
        with watch.stage("write"):
            _compose(partial, header, sources | {"frames": sequence.source()}, settings)
    return read_result(settings.output)


def block_size(memory: int, vertices: int, cage_vertices: int) -> int:
    """Frames to a block, such that weights and blocks take no more than `memory` bytes."""
    left = memory - 8 * vertices * cage_vertices
    return int(np.clip(left // (ARRAYS_PER_FRAME * 24 * vertices), 1, LARGEST_BLOCK))


@dataclass(frozen=True, slots=True, eq=False)
class _Inputs:
    """What was read before the first frame is solved."""

    sequence: MeshSequence
    rest: LoadedMesh
    cage: LoadedMesh | None
    vertex_weights: Floats | None
    sources: dict[str, Any]


def _opened(settings: ExtractSettings) -> _Inputs:
    sequence, rest = clip_and_rest(
        settings.frames, settings.clip, settings.rest, settings.rest_frame
    )
    cage = load_mesh(settings.cage) if settings.cage is not None else None
    if settings.vertex_weights is None:
        return _Inputs(sequence, rest, cage, None, {})
    loaded, source = load_vertex_weights(settings.vertex_weights)
    with located(settings.vertex_weights):
        weights = normalised_weights(loaded, len(rest.mesh.vertices))
    return _Inputs(sequence, rest, cage, weights, {"vertex_weights": source})


def _bound(inputs: _Inputs, settings: ExtractSettings, watch: Observer) -> StoredBinding:
    rest, cage = inputs.rest, inputs.cage
    if settings.binding is not None:
        bound = from_file(settings.binding, rest, cage)
        watch.advance(len(rest.mesh.vertices), len(rest.mesh.vertices))
        return bound
    if cage is None:
        raise InputError("neither a cage nor a binding is given, expected one of them")
    with located(settings.cage):
        how = WeightSettings(settings.bind, settings.cache, settings.jobs)
        return made(rest, cage, how, watch)


def _header(
    settings: ExtractSettings, inputs: _Inputs, bound: StoredBinding, solver: DualLaplacianSolver
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


def _plan(
    settings: ExtractSettings,
    header: Header,
    sources: dict[str, Any],
    vertex_weights: Floats | None,
) -> Plan:
    binding = header.binding
    arrays = [binding.rest.vertices, binding.rest.faces, binding.cage.vertices, binding.cage.faces]
    arrays += [binding.weights] if vertex_weights is None else [binding.weights, vertex_weights]
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return Plan(
        frames=list(header.frames),
        settings=header.settings,
        sources=sources,
        key=digest.hexdigest(),
        cage_vertices=len(binding.cage.vertices),
        block=block_size(settings.memory, *binding.weights.shape),
    )


def _solve_all(
    sequence: MeshSequence,
    solver: DualLaplacianSolver,
    partial: PartialResult,
    settings: ExtractSettings,
    watch: Observer,
) -> None:
    """Solve and measure every frame that the log does not hold yet."""
    blocks = sequence.blocks(partial.plan.block, settings.jobs, partial.done)
    while True:
        with watch.stage("read"):
            block = next(blocks, None)
        if block is None:
            return
        if settings.on_bad_frame == "stop":
            block.refuse_faults()
        with watch.stage("solve"):
            solution = solver.solve(block.positions)
        with watch.stage("measure"):
            rest, counted = solver.binding.rest, solver.counted
            figures = measure(rest, block.positions, solution.reconstructions, counted)
        refuse_unsound(block.start, solution.cages, figures)
        with watch.stage("write"):
            stamps = tuple(map(sequence.stamp, range(block.start, block.stop)))
            partial.append(solved(block, solution.cages, figures, stamps))
        watch.advance(block.stop, len(sequence))


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
