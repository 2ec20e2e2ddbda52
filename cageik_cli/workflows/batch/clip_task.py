"""The work on one clip, wherever it is done: extract, report, draw the page."""

from cageik_cli.report.overview import ClipEntry, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.solver.blocks import BlockExecutor
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.checkpoint import delete_checkpoint
from cageik_cli.store.result import Result, checkpoint_path, has_weights
from cageik_cli.util.errors import CageikError, describe_error
from cageik_cli.util.outputs import make_folder, write_text
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import to_unicode
from cageik_cli.workflows.batch.jobs import CLIPS_FOLDER, ClipJob, ClipState, Outcome
from cageik_cli.workflows.extract import extract, plan_extraction
from cageik_cli.workflows.extract_inputs import load_or_compute_binding, open_inputs
from cageik_cli.workflows.resume import check_output_path


class _UnchangedDetector(ProgressListener):
    """Remembers whether there was nothing to do."""

    is_unchanged = False

    def note(self, topic: str, text: str) -> None:
        self.is_unchanged = self.is_unchanged or topic == "unchanged"


def run_clip(
    job: ClipJob, stored_binding: StoredBinding | None = None, executor: BlockExecutor | None = None
) -> Outcome:
    """Do a job; what goes wrong is in its outcome, and no error of this function.

    Parameters
    ----------
    job : ClipJob
    stored_binding : StoredBinding, optional
        The weights, if they are known.
    executor : BlockExecutor, optional
        Who solves the frames; threads of this process by default.
    """
    detector = _UnchangedDetector()
    try:
        make_folder(job.settings.output.parent)
        result = extract(job.settings, detector, stored_binding, executor)
        return _make_outcome(
            job, result, ClipState.UNCHANGED if detector.is_unchanged else ClipState.DONE
        )
    except Exception as error:
        return make_failed_outcome(job, describe_error(error))


def check_clip(job: ClipJob) -> Outcome | str:
    """What came of a job of which nothing is left to do; else the key of the weights it needs."""
    try:
        make_folder(job.settings.output.parent)
        check_output_path(job.settings.output, job.settings.overwrite, job.settings.resume)
        inputs, existing = plan_extraction(job.settings)
        if existing is not None:
            delete_checkpoint(checkpoint_path(job.settings.output))
            return _make_outcome(job, existing, ClipState.UNCHANGED)
        return inputs.compute_weights_key(job.settings)
    except Exception as error:
        return make_failed_outcome(job, describe_error(error))


def bind_clip(job: ClipJob) -> StoredBinding | None:
    """The weights that a job needs; None if there are none, for each job then says why itself."""
    try:
        return load_or_compute_binding(open_inputs(job.settings), job.settings, ProgressListener())
    except CageikError:
        return None


def make_failed_outcome(job: ClipJob, sentence: str) -> Outcome:
    """The outcome of a job that ended with a sentence; how much is kept of it is none of it."""
    return Outcome(ClipEntry(job.name, fault=to_unicode(sentence)), ClipState.FAILED)


def _make_outcome(job: ClipJob, result: Result, state: ClipState) -> Outcome:
    """The outcome of a job that has a result; its page is written, unless it is there already."""
    report, place = build_report(result, job.limits, job.name), f"{CLIPS_FOLDER}/{job.name}"
    if not job.has_page:
        return Outcome(build_clip_entry(report, f"{place}.h5"), state)
    from cageik_cli.report.html.page import is_page_current, render_result_page

    page = result.path.with_suffix(".html")
    if not is_page_current(page, report, has_weights(result)):
        write_text(page, render_result_page(result, report), overwrite=True)
    return Outcome(build_clip_entry(report, f"{place}.h5", f"{place}.html"), state)
