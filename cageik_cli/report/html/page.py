"""The report as a page: one HTML file that needs no other, for a browser or a printer."""

import hashlib
from pathlib import Path
from typing import Any

from cageik_cli.report.figures import (
    VertexFigures,
    change_text,
    figure_text,
    percent_text,
    units_text,
)
from cageik_cli.report.html.frames_table import FRAME, NAME, columns_of, quality_rows, row_of
from cageik_cli.report.html.templating import data_url, rendered
from cageik_cli.report.limits import PERCENT, Gate, found_text, gate_verdict, limit_text, verdict_of
from cageik_cli.report.plots.error_plot import plot_of
from cageik_cli.report.record import Report
from cageik_cli.report.render.model_views import Pictures, pictures_of, poses_of
from cageik_cli.report.views.tables import as_json
from cageik_cli.report.vocabulary import SETTINGS, Wording, wording_of
from cageik_cli.store.result import Result

SECTIONS = (
    ("verdict", "Verdict"),
    ("course", "{measure} over the frames"),
    ("poses", "Poses"),
    ("spread", "Spread"),
    ("where", "Where"),
    ("weights", "Weights"),
    ("settings", "Settings and sources"),
    ("notes", "Notes"),
    ("frames", "Frames"),
    ("reading", "How to read"),
)

TICKS = 5
"""Of a scale."""

FINEST = 0.01
"""Percent: a histogram that ends lower has more digits than percent are printed with elsewhere."""

HEAD = 512
"""Bytes of a page that hold its mark."""


def as_html(report: Report, pictures: Pictures | None) -> str:
    """The page of a report.

    Parameters
    ----------
    report : Report
    pictures : Pictures, optional
        None for a result without weights; the page then says why it has none.

    Returns
    -------
    str
        The same for the same arguments.
    """
    columns, words = columns_of(report), wording_of(report.edited_from)
    return rendered(
        "page.html.j2",
        report=report,
        digest=record_digest(report),
        words=words,
        sections=[
            (place, text.format(measure=words.measure.capitalize())) for place, text in SECTIONS
        ],
        verdict=verdict_of(report.gates),
        gates=[_gate_row(gate, words) for gate in report.gates],
        plot=_plot(report),
        pictures=pictures,
        **(_picture_values(pictures, words) if pictures else {}),
        histogram=_histogram(report.vertices),
        quality=quality_rows(report),
        settings=[
            (name, _plain(value), SETTINGS.get(name, "")) for name, value in report.settings.items()
        ],
        sources=[(role.replace("_", " "), _facts(source)) for role, source in _sorted(report)],
        columns=(FRAME, NAME, *columns),
        rows=[row_of(frame, columns) for frame in report.frames],
        meanings=words.meanings,
        percent=percent_text,
        units=units_text,
        change=change_text,
        figure=figure_text,
    )


def page_of(result: Result, report: Report) -> str:
    """The page of a result and its report, pictures and all.

    Raises
    ------
    InputError
        When the file is damaged.
    """
    poses = poses_of(result)
    return as_html(report, None if poses is None else pictures_of(poses))


def record_digest(report: Report) -> str:
    """SHA-256 of a report as `as_json` writes it, in hexadecimal digits."""
    return hashlib.sha256(as_json([report]).encode()).hexdigest()


def is_page_of(path: Path, report: Report, has_pictures: bool) -> bool:
    """Whether there is a page at `path`, and it shows this report, with pictures or without.

    Only the head of the file is read.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return _mark(report, has_pictures).encode() in file.read(HEAD)


def _mark(report: Report, has_pictures: bool) -> str:
    """What the head of a report's page holds."""
    told = " pictures" if has_pictures else ""
    return f'<meta name="cageik-record" content="{record_digest(report)}{told}">'


def _gate_row(gate: Gate, words: Wording) -> dict[str, Any]:
    whole = "volume" if gate.metric == "volume_change" else "diagonal"
    return {
        "metric": words.metric(gate.metric),
        "baseline": ""
        if gate.baseline is None
        else f"against {percent_text(gate.baseline)} of the baseline",
        "limit": limit_text(gate),
        "found": found_text(gate),
        "unit": f"% of the {whole}" if gate.unit == PERCENT else "units of the file",
        "frame": gate.frame or "",
        "verdict": gate_verdict(gate),
    }


