"""The work on one clip, wherever it is done: extract, report, draw the page."""

from cageik_cli.batch.jobs import ClipJob, Outcome, State
from cageik_cli.errors import sentence_of
from cageik_cli.extraction import extract
from cageik_cli.layout import printable
from cageik_cli.observer import Observer
from cageik_cli.report import Entry, entry_of, report_of
from cageik_cli.solving import Crew
from cageik_cli.store.binding_file import StoredBinding


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
        result = extract(job.settings, heard, bound, crew)
        report = report_of(result, job.limits, job.name)
    except Exception as error:
        return Outcome(Entry(job.name, fault=printable(sentence_of(error))), State.FAILED)
    entry = entry_of(report, result=f"{job.name}{job.settings.output.suffix}")
    return Outcome(entry, State.UNCHANGED if heard.was_whole else State.DONE)
