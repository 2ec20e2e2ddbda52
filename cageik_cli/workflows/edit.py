"""Edit the cage animation of a result by handles and cage edits, and write the edited result."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.editing.cage_edits import EditFiles
from cageik_cli.editing.edit_target import EditTarget
from cageik_cli.editing.edits import LayeredEdit, PosingSettings
from cageik_cli.editing.statistics import PoseStatistics
from cageik_cli.editing.summary import PoseResult, take_snapshot
from cageik_cli.formats.base.files import hash_file
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.method.solve.blocks import SolvedBlock
from cageik_cli.method.solve.metrics import METRIC_TYPES, FrameMetrics, check_finite
from cageik_cli.method.solve.summary import DeviationPeaks, summarize_blocks
from cageik_cli.solver.executor import choose_block_size
from cageik_cli.store.result import Result, read_cages, read_result, read_rotations
from cageik_cli.store.result_fields import ResultHeader, ResultSummary
from cageik_cli.store.result_writer import ResultWriter, open_result_writer
from cageik_cli.util.arrays import Floats
from cageik_cli.util.outputs import check_no_overlap, check_writable
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import single_line, to_unicode
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.pose import report_placement
from cageik_cli.workflows.settings import READ, WRITTEN, CommandSettings


@dataclass(frozen=True, slots=True)
class EditSettings(CommandSettings):
    """Which animation to edit, by handles or cage edits or both, and where to write it."""

    result: Path = field(metadata=READ)
    handles: Path | None = field(metadata=READ)
    output: Path = field(metadata=WRITTEN)
    posing: PosingSettings = field(default_factory=PosingSettings)
    overwrite: bool = False
    cage_edits: Path | None = field(default=None, metadata=READ)


def edit(
    settings: EditSettings,
    progress: ProgressListener | None = None,
    files: EditFiles | None = None,
) -> PoseResult:
    """Apply the layers of an edit to the cage animation of a result, and write a result.

    Frames that no layer acts on keep their cages bit for bit. The metrics of the new result
    compare it with the old one: they tell how far the mesh was moved.

    Parameters
    ----------
    files : EditFiles, optional
        In place of those of the settings.
    """
    progress = progress or ProgressListener()
    check_no_overlap(settings.outputs(), settings.inputs())
    check_writable(settings.output, settings.overwrite)
    check_hdf5_suffix(settings.output)
    with progress.stage("open"):
        files = files or EditFiles.read(settings.handles, settings.cage_edits)
        run = _EditRun(settings, files, progress)
    return run.run()


class _EditRun:
    """The animation of a result on its way to the edited one."""

    def __init__(
        self, settings: EditSettings, files: EditFiles, progress: ProgressListener
    ) -> None:
        self._settings, self._files, self._progress = settings, files, progress
        self._result = result = read_result(settings.result)
        # Of the rest pose to each frame, (F, 3, 3); edits do not change them.
        self._rotations = read_rotations(result)
        binding = CagedModel.of_result(result).read_binding("an edit")
        self._target = EditTarget.of_animation(
            binding,
            lambda frame: np.asarray(next(read_cages(result, 1, frame))[0]),
            result.frames,
            self._rotations,
            result.scene,
        )

    def run(self) -> PoseResult:
        """Edit, measure and write all frames."""
        settings, result, progress = self._settings, self._result, self._progress
        # One thread: the last digits depend on how many.
        with progress.stage("pose"), limit_blas_threads(1):
            self._edit = LayeredEdit(self._files, self._target, settings.posing)
        report_placement(self._edit, self._files, progress)
        self._statistics = PoseStatistics(self._edit)
        writer = open_result_writer(
            settings.output,
            _build_header(settings, self._files, result),
            binding=self._target.binding,
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
            ending = ResultSummary(
                sources=_collect_sources(settings, self._files, result),
                skipped=summary.skipped,
                vertex_rms=summary.vertex_rms,
            )
            with progress.stage("write"):
                file.complete(ending, key_frames=key_frames, key_frame_errors=offsets)
        pose_summary = self._statistics.summarize()
        return PoseResult(pose_summary, take_snapshot(self._edit, posed[0], pose_summary))

    def _write_blocks(self, file: ResultWriter) -> Iterator[SolvedBlock]:
        """Edit, measure and write all frames, and yield the blocks."""
        start, progress = 0, self._progress
        for cages in read_cages(self._result, choose_block_size(len(self._result.rest.vertices))):
            with progress.stage("edit"):
                block = self._edit_block(cages, start)
            with progress.stage("write"):
                file.append(block.cages, block.rotations, block.metrics)
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
        all_cages, columns = np.full_like(cages, np.nan), {}
        all_cages[known] = block.cages_after
        rotations = self._rotations[frames]
        rotations[~known] = np.nan
        for name in METRIC_TYPES:
            found = getattr(block.metrics, name)
            gap = -1 if METRIC_TYPES[name] == "i8" else np.nan
            columns[name] = np.full(len(cages), gap, found.dtype)
            columns[name][known] = found
        return SolvedBlock(
            start=start,
            cages=all_cages,
            rotations=rotations,
            metrics=FrameMetrics(**columns),
            squared_errors=block.squared_displacements.sum(axis=0),
            peaks=DeviationPeaks.of_frames(block.squared_displacements, frames[known]),
            digests=(b"",) * len(cages),
            skipped={k: self._result.skipped[k] for k in frames[~known].tolist()},
            sampled=np.empty((0, 3 * len(cages)), np.float32),
        )


def _build_header(settings: EditSettings, files: EditFiles, result: Result) -> ResultHeader:
    posing = settings.posing
    pose_settings = {
        "pose_alpha": posing.alpha,
        "pose_beta": posing.beta,
        "rigidity": posing.rigidity,
        "hard": posing.hard,
        "snap": posing.snap,
        "allow_conflicts": posing.allow_conflicts,
        **({"mirror": True} if posing.mirror else {}),
    }
    editor = " and ".join(single_line(source["name"]) for source in files.sources.values())
    source = single_line(to_unicode(settings.result.name))
    note = (
        f"edited by {editor}: figures tell how far the mesh was moved from {source}, not how well "
        "frames were met"
    )
    return ResultHeader(
        quality=result.quality,
        scene=result.scene,
        settings=result.settings | pose_settings,
        notes=(*result.notes, note),
        edited_from=to_unicode(settings.result.name),
    )


def _collect_sources(settings: EditSettings, files: EditFiles, result: Result) -> dict[str, Any]:
    """Return the sources of the result, and the files of the edit."""
    source = {
        "name": to_unicode(settings.result.name),
        "sha256": hash_file(settings.result).hex(),
    }
    # An edit of an edit names its own files, and not those of the one before.
    earlier = {k: v for k, v in result.sources.items() if k not in ("handles", "cage_edits")}
    return earlier | {"result": source} | files.sources
