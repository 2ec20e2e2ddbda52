"""The run: one clip on its way from files to a result.

The result is composed of the checkpoint when all frames are solved.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any

import numpy as np

from cageik_cli.cages.check.quality import find_shared_sections, is_too_loose
from cageik_cli.captured.frames import CapturedBlockSolver
from cageik_cli.captured.robust import RobustSolver
from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import MIN_VOLUME_RATIO, TriMesh
from cageik_cli.geometry.parts import count_by_part
from cageik_cli.inputs.clip import (
    VertexWeights,
    load_vertex_weights,
    open_clip_and_choose_rest,
)
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.inputs.weights import (
    bind_cached,
    build_cached,
    load_matching_binding,
    restore_baseline_weights,
    suggest_repair,
)
from cageik_cli.method.solve.blocks import BlockSolver, SolvedBlock
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.metrics import DeviationPeaks
from cageik_cli.method.solve.regions import (
    MIN_DEVIATION,
    Region,
    attribute_to_loose_cage,
    attribute_to_shared_places,
    attribute_to_smoothing,
    find_worst_regions,
    has_bad_regions,
)
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.summary import ClipSummary
from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.run.executor import MemoryPlan, RunBlocks, choose_block_size, run_in_threads
from cageik_cli.run.fit import (
    choose_compared_frames,
    choose_fit,
    choose_norm,
    fit_to_clips,
    measure_baseline_weights,
)
from cageik_cli.run.resume import (
    check_output,
    find_existing,
    open_checkpoint,
    recover_blocks,
    write_built_cage,
)
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.run.time_pass import open_refined
from cageik_cli.run.tried_steps import StepTrials
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.cache import compute_key
from cageik_cli.store.checkpoint import Checkpoint, RunSpec, delete_checkpoint
from cageik_cli.store.fit_fields import BaselineErrors
from cageik_cli.store.result import (
    AnimationWriter,
    Result,
    checkpoint_path,
    open_animation_writer,
    placed_path,
    read_result,
    smoothed_path,
)
from cageik_cli.store.tried_steps import HiddenErrors, TriedStep
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, error_context, join_truncated
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.util.units import list_size_notes


def extract(settings: ExtractSettings, progress: ProgressListener | None = None) -> Result:
    """Extract the cage of every frame and write the result file."""
    return Extraction(settings, progress).run()


class Extraction:
    """One clip on its way from files, or from arrays, to its cages.

    Parameters
    ----------
    stored : StoredBinding, optional
        The weights, if they are known: of this rest pose, cage and settings.
    run_blocks : RunBlocks
        Solves the blocks of frames: threads of this process, or a cluster.

    Attributes
    ----------
    rest_index : int, optional
        Which of the frames that are taken the rest pose is; None if it is none of them.
    existing : Result, optional
        A complete result of this very run at the output, which is kept.
    replaced : str
        Of what the result at the output was that is replaced, see `find_existing`; "" if none is.
    cage : LoadedMesh, optional
        None when it comes with a binding, or is not built yet.
    sources : dict
        Name and digest of each file that was read, all but the frames, and of a built cage.
    filled : tuple of int
        Skipped frames whose cages were filled from those around them.
    fit : FitSettings, optional
        How the weights are fitted to the clip, once that is chosen; None if they are not.
    """

    sequence: MeshSequence
    rest: LoadedMesh
    rest_index: int | None
    block_solver: BlockSolver[MeshSequence]

    def __init__(
        self,
        settings: ExtractSettings,
        progress: ProgressListener | None = None,
        *,
        stored: StoredBinding | None = None,
        run_blocks: RunBlocks = run_in_threads,
    ) -> None:
        self.settings, self.stored = settings, stored
        self.progress = progress or ProgressListener()
        self._run_blocks = run_blocks
        self.existing: Result | None = None
        self.replaced = ""
        beside = settings.rest, settings.cage
        self.common = CommonScene.of_clip(settings.scene, settings.given_in, beside)
        self.cage: LoadedMesh | None = None
        self.vertex_weights = VertexWeights(None)
        self.sources: dict[str, Any] = {}
        self.filled: tuple[int, ...] = ()
        self.fit: FitSettings | None = None
        self._fit_notes: tuple[Note, ...] = ()
        self._states_high_norm = settings.solve.lowers_deviations

    def run(self) -> Result:
        """Extract the cage of every frame, or return the result that exists already."""
        check_output(self.settings)
        with self.progress.stage("open"):
            self.open()
        if self.existing is not None:
            return self.keep_existing(self.existing)
        write_built_cage(self.settings, self.bind().binding.cage)
        self.factor()
        # One thread for the products: blocks are solved, and frames read, beside each other.
        with open_checkpoint(self.settings, self._make_spec()) as checkpoint, limit_blas_threads(1):
            self.solve(checkpoint)
            refined = open_refined(self.block_solver, checkpoint, self.settings, self.scene.fps)
            with refined as (complete, self.filled):
                is_smoothed = self.settings.capture.smooth is not None
                self.write(complete, checkpoint.summary.peaks if is_smoothed else None)
        return read_result(self.settings.output)

    def open(self) -> None:
        """Open the clip and the files that are named beside it, and find a result that is kept.

        Nothing is written; whoever goes on calls `check_output` first.

        Raises
        ------
        InputError
            Naming the file at fault; or when there is another result that may not be overwritten.
        """
        clip = replace(self.settings.clip, fps=self.settings.scene.fps)
        self.settings = settings = replace(self.settings, clip=clip)
        has_cage, pose = not settings.builds_cage, (settings.rest, settings.rest_frame)
        self.sequence, self.rest, self.rest_index = open_clip_and_choose_rest(
            settings.frames, clip, *pose, self.common, has_cage=has_cage
        )
        if settings.cage is not None:
            self.cage = self.common.open_cage(settings.cage)
        self.sources = {"rest": self.rest.source}
        if settings.binding is not None:
            matching = self.stored or load_matching_binding(settings.binding, self.rest, self.cage)
            self.stored, self.sources = matching, matching.sources | self.sources
        elif self.cage is not None:
            self.sources["cage"] = self.cage.source
        elif self.stored is not None:
            self.sources["cage"] = self.stored.sources["cage"]
        self.vertex_weights = load_vertex_weights(
            settings.vertex_weights, self.rest, len(self.sequence)
        )
        self.sources |= self.vertex_weights.sources
        if self.weighs_frames:
            settings.check_norm()
        settings.capture.check_period(self.scene.fps)
        self.fit, self._fit_notes = choose_fit(settings, self.sequence, self.weighs_frames)
        self.settings = settings = replace(settings, solve=self._choose_norm())
        if settings.resume:
            scene, recorded = self.scene, self.recorded_settings
            self.existing, self.replaced = find_existing(
                settings, self.sequence, scene, recorded=recorded, sources=self.sources
            )

    def _choose_norm(self) -> SolveSettings:
        """Choose the norm of the cages, see `choose_norm`; binding files state that of their fit.

        Of data that may be noisy it is that of least squares.
        """
        settings, known = self.settings, None if self.stored is None else self.stored.fit
        is_clean = None
        if self.weighs_frames:
            is_clean = False
        elif self.fit is not None and settings.fit is None:
            is_clean = True  # or weights would not be fitted without being asked for
        fit, own = self.fit, None
        if fit is None and known is not None and known.solve.lowers_deviations:
            fit, own = FitSettings(), known.solve.norm
        chosen = choose_norm(settings.solve, fit, [self.sequence], is_clean=is_clean)
        is_stated = settings.solve.norm is not None
        return chosen if is_stated or None in (own, chosen.norm) else replace(chosen, norm=own)

    @property
    def scene(self) -> Scene:
        """Time and space: as set, else as the clip says, else the defaults."""
        from_clip = self.sequence.scene.override(Scene())
        return self.settings.scene.override(self.common.hints.override(from_clip))

    @property
    def recorded_settings(self) -> dict[str, Any]:
        """The settings on which the numbers depend, as a result file records them."""
        known, fit = self.stored, self.fit
        if known is None:
            return self.settings.record(None, fit, self.rest_index)
        if fit is None and known.fit is not None:
            fit = known.fit.settings
        return self.settings.record(known.binding.settings, fit, self.rest_index)

    @property
    def weighs_frames(self) -> bool:
        """Whether vertices of one frame may count differently than in another."""
        return self.settings.is_captured or self.vertex_weights.frames is not None

    def keep_existing(self, result: Result) -> Result:
        """Delete what an interrupted run has left beside a result that exists already."""
        for find_path in (checkpoint_path, placed_path, smoothed_path):
            delete_checkpoint(find_path(self.settings.output))
        self.progress.note("unchanged", "up to date, nothing to do")
        write_built_cage(self.settings, result.cage)
        return result

    def bind(self) -> StoredBinding:
        """Take the weights that are known, or compute and fit them; without a cage, build one.

        The same model gives the same cage each time, so that a checkpoint of it can be continued.
        """
        settings, rest, progress = self.settings, self.rest, self.progress
        weight_settings = WeightSettings(settings.bind, settings.cache, settings.jobs)
        if self.stored is not None:
            with progress.stage("bind"):
                progress.update(len(rest.mesh.vertices), len(rest.mesh.vertices))
                if settings.keep_weights:
                    self.stored = restore_baseline_weights(
                        self.stored, rest, weight_settings, progress
                    )
            return self.stored
        placed_in = None if self.cage is None else self.common
        if self.cage is None:
            with progress.stage("cage"), error_context(rest.source["name"]):
                self.cage = build_cached(rest.mesh, settings.build, settings.cache, progress)
            self.sources["cage"] = self.cage.source
        with progress.stage("bind"), suggest_repair(self.cage, rest, placed_in):
            self.stored = bind_cached(rest, self.cage, weight_settings, progress)
        if self.fit is not None:
            with progress.stage("fit"):
                fitted, notes = fit_to_clips(
                    self.stored.binding,
                    [self.sequence],
                    self.fit,
                    progress,
                    solve=settings.solve,
                    vertex_weights=self.vertex_weights.vertices,
                    memory=settings.memory,
                    jobs=settings.jobs,
                    skips_bad_frames=settings.skips_bad_frames,
                    cache=settings.cache,
                )
            self.stored = self.stored.with_fit(fitted)
            self._fit_notes += tuple(notes)
        return self.stored

    @property
    def binding(self) -> Binding:
        """The weights, once they are known."""
        assert self.stored is not None
        return self.stored.binding

    def factor(self) -> None:
        """Factor the system of the cages, and choose how blocks of frames are solved."""
        settings, progress = self.settings, self.progress
        # One thread: the matrix is small, and threads that wait for each other take longer.
        with progress.stage("factor"), limit_blas_threads(1):
            solver = DualLaplacianSolver(self.binding, settings.solve, self.vertex_weights.vertices)
        if not self.weighs_frames:
            self.block_solver = BlockSolver(
                self.sequence, solver, progress, skips_bad_frames=settings.skips_bad_frames
            )
            return
        self.block_solver = captured = CapturedBlockSolver(
            self.sequence,
            RobustSolver(solver),
            progress,
            skips_bad_frames=settings.skips_bad_frames,
            frame_weights=self.vertex_weights.frames,
            accepts_gaps=settings.accepts_gaps,
        )
        if settings.capture.robust:
            captured.find_tolerances()

    def open_blocks(self, start: int) -> AbstractContextManager[Iterator[SolvedBlock]]:
        """Open an iterator of the frames from `start` on, solved and measured, in blocks."""
        assert self.stored is not None
        unfitted = self.stored.unfitted
        held = 0 if unfitted is None else unfitted.weights.nbytes
        plan = MemoryPlan.make(self.settings.memory - held, self.binding, self.settings.jobs)
        starts = range(start, len(self.sequence), plan.block_size)
        return self._run_blocks(self.block_solver, starts, plan)

    def solve(self, checkpoint: Checkpoint) -> None:
        """Solve the frames that the checkpoint does not hold yet."""
        with self.progress.stage("read"):
            recover_blocks(checkpoint, self.sequence, self.settings, self.progress)
        with self.open_blocks(checkpoint.frames_done) as blocks:
            for block in blocks:
                with self.progress.stage("write"):
                    checkpoint.append(block)
                self.progress.update(block.stop, len(self.sequence))

    def write(self, checkpoint: Checkpoint, unsmoothed: DeviationPeaks | None) -> None:
        """Compose the result of a checkpoint that holds all frames, as of `_ResultComposer`."""
        settings, solver = self.settings, self.block_solver.solver
        hints = self.common.hints
        assert self.stored is not None
        notes = _collect_notes(
            self.stored,
            self.rest,
            self.sequence,
            hints,
            checkpoint.summary,
            solver,
            settings.capture,
        )
        first = {
            "scene": self.scene,
            "settings": self.recorded_settings,
            "notes": notes + self._fit_notes,
            "quality": solver.quality,
        }
        output, (tried, hidden) = settings.output, self._try_steps(checkpoint.summary)
        with self.progress.stage("write"):
            composer = _ResultComposer(
                checkpoint, self.stored, self.sequence, self.rest_index, unsmoothed
            )
            with open_animation_writer(
                output,
                Result,
                first,
                stored=self.stored,
                frames=self.sequence.names,
                overwrite=settings.overwrite or settings.resume,
                keep_weights=settings.keep_weights,
                has_kept=self.weighs_frames,
                temporary_path=output.with_name(f"{output.name}.whole.partial"),
            ) as result:
                last: dict[str, Any] = {"sources": self.sources, "filled": self.filled}
                last |= {"tried": tried, "hidden": hidden}
                composer.write(result, last, self._make_baseline_solver())

    def _try_steps(self, summary: ClipSummary) -> tuple[tuple[TriedStep, ...], HiddenErrors | None]:
        """Try steps that may lower the error, and measure what was missing."""
        settings = self.settings
        assert self.stored is not None
        if len(summary.skipped) == summary.frames_done:
            return (), None
        trials = StepTrials(
            settings,
            self.block_solver,
            self.stored,
            summary,
            self.vertex_weights,
            fps=self.scene.fps,
            takes_fit=self.stored.fit is None and settings.keep_weights and not self.weighs_frames,
            rejects_outliers=not (settings.capture.robust or self._states_high_norm),
        )
        with self.progress.stage("try"):
            return trials.run(), trials.hidden

    def _make_baseline_solver(self) -> DualLaplacianSolver | None:
        """Return the solver with the weights before the fit, if the result compares them.

        It is that of least squares, the default for weights that are not fitted.
        """
        assert self.stored is not None
        before, settings = self.stored.unfitted, self.settings
        if before is None or not settings.keep_weights or self.weighs_frames:
            return None
        plain = replace(settings.solve, norm=None)
        return DualLaplacianSolver(before, plain, self.vertex_weights.vertices)

    def _make_spec(self) -> RunSpec:
        """Return what this run has to do, by which an interrupted one is known again."""
        assert self.stored is not None
        binding, weights = self.stored.binding, self.vertex_weights.vertices
        rate = self.settings.clip.fps  # at which some files are sampled
        is_fitted_here = self.fit is not None
        given = (self.stored.unfitted if is_fitted_here else None) or binding
        meshes = binding.rest, binding.cage
        arrays = [array for mesh in meshes for array in (mesh.vertices, mesh.faces)]
        arrays += [given.weights] if weights is None else [given.weights, weights]
        found = []
        if isinstance(self.block_solver, CapturedBlockSolver):
            tolerances = self.block_solver.robust.tolerances
            found = [] if tolerances is None else [tolerances]
        arrays += [] if is_fitted_here else found
        return RunSpec(
            frames=list(self.sequence.names),
            settings=self.recorded_settings,
            sources=self.sources,
            key=compute_key({} if rate is None else {"fps": rate}, *arrays),
            fit=compute_key({}, binding.weights, *found) if is_fitted_here else "",
            vertices=len(binding.rest.vertices),
            cage_vertices=len(binding.cage.vertices),
            block_frames=choose_block_size(len(binding.rest.vertices)),
            sampled_vertices=len(self.block_solver.solver.sampled_vertices),
            weighs_frames=self.weighs_frames,
        )


class _ResultComposer:
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
        stored: StoredBinding,
        sequence: MeshSequence,
        rest_index: int | None,
        unsmoothed: DeviationPeaks | None = None,
    ) -> None:
        self._checkpoint, self._sequence = checkpoint, sequence
        self._binding = binding = stored.binding
        self._summary = summary = checkpoint.summary
        if len(summary.skipped) == len(sequence):
            raise FileAccessError("no frame can be read, the first: " + summary.skipped[0])
        self._regions = _find_clip_regions(stored, summary)
        if unsmoothed is not None:
            self._regions = attribute_to_smoothing(self._regions, unsmoothed, binding.rest.diagonal)
        self._key_frames = _find_key_frames(binding.rest, rest_index, summary, self._regions)

    def write(
        self,
        result: AnimationWriter,
        last: dict[str, Any],
        unfitted: DualLaplacianSolver | None,
    ) -> None:
        """Write all frames, whose blocks are read once, in order, and what is of all of them.

        Parameters
        ----------
        last : dict
            Fields of the result that the run knows. Sources are of all files but the frames.
        unfitted : DualLaplacianSolver or None
            Of the weights before the fit, if the result compares them.
        """
        summary, key_frames = self._summary, self._key_frames
        key_meshes = self._append_blocks(result)
        errors = [self._reread(k) - key_meshes[k] for k in key_frames]
        result.complete(
            {
                "vertex_rms": summary.vertex_rms,
                "regions": self._regions,
                "bound": summary.measure_bound(len(self._binding.cage.vertices)),
                "skipped": summary.skipped,
                **last,
                "sources": last["sources"] | {"frames": self._sequence.describe_source()},
            },
            key_frames=np.array(key_frames),
            key_frame_errors=np.array(errors),
            unfitted=None if unfitted is None else self._compare_baseline_weights(unfitted),
        )

    def _append_blocks(self, result: AnimationWriter) -> dict[int, Floats]:
        """Append all frames; return the reconstructions of the key frames, (m, 3) each."""
        key_meshes: dict[int, Floats] = {}
        for block in self._checkpoint.blocks():
            kept = None if block.kept is None else block.kept.metrics
            result.append(block, block.metrics, kept)
            for k in self._key_frames:
                if block.start <= k < block.stop:
                    one = slice(k - block.start, k - block.start + 1)
                    key_meshes[k] = np.asarray(reconstruct_frames(self._binding, block[one])[0])
        return key_meshes

    def _reread(self, frame: int) -> Floats:
        """Read a frame again, which must be the one that was solved."""
        sequence = self._sequence
        vertices = sequence.read_frame(frame)
        if sequence.digest(frame) != self._summary.digests[frame]:
            raise FileAccessError(
                f"{sequence.location(frame)}: changed during the run; "
                + say("run again with `resume=True`")
            )
        return vertices

    def _compare_baseline_weights(self, unfitted: DualLaplacianSolver) -> BaselineErrors:
        """Measure some frames with the weights before the fit."""
        known = np.setdiff1d(np.arange(self._summary.frames_done), list(self._summary.skipped))
        chosen = choose_compared_frames(known, self._key_frames)
        return measure_baseline_weights(
            unfitted, self._binding, chosen, self._key_frames, self._reread
        )


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


def _collect_notes(
    stored: StoredBinding,
    rest: LoadedMesh,
    sequence: MeshSequence,
    hints: SceneHints,
    summary: ClipSummary,
    solver: DualLaplacianSolver,
    capture: CaptureSettings,
) -> tuple[Note, ...]:
    """Return what the user should know of the meshes and of what is missing in them.

    `hints` are what is stated of the scene.
    """
    cage = stored.sources["cage"]["name"]
    given = (
        *(note.at(cage) for note in stored.binding.notes),
        *(note.at(rest.source["name"]) for note in rest.notes),
        *sequence.notes,
    )
    notes: list[Said] = []
    if not rest.mesh.is_closed:
        edges = rest.mesh.edges
        holes = edges.ends[~edges.is_balanced]
        counts = [
            f"{group_digits(share.found)} of {share.name}"
            for share in count_by_part(rest.mesh, holes[:, 0])
        ]
        where = f": {join_truncated(counts)}" if counts else ""
        notes.append(
            f"the model is open ({format_count(len(holes), 'boundary edge')}{where}), so its "
            "volume is not defined and volume figures are left out"
        )
    elif not rest.mesh.is_body:
        notes.append(
            f"the model is closed, but a sheet: its volume, {rest.mesh.volume:.3g}, is at most "
            f"{MIN_VOLUME_RATIO:g} of its area times its diagonal, so changes of volume are left "
            "out"
        )
    elif solver.missing_count:
        notes.append(
            f"{group_digits(solver.missing_count)} vertices of weight 0 are missing data, so "
            "volumes of frames "
            "are not known and volume figures are left out"
        )
    unit_notes = _list_unit_notes(hints.metres_per_unit, rest.mesh.diagonal)
    notes += [*_list_absence_notes(summary, capture), *unit_notes]
    return (*given, *map(Note, notes))


def _list_unit_notes(metres_per_unit: float | None, diagonal: float) -> list[Said]:
    """Note a size that no character has; or that lengths are taken for metres, if nobody says so.

    `diagonal` is in file units.
    """
    unit = Scene().metres_per_unit if metres_per_unit is None else metres_per_unit
    notes = list_size_notes(diagonal, unit, "the result says that a unit is")
    if metres_per_unit is None and not notes:
        return [say("no file states its unit: taken as metres (`metres_per_unit=0.01` for cm)")]
    return notes


def _list_absence_notes(summary: ClipSummary, capture: CaptureSettings) -> tuple[str, ...]:
    """Say how many vertices have no data for so long that no motion around it tells their place.

    Without smoothing, none does. But what is rejected is surrounded by data, mostly.
    """
    if summary.occlusions is None:
        return ()
    longest, bridged = summary.occlusions.longest, summary.occlusions.bridged
    if capture.smooth is None and not capture.robust:
        bridged = 0
    count = int((longest > bridged).sum())
    if not count:
        return ()
    verb = "is" if count == 1 else "are"
    lasting = f"for more than {bridged} frames" if bridged else "for a frame or more"
    return (
        f"{format_count(count, 'vertex')} {verb} occluded {lasting} in a row, up to "
        f"{longest.max()}: the place is a guess there, which the error does not judge",
    )


def _find_clip_regions(stored: StoredBinding, summary: ClipSummary) -> tuple[Region, ...]:
    """Find the worst regions of a clip; none if its largest deviation is within the usual."""
    binding, has_loose_cage = stored.binding, stored.has_loose_cage
    rms = float(np.sqrt(np.nanmean(summary.frame_rms**2)))
    largest = float(summary.peaks.deviations.max())
    if not has_bad_regions(rms, largest, binding.rest.diagonal):
        return ()
    regions = find_worst_regions(binding, summary.peaks)
    if has_loose_cage is None:  # nothing was said of it when it was bound
        has_loose_cage = is_too_loose(binding.cage, binding.rest)
    if has_loose_cage:
        return attribute_to_loose_cage(regions, binding.rest.diagonal)
    centres = np.array([region.centre for region in regions])
    shared = find_shared_sections(binding.cage, binding.rest, near=centres)
    places = [(section.centre, (section.size + section.length) / 2) for section in shared]
    return attribute_to_shared_places(regions, places, binding.rest.diagonal)
