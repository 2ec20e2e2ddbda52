"""The run: blocks of frames through the solver, measured, into the result file."""

from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.coordinates.binding import Binding, reconstruct_frames
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.obj import encode_exact_obj
from cageik_cli.geometry.mesh import MIN_VOLUME_RATIO, TriMesh
from cageik_cli.solver.blocks import BlockExecutor, BlockSolver, SolvedBlock, ThreadExecutor
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.memory_plan import MemoryPlan
from cageik_cli.solver.regions import MIN_DEVIATION, Region
from cageik_cli.solver.summary import ClipSummary
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.cache import compute_key
from cageik_cli.store.checkpoint import Checkpoint, RunSpec, delete_checkpoint
from cageik_cli.store.fit_fields import UnfittedClip
from cageik_cli.store.result import Result, checkpoint_path, read_result, smoothed_path
from cageik_cli.store.result_writer import ResultHeader, RunSummary, open_result_writer
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.files import read_input
from cageik_cli.util.outputs import write_bytes
from cageik_cli.util.progress import ProgressListener, locate_note
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.capture import make_capture_solver
from cageik_cli.workflows.fit import choose_compared_frames, measure_unfitted
from cageik_cli.workflows.plan import (
    ExtractionPlan,
    build_missing_cage,
    check_output_path,
    load_or_compute_binding,
    plan_extraction,
)
from cageik_cli.workflows.regions import find_clip_regions
from cageik_cli.workflows.resume import open_checkpoint, resume_from_checkpoint
from cageik_cli.workflows.settings import ExtractSettings
from cageik_cli.workflows.smooth import run_time_pass


def extract(settings: ExtractSettings, progress: ProgressListener | None = None) -> Result:
    """Extract the cage of every frame and write the result file.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the system is singular or the weights cannot be trusted.
    """
    progress = progress or ProgressListener()
    check_output_path(settings)
    with progress.stage("open"):
        plan = plan_extraction(settings)
    return run_extraction(plan, progress)


def run_extraction(
    plan: ExtractionPlan,
    progress: ProgressListener | None = None,
    executor: BlockExecutor | None = None,
) -> Result:
    """Run a plan, or return the result that exists already.

    Parameters
    ----------
    executor : BlockExecutor, optional
        Solves the blocks of frames; threads of this process by default.

    Raises
    ------
    InputError, NumericalError
        As `extract` does.
    """
    progress = progress or ProgressListener()
    if plan.existing is not None:
        delete_checkpoint(checkpoint_path(plan.settings.output))
        delete_checkpoint(smoothed_path(plan.settings.output))
        progress.note("unchanged", "up to date, nothing to do")
        _write_cage(plan, plan.existing.cage)
        return plan.existing
    plan = build_missing_cage(plan, progress)
    stored_binding = load_or_compute_binding(plan, progress)
    _write_cage(plan, stored_binding.binding.cage)
    # One thread: the matrix is small, and threads that wait for each other take longer.
    with progress.stage("factor"), limit_blas_threads(1):
        solver = DualLaplacianSolver(
            stored_binding.binding, plan.settings.solve, plan.vertex_weights
        )
    header = _make_header(plan, stored_binding, solver)
    executor = executor or ThreadExecutor(plan.settings.jobs)
    capture = make_capture_solver(plan, solver, progress)
    block_solver = BlockSolver(
        plan.sequence, solver, plan.settings.skips_bad_frames, progress, capture
    )
    _solve_and_write(plan, RunOutput(header, stored_binding), block_solver, executor)
    return read_result(plan.settings.output)


def _write_cage(plan: ExtractionPlan, cage: TriMesh) -> None:
    """Write the cage that was built, if that is asked for.

    The file that an interrupted run wrote is kept; another one is replaced only with `overwrite`.
    """
    path = plan.settings.cage_output
    if path is None:
        return
    data = encode_exact_obj(cage.vertices, cage.faces)
    is_kept = plan.settings.resume and path.is_file() and read_input(path) == data
    if not is_kept:
        write_bytes(path, data, plan.settings.overwrite)


