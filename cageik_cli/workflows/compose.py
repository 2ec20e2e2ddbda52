"""The result of a run, composed of its checkpoint when all frames are solved."""

from typing import Any

import numpy as np

from cageik_cli.cages.check.quality import has_too_much_room
from cageik_cli.cages.check.sections import find_shared_sections
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import MIN_VOLUME_RATIO, TriMesh
from cageik_cli.geometry.parts import MAX_PARTS_NAMED, count_by_part
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.regions import (
    MIN_DEVIATION,
    Region,
    blame_loose_cage,
    blame_shared_places,
    blame_smoothing,
    find_worst_regions,
    has_bad_regions,
)
from cageik_cli.method.solve.summary import MAX_BRIDGED_FRAMES, ClipSummary, DeviationPeaks
from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.checkpoint import Checkpoint
from cageik_cli.store.fit_fields import UnfittedClip
from cageik_cli.store.result_fields import ResultSummary
from cageik_cli.store.result_writer import ResultWriter
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, join_truncated
from cageik_cli.util.progress import locate_note
from cageik_cli.util.text import format_count
from cageik_cli.util.units import list_size_notes
from cageik_cli.workflows.fit import choose_compared_frames, measure_unfitted


class ResultComposer:
    """Composes the result of a complete checkpoint.

    Parameters
    ----------
    rest_index : int or None
        The number of the rest pose in the clip; None if it is a file of its own.
    unsmoothed : DeviationPeaks, optional
        Of the cages before they were smoothed, if they were.

    Raises
    ------
    FileAccessError
        When no frame could be read.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        binding: Binding,
        sequence: MeshSequence,
        rest_index: int | None,
        unsmoothed: DeviationPeaks | None = None,
    ) -> None:
        self._checkpoint, self._binding, self._sequence = checkpoint, binding, sequence
        self._summary = summary = checkpoint.summary
        if len(summary.skipped) == len(sequence):
            raise FileAccessError(f"no frame can be read, the first: {summary.skipped[0]}")
        self._regions = find_clip_regions(binding, summary)
        if unsmoothed is not None:
            self._regions = blame_smoothing(self._regions, unsmoothed, binding.rest.diagonal)
        self._key_frames = _find_key_frames(binding.rest, rest_index, summary, self._regions)

    def write(
        self,
        result: ResultWriter,
        sources: dict[str, Any],
        filled: tuple[int, ...],
        unfitted: DualLaplacianSolver | None,
    ) -> None:
        """Write all frames, whose blocks are read once, in order, and what is of all of them.

        Parameters
        ----------
        sources : dict
            Name and digest of each file that was read, all but the frames.
        filled : tuple of int
            Skipped frames whose cages were filled from those around them.
        unfitted : DualLaplacianSolver or None
            Of the weights before the fit, if the result compares them.
        """
        summary, key_frames = self._summary, self._key_frames
        key_meshes = self._append_blocks(result)
        errors = [self._reread(k) - key_meshes[k] for k in key_frames]
        result.complete(
            ResultSummary(
                sources=sources | {"frames": self._sequence.describe_source()},
                skipped=summary.skipped,
                vertex_rms=summary.vertex_rms,
                regions=self._regions,
                bound=summary.measure_bound(len(self._binding.cage.vertices)),
                filled=filled,
            ),
            key_frames=np.array(key_frames),
            key_frame_errors=np.array(errors),
            unfitted=None if unfitted is None else self._compare_unfitted(unfitted),
        )

    def _append_blocks(self, result: ResultWriter) -> dict[int, Floats]:
        """Append all frames; return the reconstructions of the key frames, (m, 3) each."""
        key_meshes: dict[int, Floats] = {}
        for block in self._checkpoint.blocks():
            kept = None if block.kept is None else block.kept.metrics
            result.append(block.cages, block.rotations, block.metrics, kept)
            for k in self._key_frames:
                if block.start <= k < block.stop:
                    one = slice(k - block.start, k - block.start + 1)
                    cages, rotations = block.cages[one], block.rotations[one]
                    rebuilt = reconstruct_frames(self._binding, cages, rotations)
                    key_meshes[k] = np.asarray(rebuilt[0])
        return key_meshes

    def _reread(self, frame: int) -> Floats:
        """Read a frame again, which must be the one that was solved."""
        sequence = self._sequence
        vertices = sequence.read_frame(frame)
        if sequence.digest(frame) != self._summary.digests[frame]:
            raise FileAccessError(
                f"{sequence.location(frame)}: changed during the run; run again with `resume=True`"
            )
        return vertices

    def _compare_unfitted(self, unfitted: DualLaplacianSolver) -> UnfittedClip:
        """Measure some frames with the weights before the fit."""
        known = np.setdiff1d(np.arange(self._summary.frames_done), list(self._summary.skipped))
        chosen = choose_compared_frames(known, self._key_frames)
        return measure_unfitted(unfitted, self._binding, chosen, self._key_frames, self._reread)


def _find_key_frames(
    rest: TriMesh, rest_index: int | None, summary: ClipSummary, regions: tuple[Region, ...]
) -> list[int]:
    """Return the worst, the median and the best frame, and that of the worst region.

    Where some frames deviate, those that the rest cage gives exactly are the rest pose: they say
    nothing of the best frame.
    """
    is_rest = summary.frame_rms <= MIN_DEVIATION * rest.diagonal
    if (is_rest | np.isnan(summary.frame_rms)).all():
        is_rest = np.zeros_like(is_rest)
    if rest_index is not None:
        is_rest[rest_index] = True
    frames: list[int] = summary.find_key_frames(is_rest).tolist()
    return frames + [region.frame for region in regions[:1] if region.frame not in frames]


def collect_notes(
    stored: StoredBinding,
    rest: LoadedMesh,
    sequence: MeshSequence,
    hints: SceneHints,
    summary: ClipSummary,
    solver: DualLaplacianSolver,
) -> tuple[str, ...]:
    """Return what the user should know of the meshes and of what is missing in them.

    `hints` are what is stated of the scene.
    """
    cage = stored.sources["cage"]["name"]
    notes = [
        *(locate_note(cage, note) for note in stored.binding.notes),
        *(locate_note(rest.source["name"], note) for note in rest.notes),
        *sequence.notes,
    ]
    if not rest.mesh.is_closed:
        edges = rest.mesh.edges
        holes = edges.ends[~edges.is_balanced]
        counts = [
            f"{share.found} of {share.name}" for share in count_by_part(rest.mesh, holes[:, 0])
        ]
        where = f": {join_truncated(counts, MAX_PARTS_NAMED)}" if counts else ""
        notes.append(
            f"the model is open ({len(holes)} boundary edges{where}), so its volume "
            "is not defined and volume figures are left out"
        )
    elif not rest.mesh.is_body:
        notes.append(
            f"the model is closed, but a sheet: its volume, {rest.mesh.volume:.3g}, is at most "
            f"{MIN_VOLUME_RATIO:g} of its area times its diagonal, so changes of volume are left "
            "out"
        )
    elif solver.missing_count:
        notes.append(
            f"{solver.missing_count} vertices of weight 0 are missing data, so volumes of frames "
            "are not known and volume figures are left out"
        )
    unit_notes = _list_unit_notes(hints.metres_per_unit, rest.mesh.diagonal)
    return (*notes, *_list_absence_notes(summary), *unit_notes)


def _list_unit_notes(metres_per_unit: float | None, diagonal: float) -> list[str]:
    """Note a size that no character has; or that lengths are taken for metres, if nobody says so.

    `diagonal` is in file units.
    """
    unit = Scene().metres_per_unit if metres_per_unit is None else metres_per_unit
    notes = list_size_notes(diagonal, unit, "the result says that a unit is")
    if metres_per_unit is None and not notes:
        return ["no file states its unit: taken as metres (`metres_per_unit=0.01` for cm)"]
    return notes


def _list_absence_notes(summary: ClipSummary) -> tuple[str, ...]:
    """Say how many vertices have no data for so long that no motion around it tells their place."""
    if summary.absences is None:
        return ()
    longest = summary.absences.longest
    count = int((longest > MAX_BRIDGED_FRAMES).sum())
    if not count:
        return ()
    verb = "is" if count == 1 else "are"
    return (
        f"{format_count(count, 'vertex')} {verb} hidden for more than {MAX_BRIDGED_FRAMES} frames "
        f"in a row, up to {longest.max()}: the place is a guess there, which no figure judges",
    )


def find_clip_regions(binding: Binding, summary: ClipSummary) -> tuple[Region, ...]:
    """Find the worst regions of a clip; none if its largest deviation is within the usual."""
    rms = float(np.sqrt(np.nanmean(summary.frame_rms**2)))
    largest = float(summary.peaks.deviations.max())
    if not has_bad_regions(rms, largest, binding.rest.diagonal):
        return ()
    regions = find_worst_regions(binding, summary.peaks)
    has_loose_cage = binding.has_loose_cage
    if has_loose_cage is None:  # nothing was said of it when it was bound
        has_loose_cage = has_too_much_room(binding.cage, binding.rest)
    if has_loose_cage:
        return blame_loose_cage(regions, binding.rest.diagonal)
    centres = np.array([region.centre for region in regions])
    shared = find_shared_sections(binding.cage, binding.rest, near=centres)
    places = [(section.centre, (section.size + section.length) / 2) for section in shared]
    return blame_shared_places(regions, places, binding.rest.diagonal)
