"""The part of a run that is for captured clips: tolerances, and the solver of their blocks."""

from collections.abc import Iterator

from cageik_cli.formats.base.sequence import Block
from cageik_cli.solver.captured import CapturedFrames
from cageik_cli.solver.captured_blocks import CapturedBlockSolver
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.robust import RobustSolver
from cageik_cli.solver.tolerances import choose_tolerance_frames, measure_tolerances
from cageik_cli.util.errors import FileAccessError, InputError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.plan import ExtractionPlan


def make_capture_solver(
    plan: ExtractionPlan, solver: DualLaplacianSolver, progress: ProgressListener
) -> CapturedBlockSolver | None:
    """Return the solver of blocks in which vertices count differently; None for other clips.

    For outliers, some frames are solved twice: their residuals give tolerances, with which those of
    the second time are not led astray by outliers.

    Raises
    ------
    InputError
        When one of these frames cannot be read and must not be skipped.
    """
    if not plan.weighs_frames:
        return None
    tolerances = None
    if plan.settings.capture.robust:
        with progress.stage("solve"), limit_blas_threads(1):
            for _ in range(2):
                capture = _make_solver(plan, RobustSolver(solver, tolerances))
                tolerances = measure_tolerances(capture.robust, _read_frames(plan, capture))
    return _make_solver(plan, RobustSolver(solver, tolerances))


def _make_solver(plan: ExtractionPlan, robust: RobustSolver) -> CapturedBlockSolver:
    return CapturedBlockSolver(
        robust=robust,
        frame_weights=plan.frame_weights,
        names=tuple(map(plan.sequence.location, range(len(plan.sequence)))),
        accepts_gaps=plan.settings.accepts_gaps,
    )


def _read_frames(plan: ExtractionPlan, capture: CapturedBlockSolver) -> Iterator[CapturedFrames]:
    """Read the frames on which tolerances are measured, one by one."""
    is_any = False
    for index in choose_tolerance_frames(len(plan.sequence)).tolist():
        if index in plan.sequence.missing:
            continue
        try:
            positions = plan.sequence.read_frame(index)[None]
        except InputError:
            if not plan.settings.skips_bad_frames:
                raise
            continue
        is_any = True
        yield capture.complete(Block(index, positions, {}))
    if not is_any:
        raise FileAccessError("none of the frames on which tolerances are measured can be read")
