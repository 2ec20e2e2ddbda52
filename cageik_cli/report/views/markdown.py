"""The report as Markdown, for the summary page of a run in continuous integration."""

import re
from collections import Counter
from collections.abc import Iterable

from cageik_cli.report.figures import format_change, format_percent
from cageik_cli.report.fit_rows import format_fit_line
from cageik_cli.report.overview import ClipEntry, Overview, describe_poor
from cageik_cli.report.regions import describe_region
from cageik_cli.report.views.text import format_check_row
from cageik_cli.report.vocabulary import QUALITY_WORDS, Vocabulary
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.text import format_count, group_digits, single_line

MAX_TEXT_LENGTH = 300
"""Characters of a name or a sentence that are shown; longer ones are cut."""


def format_markdown(overview: Overview) -> str:
    """Write the verdict, a table of the clips, worst first, failures and exceeded limits.

    Each part has a share of 60 000 bytes, less those of headings; lines without room are counted.
    Percentages are of the diagonal, those of volumes of the volume.
    """
    clips = overview.worst_first
    rows = _fit_lines((_format_table_row(entry) for entry in clips), 21_000, "| {} |")
    table = [_table_header(overview.vocabulary), "|---|---|---:|---:|---|---:|---:|", *rows]
    over = [(one, check) for one in clips for check in one.gates if check.passed is False]
    reports = [(one, one.report) for one in clips if one.report]
    parts = {
        "Failed": (9_500, [_make_item(one, one.fault) for one in clips if one.has_failed]),
        "Not in both run and baseline": (
            3_000,
            [f"- {_escape_markdown(f'{gap.name}: {gap.text}')}" for gap in overview.gaps],
        ),
        "Over a limit": (
            6_500,
            [_make_item(one, format_check_row(check, one.vocabulary)[1]) for one, check in over],
        ),
        QUALITY_WORDS["poor"].capitalize(): (
            3_000,
            [f"- {_escape_markdown(line)}" for line in describe_poor(clips)],
        ),
        "Worst regions": (
            5_000,
            [_make_item(one, describe_region(r.regions[0])) for one, r in reports if r.regions],
        ),
        "Fitted weights": (
            5_000,
            [_make_item(one, format_fit_line(r.fit.report)) for one, r in reports if r.fit],
        ),
        "Notes": (5_000, _list_notes(overview)),
    }
    counts = Counter(map(_name_clip_verdict, clips))
    verdicts = ", ".join(f"{group_digits(count)} {verdict}" for verdict, count in counts.items())
    head = f"## cageik: {format_count(len(clips), 'clip')}: {verdicts}"
    blocks = [head, "\n".join(table)]
    for heading, (max_bytes, lines) in parts.items():
        if lines:
            blocks += [f"### {heading}", "\n".join(_fit_lines(lines, max_bytes, "- {}"))]
    return "\n\n".join(blocks) + "\n"


def _make_item(entry: ClipEntry, text: str | None) -> str:
    """Return what is said of a clip as an item of a list."""
    return f"- {_escape_markdown(entry.label)}: {_escape_markdown(text)}"


def _table_header(words: Vocabulary) -> str:
    return (
        f"| clip | verdict | {words.limits['rms']}, % | {words.worst_frame}, % | frame "
        f"| {words.largest}, % | volume change, % |"
    )


def _format_table_row(entry: ClipEntry) -> str:
    if entry.report is None:
        cells = ["", "", "", "", ""]
    else:
        summary = entry.report.summary
        change = summary.volume_change_percent_max
        cells = [
            format_percent(summary.rms_percent),
            format_percent(summary.worst_frame_rms_percent),
            _escape_markdown(summary.worst_frame),
            format_percent(summary.max_deviation_percent),
            "not defined" if change is None else format_change(change),
        ]
    verdict = _name_clip_verdict(entry)
    if entry.has_failed or entry.exceeds_limit or entry.is_poor:
        verdict = f"**{verdict}**"
    name = _escape_markdown(entry.title)
    return f"| {' | '.join([name, verdict, *cells])} |"


def _name_clip_verdict(entry: ClipEntry) -> str:
    if entry.has_failed:
        return "failed"
    if entry.exceeds_limit:
        return "over limit"
    is_within = any(check.passed for check in entry.gates)
    if entry.is_poor:
        return QUALITY_WORDS["poor"] + ", within limits" * is_within
    if is_within:
        return "within limits"
    return entry.vocabulary.done


def _list_notes(overview: Overview) -> list[str]:
    """List the notes on the run, then those on clips: each once, behind the clips that have it."""
    clips: dict[str, list[str]] = {}
    for entry in overview.worst_first:
        for note in dict.fromkeys(map(str, entry.notes)):
            clips.setdefault(note, []).append(entry.label)
    return [f"- {_escape_markdown(note)}" for note in overview.notes] + [
        f"- {_escape_markdown(join_truncated(labels))}: {_escape_markdown(note)}"
        for note, labels in sorted(clips.items(), key=lambda one: -len(one[1]))
    ]


def _fit_lines(lines: Iterable[str], max_bytes: int, rest_template: str) -> list[str]:
    """Return as many lines as have room, and one that counts the others."""
    waiting = list(lines)
    shown_lines: list[str] = []
    for line in waiting:
        max_bytes -= len(line.encode()) + 1
        if max_bytes < 0:
            break
        shown_lines.append(line)
    left = len(waiting) - len(shown_lines)
    return (
        [*shown_lines, rest_template.format(f"and {group_digits(left)} more")]
        if left
        else shown_lines
    )


def _escape_markdown(text: str | None) -> str:
    """Escape text for Markdown and HTML, on one line, cut when very long."""
    line = single_line(text or "").strip()
    if len(line) > MAX_TEXT_LENGTH:
        line = line[: MAX_TEXT_LENGTH - 1] + "…"
    line = re.sub(r"([\\`*_{}\[\]<>&|~$@:!#])", r"\\\1", line)
    return re.sub(r"^(\d*)([-+=.)])", r"\1\\\2", line)  # marks of lists and underlined headings