def _plot(report: Report) -> dict[str, Any]:
    """The figure, where its axes are, and what it shows in words."""
    plot, summary, words = plot_of(report), report.summary, wording_of(report.edited_from)
    changes = summary.volume_change_percent_max
    other = (
        f"the largest {words.distance} of each frame, at most "
        f"{percent_text(summary.max_deviation_percent)} % at {summary.max_deviation_frame}"
        if changes is None
        else f"the change of its volume, at most {change_text(changes)} % at "
        f"{summary.volume_change_frame}"
    )
    return {
        "source": data_url(plot.svg.encode(), "svg+xml"),
        "text": f"RMS {words.measure} of {len(report.frames)} frames, at most "
        f"{percent_text(summary.worst_frame_rms_percent)} % of the diagonal at "
        f"{summary.worst_frame}, and {other}. The table of frames has all values.",
        "left": plot.left,
        "right": plot.right,
        "top": plot.top,
        "bottom": plot.bottom,
        "first": plot.first,
        "last": plot.last,
    }


def _picture_values(pictures: Pictures, words: Wording) -> dict[str, Any]:
    titles = _pose_titles(words)
    poses = [
        {
            "title": titles[pose.label],
            "name": "" if pose.label == "rest" else pose.name,
            "views": [
                (
                    words.given.capitalize(),
                    _png(pose.given),
                    f"{titles[pose.label]}: the {words.given}",
                ),
                (
                    words.rebuilt.capitalize(),
                    _png(pose.rebuilt),
                    f"{titles[pose.label]}: the {words.rebuilt}, coloured by {words.distance}",
                ),
                ("Cage", _png(pose.cage), f"{titles[pose.label]}: the cage"),
            ],
        }
        for pose in pictures.poses
    ]
    spread = [
        (side, _png(picture), f"The rest pose {side.lower()}, coloured by each vertex's rms")
        for side, picture in zip(("From the front", "From behind"), pictures.spread, strict=True)
    ]
    return {
        "poses": poses,
        "spread": spread,
        "pose_ticks": _ticks(pictures.top_percent),
        "spread_ticks": _ticks(pictures.spread_top_percent),
    }


def _pose_titles(words: Wording) -> dict[str, str]:
    frames = {"worst": words.worst, "median": "median", "best": words.best}
    return {"rest": "Rest pose"} | {k: f"{text.capitalize()} frame" for k, text in frames.items()}


def _png(picture: bytes) -> str:
    return data_url(picture, "png")


def _ticks(top: float) -> list[str]:
    """The numbers under a scale that ends at `top`."""
    return [f"{top * k / (TICKS - 1):.4g}" for k in range(TICKS)]


def _histogram(vertices: VertexFigures) -> dict[str, Any]:
    most = max(vertices.counts)
    shown = percent_text if vertices.edges_percent[-1] >= FINEST else units_text
    edges = [shown(edge) for edge in vertices.edges_percent]
    bars = [
        {
            "low": low,
            "high": high,
            "count": count,
            "text": f"{low} to {high} %: {count} vertices",
            "height": f"{100 * count / (most or 1):.2f}",
            "top": f"{100 - 100 * count / (most or 1):.2f}",
        }
        for low, high, count in zip(edges[:-1], edges[1:], vertices.counts, strict=True)
    ]
    peak = bars[vertices.counts.index(most)]
    return {
        "bars": bars,
        "most": most,
        "ticks": edges[:: len(bars) // (TICKS - 1)],
        "text": f"Histogram of the rms of vertices, from {edges[0]} to {edges[-1]} % of the "
        f"diagonal; most of them, {most}, are between {peak['low']} and {peak['high']} %. "
        "The table below has all bins.",
    }


def _sorted(report: Report) -> list[tuple[str, Any]]:
    return sorted(report.sources.items())


def _facts(source: Any) -> list[tuple[str, str]]:
    """What is known of a file; its name first."""
    facts = sorted(source.items(), key=lambda fact: fact[0] != "name")
    return [(str(name), _plain(value)) for name, value in facts]


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)
