"""The work on one clip, wherever it is done: extract, report, draw the page."""

from cageik_cli.report.overview import Entry, entry_of
from cageik_cli.report.record import report_of
from cageik_cli.solver.blocks import Crew
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.checkpoint import forget
from cageik_cli.store.result import Result, has_weights, partial_name
from cageik_cli.util.errors import CageikError, cause_of
from cageik_cli.util.outputs import make_folder, write_text
from cageik_cli.util.progress import Observer
from cageik_cli.util.text import printable
from cageik_cli.workflows.batch.jobs import CLIPS, ClipJob, Outcome, State
from cageik_cli.workflows.extract import extract, held_result
from cageik_cli.workflows.extract_inputs import bound_of, opened
from cageik_cli.workflows.resume import prepare_result


class _Heard(Observer):
    """Remembers whether there was nothing to do."""

    was_whole = False

    def remark(self, topic: str, text: str) -> None:
        self.was_whole = self.was_whole or topic == "unchanged"


def work_on(job: ClipJob, bound: StoredBinding | None = None, crew: Crew | None = None) -> Outcome:
    """Do a job; what goes wrong is in its outcome, and no error of this function.

    Parameters
    ----------
    job : ClipJob
    bound : StoredBinding, optional
        The weights, if they are known.
    crew : Crew, optional
        Who solves the frames; threads of this process by default.
    """
    heard = _Heard()
    try:
        make_folder(job.settings.output.parent)
        result = extract(job.settings, heard, bound, crew)
        return _reported(job, result, State.UNCHANGED if heard.was_whole else State.DONE)
    except Exception as error:
        return failed(job, cause_of(error))


def looked_at(job: ClipJob) -> Outcome | str:
    """What came of a job of which nothing is left to do; else the key of the weights it needs."""
    try:
        make_folder(job.settings.output.parent)
        prepare_result(job.settings.output, job.settings.overwrite, job.settings.resume)
        inputs, held = held_result(job.settings)
        if held is not None:
            forget(partial_name(job.settings.output))
            return _reported(job, held, State.UNCHANGED)
        return inputs.weights_key(job.settings)
    except Exception as error:
        return failed(job, cause_of(error))


def bound_for(job: ClipJob) -> StoredBinding | None:
    """The weights that a job needs; None if there are none, for each job then says why itself."""
    try:
        return bound_of(opened(job.settings), job.settings, Observer())
    except CageikError:
        return None


def failed(job: ClipJob, sentence: str) -> Outcome:
    """The outcome of a job that ended with a sentence; how much is kept of it is none of it."""
    return Outcome(Entry(job.name, fault=printable(sentence)), State.FAILED)


def _reported(job: ClipJob, result: Result, state: State) -> Outcome:
    """The outcome of a job that has a result; its page is written, unless it is there already."""
    report, place = report_of(result, job.limits, job.name), f"{CLIPS}/{job.name}"
    if not job.has_page:
        return Outcome(entry_of(report, f"{place}.h5"), state)
    from cageik_cli.report.html.page import is_page_of, page_of

    page = result.path.with_suffix(".html")
    if not is_page_of(page, report, has_weights(result)):
        write_text(page, page_of(result, report), overwrite=True)
    return Outcome(entry_of(report, f"{place}.h5", f"{place}.html"), state)
