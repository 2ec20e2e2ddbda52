"""The jobs of a batch, one per clip: what each does, in whatever process, and its outcome."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol

from cageik_cli.method.solve.settings import AREA
from cageik_cli.report.limits import Limits
from cageik_cli.report.overview import ClipEntry, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.report.render.model_views import draw_thumbnail
from cageik_cli.run.executor import RunBlocks, run_in_threads
from cageik_cli.run.extraction import Extraction
from cageik_cli.run.resume import check_output
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.cache import compute_key
from cageik_cli.store.result import Result, has_weights
from cageik_cli.util.errors import CageikError, InputError, describe_error
from cageik_cli.util.messages import Said, Spelling, spell, spell_keyword
from cageik_cli.util.outputs import make_folder, write_text
from cageik_cli.util.text import to_unicode

if TYPE_CHECKING:
    from cageik_cli.report.html.templating import PlayerPart

CLIPS_FOLDER = "clips"
"""The folder of the clips' results, inside the output folder."""


@dataclass(frozen=True, slots=True)
class ClipJob:
    """The work on one clip of a batch.

    Attributes
    ----------
    name : str
        Its path under the folder of the batch, with forward slashes; unique.
    settings : ExtractSettings
        All paths are absolute. With `resume`, an interrupted run is continued; with `overwrite`,
        results of other files or settings are replaced.
    has_page : bool
        Whether a page is written beside the result.
    load_player : callable, optional
        Reads the player of the page, which else has none.
    spelling : callable
        Writes the settings that messages name, as in `build_report`. It is sent to the process that
        does the job, as `load_player` is.
    """

    name: str
    settings: ExtractSettings
    limits: Limits = field(default_factory=Limits)
    has_page: bool = True
    load_player: "Callable[[Result], PlayerPart | None] | None" = None
    spelling: Spelling = spell_keyword


class ClipState(Enum):
    """How a clip ended in this run."""

    DONE = "done"
    UNCHANGED = "unchanged"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a job.

    Attributes
    ----------
    entry : ClipEntry
        What the report over all clips shows; it does not depend on interruptions of the batch.
    replaced : str
        Of what the result was that this one replaces, such as "other settings"; "" of a new one.
    has_bad_frame : bool
        Whether it failed on a frame, which the run could have left out.
    seconds : float
        That the job took, where it had work.
    """

    entry: ClipEntry
    state: ClipState
    replaced: str = ""
    has_bad_frame: bool = False
    seconds: float = field(default=0.0, compare=False)


class Scheduler(Protocol):
    """Runs jobs; a context manager that leaves no process and no connection behind."""

    def __enter__(self) -> "Scheduler": ...

    def __exit__(self, *error: object) -> None: ...

    def run_jobs(self, jobs: Sequence[ClipJob]) -> Iterator[Outcome]:
        """Yield the outcome of each job, as they end."""


def run_clip(
    job: ClipJob, stored: StoredBinding | None = None, run_blocks: RunBlocks = run_in_threads
) -> Outcome:
    """Do a job; the outcome holds what failed, and this function raises no error."""
    start = time.perf_counter()
    outcome = _extract_clip(job, stored, run_blocks)
    return replace(outcome, seconds=time.perf_counter() - start)


def _extract_clip(job: ClipJob, stored: StoredBinding | None, run_blocks: RunBlocks) -> Outcome:
    extraction = Extraction(job.settings, stored=stored, run_blocks=run_blocks)
    try:
        make_folder(job.settings.output.parent)
        result = extraction.run()
        outcome = _make_outcome(job, result, is_new=extraction.existing is None)
        return replace(outcome, replaced=extraction.replaced)
    except Exception as error:
        outcome = make_failed_outcome(job, describe_error(error))
        if not isinstance(error, InputError) or not hasattr(extraction, "sequence"):
            return outcome
        sequence = extraction.sequence  # an error of a frame names it first
        frames = {sequence.location(k) for k in range(len(sequence))}
        return replace(outcome, has_bad_frame=not frames.isdisjoint(error.locations[:1]))


def check_clip(job: ClipJob) -> Outcome | str:
    """Return the outcome of a job that needs no work; else the key of the weights it needs."""
    try:
        make_folder(job.settings.output.parent)
        check_output(job.settings)
        extraction = Extraction(job.settings)
        extraction.open()
        if extraction.existing is None:
            return compute_weights_key(extraction)
        result = extraction.keep_existing(extraction.existing)
        return _make_outcome(job, result, is_new=False)
    except Exception as error:
        return make_failed_outcome(job, describe_error(error))


def bind_clip(job: ClipJob) -> StoredBinding | None:
    """Return the weights that a job needs; None if that fails, for each job reports why itself."""
    try:
        extraction = Extraction(job.settings)
        extraction.open()
        return extraction.bind()
    except CageikError:
        return None


def compute_weights_key(extraction: Extraction) -> str:
    """Return a digest of what the weights of an opened clip depend on: clips of one share them.

    It does not cover the name of the file of the rest pose, since the frames of two clips have
    different names, nor the number of threads. A cage that is built depends on the rest pose and
    on how it is built alone.
    """
    settings, sources, stored = extraction.settings, extraction.sources, extraction.stored
    shared: dict[str, Any] = {
        name: sources[name] for name in ("cage", "binding") if name in sources
    }
    if settings.builds_cage:
        shared = {"build": asdict(settings.build)}
    if extraction.fit is not None:
        shared |= {
            "fit": asdict(extraction.fit),
            "solve": asdict(settings.solve),
            "weighted": sources.get("vertex_weights", settings.vertex_weights == AREA),
            "memory": settings.memory,
            "skips": settings.skips_bad_frames,
            "clip": (settings.frames, repr(settings.clip), extraction.sequence.names),
        }
    recorded = asdict(settings.bind if stored is None else stored.binding.settings)
    rest = extraction.rest.mesh
    return compute_key(recorded | shared, rest.vertices, rest.faces)


def make_failed_outcome(job: ClipJob, fault: Said) -> Outcome:
    """Make the outcome of a job that failed with this message."""
    entry = ClipEntry(job.name, fault=to_unicode(spell(fault, job.spelling)))
    return Outcome(entry, ClipState.FAILED)


def _make_outcome(job: ClipJob, result: Result, is_new: bool) -> Outcome:
    """Make the outcome of a job that has a result; write its page unless that is up to date."""
    state = ClipState.DONE if is_new else ClipState.UNCHANGED
    report = build_report(result, job.limits, job.name, job.spelling)
    file, picture = f"{CLIPS_FOLDER}/{result.path.name}", draw_thumbnail(result)
    if not job.has_page:
        return Outcome(build_clip_entry(report, file, picture=picture), state)
    from cageik_cli.report.html.page import is_page_current, render_result_page

    page = result.path.with_suffix(".html")
    has_pictures = has_weights(result)
    load_player = job.load_player if has_pictures else None
    if not is_page_current(page, report, has_pictures, load_player is not None):
        player = None if load_player is None else load_player(result)
        text = render_result_page(result, report, player, job.spelling)
        write_text(page, text, overwrite=True)
    return Outcome(build_clip_entry(report, file, f"{CLIPS_FOLDER}/{page.name}", picture), state)
