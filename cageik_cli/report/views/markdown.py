"""The report as Markdown, for the summary page of a run in continuous integration."""

import re
from collections import Counter
from collections.abc import Iterable

from cageik_cli.report.figures import percent_text
from cageik_cli.report.overview import Entry, Overview
from cageik_cli.report.views.text import gate_row
from cageik_cli.report.vocabulary import Wording, marked, wording_of
from cageik_cli.util.text import shown

ROOM = {"clips": 24_000, "failed": 12_000, "limits": 12_000, "notes": 8_000}
"""Bytes of the lines of each part; with headings all is under 60 000."""

LONGEST = 300
"""Characters of a name or a sentence that are shown."""

_RULE = "|---|---|---:|---:|---|---:|---:|"


def as_markdown(overview: Overview) -> str:
    """The verdict, a table of the clips, worst first, and what failed or is over its limit.

    Each part has a share of 60 000 bytes; what has no room is counted. Percentages are of the
    diagonal, volumes' of the volume.
    """
    clips = overview.worst_first
    rows = _fitting((_row(entry) for entry in clips), ROOM["clips"], "| {} |")
    table = [_header(overview.wording), _RULE, *rows]
    failed = [
        f"- {_plain(entry.name)}: {_plain(entry.fault)}" for entry in clips if entry.has_failed
    ]
    limits = [
        f"- {_plain(entry.name)}: {_plain(gate_row(gate, wording_of(entry.edited_from))[1])}"
        for entry in clips
        for gate in entry.gates
        if gate.passed is False
    ]
    parts = {"Failed": (failed, "failed"), "Over a limit": (limits, "limits"),
             "Notes": (_notes(clips), "notes")}  # fmt: skip
    blocks = [f"## cageik: {_verdict(overview)}", "\n".join(table)]
    for heading, (lines, room) in parts.items():
        if lines:
            blocks += [f"### {heading}", "\n".join(_fitting(lines, ROOM[room], "- {}"))]
    return "\n\n".join(blocks) + "\n"


def _header(words: Wording) -> str:
    return (
        f"| clip | verdict | {words.limits['rms']}, % | {words.worst_frame}, % | at "
        f"| {words.largest}, % | volume change, % |"
    )


def _verdict(overview: Overview) -> str:
    """The run in a line: how many clips there are of each verdict, the worst first."""
    clips = overview.worst_first
    counts = Counter(map(_clip_verdict, clips))
    found = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return f"{len(clips)} clip{'' if len(clips) == 1 else 's'}: {found}"


def _row(entry: Entry) -> str:
    summary = entry.summary
    if summary is None:
        cells = ["", "", "", "", ""]
    else:
        change = summary.volume_change_percent_max
        cells = [
            percent_text(summary.rms_percent),
            percent_text(summary.worst_frame_rms_percent),
            _plain(summary.worst_frame),
            percent_text(summary.max_deviation_percent),
            "not defined" if change is None else f"{change:+.4f}",
        ]
    verdict = _clip_verdict(entry)
    if entry.has_failed or entry.exceeds:
        verdict = f"**{verdict}**"
    name = _plain(marked(entry.name, entry.edited_from))
    return f"| {' | '.join([name, verdict, *cells])} |"


def _clip_verdict(entry: Entry) -> str:
    if entry.has_failed:
        return "failed"
    if entry.exceeds:
        return "over limit"
    if any(gate.passed for gate in entry.gates):
        return "within limits"
    return wording_of(entry.edited_from).done


def _notes(clips: Iterable[Entry]) -> list[str]:
    """Each note once, and how many clips have it."""
    counts = Counter(note for entry in clips for note in entry.notes)
    return [
        f"- {_plain(note)}" + (f" ({count} clips)" if count > 1 else "")
        for note, count in counts.most_common()
    ]


def _fitting(lines: Iterable[str], room: int, rest: str) -> list[str]:
    """As many of the lines as have room, and one that counts the others."""
    waiting = list(lines)
    shown_lines: list[str] = []
    for line in waiting:
        room -= len(line.encode()) + 1
        if room < 0:
            break
        shown_lines.append(line)
    left = len(waiting) - len(shown_lines)
    return [*shown_lines, rest.format(f"and {left} more")] if left else shown_lines


def _plain(text: str | None) -> str:
    """Text that Markdown and HTML leave as it is, on one line, cut when very long."""
    line = shown(text or "").strip()
    if len(line) > LONGEST:
        line = line[: LONGEST - 1] + "…"
    line = re.sub(r"([\\`*_{}\[\]<>&|~$@:!#])", r"\\\1", line)
    return re.sub(r"^(\d*)([-+=.)])", r"\1\\\2", line)  # what begins a list, or underlines
