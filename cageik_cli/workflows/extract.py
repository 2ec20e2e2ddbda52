"""The run: blocks of frames through the solver, measured, into the result file."""

import hashlib
from dataclasses import asdict
from typing import Any

import numpy as np

from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.solver.blocks import (
    BlockExecutor,
    BlockSolver,
    MemoryPlan,
    ThreadExecutor,
    summarize_blocks,
)
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.checkpoint import Checkpoint, RunSpec, delete_checkpoint
from cageik_cli.store.result import Result, checkpoint_path, read_result
from cageik_cli.store.result_writer import ResultHeader, RunSummary, open_result_writer
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.extract_inputs import (
    ExtractSettings,
    Inputs,
    load_or_compute_binding,
    open_inputs,
    resolve_scene,
)
from cageik_cli.workflows.resume import (
    check_output_path,
    find_existing_result,
    open_checkpoint,
    resume_from_checkpoint,
)


def extract(
    settings: ExtractSettings,
    progress: ProgressListener | None = None,
    stored_binding: StoredBinding | None = None,
    executor: BlockExecutor | None = None,
) -> Result:
    """Extract the cage of every frame and write the result file.

    Parameters
    ----------
    settings : ExtractSettings
    progress : ProgressListener, optional
        Told how it goes on.
    stored_binding : StoredBinding, optional
        The weights, if they are known: of this rest pose, cage and settings.
    executor : BlockExecutor, optional
        Who solves the blocks of frames; threads of this process by default.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the system is singular or the weights cannot be trusted.
    """
    progress = progress or ProgressListener()
    check_output_path(settings.output, settings.overwrite, settings.resume)
    with progress.stage("open"):
        inputs, existing = plan_extraction(settings, stored_binding)
    if existing is not None:
        delete_checkpoint(checkpoint_path(settings.output))
        progress.note("unchanged", "the result is whole already")
        return existing
    with progress.stage("bind"):
        stored_binding = stored_binding or load_or_compute_binding(inputs, settings, progress)
    # One thread: the matrix is small, and threads that wait for each other take longer.
    with progress.stage("factor"), limit_blas_threads(1):
        solver = DualLaplacianSolver(stored_binding.binding, settings.solve, inputs.vertex_weights)
    header = ResultHeader(
        binding=stored_binding.binding,
        quality=solver.quality,
        frames=inputs.sequence.names,
        scene=resolve_scene(settings, inputs),
        settings=_recorded_settings(settings, inputs),
        notes=_collect_notes(inputs, stored_binding, solver.missing_count),
        keep_weights=settings.keep_weights,
    )
    memory_plan = MemoryPlan.fit(settings.memory, stored_binding.binding, settings.jobs)
    checkpoint_file, spec = (
        checkpoint_path(settings.output),
        _make_run_spec(header, inputs, memory_plan.block_size),
    )
    block_solver = BlockSolver(inputs.sequence, solver, settings.on_bad_frame == "skip", progress)
    # One thread for the products: blocks are solved, and frames read, beside each other.
    with (
        open_checkpoint(checkpoint_file, spec, settings.resume, settings.overwrite) as checkpoint,
        limit_blas_threads(1),
    ):
        with progress.stage("read"):
            resume_from_checkpoint(
                checkpoint, inputs.sequence, block_solver.skips_bad_frames, settings.jobs, progress
            )
        starts = range(checkpoint.frames_done, len(inputs.sequence), checkpoint.spec.block)
        with (executor or ThreadExecutor(settings.jobs)).run_blocks(
            block_solver, starts, memory_plan
        ) as made:
            for block in made:
                with progress.stage("write"):
                    checkpoint.append(block)
                progress.update(block.stop, len(inputs.sequence))
        with progress.stage("write"):
            _write_result(checkpoint, header, inputs, settings)
    return read_result(settings.output)


def plan_extraction(
    settings: ExtractSettings, stored_binding: StoredBinding | None = None
) -> tuple[Inputs, Result | None]:
    """What a run would be given; and the result, if there is a whole one of just that already.

    Raises
    ------
    InputError
        Naming the file at fault; or when there is another result that may not be overwritten.
    """
    inputs = open_inputs(settings, stored_binding)
    if not settings.resume:
        return inputs, None
    return inputs, find_existing_result(settings, inputs, _recorded_settings(settings, inputs))


def _make_run_spec(header: ResultHeader, inputs: Inputs, block: int) -> RunSpec:
    binding, weights = header.binding, inputs.vertex_weights
    arrays = [binding.rest.vertices, binding.rest.faces, binding.cage.vertices, binding.cage.faces]
    arrays += [binding.weights] if weights is None else [binding.weights, weights]
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return RunSpec(
        frames=list(header.frames),
        settings=header.settings,
        sources=inputs.sources,
        key=digest.hexdigest(),
        vertices=len(binding.rest.vertices),
        cage_vertices=len(binding.cage.vertices),
        block=block,
    )


def _write_result(
    checkpoint: Checkpoint, header: ResultHeader, inputs: Inputs, settings: ExtractSettings
) -> None:
    """Write the result from the log, which is gone through twice."""
    output = settings.output
    temporary = output.with_name(f"{output.name}.whole.partial")
    summary = summarize_blocks(checkpoint.blocks())
    if len(summary.skipped) == len(header.frames):
        raise InputError(f"no frame can be read, the first: {summary.skipped[0]}")
    replaces = settings.overwrite or settings.resume
    with open_result_writer(output, header, replaces, temporary) as result:
        key_cages: dict[int, Floats] = {}
        for block in checkpoint.blocks():
            result.append(block.cages, block.metrics)
            key_cages |= {
                k: block.get_cage(k) for k in summary.key_frames if block.start <= k < block.stop
            }
        offsets = [
            _reread_frame(inputs.sequence, k, summary.digests[k])
            - header.binding.weights @ key_cages[k]
            for k in summary.key_frames
        ]
        sources = inputs.sources | {"frames": inputs.sequence.describe_source()}
        result.complete(
            RunSummary(
                sources, summary.skipped, summary.vertex_rms, summary.key_frames, np.array(offsets)
            )
        )


def _reread_frame(sequence: MeshSequence, index: int, digest: bytes) -> Floats:
    """A frame that was solved, unless it is another by now."""
    vertices = sequence.read_frame(index)
    if sequence.digest(index) != digest:
        raise InputError(
            f"{sequence.location(index)}: changed while the run went on; run again with --resume"
        )
    return vertices


def _recorded_settings(settings: ExtractSettings, inputs: Inputs) -> dict[str, Any]:
    """The settings on which the numbers depend."""
    solve = settings.solve
    return {
        "alpha": solve.alpha,
        "beta": solve.beta,
        "align": solve.align,
        **asdict(inputs.choose_bind_settings(settings)),
        "rest_frame": settings.rest_frame if settings.rest is None else None,
        "vertex_weights": settings.vertex_weights is not None,
    }


def _collect_notes(inputs: Inputs, stored_binding: StoredBinding, missing: int) -> tuple[str, ...]:
    rest = inputs.rest
    cage = stored_binding.sources["cage"]["name"]
    notes = [
        *(f"{cage}: {note}" for note in stored_binding.binding.notes),
        *(f"{rest.source['name']}: {note}" for note in rest.notes),
        *inputs.sequence.notes,
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
