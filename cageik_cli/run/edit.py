"""Edit the cage animation of a result or an edit by handles and cage edits, and write an edit.

A model in its cage is posed in the same way, by the handles and the cage edits of files.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.editing.cage_edits import EditFiles
from cageik_cli.editing.edits import EditTarget, LayeredEdit
from cageik_cli.editing.summary import PoseResult, PoseStatistics, take_snapshot
from cageik_cli.formats.base.files import describe_file
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.ply_points import place_positions
from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.inputs.reconstruction import PointReconstruction
from cageik_cli.inputs.source import load_model
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.solve.blocks import SolvedBlock
from cageik_cli.method.solve.metrics import DeviationPeaks, check_finite, map_columns
from cageik_cli.method.solve.summary import summarize_blocks
from cageik_cli.method.weights.binding import Binding, Poses
from cageik_cli.run.executor import choose_block_size
from cageik_cli.run.settings import EditSettings, PoseSettings
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import (
    AnimationWriter,
    Edit,
    open_animation_writer,
    read_animation,
    read_cages,
    read_low_rank,
    read_rotations,
)
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, SettingError, error_context
from cageik_cli.util.messages import Note, say
from cageik_cli.util.outputs import check_no_overlap, check_writable, write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.settings import DEFAULT_MEMORY, describe_settings
from cageik_cli.util.text import single_line, to_unicode
from cageik_cli.util.threads import limit_blas_threads


def edit(
    settings: EditSettings,
    progress: ProgressListener | None = None,
    files: EditFiles | None = None,
) -> PoseResult:
    """Apply the layers of an edit to the cage animation of a result or an edit, and write an edit.

    Frames that no layer acts on keep their cages bit for bit. The metrics of the edit compare its
    meshes with those before it: they tell how far the mesh was moved.

    Parameters
    ----------
    files : EditFiles, optional
        In place of those of the settings.
    """
    return _AnimationEdit(settings, progress or ProgressListener()).run(files)


class _AnimationEdit:
    """The animation of a result on its way to the edited one."""

    def __init__(self, settings: EditSettings, progress: ProgressListener) -> None:
        self._settings, self._progress = settings, progress

    def run(self, files: EditFiles | None) -> PoseResult:
        """Edit, measure and write all frames."""
        settings, progress = self._settings, self._progress
        check_no_overlap(settings.outputs(), settings.inputs())
        check_writable(settings.output, settings.overwrite)
        check_hdf5_suffix(settings.output)
        with progress.stage("open"):
            self._files = files or EditFiles.read(settings.handles, settings.cage_edits)
            self._open()
        # One thread: the last digits depend on how many.
        with progress.stage("pose"), limit_blas_threads(1):
            self._edit = LayeredEdit(self._files, self._target, settings.posing)
        _report_placement(self._edit, self._files, progress)
        self._statistics, result = PoseStatistics(self._edit), self._result
        writer = open_animation_writer(
            settings.output,
            Edit,
            self._collect_first_fields(),
            stored=StoredBinding(
                self._target.binding, {}, fit=result.fit, low_rank=read_low_rank(result)
            ),
            frames=result.frames,
            overwrite=settings.overwrite,
        )
        with writer as file, limit_blas_threads(1):
            summary = summarize_blocks(self._write_blocks(file))
            key_frames = summary.find_key_frames()
            posed = [
                self._edit.edit_frames(np.array([frame]), self._target.cage_at(frame)[None])
                for frame in key_frames.tolist()
            ]
            offsets = np.concatenate([block.meshes_before - block.meshes_after for block in posed])
            last = {
                "vertex_rms": summary.vertex_rms,
                "sources": self._collect_sources(),
                "skipped": summary.skipped,
            }
            with progress.stage("write"):
                file.complete(last, key_frames=key_frames, key_frame_errors=offsets)
        pose_summary = self._statistics.summarize()
        return PoseResult(pose_summary, take_snapshot(self._edit, posed[0], pose_summary))

    def _open(self) -> None:
        """Read the result, its weights, and the rotation of the rest pose to each frame."""
        self._result = result = read_animation(self._settings.result)
        self._rotations = read_rotations(result)  # (F, 3, 3); edits do not change them
        self._target = EditTarget.of_animation(
            CagedModel.of_file(result.path, result).read_binding("an edit"),
            lambda frame: np.asarray(next(read_cages(result, 1, frame))[0]),
            result.frames,
            self._rotations,
            result.scene,
        )

    def _write_blocks(self, file: AnimationWriter) -> Iterator[SolvedBlock]:
        """Edit, measure and write all frames, and yield the blocks."""
        start, progress = 0, self._progress
        for cages in read_cages(self._result, choose_block_size(len(self._result.rest.vertices))):
            with progress.stage("edit"):
                block = self._edit_block(cages, start)
            with progress.stage("write"):
                file.append(block, block.metrics)
            yield block
            start += len(cages)
            progress.update(start, len(self._result.frames))

    def _edit_block(self, cages: Floats, start: int) -> SolvedBlock:
        """Apply all layers to the frames from `start` on; skipped frames stay gaps."""
        frames = start + np.arange(len(cages))
        known = ~np.isin(frames, list(self._result.skipped))
        block = self._edit.edit_frames(frames[known], cages[known])
        check_finite(block.frames, block.cages_after, block.metrics)
        self._statistics.update(block)

        def spread(values: NDArray[Any]) -> NDArray[Any]:
            """Return values of the edited frames among all, with gaps for the others."""
            gap = -1 if np.issubdtype(values.dtype, np.integer) else np.nan
            held = np.full((len(cages), *values.shape[1:]), gap, values.dtype)
            held[known] = values
            return held

        return SolvedBlock(
            start=start,
            cages=spread(block.cages_after),
            rotations=spread(self._rotations[frames[known]]),
            metrics=map_columns(block.metrics, spread),
            squared_errors=block.squared_displacements.sum(axis=0),
            peaks=DeviationPeaks.of_frames(block.squared_displacements, frames[known]),
            digests=(b"",) * len(cages),
            skipped={k: self._result.skipped[k] for k in frames[~known].tolist()},
            sampled=np.empty((0, 3 * len(cages)), np.float32),
        )

    def _collect_first_fields(self) -> dict[str, Any]:
        """Return what is known of an edit before the first frame is edited."""
        result, name = self._result, to_unicode(self._settings.result.name)
        sources = self._files.sources.values()
        editor = " and ".join(single_line(source["name"]) for source in sources)
        note = (
            f"edited by {editor}: figures measure how far the mesh was moved from "
            f"{single_line(name)}, not how well frames were met"
        )
        return {
            "scene": result.scene,
            "settings": result.settings | describe_settings(self._settings.posing),
            "notes": (*result.notes, Note(note)),
            "quality": result.quality,
            "edited_from": name,
        }

    def _collect_sources(self) -> dict[str, Any]:
        """Return the sources of the result, and the files of the edit."""
        # An edit of an edit names its own files, and not those of the one before.
        held = self._result.sources.items()
        earlier = {k: v for k, v in held if k not in ("handles", "cage_edits")}
        return earlier | {"result": describe_file(self._settings.result)} | self._files.sources


def pose(settings: PoseSettings, progress: ProgressListener | None = None) -> PoseResult:
    """Pose a model by handles and cage edits, and write it."""
    return _ModelPose(settings, progress or ProgressListener()).run()


class _ModelPose:
    """A model in its cage on its way to the posed one."""

    def __init__(self, settings: PoseSettings, progress: ProgressListener) -> None:
        self._settings, self._progress = settings, progress

    def run(self) -> PoseResult:
        """Open the model, bind it, pose it, and write it."""
        settings, progress = self._settings, self._progress
        check_target_kind(settings.target, "to edit an animation")
        with progress.stage("open"):
            target = self._open_target()
            check_no_overlap(settings.outputs(), settings.inputs())
            for path in settings.outputs():
                check_mesh_output(path, settings.overwrite)
            files = EditFiles.read(settings.handles, settings.cage_edits)
        self._model, self._stored = target.model, target.bind(settings.weights, progress)
        binding, cage_output = self._stored.binding, settings.cage_output
        with progress.stage("pose"):
            posed = pose_model(binding, files, settings.posing, progress)
        with progress.stage("write"):
            if self._model.points is None:
                write_mesh(settings.output, binding.rest, posed.snapshot.after, settings.overwrite)
            else:
                rows = self._move_points(posed)
                with error_context(settings.output):
                    data = self._model.points.encode(rows)
                write_bytes(settings.output, data, settings.overwrite)
            if cage_output is not None:
                places = posed.snapshot.cage_after
                write_mesh(cage_output, binding.cage, places, settings.overwrite)
        return posed

    def _open_target(self) -> CagedModel:
        """Open the model and its cage; refuse an output that cannot hold the model."""
        settings = self._settings
        load = partial(load_model, exclude=settings.exclude)
        given_in = settings.given_in
        target = CagedModel.open(settings.target, settings.cage, given_in=given_in, load=load)
        if target.cage is None:
            raise SettingError(
                f"{target.path}: is a model without a cage; " + say("give one with `cage=`")
            )
        target.model.check_posed_output(settings.output)
        return target

    def _move_points(self, posed: PoseResult) -> NDArray[Any]:
        """Return the rows of posed points or splats, (m,)."""
        settings, model, stored = self._settings, self._model, self._stored
        assert model.points is not None
        rows, note = model.points.rows.copy(), model.note(self._progress)
        oriented = model.find_oriented(stored.binding, note)
        if oriented is None:
            place_positions(rows, posed.snapshot.after)
            return rows
        with error_context(settings.target):
            moved = PointReconstruction.prepare(
                stored.binding,
                oriented,
                memory=DEFAULT_MEMORY,
                jobs=settings.weights.jobs,
                progress=self._progress,
                transferred=stored.transferred,
            )
        with limit_blas_threads(1):
            moved.fill_rows(rows[None], Poses(posed.snapshot.cage_after[None]))
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
    _report_placement(edit, files, progress)
    statistics = PoseStatistics(edit)
    statistics.update(block)
    summary = statistics.summarize()
    return PoseResult(summary, take_snapshot(edit, block, summary))


def _report_placement(edit: LayeredEdit, files: EditFiles, progress: ProgressListener) -> None:
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
