"""What people read of a report: at most nine lines on how good a result is, and what to do next."""

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import partial
from textwrap import shorten, wrap

from cageik_cli.formats.timeline import format_frame_number
from cageik_cli.method.solve.regions import Cause
from cageik_cli.report.figures import (
    FrameRecord,
    format_briefly,
    format_scene_length,
)
from cageik_cli.report.record import Report
from cageik_cli.report.regions import label_vertex, name_cause, sort_parts
from cageik_cli.report.views.text import format_check_row
from cageik_cli.report.vocabulary import QUALITY_WORDS
from cageik_cli.util.messages import Hint, spell
from cageik_cli.util.text import format_count, format_row, group_digits, single_line

MAX_FRONT_WIDTH = 110
"""Characters of a line of notes, at most."""

MAX_FRONT_LINES = 9
"""Lines that a command prints, at most, with the one on what it wrote."""

MAX_BRIEF_WIDTH = MAX_FRONT_WIDTH - 17
"""Characters beside the label of a line that a command prints, at most."""

EXACT_ERROR_TOL = 1e-5
"""Percent of the diagonal; errors below it are rounding, in single precision at least."""

NOTE_LABELS = ("note", "warning")
"""Labels of what is counted among the notes."""

UNREAD_LABELS = ("seconds", "cache", "from cage", "from rest")
"""Labels of lines that only -v prints: they say how a command went, not what came of it."""

ALL_FIGURES = str(Hint("verbose", True))
"""What shows all figures, unless a front end says otherwise."""


def format_front(
    report: Report,
    run_notes: Sequence[tuple[str, str]] = (),
    seconds: float | None = None,
    *,
    source: str = ALL_FIGURES,
) -> str:
    """Write the verdict, the place to look at, the step that helps most, limits and notes.

    Parameters
    ----------
    run_notes : sequence of tuple of str
        Labels and texts of what the run told, beside what the report holds.
    seconds : float, optional
        How long the run took.
    source : str
        What shows all figures, as the reader calls it.
    """
    own = [(note.kind, spell(note.located)) for note in report.notes]
    notes = [*_list_gap_notes(report), *own, *run_notes]
    verdict = _wrap_rows(list_verdict_rows(report), MAX_FRONT_WIDTH - 12)
    # Four more are the headline, what is written, and two on what comes next. Limits, which are
    # asked for, do not count.
    count = 2 if len(verdict) < MAX_FRONT_LINES - 5 else 1
    rows = [
        *verdict,
        *_list_limit_rows(report),
        *_list_note_rows(notes, source=source, count=count),
    ]
    return "\n".join([single_line(_describe_clip(report, seconds)), *map(format_front_row, rows)])


def format_front_row(labelled_text: tuple[str, str]) -> str:
    """Return one labelled line, whose label has less room than in the full text."""
    label, text = labelled_text
    return single_line(f"  {label:<9} {text}")


def format_brief(
    headline: str, rows: Sequence[tuple[str, str]], after: int = 1, *, source: str = ALL_FIGURES
) -> str:
    """Return a headline with labelled lines under it, wrapped, and no seconds.

    If there are too many lines, notes are counted, and shown in one or two. Facts for which there
    is still no room are named in a last line; the first is always shown.

    Parameters
    ----------
    after : int
        Lines that the command prints after these, such as what it wrote.
    source : str
        What shows all of it, as the reader calls it.
    """
    read = [row for row in rows if row[0] not in UNREAD_LABELS]
    notes = [row for row in read if row[0] in NOTE_LABELS]
    facts = [row for row in read if row[0] not in NOTE_LABELS]
    first, *others = _wrap_text(headline, MAX_FRONT_WIDTH - 2)
    head = [single_line(first), *(single_line(f"  {line}") for line in others)]
    room = MAX_FRONT_LINES - len(head) - after
    if len(_wrap_rows(read)) <= room:
        return "\n".join([*head, *map(format_row, _wrap_rows(read))])
    is_tight = len(_wrap_rows(facts)) + 2 > room
    noted = _list_note_rows(notes, MAX_BRIEF_WIDTH, source, 2 - is_tight) if notes else []
    rows = [*_pick_facts(facts, room - len(noted), source), *noted]
    return "\n".join([*head, *map(format_row, rows)])


