"""What people read of a report: at most nine lines on how good a result is, and what to do next."""

from collections.abc import Sequence
from textwrap import wrap

from cageik_cli.formats.timeline import format_frame_number
from cageik_cli.report.figures import FrameRecord, KeptSummary, group_digits
from cageik_cli.report.parts import label_vertex, sort_parts
from cageik_cli.report.record import Report
from cageik_cli.report.regions import name_cause
from cageik_cli.report.views.text import format_check_row
from cageik_cli.solver.regions import Cause
from cageik_cli.util.progress import label_note, mark_warning
from cageik_cli.util.text import format_block, format_count, single_line
from cageik_cli.util.units import UNIT_LENGTHS, find_unit

MAX_FRONT_WIDTH = 110
"""Characters of a line of notes, at most."""

NOTE_LABELS = ("note", "warning")
"""Labels of what is counted among the notes."""

UNREAD_LABELS = ("seconds", "cache", "from cage", "from rest")
"""Labels of lines that only -v prints: they say how a command went, not what came of it."""

METRIC_UNITS = ("m", "cm", "mm")
"""Units in which metric lengths are read, the longest first."""


def format_front(
    report: Report, run_notes: Sequence[tuple[str, str]] = (), seconds: float | None = None
) -> str:
    """Write the verdict, the place to look at, the step that helps most, limits and notes.

    Parameters
    ----------
    run_notes : sequence of tuple of str
        Labels and texts of what the run told, beside what the report holds.
    seconds : float, optional
        How long the run took.
    """
    rows = [
        *_list_verdict_rows(report),
        *([] if report.better is None else [("better", report.better)]),
        *_list_limit_rows(report),
        *_list_note_rows([*_list_gap_notes(report), *map(label_note, report.notes), *run_notes]),
    ]
    return "\n".join([single_line(_describe_clip(report, seconds)), *map(format_front_row, rows)])


def format_front_row(labelled_text: tuple[str, str]) -> str:
    """Return one labelled line, whose label has less room than in the full text."""
    label, text = labelled_text
    return single_line(f"  {label:<9} {text}")


def format_brief(headline: str, rows: Sequence[tuple[str, str]]) -> str:
    """Return a headline with labelled lines under it, notes in two lines, and no seconds."""
    facts = [row for row in rows if row[0] not in (*NOTE_LABELS, *UNREAD_LABELS)]
    notes = [row for row in rows if row[0] in NOTE_LABELS]
    noted = _list_note_rows(notes) if notes else []
    return format_block(headline, [*facts, *noted])


def _describe_clip(report: Report, seconds: float | None) -> str:
    clip = report.clip
    origin = "built" if "cage_vertices" in report.settings else "given"
    facts = [
        format_count(clip.frames, "frame"),
        f"{group_digits(clip.vertices)} vertices"
        + (f" in {len(report.parts)} parts" if report.parts else ""),
        f"a cage of {clip.cage_vertices} that was {origin}",
        *([] if report.edited_from is None else [f"edited from {report.edited_from}"]),
        *([] if seconds is None else [f"{seconds:.1f} s"]),
    ]
    return f"{report.result}: {', '.join(facts)}"


def _list_verdict_rows(report: Report) -> list[tuple[str, str]]:
    """Return the word on the result, and where it deviates most; of an edit, how far it moved."""
    rms = (report.summary if report.kept is None else report.kept).rms_percent
    worst, error = _find_worst_frame(report, "rms")
    average = (
        f"{_round(rms)} % of the size on average ({_format_length(report, rms)} of "
        f"{_format_length(report, 100.0, 3)}), {report.vocabulary.worst} frame "
        f"{format_frame_number(worst.number)}: {_round(error)} %"
    )
    for part in sort_parts(report.parts)[:1]:
        if part.rms_percent is not None:
            average += f", {report.vocabulary.worst} part {part.name}: {_round(part.rms_percent)} %"
    label, words = ("moved", "") if report.quality is None else ("quality", f"{report.quality}: ")
    kept = [] if report.kept is None else [("data", _describe_data(report.kept))]
    return [(label, words + average), *kept, ("look at", _describe_worst_place(report))]


