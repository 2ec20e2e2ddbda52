"""The part of a run that is for captured clips: tolerances, and the solver of their blocks."""

from collections.abc import Iterator
from dataclasses import replace

from cageik_cli.formats.base.sequence import Block, MeshSequence
from cageik_cli.solver.captured import CapturedFrames, FrameWeights
from cageik_cli.solver.captured_blocks import CapturedBlockSolver
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.robust import RobustSolver
from cageik_cli.solver.tolerances import measure_tolerances
from cageik_cli.util.arrays import spread_evenly
from cageik_cli.util.errors import FileAccessError, InputError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.settings import ExtractSettings


def make_capture_solver(
    solver: DualLaplacianSolver,
    sequence: MeshSequence,
    settings: ExtractSettings,
    frame_weights: FrameWeights | None,
    progress: ProgressListener,
) -> CapturedBlockSolver:
    """Return the solver of blocks in which vertices count differently.

    For outliers, some frames are solved twice: their residuals give tolerances, with which those of
    the second time are not led astray by outliers.

    Raises
    ------
    InputError
        When one of these frames cannot be read and must not be skipped.
    """
    capture = CapturedBlockSolver(
        robust=RobustSolver(solver, None),
        frame_weights=frame_weights,
        names=tuple(map(sequence.location, range(len(sequence)))),
        accepts_gaps=settings.accepts_gaps,
    )
    if settings.capture.robust:
        with progress.stage("solve"), limit_blas_threads(1):
            for _ in range(2):
                frames = _read_frames(sequence, capture, settings.skips_bad_frames)
                tolerances = measure_tolerances(capture.robust, frames)
                capture = replace(capture, robust=RobustSolver(solver, tolerances))
    return capture


def _read_frames(
    sequence: MeshSequence, capture: CapturedBlockSolver, skips_bad_frames: bool
) -> Iterator[CapturedFrames]:
    """Read the frames on which tolerances are measured, one by one."""
    is_any = False
    for index in spread_evenly(len(sequence), 16).tolist():
        if index in sequence.missing:
            continue
        try:
            positions = sequence.read_frame(index)[None]
        except InputError:
            if not skips_bad_frames:
                raise
            continue
        is_any = True
        yield capture.complete(Block(index, positions, {}))
    if not is_any:
        raise FileAccessError("none of the frames on which tolerances are measured can be read")