@dataclass(frozen=True, slots=True, eq=False)
class RunOutput:
    """What a run writes beside its frames.

    Attributes
    ----------
    filled : tuple of int
        Skipped frames whose cages were filled from those around them.
    """

    header: ResultHeader
    stored: StoredBinding
    filled: tuple[int, ...] = ()

    @property
    def unfitted(self) -> Binding | None:
        """The binding with the weights before the fit, if the result compares them."""
        is_compared = self.header.keep_weights and not self.header.has_kept
        return self.stored.binding.unfitted if is_compared else None

    def plan_memory(self, settings: ExtractSettings) -> MemoryPlan:
        """Plan the blocks of frames beside all weights that are held."""
        unfitted = self.stored.binding.unfitted
        held = 0 if unfitted is None else unfitted.weights.nbytes
        return MemoryPlan.fit(settings.memory - held, self.header.binding, settings.jobs)


def _solve_and_write(
    plan: ExtractionPlan, output: RunOutput, block_solver: BlockSolver, executor: BlockExecutor
) -> None:
    """Solve the frames that the checkpoint does not hold yet, and compose the result of it."""
    settings, sequence, progress = plan.settings, plan.sequence, block_solver.progress
    memory_plan = output.plan_memory(settings)
    tolerances = None if block_solver.capture is None else block_solver.capture.robust.tolerances
    spec = _make_run_spec(plan, output.stored, tolerances)
    # One thread for the products: blocks are solved, and frames read, beside each other.
    with open_checkpoint(settings, spec) as checkpoint, limit_blas_threads(1):
        with progress.stage("read"):
            resume_from_checkpoint(checkpoint, plan, progress)
        starts = range(checkpoint.frames_done, len(sequence), memory_plan.block_size)
        with executor.run_blocks(block_solver, starts, memory_plan) as blocks:
            for block in blocks:
                with progress.stage("write"):
                    checkpoint.append(block)
                progress.update(block.stop, len(sequence))
        if not settings.capture.needs_time_pass or len(checkpoint.summary.skipped) == len(sequence):
            with progress.stage("write"):
                _write_result(plan, output, checkpoint)
            return
        path = smoothed_path(settings.output)
        smoothed = Checkpoint.open(path, checkpoint.spec, resume=False, overwrite=True)
        try:
            filled = run_time_pass(plan, block_solver, checkpoint, smoothed)
            with progress.stage("write"):
                _write_result(plan, replace(output, filled=filled), smoothed)
        finally:
            smoothed.discard()


def _write_result(plan: ExtractionPlan, run_output: RunOutput, checkpoint: Checkpoint) -> None:
    """Compose the result of a complete checkpoint, whose blocks are read once, in order."""
    header, output, summary = run_output.header, plan.settings.output, checkpoint.summary
    if len(summary.skipped) == len(header.frames):
        raise FileAccessError(f"no frame can be read, the first: {summary.skipped[0]}")
    regions = find_clip_regions(header.binding, summary)
    key_frames = _find_key_frames(plan, summary, regions)
    replaces = plan.settings.overwrite or plan.settings.resume
    temporary = output.with_name(f"{output.name}.whole.partial")
    with open_result_writer(output, header, replaces, temporary) as result:
        key_meshes: dict[int, Floats] = {}
        binding = header.binding
        for block in checkpoint.blocks():
            kept = None if block.kept is None else block.kept.metrics
            result.append(block.cages, block.rotations, block.metrics, kept)
            inside = [k for k in key_frames if block.start <= k < block.stop]
            key_meshes |= {k: _rebuild_frame(binding, block, k) for k in inside}
        errors = [
            _reread_frame(plan.sequence, k, summary.digests[k]) - key_meshes[k] for k in key_frames
        ]
        result.complete(
            RunSummary(
                sources=plan.collect_sources(),
                skipped=summary.skipped,
                vertex_rms=summary.vertex_rms,
                key_frames=np.array(key_frames),
                key_frame_errors=np.array(errors),
                regions=regions,
                bound=summary.measure_bound(len(binding.cage.vertices)),
                filled=run_output.filled,
                unfitted=_measure_unfitted(plan, run_output, summary, key_frames),
            )
        )


def _measure_unfitted(
    plan: ExtractionPlan, output: RunOutput, summary: ClipSummary, key_frames: list[int]
) -> UnfittedClip | None:
    """Measure some frames with the weights before the fit, if the result compares them."""
    if output.unfitted is None:
        return None
    known = np.setdiff1d(np.arange(summary.frames_done), list(summary.skipped))
    return measure_unfitted(
        DualLaplacianSolver(output.unfitted, plan.settings.solve, plan.vertex_weights),
        output.header.binding,
        choose_compared_frames(known, key_frames),
        key_frames,
        read=lambda k: _reread_frame(plan.sequence, k, summary.digests[k]),
    )