def _find_worst_frame(report: Report, metric: str) -> tuple[FrameRecord, float]:
    """Return the frame in which a metric is largest, and that, in percent; over what was kept."""
    name = f"{metric}_percent" if report.kept is None else f"{metric}_kept_percent"
    values = {frame: getattr(frame, name) for frame in report.frames}
    known = {frame: value for frame, value in values.items() if value is not None}
    worst = max(known, key=lambda frame: known[frame])
    return worst, known[worst]


def _describe_data(kept: KeptSummary) -> str:
    """Say how much of the data does not count in the figures."""
    return (
        f"{_round(kept.missing_percent)} % of the vertices are missing, and "
        f"{_round(kept.rejected_percent)} % of the others rejected; neither counts here"
    )


def _describe_worst_place(report: Report) -> str:
    """Say in which frame and where the largest deviation is, and the cause if it is known."""
    frame, percent = _find_worst_frame(report, "max_deviation")
    number, length = format_frame_number(frame.number), _format_length(report, percent)
    text = f"frame {number}: {_round(percent)} % ({length})"
    if report.kept is not None:  # the worst vertex and region may be those of what was rejected
        return text
    if frame.worst_vertex is not None:
        text += f" at vertex {label_vertex(report.parts, frame.worst_vertex)}"
    for region in (report.regions or ())[:1]:
        place = ", ".join(f"{value + 0.0:.3g}" for value in region.centre)
        text += f", near ({place})"
        if region.cause != Cause.UNKNOWN:
            text += f", {name_cause(region)}"
    return text


def _list_limit_rows(report: Report) -> list[tuple[str, str]]:
    """Return a line for each limit that is exceeded or unknown, or one for all that are kept."""
    words = report.vocabulary
    others = [format_check_row(check, words) for check in report.gates if not check.passed]
    rows = [("limits", f"{verdict}: {text}") for verdict, text in others]
    kept = ", ".join(words.limits[check.metric] for check in report.gates if check.passed)
    return [*rows, ("limits", f"kept: {kept}")] if kept else rows


def _list_gap_notes(report: Report) -> list[tuple[str, str]]:
    """Note the frames that were skipped."""
    frames = [frame for frame in report.frames if frame.skipped is not None]
    if not frames:
        return []
    total = format_count(len(report.frames), "frame")
    return [("warning", f"{len(frames)} of {total} skipped: {frames[0].skipped}")]


def _list_note_rows(notes: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return two lines at most: how many notes there are, and the first of them, warnings first."""
    known = dict.fromkeys(note for note in notes if note[0] in NOTE_LABELS)
    order = sorted(known, key=lambda note: note[0] != "warning")
    if not order:
        return [("notes", "none (`verbose=True` shows all figures)")]
    texts = [text if label == "note" else mark_warning(text) for label, text in order]
    text = f"{len(texts)}: {_join_notes(texts)} (`verbose=True` shows all)"
    lines = wrap(text, MAX_FRONT_WIDTH - 12)
    return [("notes", lines[0]), *(("", line) for line in lines[1:])]


def _join_notes(notes: Sequence[str]) -> str:
    """Return as many whole notes as two lines have room for; at least the first, cut at a word."""
    room = 2 * (MAX_FRONT_WIDTH - 12) - 30  # the count, the pointer to all notes, and ragged ends
    shown, *others = notes
    if len(shown) > room:
        return shown[: shown.rfind(" ", 0, room - 4)].rstrip(",;:") + " ..."
    for note in others:
        if len(shown) + len(note) + 2 <= room:
            shown += f"; {note}"
    return shown


def _round(value: float, digits: int = 2) -> str:
    """Format a number, zero or above, with the few digits that are read, and never fewer."""
    return f"{value:.0f}" if value >= 10 ** (digits - 1) else f"{value:#.{digits}g}"


def _format_length(report: Report, percent: float, digits: int = 2) -> str:
    """Return a share of the size, in percent, as a length in the unit of the scene.

    Metric lengths take the unit that suits them.
    """
    size = report.clip.diagonal * percent / 100
    unit = find_unit(report.clip.metres_per_unit)
    if unit in METRIC_UNITS:
        metres = size * report.clip.metres_per_unit
        unit = next((name for name in METRIC_UNITS if metres >= UNIT_LENGTHS[name]), "mm")
        size = metres / UNIT_LENGTHS[unit]
    number = _round(size, digits)
    return number if unit is None else f"{number} {unit}"
