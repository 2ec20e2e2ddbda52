"""Pose a model in its cage by the handles of a file."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.base.files import file_suffix, hash_file
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.open import clip_suffixes, load_mesh, mesh_suffixes
from cageik_cli.formats.ply_points import place_positions
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.posing.edits import (
    CageSkin,
    EditTarget,
    Layer,
    PosingSettings,
    build_layers,
    edit_frames,
)
from cageik_cli.posing.handles.model import Handles
from cageik_cli.posing.handles.reader import read_handles
from cageik_cli.posing.snapshot import PoseResult, take_snapshot
from cageik_cli.posing.summary import PoseStatistics
from cageik_cli.store.binding_file import read_binding
from cageik_cli.util.arrays import DEFAULT_MEMORY, Floats
from cageik_cli.util.errors import FileAccessError, SettingError, error_context
from cageik_cli.util.outputs import check_no_overlap, write_bytes
from cageik_cli.util.progress import ProgressListener, label_note
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.bind import WeightSettings, bind_cached
from cageik_cli.workflows.model_file import LoadedModel, load_model
from cageik_cli.workflows.move_points import (
    fill_rows,
    find_oriented,
    note_faults,
    prepare_motion,
)
from cageik_cli.workflows.repair_hint import suggest_repair
from cageik_cli.workflows.settings import READ, WRITTEN, CommandSettings


@dataclass(frozen=True, slots=True)
class PoseSettings(CommandSettings):
    """Which model to pose, and where to write it.

    Attributes
    ----------
    target : Path
        A rest model, or a binding file.
    output : Path
        The posed model: .obj or .ply.
    cage : Path, optional
        Needed for a rest model.
    cage_output : Path, optional
        The posed cage: .obj or .ply.
    """

    target: Path = field(metadata=READ)
    handles: Path = field(metadata=READ)
    output: Path = field(metadata=WRITTEN)
    cage: Path | None = field(default=None, metadata=READ)
    cage_output: Path | None = field(default=None, metadata=WRITTEN)
    posing: PosingSettings = field(default_factory=PosingSettings)
    weights: WeightSettings = field(default_factory=WeightSettings)
    overwrite: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class NamedHandles:
    """The handles of a file.

    Attributes
    ----------
    path : Path
        The file, for messages.
    sha256 : str
        Digest of the file, in hexadecimal digits.
    """

    path: Path
    handles: Handles
    sha256: str


def read_named_handles(path: Path) -> NamedHandles:
    """Read a handles file, and its digest.

    Raises
    ------
    InputError
        As `read_handles`.
    """
    return NamedHandles(path, read_handles(path), hash_file(path).hex())


def pose(settings: PoseSettings, progress: ProgressListener | None = None) -> PoseResult:
    """Pose a model by handles, and write it.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the weights cannot be trusted, or hard handles cannot all be met.
    """
    progress = progress or ProgressListener()
    check_target_kind(settings.target, "to edit an animation")
    with progress.stage("open"):
        model = _load_model(settings)
        _check_outputs(settings)
        handles = read_named_handles(settings.handles)
    with progress.stage("bind"):
        target = _load_target(settings, model, progress)
        binding = target.binding
    with progress.stage("pose"):
        posed = pose_model(binding, handles, settings.posing)
    report_layer_notes(posed.layers, settings.handles, progress)
    with progress.stage("write"):
        _write_model(settings, target, posed, progress)
        if settings.cage_output is not None:
            write_mesh(settings.cage_output, binding.cage, posed.cage, settings.overwrite)
    return posed.result


@dataclass(frozen=True, slots=True, eq=False)
class PosedModel:
    """A model that was posed.

    Attributes
    ----------
    mesh : (m, 3) float64
    cage : (n, 3) float64
    """

    mesh: Floats
    cage: Floats
    layers: list[Layer]
    result: PoseResult


def pose_model(binding: Binding, handles: NamedHandles, posing: PosingSettings) -> PosedModel:
    """Pose a model in its cage by handles.

    Raises
    ------
    HandlesError, NumericalError
        Naming the file of the handles, as `pose`.
    """
    cage = binding.cage.vertices
    target = EditTarget(
        binding, CageSkin.for_rest_pose(binding), lambda _: cage, None, Scene().up_axis
    )
    # One thread: the last digits depend on how many.
    with error_context(handles.path), limit_blas_threads(1):
        layers = build_layers(handles.handles, target, posing)
        block = edit_frames(layers, target, np.zeros(1, np.int64), cage[None])
    statistics = PoseStatistics(layers, binding.rest)
    statistics.update(block)
    summary = statistics.summarize([])
    result = PoseResult(summary, take_snapshot(layers, target, block, summary))
    return PosedModel(block.meshes_after[0], block.edit.cages[0], layers, result)


def report_layer_notes(layers: Sequence[Layer], handles: Path, progress: ProgressListener) -> None:
    """Note how handles were understood."""
    for layer in layers:
        for note in layer.schedule.notes:
            progress.note("note", f"{handles.name}: {note}")


@dataclass(frozen=True, slots=True, eq=False)
class _Target:
    """What is posed: a model in its cage, and its file unless a binding file holds it."""

    binding: Binding
    file: LoadedModel | None = None


def _write_model(
    settings: PoseSettings, target: _Target, posed: PosedModel, progress: ProgressListener
) -> None:
    """Write the posed mesh, points or splats."""
    path, file = settings.output, target.file
    if file is None or file.points is None:
        write_mesh(path, target.binding.rest, posed.mesh, settings.overwrite)
        return
    rows, note = file.points.rows.copy(), file.note(progress)
    oriented = find_oriented(file, target.binding, note)
    if oriented is None:
        place_positions(rows, posed.mesh)
    else:
        jobs = settings.weights.jobs
        with error_context(settings.target):
            motion = prepare_motion(target.binding, oriented, DEFAULT_MEMORY, jobs, progress)
        with limit_blas_threads(1):
            faults = fill_rows(motion, rows[None], posed.cage[None], jobs)
        note_faults(faults, motion, len(rows), note)
    with error_context(path):
        data = file.points.encode(rows)
    write_bytes(path, data, settings.overwrite)


def _check_outputs(settings: PoseSettings) -> None:
    check_no_overlap(settings.outputs(), settings.inputs())
    for path in settings.outputs():
        check_mesh_output(path, settings.overwrite)


def check_target_kind(target: Path, purpose: str) -> None:
    """Refuse an animation that was not extracted yet.

    Parameters
    ----------
    purpose : str
        Why its result is needed.

    Raises
    ------
    FileAccessError
        Naming the file and what to do.
    """
    of_models = {*mesh_suffixes(), *HDF5_SUFFIXES}
    if target.is_dir() or file_suffix(target) in {*clip_suffixes()} - of_models:
        what = "a folder" if target.is_dir() else f"a clip (`{file_suffix(target)}`)"
        raise FileAccessError(
            f"{target}: is {what}, expected a model, a binding or a result; {purpose}, run cageik "
            "extract first and name its result"
        )


def _load_model(settings: PoseSettings) -> LoadedModel | None:
    """Read the model, which decides what the output can be; None if a binding file holds it."""
    if settings.target.suffix.lower() in HDF5_SUFFIXES:
        return None
    if settings.cage is None:
        raise SettingError(f"{settings.target}: is a model without a cage; give one with --cage")
    model = load_model(settings.target)
    model.check_posed_output(settings.output)
    return model


def _load_target(
    settings: PoseSettings, model: LoadedModel | None, progress: ProgressListener
) -> _Target:
    """Read the binding file that is named, or bind the model to the cage."""
    if model is None or settings.cage is None:
        return _Target(read_binding(settings.target).binding)
    cage = load_mesh(settings.cage)
    with error_context(settings.cage), suggest_repair(settings.cage, settings.target):
        return _Target(bind_model(model.mesh, cage, settings.weights, progress), model)


def bind_model(
    rest: LoadedMesh, cage: LoadedMesh, weights: WeightSettings, progress: ProgressListener
) -> Binding:
    """Bind a model to a cage, and note what was changed in reading them.

    Raises
    ------
    InputError, NumericalError
        As `bind_cached`.
    """
    binding = bind_cached(rest, cage, weights, progress).binding
    for mesh, notes in ((rest, rest.notes), (cage, binding.notes)):
        for note in notes:
            label, text = label_note(note)
            progress.note(label, f"{mesh.source['name']}: {text}")
    return binding
