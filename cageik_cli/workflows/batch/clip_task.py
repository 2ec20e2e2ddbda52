"""The work on one clip, in whatever process: plan, extract, report, write the page."""

from cageik_cli.report.overview import ClipEntry, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.solver.blocks import BlockExecutor
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import Result, has_weights
from cageik_cli.util.errors import CageikError, describe_error
from cageik_cli.util.outputs import make_folder, write_text
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import to_unicode
from cageik_cli.workflows.batch.jobs import CLIPS_FOLDER, ClipJob, ClipState, Outcome
from cageik_cli.workflows.extract import run_extraction
from cageik_cli.workflows.plan import (
    ExtractionPlan,
    build_missing_cage,
    check_output_path,
    load_or_compute_binding,
    plan_extraction,
)


def run_clip(
    job: ClipJob, stored_binding: StoredBinding | None = None, executor: BlockExecutor | None = None
) -> Outcome:
    """Do a job; the outcome holds what failed, and this function raises no error.

    Parameters
    ----------
    stored_binding : StoredBinding, optional
        The weights, if they are known.
    executor : BlockExecutor, optional
        Solves the frames; threads of this process by default.
    """
    try:
        return _run_plan(job, _plan_clip(job, stored_binding), executor)
    except Exception as error:
        return make_failed_outcome(job, describe_error(error))


def check_clip(job: ClipJob) -> Outcome | str:
    """Return the outcome of a job that needs no work; else the key of the weights it needs."""
    try:
        plan = _plan_clip(job)
        return plan.weights_key if plan.existing is None else _run_plan(job, plan)
    except Exception as error:
        return make_failed_outcome(job, describe_error(error))


def bind_clip(job: ClipJob) -> StoredBinding | None:
    """Return the weights that a job needs; None if that fails, for each job reports why itself."""
    try:
        progress = ProgressListener()
        plan = build_missing_cage(plan_extraction(job.settings), progress)
        return load_or_compute_binding(plan, progress)
    except CageikError:
        return None


def _plan_clip(job: ClipJob, stored_binding: StoredBinding | None = None) -> ExtractionPlan:
    make_folder(job.settings.output.parent)
    check_output_path(job.settings)
    return plan_extraction(job.settings, stored_binding)


def _run_plan(job: ClipJob, plan: ExtractionPlan, executor: BlockExecutor | None = None) -> Outcome:
    result = run_extraction(plan, executor=executor)
    state = ClipState.DONE if plan.existing is None else ClipState.UNCHANGED
    return _make_outcome(job, result, state)


def make_failed_outcome(job: ClipJob, sentence: str) -> Outcome:
    """Make the outcome of a job that failed with this message."""
    return Outcome(ClipEntry(job.name, fault=to_unicode(sentence)), ClipState.FAILED)


def _make_outcome(job: ClipJob, result: Result, state: ClipState) -> Outcome:
    """Make the outcome of a job that has a result; write its page unless that is up to date."""
    report, place = build_report(result, job.limits, job.name), f"{CLIPS_FOLDER}/{job.name}"
    if not job.has_page:
        return Outcome(build_clip_entry(report, f"{place}.h5"), state)
    from cageik_cli.report.html.page import render_result_page
    from cageik_cli.report.html.page_mark import is_page_current

    page = result.path.with_suffix(".html")
    has_pictures = has_weights(result)
    has_player = job.has_player and has_pictures
    if not is_page_current(page, report, has_pictures, has_player):
        write_text(page, render_result_page(result, report, has_player), overwrite=True)
    return Outcome(build_clip_entry(report, f"{place}.h5", f"{place}.html"), state)
