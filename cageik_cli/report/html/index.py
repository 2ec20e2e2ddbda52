"""The page over all clips of a batch, with links to theirs."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any
from urllib.parse import quote

from cageik_cli.report.figures import Clip, Summary, change_text, percent_text
from cageik_cli.report.html.templating import rendered
from cageik_cli.report.limits import Verdict, found_text, limit_text, verdict_of
from cageik_cli.report.overview import Curve, Entry, Overview
from cageik_cli.report.vocabulary import Wording, marked, wording_of

HEIGHT, EDGE, STEP = 48, 4, 2
"""Of a thumbnail: units down, units kept free above and below, and units across a point."""


def as_index(overview: Overview) -> str:
    """The page of an overview: those that failed, those over a limit, and the others by error.

    Links are relative to the page. The same overview gives the same page.
    """
    failed = [entry for entry in overview.clips if entry.has_failed]
    done = [entry for entry in overview.worst_first if not entry.has_failed]
    over = sum(entry.exceeds for entry in done)
    counts = [
        ("Failed", len(failed), "bad"),
        ("Over a limit", over, "bad"),
        ("Fine", len(done) - over, "good"),
    ]
    return rendered(
        "index.html.j2",
        total=len(overview.clips),
        verdict=_verdict(len(failed), over, len(overview.clips)),
        counts=counts,
        words=overview.wording,
        failed=failed,
        rows=[
            _row(entry, entry.clip, entry.summary, entry.curve)
            for entry in done
            if entry.clip and entry.summary and entry.curve
        ],
    )


def _verdict(failed: int, over: int, total: int) -> Verdict:
    """What a batch comes to."""
    told = [
        f"{count} of {total} {'clip' if total == 1 else 'clips'} {what}"
        for count, what in ((failed, "failed"), (over, "over a limit"))
        if count
    ]
    if told:
        return Verdict("bad", ", ".join(told))
    return Verdict("good", "All clips are done, and none is over a limit")


def _row(entry: Entry, clip: Clip, summary: Summary, curve: Curve) -> dict[str, Any]:
    change, words = summary.volume_change_percent_max, wording_of(entry.edited_from)
    verdict = verdict_of(entry.gates) if entry.gates else Verdict("none", "none")
    return {
        "name": marked(entry.name, entry.edited_from),
        "href": entry.page and "./" + quote(entry.page, errors="surrogateescape"),
        "error": percent_text(summary.rms_percent),
        "worst_rms": percent_text(summary.worst_frame_rms_percent),
        "worst_frame": summary.worst_frame,
        "deviation": percent_text(summary.max_deviation_percent),
        "volume": _undefined(clip) if change is None else change_text(change),
        "frames": clip.frames,
        "skipped": summary.frames_skipped,
        "vertices": clip.vertices,
        "cage_vertices": clip.cage_vertices,
        "verdict": verdict,
        "rank": {"bad": 0, "none": 1, "good": 2}[verdict.state],
        "passed": [
            f"{words.metric(gate.metric)} {found_text(gate)} > {limit_text(gate, f' {gate.unit}')}"
            for gate in entry.gates
            if gate.passed is False
        ],
        "text": _told(summary, words),
        **_thumbnail(curve),
    }


def _undefined(clip: Clip) -> str:
    """Why there is no change of volume, in a word."""
    return "unknown" if clip.closed else "open"


def _told(summary: Summary, words: Wording) -> str:
    """What a thumbnail shows."""
    change = summary.volume_change_percent_max
    other = (
        f"{words.largest} up to {percent_text(summary.max_deviation_percent)} %"
        if change is None
        else f"volume change up to {change_text(change)} %"
    )
    return (
        f"RMS up to {percent_text(summary.worst_frame_rms_percent)} % at {summary.worst_frame}; "
        + other
    )


def _thumbnail(curve: Curve) -> dict[str, Any]:
    """The lines of a curve as paths, each as high as its largest value."""
    rms, other = _heights(curve.rms_percent), _heights(curve.other)
    return {
        "width": max(STEP * (len(rms) - 1), 1),
        "rms": _path(rms),
        "other": _path(other),
        "worst": f"M{STEP * curve.worst} {rms[curve.worst]}h0",
    }


def _heights(values: Sequence[float | None]) -> list[int | None]:
    """Units from the top; the line's own extremes and zero just fit."""
    known = [value for value in values if value is not None]
    lowest, highest = min([*known, 0.0]), max([*known, 0.0])
    size = (highest - lowest) or 1.0
    return [
        None if value is None else round(EDGE + (HEIGHT - 2 * EDGE) * (highest - value) / size)
        for value in values
    ]


def _path(heights: Sequence[int | None]) -> str:
    """A line through the points, with gaps where there are none; a lone point is a dot."""
    parts = []
    runs = groupby(enumerate(heights), key=lambda point: point[1] is None)
    for is_gap, run in runs:
        if not is_gap:
            points = [f"{STEP * k} {height}" for k, height in run]
            parts.append("M" + " ".join(points) + ("h0" if len(points) == 1 else ""))
    return "".join(parts)