def _find_key_frames(
    plan: ExtractionPlan, summary: ClipSummary, regions: tuple[Region, ...]
) -> list[int]:
    """Return the worst, the median and the best frame, and that of the worst region.

    Where some frames deviate, those that the rest cage gives exactly are the rest pose: they say
    nothing of the best frame.
    """
    is_rest = summary.frame_rms <= MIN_DEVIATION * plan.rest.mesh.diagonal
    if (is_rest | np.isnan(summary.frame_rms)).all():
        is_rest = np.zeros_like(is_rest)
    if plan.rest_index is not None:
        is_rest[plan.rest_index] = True
    frames: list[int] = summary.find_key_frames(is_rest).tolist()
    return frames + [region.frame for region in regions[:1] if region.frame not in frames]


def _rebuild_frame(binding: Binding, block: SolvedBlock, frame: int) -> Floats:
    """Return the mesh, (m, 3), that the cage of a frame gives."""
    one = slice(frame - block.start, frame - block.start + 1)
    return np.asarray(reconstruct_frames(binding, block.cages[one], block.rotations[one])[0])


def _reread_frame(sequence: MeshSequence, index: int, digest: bytes) -> Floats:
    """Read a frame that was solved again, unless its file has changed since."""
    vertices = sequence.read_frame(index)
    if sequence.digest(index) != digest:
        raise FileAccessError(
            f"{sequence.location(index)}: changed during the run; run again with --resume"
        )
    return vertices


def _make_header(
    plan: ExtractionPlan, stored_binding: StoredBinding, solver: DualLaplacianSolver
) -> ResultHeader:
    return ResultHeader(
        binding=stored_binding.binding,
        quality=solver.quality,
        frames=plan.sequence.names,
        scene=plan.scene,
        settings=plan.recorded_settings,
        notes=_collect_notes(plan, stored_binding, solver.missing_count),
        keep_weights=plan.settings.keep_weights,
        has_kept=plan.weighs_frames,
    )


def _make_run_spec(
    plan: ExtractionPlan, stored: StoredBinding, tolerances: Floats | None
) -> RunSpec:
    binding, weights = stored.binding, plan.vertex_weights
    is_fitted_here = plan.settings.fit is not None
    given = (binding.unfitted if is_fitted_here else None) or binding
    arrays = [binding.rest.vertices, binding.rest.faces, binding.cage.vertices, binding.cage.faces]
    arrays += [given.weights] if weights is None else [given.weights, weights]
    found = [] if tolerances is None else [tolerances]
    if not is_fitted_here:
        arrays += found
    return RunSpec(
        frames=list(plan.sequence.names),
        settings=plan.recorded_settings,
        sources=plan.sources,
        key=compute_key({}, *arrays),
        fit=compute_key({}, binding.weights, *found) if is_fitted_here else "",
        vertices=len(binding.rest.vertices),
        cage_vertices=len(binding.cage.vertices),
    )


def _collect_notes(
    plan: ExtractionPlan, stored_binding: StoredBinding, missing: int
) -> tuple[str, ...]:
    rest = plan.rest
    cage = stored_binding.sources["cage"]["name"]
    notes = [
        *(locate_note(cage, note) for note in stored_binding.binding.notes),
        *(locate_note(rest.source["name"], note) for note in rest.notes),
        *plan.sequence.notes,
    ]
    if not rest.mesh.is_closed:
        holes = np.count_nonzero(~rest.mesh.edges.is_balanced)
        notes.append(
            f"the model is open ({holes} edges without a counterpart), so its volume is not "
            "defined and volume figures are left out"
        )
    elif not rest.mesh.is_body:
        notes.append(
            f"the model is closed, but a sheet: its volume, {rest.mesh.volume:.3g}, is at most "
            f"{MIN_VOLUME_RATIO:g} of its area times its diagonal, so changes of volume are left "
            "out"
        )
    elif missing:
        notes.append(
            f"{missing} vertices of weight 0 are missing data, so volumes of frames are not "
            "known and volume figures are left out"
        )
    return tuple(notes)
