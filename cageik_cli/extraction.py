"""The run: blocks of frames through the solver, measured, into the result file."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.binding import Binding, BindSettings
from cageik_cli.binding_run import WeightSettings, from_file, made
from cageik_cli.dual_laplacian import DualLaplacianSolver, SolveSettings, normalised_weights
from cageik_cli.errors import InputError, located
from cageik_cli.mesh import TriMesh
from cageik_cli.metrics import measure
from cageik_cli.observer import Observer
from cageik_cli.outputs import prepare
from cageik_cli.scene import Scene, SceneHints
from cageik_cli.sequence import (
    ClipSettings,
    LoadedMesh,
    MeshSequence,
    load_mesh,
    load_vertex_weights,
    open_sequence,
    refuse_other_connectivity,
)
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import Header, Result, ResultWriter, create, read_result
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
    scene : SceneHints
        Time and space, where they are not to be as the clip's files say.
    memory : int
        Bytes that blocks of frames may take.
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
    prepare(settings.output, settings.overwrite)
    with watch.stage("open"):
        sequence, rest = clip_and_rest(
            settings.frames, settings.clip, settings.rest, settings.rest_frame
        )
        cage = load_mesh(settings.cage) if settings.cage is not None else None
        sources, vertex_weights = {}, None
        if settings.vertex_weights is not None:
            loaded, sources["vertex_weights"] = load_vertex_weights(settings.vertex_weights)
            with located(settings.vertex_weights):
                vertex_weights = normalised_weights(loaded, len(rest.mesh.vertices))
    with watch.stage("bind"):
        bound = _bound(rest, cage, settings, watch)
    binding, sources = bound.binding, sources | bound.sources
    # One thread: the matrix is small, and threads that wait for each other take longer.
    with watch.stage("factor"), blas_threads(1):
        solver = DualLaplacianSolver(binding, settings.solve, vertex_weights)
    header = Header(
        binding=binding,
        quality=solver.quality,
        frames=sequence.names,
        scene=settings.scene.applied(sequence.scene.applied(Scene())),
        settings=_recorded(settings, binding),
        notes=_notes(sequence, rest, bound, solver.missing),
        keep_weights=settings.keep_weights,
    )
    # One thread for the products: the others read ahead, which is most of the work.
    with create(settings.output, header, settings.overwrite) as result, blas_threads(1):
        _solve_all(sequence, solver, result, settings, watch)
        with watch.stage("write"):
            result.complete(sources | {"frames": sequence.source()})
    return read_result(settings.output)


def clip_and_rest(
    frames: tuple[str, ...], how: ClipSettings, path: Path | None, index: int
) -> tuple[MeshSequence, LoadedMesh]:
    """A clip and its rest pose: that of a file, of the clip's connectivity, or a frame of it."""
    rest = load_mesh(path) if path is not None else None
    sequence = open_sequence(list(frames), how, rest)
    if rest is not None:
        with located(path):
            count, faces = len(rest.fanned.vertices), rest.fanned.faces
            refuse_other_connectivity(count, faces, sequence.fanned, "the first frame")
        # Polygons are cut alike in all frames: as in the first.
        return sequence, replace(rest, mesh=TriMesh(rest.mesh.vertices, sequence.first.faces))
    if not 0 <= index < len(sequence):
        raise InputError(
            f"--rest-frame {index}: the clip has {len(sequence)} frames, expected "
            f"0 to {len(sequence) - 1}"
        )
    frame = TriMesh(sequence.frame(index), sequence.first.faces)
    return sequence, LoadedMesh(frame, frame, {"name": sequence.names[index]})


def block_size(memory: int, vertices: int) -> int:
    """Frames to a block, such that blocks take no more than `memory` bytes."""
    return int(np.clip(memory // (ARRAYS_PER_FRAME * 24 * vertices), 1, LARGEST_BLOCK))


def _bound(
    rest: LoadedMesh, cage: LoadedMesh | None, settings: ExtractSettings, watch: Observer
) -> StoredBinding:
    if settings.binding is not None:
        bound = from_file(settings.binding, rest, cage)
        watch.advance(len(rest.mesh.vertices), len(rest.mesh.vertices))
        return bound
    if cage is None:
        raise InputError("neither a cage nor a binding is given, expected one of them")
    with located(settings.cage):
        how = WeightSettings(settings.bind, settings.cache, settings.jobs)
        return made(rest, cage, how, watch)


def _solve_all(
    sequence: MeshSequence,
    solver: DualLaplacianSolver,
    result: ResultWriter,
    settings: ExtractSettings,
    watch: Observer,
) -> None:
    counted = solver.counted
    rest = solver.binding.rest
    blocks = sequence.blocks(block_size(settings.memory, len(rest.vertices)), settings.jobs)
    while True:
        with watch.stage("read"):
            block = next(blocks, None)
        if block is None:
            return
        block.refuse_faults()
        with watch.stage("solve"):
            solution = solver.solve(block.positions)
        with watch.stage("measure"):
            figures = measure(rest, block.positions, solution.reconstructions, counted)
        with watch.stage("write"):
            result.append(solution.cages, figures)
        watch.advance(block.stop, len(sequence))


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