def _pick_facts(facts: Sequence[tuple[str, str]], room: int, source: str) -> list[tuple[str, str]]:
    """Return the wrapped facts for which there is room, and the labels of the others."""
    if len(_wrap_rows(facts)) <= room:
        return _wrap_rows(facts)
    shown, others = _wrap_rows(facts[:1]), []
    for fact in facts[1:]:
        lines = _wrap_rows([fact])
        if len(shown) + len(lines) < room:
            shown += lines
        else:
            others.append(fact[0])
    counts = (label if n == 1 else f"{n} {label}" for label, n in Counter(others).items())
    text, end = ", ".join(counts), f" ({source} shows all)"
    if not others:
        return shown
    return [*shown, ("more", shorten(text + end, MAX_BRIEF_WIDTH, placeholder=f", ...{end}"))]


def _wrap_rows(
    rows: Sequence[tuple[str, str]], width: int = MAX_BRIEF_WIDTH
) -> list[tuple[str, str]]:
    """Return rows of which none is too wide, unless a word is; the label stands in the first.

    A command stays whole, so that it can be copied.
    """
    return [
        ("" if k else label, line)
        for label, text in rows
        for k, line in enumerate([text] if label == "to repair" else _wrap_text(text, width))
    ]


def _wrap_text(text: str, width: int) -> list[str]:
    return wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]


def _describe_clip(report: Report, seconds: float | None) -> str:
    clip = report.clip
    origin = "built" if "cage_vertices" in report.settings else "given"
    facts = [
        format_count(clip.frames, "frame"),
        f"{group_digits(clip.vertices)} vertices"
        + (f" in {len(report.parts)} parts" if report.parts else ""),
        f"a cage of {clip.cage_vertices} that was {origin}",
        *map(" ".join, report.origin_rows),
        *([] if seconds is None else [f"{seconds:.1f} s"]),
    ]
    return f"{report.result}: {', '.join(facts)}"


def list_verdict_rows(report: Report) -> list[tuple[str, str]]:
    """Return the word on the result, where it deviates most, and the step that helps most.

    Of an edit, they say how far it moved.
    """
    rms = report.counted.rms_percent
    worst, error = find_worst_frame(report, "rms")
    length, size = format_scene_length(report.clip, rms), format_scene_length(report.clip, 100.0, 3)
    average = f"{_format_error(rms)} of the size on average ({length} of {size})"
    most = report.vocabulary.worst
    frame = f"{most} frame {format_frame_number(worst.number)}: {_format_error(error)}"
    parts = [
        f"{most} part {part.name}: {_format_error(part.rms_percent)}"
        for part in sort_parts(report.parts)[:1]
        if part.rms_percent is not None
    ]
    label, words = ("moved", "") if report.verdict is None else ("quality", f"{report.verdict}: ")
    average = _take_fitting(
        ", ".join([words + average, *facts]) for facts in ([frame, *parts], parts, [frame]) if facts
    )
    if report.quality is not None and report.counted.max_deviation_percent < EXACT_ERROR_TOL:
        average = f"{words}exact"
    kept = [("data", text) for text in _describe_data(report)]
    better = [] if report.better is None else [("better", report.better + _format_gain(report))]
    deviation = report.counted.max_deviation_percent
    place = [] if deviation < EXACT_ERROR_TOL else [("look at", _describe_worst_place(report))]
    return [(label, average), *kept, *place, *better]


def _format_gain(report: Report) -> str:
    """Say what the advised step has gained where it was tried; nothing if it was not."""
    gain = report.gain
    if gain is None:
        return ""
    before, after = map(_format_error, (gain.before_percent, gain.after_percent))
    return f" ({before} to {after} on {format_count(gain.frames, 'frame')})"


def _take_fitting(texts: Iterable[str]) -> str:
    """Return the first text that fits in a line of the verdict; the last, if none does."""
    found = list(texts)
    return next((text for text in found if len(text) <= MAX_FRONT_WIDTH - 12), found[-1])


def _format_error(percent: float) -> str:
    """Format an error in percent."""
    return f"{format_briefly(percent)} %"


def find_worst_frame(report: Report, metric: str) -> tuple[FrameRecord, float]:
    """Return the frame in which a metric is largest, and that, in percent; over what was kept."""
    name = f"{metric}_percent" if report.kept is None else f"{metric}_kept_percent"
    values = {frame: getattr(frame, name) for frame in report.frames}
    known = {frame: value for frame, value in values.items() if value is not None}
    worst = max(known, key=lambda frame: known[frame])
    return worst, known[worst]


