"""Cages of a result, or of a clip, applied to a model at rest or to another mesh in the cage."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cageik_cli.cages.enclosure import OutsideError
from cageik_cli.coordinates.binding import FRAMES_PER_PRODUCT, Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.base.mesh_data import LoadedMesh, check_vertex_order
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings, MorphSettings, SceneHints
from cageik_cli.formats.write import ExportSummary, Output, write_animation
from cageik_cli.geometry.oriented import Oriented
from cageik_cli.store import result_frames
from cageik_cli.store.result import Result
from cageik_cli.util.arrays import DEFAULT_MEMORY, Floats, fit_frames
from cageik_cli.util.errors import SettingError, error_context, join_truncated
from cageik_cli.util.outputs import check_no_overlap
from cageik_cli.util.progress import ProgressListener, label_note
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.bind import WeightSettings, bind_cached
from cageik_cli.workflows.cage_source import CageSource
from cageik_cli.workflows.export import report_skipped_frames
from cageik_cli.workflows.model_file import LoadedModel, load_model
from cageik_cli.workflows.move_points import find_oriented, move_frames, prepare_motion
from cageik_cli.workflows.reconstruction import Block, CageFrames, Reconstruction
from cageik_cli.workflows.rig import check_influences, make_rig
from cageik_cli.workflows.settings import READ, READ_CLIP, WRITTEN, CommandSettings

NO_CAGES = "which has no cages; give them by --cages, or give a result"

MAX_BLOCK_FRAMES = 16
"""Frames per block at most; more is not faster."""

ARRAYS_PER_FRAME = 4
"""Arrays (m, 3) per frame at once: in the two blocks, moved to the origin, in the writer."""


@dataclass(frozen=True, slots=True)
class DeformSettings(CommandSettings):
    """Which mesh to deform by which cages, and where to write it.

    Attributes
    ----------
    source : Path
        A result, or a binding, which needs `cages`.
    mesh : Path, optional
        Bound to the rest cage; the rest model if absent.
    coordinates, accuracy, outside : str, optional
        As in `BindSettings`; those of the source if absent.
    cages : str, optional
        A clip of cages to use instead of those of the result.
    clip : ClipSettings
        How that clip is read.
    scene : SceneHints
        Time and space, where they differ from those of the clip or the source.
    cache : Path, optional
        The folder of the weight cache; none is used if absent.
    memory : int
        Bytes for the weights and blocks of frames.
    jobs : int
        Threads.
    influences : int, optional
        Cage vertices that move each vertex, at most, with weights that are fitted again to the
        motion of the mesh; the weights that it has if absent.
    compares : bool
        Note the error of other numbers of influences, too.
    morphs : MorphSettings
        How morph targets follow the mesh, in a format that has them.
    """

    source: Path = field(metadata=READ)
    output: Output = field(metadata=WRITTEN)
    mesh: Path | None = field(default=None, metadata=READ)
    coordinates: str | None = None
    accuracy: str | None = None
    outside: str | None = None
    cages: str | None = field(default=None, metadata=READ_CLIP)
    clip: ClipSettings = field(default_factory=ClipSettings)
    scene: SceneHints = field(default_factory=SceneHints)
    cache: Path | None = None
    memory: int = DEFAULT_MEMORY
    jobs: int = 1
    influences: int | None = None
    compares: bool = False
    morphs: MorphSettings = field(default_factory=lambda: MorphSettings(has_normals=True))


def deform(settings: DeformSettings, progress: ProgressListener | None = None) -> ExportSummary:
    """Write the animation of the mesh that the cages move.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the weights cannot be trusted.
    """
    progress = progress or ProgressListener()
    given = None if settings.mesh is None else _load_model(settings.mesh, settings)
    output = settings.output if given is None else given.choose_output(settings.output)
    check_no_overlap(output.list_paths(), settings.inputs())
    output.check_writable()
    source = CageSource.read(settings.source)
    if settings.influences is not None:
        result = source.require_result("but --influences needs the settings of a result; give one")
        check_influences(result, settings.influences)
    clip = _open_cage_clip(settings, source, progress)
    model = given or LoadedModel(source.rest_model)
    binding = _load_or_compute_binding(settings, model.mesh, source, progress)
    if clip is None:
        result = source.require_result(NO_CAGES)
        report_skipped_frames(result, progress)
        cages, scene = CageFrames.from_result(result), result.scene
    else:
        cages = CageFrames.from_clip(clip, settings.jobs)
        scene = clip.scene.override(source.scene)
    animation = Animation(
        rest=binding.rest,
        frame_count=cages.count,
        scene=settings.scene.override(scene),
        name=_make_object_name(settings.mesh),
        morphs=settings.morphs,
    )
    # One thread per product: the last digits depend on how many.
    with limit_blas_threads(1):
        factory = model.choose_writer(output)
        oriented = find_oriented(model, binding, model.note(progress)) if factory else None
        motion = _Motion(model, binding, cages, oriented)
        frames = _move_model(settings, source, motion, progress)
        summary = write_animation(output, animation, frames, progress, factory)
    return replace(summary, parts=model.parts)


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """A model, its weights, the cages that move it, and what turns with its points."""

    model: LoadedModel
    binding: Binding
    cages: CageFrames
    oriented: Oriented | None


def _load_model(path: Path, settings: DeformSettings) -> LoadedModel:
    """Read the model that is moved instead of the one at rest.

    Raises
    ------
    SettingError
        When it has points only, and weights that are fitted to a surface are asked for.
    """
    model = load_model(path)
    if model.points is not None and settings.influences is not None:
        raise SettingError(
            f"{path}: is {model.kind}, and weights of few influences are fitted to a "
            "surface; leave out --influences"
        )
    return model


def _move_model(
    settings: DeformSettings, source: CageSource, motion: _Motion, progress: ProgressListener
) -> Iterator[Any]:
    """Return the frames that the writer of the model takes, in blocks."""
    model, binding, cages = motion.model, motion.binding, motion.cages
    if motion.oriented is not None:
        jobs, rest = settings.jobs, model.make_rest_rows()
        with error_context(settings.mesh):
            held = prepare_motion(binding, motion.oriented, settings.memory, jobs, progress)
        return move_frames(held, rest, cages, jobs, model.note(progress))
    rotations = _read_needed_rotations(settings, source, binding, cages.count)
    target = Reconstruction(binding, cages, rotations)
    if settings.influences is None:
        memory = settings.memory - binding.weights.nbytes
        size = choose_block_size(memory, len(binding.rest.vertices))
        return target.stream_meshes(size, settings.jobs)
    result = source.require_result("but --influences needs the settings of a result")
    blocks = _limit_influences(settings, result, target, progress)
    return (block.meshes for block in blocks)


def _limit_influences(
    settings: DeformSettings, result: Result, target: Reconstruction, progress: ProgressListener
) -> Iterator[Block]:
    """Yield the frames that few influences give, fitted to the motion of the mesh."""
    rig = make_rig(
        result,
        target,
        progress,
        influences=settings.influences,
        name=settings.output.path.name,
        compares=settings.compares,
        memory=settings.memory,
        jobs=settings.jobs,
    )
    return rig.blocks()


def _read_needed_rotations(
    settings: DeformSettings, source: CageSource, binding: Binding, count: int
) -> Floats | None:
    """Read the rotations of the rest pose to each of `count` frames, if the weights need them."""
    if not binding.has_offsets:
        return None
    result = source.require_result(
        "with weights of few influences, which turn with the frames of a clip; give a result of "
        "that clip"
    )
    if count != len(result.frames):
        raise SettingError(
            f"{settings.cages}: has {count} cages, expected {len(result.frames)} as the result, "
            "whose weights have few influences: they turn with its frames; give as many cages"
        )
    return result_frames.read_rotations(result)


def choose_block_size(memory: int, vertices: int) -> int:
    """Return how many frames, in whole groups, fit into `memory` bytes; one group at least."""
    groups = fit_frames(memory, vertices * FRAMES_PER_PRODUCT, ARRAYS_PER_FRAME)
    return FRAMES_PER_PRODUCT * min(groups, MAX_BLOCK_FRAMES // FRAMES_PER_PRODUCT)


def _open_cage_clip(
    settings: DeformSettings, source: CageSource, progress: ProgressListener
) -> MeshSequence | None:
    """Open the clip of cages, if one is given, which has the connectivity of the source's.

    Raises
    ------
    InputError
        When it cannot be read, or none is given and the source has no cages.
    """
    if settings.cages is None:
        source.require_result(NO_CAGES)
        return None
    clip = open_sequence([settings.cages], settings.clip, source.rest_cage)
    with error_context(settings.cages):
        check_vertex_order(clip.first, source.cage, source.cage_name)
    for note in clip.notes:
        progress.note("note", note)
    if clip.missing:
        names = join_truncated((clip.names[k] for k in sorted(clip.missing)), 5)
        progress.note("note", f"{len(clip.missing)} cages are missing ({names}) and interpolated")
    return clip


def _load_or_compute_binding(
    settings: DeformSettings, mesh: LoadedMesh, source: CageSource, progress: ProgressListener
) -> Binding:
    """Return the weights of the source if they fit the settings; else bind the mesh to the cage."""
    bind_settings = BindSettings(
        settings.coordinates or source.bind.coordinates,
        settings.accuracy or source.bind.accuracy,
        settings.outside or source.bind.outside,
    )
    is_own = settings.mesh is None and bind_settings == source.bind
    held = source.read_binding() if is_own else None
    if held is not None:
        return held
    weight_settings = WeightSettings(
        bind_settings, settings.cache, settings.jobs, is_own_cage=settings.mesh is None
    )
    with progress.stage("bind"), error_context(settings.mesh or settings.source), _suggest_moving():
        binding = bind_cached(mesh, source.rest_cage, weight_settings, progress).binding
    for note in mesh.notes + binding.notes:
        label, text = label_note(note)
        progress.note(label, f"{mesh.source['name']}: {text}")
    return binding if source.fit is None else _apply_fit(binding, source, is_own, progress)


def _apply_fit(
    binding: Binding, source: CageSource, is_own: bool, progress: ProgressListener
) -> Binding:
    """Return a binding of computed weights with what a fit has changed, where it can be known.

    Raises
    ------
    SettingError
        When the weights of the source are fitted, not in it, and wanted.
    """
    if is_own:
        result = source.require_result("which holds its weights")
        change = result_frames.read_low_rank(result)
        if change is not None:
            return replace(binding, weights=change.add_to(binding.weights))
        raise SettingError(
            f"{source.path}: its weights are fitted to a clip and not in it, so they cannot be "
            "computed again; extract it again without --no-weights, or with --fit-rank"
        )
    progress.note(
        "note",
        f"the cages of {source.path.name} are for weights that were fitted to its model; this mesh "
        f"has {binding.settings.coordinates} weights, which follow them less closely",
    )
    return binding


@contextmanager
def _suggest_moving() -> Iterator[None]:
    """Say what to do with a mesh that is outside the cage, which is not made for it."""
    try:
        yield
    except OutsideError as error:
        if error.placement is None:
            raise
        remedy = "move it into the rest cage"
        if not error.placement.is_misplaced:
            remedy += ", or take the nearest points of the cage with --outside project"
        raise OutsideError(f"{error.placement.describe_outside()}; {remedy}") from error


def _make_object_name(mesh: Path | None) -> str:
    """Return the name of the mesh in letters that all formats accept."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", mesh.stem) if mesh is not None else "mesh"
    return f"_{name}" if name[0].isdigit() else name
