"""The index page of a batch: one row per clip, with links to the pages of the clips."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any
from urllib.parse import quote

from cageik_cli.report.figures import format_change, format_percent
from cageik_cli.report.html.templating import REPORT_TEMPLATES, make_png_url
from cageik_cli.report.limits import make_overall_verdict
from cageik_cli.report.notes import MAX_FAIR_DEVIATION
from cageik_cli.report.overview import ClipEntry, Curve, Overview, describe_poor
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import QUALITY_WORDS
from cageik_cli.util.text import format_count

THUMBNAIL_HEIGHT, THUMBNAIL_MARGIN, THUMBNAIL_STEP = 48, 4, 2
"""Height of a thumbnail, margin above and below its curves, and width per point."""


def render_index(overview: Overview) -> str:
    """Render the index: failed clips, those over a limit, poor ones, then the others by error.

    Links are relative to the page. The same overview gives the same page.
    """
    failed = [entry for entry in overview.clips if entry.has_failed]
    done = [entry for entry in overview.worst_first if not entry.has_failed]
    over = sum(entry.exceeds_limit for entry in done)
    poor = sum(entry.is_poor for entry in done)
    counts = [
        ("Failed", len(failed), "bad"),
        ("Over a limit", over, "bad"),
        (QUALITY_WORDS["poor"].capitalize(), poor, "warn"),
        ("OK", sum(not entry.states for entry in done), "good"),
    ]
    return REPORT_TEMPLATES.render_page(
        "index.html.j2",
        total=len(overview.clips),
        verdict=_make_batch_verdict(
            len(failed), over, poor, len(overview.gaps), total=len(overview.clips)
        ),
        steps=[*(f"{gap.name}: {gap.text}" for gap in overview.gaps), *describe_poor(done)],
        notes=overview.notes,
        scale_end=f"{MAX_FAIR_DEVIATION:g}",
        counts=counts,
        words=overview.vocabulary,
        poor=QUALITY_WORDS["poor"],
        failed=failed,
        rows=[
            _build_clip_row(entry, entry.report, entry.curve)
            for entry in done
            if entry.report and entry.curve
        ],
    )


def _make_batch_verdict(
    failed: int, over: int, poor: int, gaps: int, *, total: int
) -> tuple[str, str]:
    """Return the verdict on a batch: as `LimitCheck.state` or "warn", and in words."""
    parts = [
        f"{count} of {format_count(total, 'clip')} {what}"
        for count, what in (
            (failed, "failed"),
            (over, "over a limit"),
            (poor, QUALITY_WORDS["poor"]),
        )
        if count
    ]
    if gaps:
        parts.append(f"{format_count(gaps, 'clip')} not in both run and baseline")
    if parts:
        return "bad" if failed or over or gaps else "warn", ", ".join(parts)
    return "good", f"All clips done, none over a limit, none {QUALITY_WORDS['poor']}"


def _make_clip_verdict(entry: ClipEntry) -> tuple[str, str]:
    """Return the verdict on a clip, as that on a batch: on its limits, and on its quality."""
    state, words = make_overall_verdict(entry.gates) if entry.gates else ("none", "")
    report = entry.report
    if entry.is_poor:
        state = "bad" if entry.exceeds_limit else "warn"
    elif report is not None and report.quality == "good" and not entry.gates:
        state = "good"
    parts = (report and report.verdict, words.lower())
    text = ", ".join(part for part in parts if part) or "no limits"
    return state, text.capitalize()


def _build_clip_row(entry: ClipEntry, report: Report, curve: Curve) -> dict[str, Any]:
    clip, summary, words = report.clip, report.summary, report.vocabulary
    change = summary.volume_change_percent_max
    undefined = "unknown" if clip.closed else "open"
    state, verdict = _make_clip_verdict(entry)
    rms, worst_rms = _scale_heights(curve.rms_percent), summary.worst_frame_rms_percent
    other = (
        f"{words.largest} up to {format_percent(summary.max_deviation_percent)} %"
        if change is None
        else f"largest volume change {format_change(change)} %"
    )
    return {
        "name": entry.title,
        "href": entry.page and "./" + quote(entry.page, errors="surrogateescape"),
        "error": format_percent(summary.rms_percent),
        "worst_rms": format_percent(worst_rms),
        "worst_frame": summary.worst_frame,
        "deviation": format_percent(summary.max_deviation_percent),
        "volume": undefined if change is None else format_change(change),
        "frames": clip.frames,
        "skipped": summary.frames_skipped,
        "vertices": clip.vertices,
        "cage_vertices": clip.cage_vertices,
        "state": state,
        "verdict": verdict,
        "rank": {"bad": 0, "warn": 1, "none": 2, "good": 3}[state],
        "picture": entry.picture and make_png_url(entry.picture),
        "exceeded": [
            f"{words.describe_metric(check.metric)} {check.format_found()} > "
            f"{check.format_limit_with_baseline(f' {check.unit}')}"
            for check in entry.gates
            if check.passed is False
        ],
        "text": f"RMS up to {format_percent(worst_rms)} % at {summary.worst_frame}; {other}",
        # The lines of the thumbnail are paths, each scaled to its own largest value.
        "width": max(THUMBNAIL_STEP * (len(rms) - 1), 1),
        "rms": _make_svg_path(rms),
        "other": _make_svg_path(_scale_heights(curve.other)),
        "worst": f"M{THUMBNAIL_STEP * curve.worst} {rms[curve.worst]}h0",
    }


def _scale_heights(values: Sequence[float | None]) -> list[int | None]:
    """Return distances from the top, scaled so that the line's extremes and zero just fit."""
    known = [value for value in values if value is not None]
    lowest, highest = min([*known, 0.0]), max([*known, 0.0])
    size = (highest - lowest) or 1.0
    return [
        None
        if value is None
        else round(
            THUMBNAIL_MARGIN + (THUMBNAIL_HEIGHT - 2 * THUMBNAIL_MARGIN) * (highest - value) / size
        )
        for value in values
    ]


def _make_svg_path(heights: Sequence[int | None]) -> str:
    """Draw a line through the points, with gaps at None; a single point is a dot."""
    parts = []
    runs = groupby(enumerate(heights), key=lambda point: point[1] is None)
    for is_gap, run in runs:
        if not is_gap:
            points = [f"{THUMBNAIL_STEP * k} {height}" for k, height in run]
            parts.append("M" + " ".join(points) + ("h0" if len(points) == 1 else ""))
    return "".join(parts)
