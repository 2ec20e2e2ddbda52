"""The record of many clips, shown by the index page, JUnit and Markdown."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.report.figures import FrameRecord
from cageik_cli.report.limits import LimitCheck
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import Vocabulary, choose_vocabulary


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
    fault : str, optional
        The message of its failure; it then has no result, page, report and curve.
    result, page : str, optional
        Its files, relative to the overview's, with forward slashes.
    report : Report, optional
        Without its frames, which would fill the memory in a batch of many long clips.
    """

    name: str
    fault: str | None = None
    result: str | None = None
    page: str | None = None
    report: Report | None = None
    curve: Curve | None = None

    @property
    def has_failed(self) -> bool:
        """Whether the clip has no result."""
        return self.fault is not None

    @property
    def gates(self) -> tuple[LimitCheck, ...]:
        """The limits on the clip; none if it has failed."""
        return () if self.report is None else self.report.gates

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes on the clip; none if it has failed."""
        return () if self.report is None else self.report.notes

    @property
    def exceeds_limit(self) -> bool:
        """Whether a metric is above its limit."""
        return any(check.passed is False for check in self.gates)

    @property
    def error(self) -> float:
        """The rms of the clip, percent of the diagonal; 0 if it has failed."""
        return 0.0 if self.report is None else self.report.summary.rms_percent

    @property
    def edited_from(self) -> str | None:
        """The name of the result that was edited; None for an extracted one."""
        return None if self.report is None else self.report.edited_from

    @property
    def vocabulary(self) -> Vocabulary:
        """The words for the clip."""
        return choose_vocabulary(self.edited_from)

    @property
    def title(self) -> str:
        """The name in a list; that of an edited result says what its numbers mean."""
        if self.edited_from is None:
            return self.name
        return f"{self.name} (edited: distance moved from {self.edited_from})"


@dataclass(frozen=True, slots=True)
class Overview:
    """All clips of a run, in order of their names; it owns the exit code."""

    clips: Sequence[ClipEntry]

    @property
    def worst_first(self) -> list[ClipEntry]:
        """Failed clips, then those over a limit, then the others, largest error first."""
        return sorted(
            self.clips, key=lambda clip: (not clip.has_failed, not clip.exceeds_limit, -clip.error)
        )

    @property
    def vocabulary(self) -> Vocabulary:
        """The words for all clips that have metrics."""
        return choose_vocabulary(*(clip.edited_from for clip in self.clips if not clip.has_failed))

    @property
    def exit_code(self) -> int:
        """0 success, 1 all clips failed, 4 some failed, 3 none failed but a limit is exceeded."""
        failed = sum(entry.has_failed for entry in self.clips)
        if failed:
            return 1 if failed == len(self.clips) else 4
        return 3 if any(entry.exceeds_limit for entry in self.clips) else 0


def build_clip_entry(
    report: Report, result: str | None = None, page: str | None = None
) -> ClipEntry:
    """Build the entry of a report in an overview."""
    short = replace(report, frames=())
    return ClipEntry(report.result, None, result, page, short, _build_curve(report))


def _build_curve(report: Report) -> Curve:
    count, max_points = len(report.frames), 120  # of a small picture
    spans = np.array_split(np.arange(count), min(count, max_points))
    other = "volume_change" if report.summary.volume_change_percent_max is not None else None
    return Curve(
        rms_percent=tuple(_largest_value(report.frames, span, "rms_percent") for span in spans),
        other=tuple(
            _largest_value(report.frames, span, other or "max_deviation_percent") for span in spans
        ),
        worst=next(k for k, span in enumerate(spans) if report.summary.worst_frame_index in span),
    )


def _largest_value(frames: Sequence[FrameRecord], span: np.ndarray, name: str) -> float | None:
    """Return the value of largest magnitude, with its sign, of the frames that have one."""
    values = [getattr(frames[k], name) for k in span]
    return max((value for value in values if value is not None), key=abs, default=None)
