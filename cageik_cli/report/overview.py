"""The record of many clips, shown by the index page, JUnit and Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import PurePosixPath

import numpy as np

from cageik_cli.report.figures import FrameRecord
from cageik_cli.report.limits import Gap, LimitCheck, Limits, find_gaps
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import (
    EDIT_VOCABULARY,
    EXTRACTION_VOCABULARY,
    QUALITY_WORDS,
    Vocabulary,
)
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.messages import Note


@dataclass(frozen=True, slots=True)
class Curve:
    """A small curve of a clip: the largest value in each of at most 120 spans.

    Attributes
    ----------
    rms_percent : tuple of float or None
        None where all frames of a span were skipped.
    other : tuple of float or None
        Volume change in percent, signed, of largest size; of open models the max deviation.
    worst : int
        The span with the worst frame.
    """

    rms_percent: tuple[float | None, ...]
    other: tuple[float | None, ...]
    worst: int


@dataclass(frozen=True, slots=True)
class ClipEntry:
    """A clip: its report, or the reason why it has none.

    Attributes
    ----------
    name : str
        Its path below the folder of the batch, with forward slashes.
    fault : str, optional
        The message of its failure; it then has no result, page, report and curve.
    result, page : str, optional
        Its files, relative to the overview's, with forward slashes.
    curve : Curve, optional
        A small curve of its error.
    report : Report, optional
        Without its frames, which would fill the memory in a batch of many long clips.
    picture : bytes, optional
        The worst frame, as a PNG file; None without stored weights.
    label : str
        What lists call the clip: its name without what all names share. The overview sets it.
    seconds : float
        That its extraction took; 0 unless the batch is timed.
    """

    name: str
    fault: str | None = None
    result: str | None = None
    page: str | None = None
    report: Report | None = None
    curve: Curve | None = None
    picture: bytes | None = None
    label: str = field(default="", compare=False)
    seconds: float = field(default=0.0, compare=False)

    @property
    def has_failed(self) -> bool:
        """Whether the clip has no result."""
        return self.fault is not None

    @property
    def gates(self) -> tuple[LimitCheck, ...]:
        """The limits on the clip; none if it has failed."""
        return () if self.report is None else self.report.gates

    @property
    def notes(self) -> tuple[Note, ...]:
        """The notes on the clip; none if it has failed."""
        return () if self.report is None else self.report.notes

    @property
    def exceeds_limit(self) -> bool:
        """Whether a metric is above its limit."""
        return any(check.passed is False for check in self.gates)

    @property
    def is_poor(self) -> bool:
        """Whether the clip was extracted, and its cages give it poorly."""
        return self.report is not None and self.report.quality == "poor"

    @property
    def states(self) -> list[str]:
        """What is wrong with a clip that has a result, in words; nothing if all is well."""
        return ["over a limit"] * self.exceeds_limit + [QUALITY_WORDS["poor"]] * self.is_poor

    @property
    def error(self) -> float:
        """The rms of the clip, percent of the diagonal; 0 if it has failed."""
        return 0.0 if self.report is None else self.report.summary.rms_percent

    @property
    def vocabulary(self) -> Vocabulary:
        """The words for the clip."""
        return EXTRACTION_VOCABULARY if self.report is None else self.report.vocabulary

    @property
    def title(self) -> str:
        """The name in a list; that of an edit says what its numbers mean."""
        if self.report is None or self.report.edited_from is None:
            return self.label
        return f"{self.label} (edited: distance moved from {self.report.edited_from})"


@dataclass(frozen=True, slots=True)
class Overview:
    """All clips of a run, in order of their names; it owns the exit code.

    Attributes
    ----------
    notes : sequence of str
        On the run as a whole, such as on files that are no clips.
    limits : mapping of str to Limits
        By the names of the clips that have some.
    """

    clips: Sequence[ClipEntry]
    notes: Sequence[str] = ()
    limits: Mapping[str, Limits] = field(default_factory=dict)

    def __post_init__(self) -> None:
        labels = shorten_names([clip.name for clip in self.clips])
        labelled = [
            replace(clip, label=label) for clip, label in zip(self.clips, labels, strict=True)
        ]
        object.__setattr__(self, "clips", labelled)

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """Clips that the run or the baseline lacks, and that are not allowed."""
        names = [clip.name for clip in self.clips]
        compared = {one.name: one.report.baseline_name for one in self.clips if one.report}
        return find_gaps(names, self.limits, compared)

    @property
    def worst_first(self) -> list[ClipEntry]:
        """Failed clips, those over a limit, poor ones, then the others, largest error first."""
        return sorted(
            self.clips,
            key=lambda clip: (
                not clip.has_failed,
                not clip.exceeds_limit,
                not clip.is_poor,
                -clip.error,
            ),
        )

    @property
    def vocabulary(self) -> Vocabulary:
        """The words for all clips that have metrics: those of edits if each is one."""
        are_edits = [clip.vocabulary is EDIT_VOCABULARY for clip in self.clips if clip.report]
        return EDIT_VOCABULARY if are_edits and all(are_edits) else EXTRACTION_VOCABULARY

    @property
    def exit_code(self) -> int:
        """0 success, 1 all clips failed, 4 some failed, 3 a limit is exceeded or there is a gap."""
        failed = sum(entry.has_failed for entry in self.clips)
        if failed:
            return 1 if failed == len(self.clips) else 4
        return 3 if self.gaps or any(entry.exceeds_limit for entry in self.clips) else 0


def shorten_names(names: Sequence[str]) -> list[str]:
    """Return names of clips without the folders that all begin or end with, and their one suffix.

    They are as different as before. A name that is alone stays.
    """
    if len(set(names)) < 2:
        return list(names)
    parts = [name.split("/") for name in names]
    room = min(map(len, parts)) - 1  # something is left of each
    first = min(_count_shared(zip(*parts, strict=False)), room)
    last = min(_count_shared(zip(*(part[::-1] for part in parts), strict=False)), room - first)
    kept = ["/".join(part[first : len(part) - last]) for part in parts]
    suffix, *others = {PurePosixPath(name).suffix for name in kept}
    is_shared = not others and suffix[1:].isalnum()
    return [name.removesuffix(suffix) for name in kept] if is_shared else kept


def _count_shared(levels: Iterable[tuple[str, ...]]) -> int:
    """Return how many levels from the first on have one name only."""
    return sum(1 for _ in takewhile(lambda level: len(set(level)) == 1, levels))


def build_clip_entry(
    report: Report,
    result: str | None = None,
    page: str | None = None,
    picture: bytes | None = None,
) -> ClipEntry:
    """Build the entry of a report in an overview."""
    count, max_points = len(report.frames), 120  # of a small picture
    spans = np.array_split(np.arange(count), min(count, max_points))
    has_volumes = report.summary.volume_change_percent_max is not None
    other = "volume_change" if has_volumes else "max_deviation_percent"
    curve = Curve(
        rms_percent=tuple(_largest_value(report.frames, span, "rms_percent") for span in spans),
        other=tuple(_largest_value(report.frames, span, other) for span in spans),
        worst=next(k for k, span in enumerate(spans) if report.summary.worst_frame_index in span),
    )
    short = replace(report, frames=())
    return ClipEntry(report.result, None, result, page, short, curve, picture)


def describe_poor(clips: Iterable[ClipEntry]) -> list[str]:
    """Name poor clips, in one sentence for all that the same step would help."""
    by_step: dict[str | None, list[str]] = {}
    for clip in clips:
        if clip.report is not None and clip.is_poor:
            by_step.setdefault(clip.report.better, []).append(clip.label)
    return [
        f"{QUALITY_WORDS['poor']}: {join_truncated(labels)}" + (f"; better: {step}" if step else "")
        for step, labels in by_step.items()
    ]


def _largest_value(frames: Sequence[FrameRecord], span: np.ndarray, name: str) -> float | None:
    """Return the value of largest magnitude, with its sign, of the frames that have one."""
    values = [getattr(frames[k], name) for k in span]
    return max((value for value in values if value is not None), key=abs, default=None)