def _describe_data(report: Report) -> list[str]:
    """Say in a row how much of the data does not count in the figures; in none if all does.

    How far off missing data may be is what was measured on data that was hidden on purpose.
    """
    kept, hidden, doubt = report.kept, report.hidden, describe_doubt(report)
    if kept is None or not (kept.missing_percent or kept.rejected_percent):
        return [doubt] if doubt else []
    missing, rejected = (
        f"{format_briefly(percent)} % of the"
        for percent in (kept.missing_percent, kept.rejected_percent)
    )
    off = ""
    if hidden is not None:
        off = f" (others, hidden on purpose, are off by {_format_error(hidden.rms_percent)})"
    if kept.missing_percent and kept.rejected_percent:
        count = doubt or "neither counts here"
        return [f"{missing} vertices are missing{off}, and {rejected} others rejected; {count}"]
    count = doubt or "they do not count here"
    if kept.missing_percent:
        return [f"{missing} vertices are missing; {count}{off}"]
    return [f"{rejected} vertices are rejected; {count}"]


def describe_doubt(report: Report) -> str:
    """Say why a result is only fair whose figures are good; nothing of any other."""
    if report.doubt is None:
        return ""
    reason = "the error of missing vertices is unknown"
    if report.doubt == "torn":
        reason = "pieces of the input jump apart from the surface around them"
    if report.doubt == "rejected":
        rms, largest = report.summary.rms_percent, report.summary.max_deviation_percent
        reason = f"all data is off by {_format_error(rms)}, at most {_format_error(largest)}"
    return f"{reason}, so {QUALITY_WORDS['fair']} at best"


def _describe_worst_place(report: Report) -> str:
    """Say in which frame and where the largest deviation is, and the cause if it is known."""
    frame, percent = find_worst_frame(report, "max_deviation")
    number, length = format_frame_number(frame.number), format_scene_length(report.clip, percent)
    text = f"frame {number}: {format_briefly(percent)} % ({length})"
    if report.kept is not None:  # the worst vertex and region may be those of what was rejected
        return text
    vertex = place = cause = ""
    if frame.worst_vertex is not None:
        vertex = f" at vertex {label_vertex(report.parts, frame.worst_vertex)}"
    for region in (report.regions or ())[:1]:
        place = f" near ({', '.join(f'{value + 0.0:.3g}' for value in region.centre)})"
        cause = "" if region.cause == Cause.UNKNOWN else f", {name_cause(region)}"
    both = f"{vertex}," if vertex and place else vertex
    return _take_fitting(f"{text}{where}{cause}" for where in (both + place, vertex, place))


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
    return [("warning", f"{group_digits(len(frames))} of {total} skipped: {frames[0].skipped}")]


def _list_note_rows(
    notes: Sequence[tuple[str, str]],
    width: int = MAX_FRONT_WIDTH - 12,
    source: str = ALL_FIGURES,
    count: int = 2,
) -> list[tuple[str, str]]:
    """Return `count` lines at most: how many notes there are, and the first, warnings first."""
    known = dict.fromkeys(note for note in notes if note[0] in NOTE_LABELS)
    order = sorted(known, key=lambda note: note[0] != "warning")
    if not order:
        return [("notes", f"none ({source} shows all figures)")]
    texts = [text if label == "note" else f"{label}: {text}" for label, text in order]
    end = f" ({source} shows all)"
    room = count * width - 30  # the count, the pointer to all notes, and ragged ends
    shown = f"{len(texts)}: {_join_notes(texts, room)}"
    break_lines = partial(wrap, width=width, break_long_words=False, break_on_hyphens=False)
    lines = break_lines(shown + end, max_lines=count, placeholder=f" ...{end}")
    # The pointer to all notes is worth no line of its own where none is left out.
    if shown.endswith(": " + "; ".join(texts)) and len(plain := break_lines(shown)) < len(lines):
        lines = plain
    return [("notes", lines[0]), *(("", line) for line in lines[1:])]


def _join_notes(notes: Sequence[str], room: int) -> str:
    """Return as many whole notes as there is room for; at least the first, cut at a word."""
    shown, *others = notes
    if len(shown) > room:
        return shown[: shown.rfind(" ", 0, room - 4)].rstrip(",;:") + " ..."
    for note in others:
        if len(shown) + len(note) + 2 <= room:
            shown += f"; {note}"
    return shown
