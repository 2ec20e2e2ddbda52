"""Pose a model in its cage by the handles and the cage edits of files."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.editing.cage_edits import EditFiles
from cageik_cli.editing.edit_target import EditTarget
from cageik_cli.editing.edits import LayeredEdit, PosingSettings
from cageik_cli.editing.statistics import PoseStatistics
from cageik_cli.editing.summary import PoseResult, take_snapshot
from cageik_cli.formats.ply_points import place_positions
from cageik_cli.formats.settings import SceneHints
from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.inputs.model_file import LoadedModel, PointReconstruction, load_model
from cageik_cli.inputs.weights import WeightSettings
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import DEFAULT_MEMORY
from cageik_cli.util.errors import FileAccessError, SettingError, error_context
from cageik_cli.util.outputs import check_no_overlap, write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.settings import READ, WRITTEN, CommandSettings


@dataclass(frozen=True, slots=True)
class PoseSettings(CommandSettings):
    """Which model to pose, and where to write it.

    Attributes
    ----------
    target : Path
        A rest model, or a binding file.
    handles, cage_edits : Path, optional
        One of them at least.
    output : Path
        The posed model: .obj or .ply.
    cage : Path, optional
        Needed for a rest model.
    given_in : SceneHints
        Unit and up axis of the cage, in place of what its file states.
    cage_output : Path, optional
        The posed cage: .obj or .ply.
    exclude : tuple of str
        Patterns of parts of a rest model that are left out.
    """

    target: Path = field(metadata=READ)
    handles: Path | None = field(metadata=READ)
    output: Path = field(metadata=WRITTEN)
    cage: Path | None = field(default=None, metadata=READ)
    cage_output: Path | None = field(default=None, metadata=WRITTEN)
    posing: PosingSettings = field(default_factory=PosingSettings)
    weights: WeightSettings = field(default_factory=WeightSettings)
    overwrite: bool = False
    given_in: SceneHints = field(default_factory=SceneHints)
    exclude: tuple[str, ...] = ()
    cage_edits: Path | None = field(default=None, metadata=READ)


def pose(settings: PoseSettings, progress: ProgressListener | None = None) -> PoseResult:
    """Pose a model by handles and cage edits, and write it."""
    progress = progress or ProgressListener()
    check_target_kind(settings.target, "to edit an animation")
    with progress.stage("open"):
        target = CagedModel.open(
            settings.target,
            settings.cage,
            given_in=settings.given_in,
            load=partial(load_model, exclude=settings.exclude),
        )
        if target.cage is None:
            raise SettingError(f"{target.path}: is a model without a cage; give one with `cage=`")
        target.model.check_posed_output(settings.output)
        check_no_overlap(settings.outputs(), settings.inputs())
        for path in settings.outputs():
            check_mesh_output(path, settings.overwrite)
        files = EditFiles.read(settings.handles, settings.cage_edits)
    binding = target.bind(settings.weights, progress)
    with progress.stage("pose"):
        posed = pose_model(binding, files, settings.posing, progress)
    with progress.stage("write"):
        if target.model.points is None:
            write_mesh(settings.output, binding.rest, posed.snapshot.after, settings.overwrite)
        else:
            rows = _move_points(target.model, binding, posed, settings, progress)
            with error_context(settings.output):
                data = target.model.points.encode(rows)
            write_bytes(settings.output, data, settings.overwrite)
        if settings.cage_output is not None:
            write_mesh(
                settings.cage_output, binding.cage, posed.snapshot.cage_after, settings.overwrite
            )
    return posed


def _move_points(
    model: LoadedModel,
    binding: Binding,
    posed: PoseResult,
    settings: PoseSettings,
    progress: ProgressListener,
) -> NDArray[Any]:
    """Return the rows of posed points or splats, (m,)."""
    assert model.points is not None
    rows, note = model.points.rows.copy(), model.note(progress)
    oriented = model.find_oriented(binding, note)
    if oriented is None:
        place_positions(rows, posed.snapshot.after)
        return rows
    jobs = settings.weights.jobs
    with error_context(settings.target):
        moved = PointReconstruction.prepare(
            binding, oriented, memory=DEFAULT_MEMORY, jobs=jobs, progress=progress
        )
    with limit_blas_threads(1):
        moved.fill_rows(rows[None], posed.snapshot.cage_after[None])
    moved.note_faults(len(rows), note)
    return rows


def pose_model(
    binding: Binding, files: EditFiles, posing: PosingSettings, progress: ProgressListener
) -> PoseResult:
    """Pose a model in its cage by an edit, and note how its handles were understood."""
    # One thread: the last digits depend on how many.
    with limit_blas_threads(1):
        edit = LayeredEdit(files, EditTarget.of_model(binding), posing)
        block = edit.edit_frames(np.zeros(1, np.int64), binding.cage.vertices[None])
    report_placement(edit, files, progress)
    statistics = PoseStatistics(edit)
    statistics.update(block)
    summary = statistics.summarize()
    return PoseResult(summary, take_snapshot(edit, block, summary))


def report_placement(edit: LayeredEdit, files: EditFiles, progress: ProgressListener) -> None:
    """Note how handles were understood, and what mirrors the edit."""
    if edit.mirror is not None:
        progress.note("mirror", f"both sides move as mirror images about {edit.mirror}")
    for note in edit.notes:
        assert files.handles is not None
        progress.note("note", f"{files.handles.path.name}: {note}")


def check_target_kind(target: Path, purpose: str) -> None:
    """Refuse a folder of frames, whose animation was not extracted yet.

    Parameters
    ----------
    purpose : str
        Why its result is needed.
    """
    if target.is_dir():
        raise FileAccessError(
            f"{target}: is a folder, expected a model, a binding or a result; {purpose}, run "
            "cageik extract first and name its result"
        )
