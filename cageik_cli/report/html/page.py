"""The report as a page: one HTML file without other files, for a browser or a printer."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from cageik_cli.formats.timeline import format_frame_number
from cageik_cli.method.solve.dual_laplacian import MAX_CONDITION
from cageik_cli.method.weights.binding import WeightQuality
from cageik_cli.method.weights.settings import ACCURACIES, COORDINATES
from cageik_cli.report.figures import (
    FrameRecord,
    VertexMetrics,
    describe_kept,
    describe_size,
    explain_missing_volume,
    format_change,
    format_length,
    format_percent,
    format_scene_length,
)
from cageik_cli.report.fit_rows import format_fit_rows
from cageik_cli.report.html.pictures import (
    FitShapes,
    draw_fit_section,
    draw_pictures,
    load_fit_shapes,
)
from cageik_cli.report.html.templating import (
    REPORT_TEMPLATES,
    THIN_SPACE,
    PlayerPart,
    make_data_url,
)
from cageik_cli.report.limits import PERCENT, LimitCheck, make_overall_verdict
from cageik_cli.report.plots.error_plot import render_page_plot
from cageik_cli.report.record import Report
from cageik_cli.report.regions import (
    explain_regions,
    format_centre,
    format_size,
    label_vertex,
    list_remedies,
    name_cause,
    place_vertex,
    sort_parts,
)
from cageik_cli.report.render.model_views import PoseSet, load_poses
from cageik_cli.report.views.data import format_json
from cageik_cli.report.views.front import find_worst_frame, format_front, list_verdict_rows
from cageik_cli.report.vocabulary import QUALITY_WORDS, SETTING_MEANINGS, Vocabulary
from cageik_cli.store.result import StoredAnimation
from cageik_cli.util.files import open_input
from cageik_cli.util.messages import Hint, Spelling, spell, spell_keyword
from cageik_cli.util.text import format_count

SECTIONS = (
    ("verdict", "Verdict"),
    ("player", "Player"),
    ("parts", "Parts"),
    ("per-frame", "Per frame"),
    ("poses", "Poses"),
    ("fit", "Fit"),
    ("regions", "Regions"),
    ("histogram", "Histogram"),
    ("worst-vertices", "Vertices"),
    ("weights", "Weights"),
    ("settings", "Settings"),
    ("notes", "Notes"),
    ("frames", "Frames"),
    ("definitions", "Definitions"),
)
"""Anchors of the sections, and their names in the navigation: one line of a laptop holds all."""

QUALITY_STATES = {"good": "good", "fair": "none", "poor": "warn"}
"""Looks of the badge of a quality."""


def render_page(
    report: Report,
    poses: PoseSet | None = None,
    shapes: FitShapes | None = None,
    *,
    player: PlayerPart | None = None,
    spelling: Spelling = spell_keyword,
    pixels: int = 360,
) -> str:
    """Render the page of a report; the same text for the same arguments.

    Parameters
    ----------
    poses : PoseSet, optional
        None for a result without weights; the page then has no pictures, and says so.
    shapes : FitShapes, optional
        None for a result that does not hold the weights before a fit.
    player : PlayerPart, optional
        None for a page without a player.
    spelling : callable
        Writes the settings that the page names, as in `build_report`.
    pixels : int
        Width and height of each picture.
    """
    columns, words = choose_columns(report), report.vocabulary
    digest = compute_record_digest(report)
    pictures = None if poses is None else draw_pictures(poses, words, pixels)
    fit = None if poses is None else draw_fit_section(report, poses, shapes, pixels)
    optional = {"regions": report.regions, "fit": fit, "player": player, "parts": report.parts}
    return REPORT_TEMPLATES.render_page(
        "page.html.j2",
        player=player,
        mark=_make_record_mark(digest, pictures is not None, player is not None),
        report=report,
        digest=digest,
        words=words,
        sections=[one for one in SECTIONS if one[0] not in optional or optional[one[0]]],
        fit=fit,
        badges=_list_badges(report),
        advice=list_verdict_rows(report)[1:],
        worst=find_worst_frame(report, "rms"),
        furthest=find_worst_frame(report, "max_deviation"),
        message=format_front(report, source="the page"),
        limit_rows=[_build_limit_row(check, words) for check in report.gates],
        plot=_build_plot_values(report),
        pictures=pictures,
        parts=sort_parts(report.parts),
        vertex_label=lambda vertex: label_vertex(report.parts, vertex),
        vertex_place=lambda vertex: place_vertex(report.parts, vertex),
        regions=_build_region_values(report, spelling),
        histogram=_build_histogram_values(report.vertices),
        quality=build_quality_rows(report, spelling),
        fit_rows=() if report.fit is None else format_fit_rows(report.fit, is_verbose=True),
        settings=[
            (name, _format_value(value), SETTING_MEANINGS.get(name, ""))
            for name, value in report.settings.items()
        ],
        sources=_list_sources(report),
        length=partial(format_scene_length, report.clip, group=THIN_SPACE),
        columns=columns,
        rows=[(frame.skipped, format_cells(frame, columns)) for frame in report.frames],
        meanings=words.meanings,
        no_volume=explain_missing_volume(report.clip),
        kept=[" ".join(row) for row in describe_kept(report.kept, report.clip.vertices)],
        size=describe_size(report.clip, report.summary.fixed_floats, group=THIN_SPACE),
    )


def _list_badges(report: Report) -> list[tuple[str, str]]:
    """Return the look and the word of the verdict on the result, and of that on its limits."""
    badges = []
    if report.quality is not None:
        word = QUALITY_WORDS[report.quality].capitalize()
        badges.append((QUALITY_STATES[report.quality], word))
    return [*badges, *([make_overall_verdict(report.gates)] if report.gates else [])]


def _list_sources(report: Report) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return the facts of each file that the result was made of, its name first."""
    return [
        (
            role.replace("_", " "),
            [
                (name, _format_value(value))
                for name, value in sorted(source.items(), key=lambda fact: fact[0] != "name")
            ],
        )
        for role, source in sorted(report.sources.items())
    ]


def compute_record_digest(report: Report) -> str:
    """Compute the SHA-256 of a report as `format_json` writes it, in hexadecimal digits."""
    return hashlib.sha256(format_json([report]).encode()).hexdigest()


def is_page_current(
    path: Path, report: Report, has_pictures: bool, has_player: bool = False
) -> bool:
    """Whether the page at `path` exists and shows this report, with or without these parts.

    Only the first bytes of the file are read, which hold the tag that names its record.
    """
    if not path.is_file():
        return False
    with open_input(path) as file:
        mark = _make_record_mark(compute_record_digest(report), has_pictures, has_player)
        return f'<meta name="cageik-record" content="{mark}">'.encode() in file.read(512)


def _make_record_mark(digest: str, has_pictures: bool, has_player: bool) -> str:
    """Return the mark in the head of the page of a report with this digest: what it shows."""
    parts = [" pictures"] * has_pictures + [" player"] * has_player
    return digest + "".join(parts)


def _build_region_values(report: Report, spelling: Spelling) -> dict[str, Any]:
    """Collect the rows of the table of worst regions, and what to do about them."""
    return {
        "why": explain_regions(report.summary),
        "rows": [
            {
                "centre": format_centre(region),
                "size": format_size(region),
                "vertices": region.vertices,
                "frame": region.frame,
                "part": region.part,
                "deviation": format_percent(region.max_deviation_percent),
                "faces": ", ".join(map(str, region.cage_faces)),
                "cause": name_cause(region),
            }
            for region in report.regions or ()
        ],
        "remedies": [
            spell(text, spelling)
            for text in list_remedies(report.regions or (), report.fit is not None)
        ],
    }


def render_result_page(
    result: StoredAnimation,
    report: Report,
    player: PlayerPart | None = None,
    spelling: Spelling = spell_keyword,
) -> str:
    """Render the page of a result and its report, with pictures if it has weights.

    `player` and `spelling` are as in `render_page`.
    """
    poses = load_poses(result)
    if poses is None:
        return render_page(report, player=player, spelling=spelling)
    shapes = load_fit_shapes(result, poses)
    return render_page(report, poses, shapes, player=player, spelling=spelling)


def _build_limit_row(check: LimitCheck, words: Vocabulary) -> dict[str, Any]:
    whole = "volume" if check.metric == "volume_change" else "diagonal"
    return {
        "metric": words.describe_metric(check.metric),
        "baseline": "" if check.baseline is None else f"baseline {format_percent(check.baseline)}",
        "limit": check.format_limit_with_baseline(),
        "value": check.format_found(),
        "unit": f"% of the {whole}" if check.unit == PERCENT else "file units",
        "frame": check.frame or "",
        "state": check.state,
        "verdict": check.verdict,
    }


def _build_plot_values(report: Report) -> dict[str, Any]:
    """Collect the plot, the position of its axes, and a description in words."""
    svg, places = render_page_plot(report)
    summary, words = report.summary, report.vocabulary
    changes = summary.volume_change_percent_max
    other = (
        f"the largest {words.distance} of each frame, up to "
        f"{format_percent(summary.max_deviation_percent)} % at {summary.max_deviation_frame}"
        if changes is None
        else f"the volume change of each frame, largest {format_change(changes)} % at "
        f"{summary.volume_change_frame}"
    )
    if report.unfitted is not None:
        most = format_percent(max(report.unfitted.rms_percent))
        other = f"{most} % with {report.unfitted.coordinates} weights, and {other}"
    return {
        "source": make_data_url(svg.encode(), "svg+xml"),
        "text": f"RMS {words.measure} of {format_count(len(report.frames), 'frame')}, up to "
        f"{format_percent(summary.worst_frame_rms_percent)} % of the diagonal at "
        f"{summary.worst_frame}, and {other}. The table of frames lists all values.",
        **places,
    }


def _build_histogram_values(vertices: VertexMetrics) -> dict[str, Any]:
    max_count = max(vertices.counts)
    # A histogram that ends low is printed with more digits than other percentages.
    format_edge = format_percent if vertices.edges_percent[-1] >= 0.01 else format_length
    edges = [format_edge(edge) for edge in vertices.edges_percent]
    bars = [
        {
            "low": low,
            "high": high,
            "count": count,
            "text": f"{low} to {high} %: {format_count(count, 'vertex')}",
            "height": f"{100 * count / (max_count or 1):.2f}",
            "top": f"{100 - 100 * count / (max_count or 1):.2f}",
        }
        for low, high, count in zip(edges[:-1], edges[1:], vertices.counts, strict=True)
    ]
    peak = bars[vertices.counts.index(max_count)]
    return {
        "bars": bars,
        "most": max_count,
        "ticks": edges[:: len(bars) // 4],
        "text": f"Histogram of the RMS of vertices, from {edges[0]} to {edges[-1]} % of the "
        f"diagonal; the largest bin, {peak['low']} to {peak['high']} %, has "
        f"{format_count(max_count, 'vertex')}. The table below lists all bins.",
    }


def _format_value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the table of frames.

    Attributes
    ----------
    name : str
        Field of `FrameRecord`.
    kind : str
        "number" or "name"; decides sorting and alignment.
    is_at_cursor : bool
        Whether the values are also shown at the cursor of the plot.
    """

    name: str
    label: str
    format_value: Callable[[Any], str] = str
    kind: str = "number"
    is_at_cursor: bool = False


UNITS = partial(format_length, group=THIN_SPACE)

FRAME_COLUMNS = (
    Column("number", "#", format_frame_number),
    Column("name", "Frame", kind="name"),
    Column("rms_percent", "RMS, %", format_percent, is_at_cursor=True),
    Column("rms", "RMS, file units", UNITS),
    Column("max_deviation_percent", "Max deviation, %", format_percent, is_at_cursor=True),
    Column("max_deviation", "Max deviation, file units", UNITS),
    Column("worst_vertex", "At vertex"),
    Column("missing", "Missing", is_at_cursor=True),
    Column("rejected", "Rejected", is_at_cursor=True),
    Column("rms_kept_percent", "RMS of kept, %", format_percent),
    Column("max_deviation_kept_percent", "Max deviation of kept, %", format_percent),
    Column("area_rms_percent", "RMS by area, %", format_percent),
    Column("area_rms_kept_percent", "RMS by area of kept, %", format_percent),
    Column("volume_change", "Volume change, %", format_change, is_at_cursor=True),
    Column("volume", "Volume", UNITS),
    Column("volume_reconstructed", "Volume reconstructed", UNITS),
    Column("volume_drift", "Drift from rest, %", format_change),
)
"""All columns that a table of frames may have."""


WeightRow = tuple[str, str, str, str]
"""A metric of the weights, its value as printed, its meaning, and the expected value or ""."""


def choose_columns(report: Report) -> tuple[Column, ...]:
    """Choose the columns in which some frame has a value, with the titles of the vocabulary."""
    titles = report.vocabulary.columns
    return tuple(
        replace(column, label=titles.get(column.name, column.label))
        for column in FRAME_COLUMNS
        if any(getattr(frame, column.name) is not None for frame in report.frames)
    )


def format_cells(frame: FrameRecord, columns: Sequence[Column]) -> list[str]:
    """Format the values of a frame in these columns; "" where one is not defined."""
    values = [getattr(frame, column.name) for column in columns]
    return [
        "" if value is None else column.format_value(value)
        for column, value in zip(columns, values, strict=True)
    ]


def build_quality_rows(report: Report, spelling: Spelling = spell_keyword) -> list[WeightRow]:
    """Build the rows on a report's weights, then the one on its system.

    Settings that they name are written as `spelling` does.
    """
    quality, settings = report.binding, report.settings
    kind = "fitted" if report.fit is not None else settings.get("coordinates")
    rest_pose_row = (
        "Rest pose error",
        f"{quality.linear_precision:.1e}",
        "Largest distance between the rest pose and the weights times the rest cage, in "
        "diagonals. Affine motions are reproduced with the same error.",
        "1e-10 or less (rounding)",
    )
    return [
        (
            "Partition of unity error",
            f"{quality.partition_of_unity:.1e}",
            "Largest difference between the sum of a vertex's weights and 1. Where the sum is not "
            "1, the model does not move as far as the cage.",
            "1e-10 or less (rounding)",
        ),
        *([] if report.has_offsets else [rest_pose_row]),
        _smallest_weight_row(quality, kind),
        *_accuracy_rows(quality, str(settings.get("accuracy")), spelling),
        (
            "Projected vertices",
            str(quality.projected),
            "Vertices outside the cage. They have the weights of the nearest point on it.",
            "0",
        ),
        (
            "Condition number",
            f"{quality.condition_number:.4g}",
            report.vocabulary.condition,
            f"far below {MAX_CONDITION:.0e}; a run above it is refused",
        ),
    ]


def _smallest_weight_row(quality: WeightQuality, kind: object) -> WeightRow:
    """Build the row on the smallest weight, which means different things for different weights."""
    meaning, expected = "", ""
    if kind == "fitted":
        meaning = (
            "Weights that are fitted to frames may be negative, unless they have few influences."
        )
    elif kind in COORDINATES:
        known = COORDINATES[str(kind)]
        meaning, expected = known.lowest_meaning, known.lowest_expected
        if known.lowest_weight is not None:
            expected = f"{known.lowest_weight} or more"
    return "Smallest weight", f"{quality.min_weight:.1e}", meaning, expected


def _accuracy_rows(
    quality: WeightQuality, accuracy_name: str, spelling: Spelling
) -> list[WeightRow]:
    """Build the rows on the error of the weights and on the panels used to compute them."""
    if not quality.panels:
        return [("Accuracy", "exact", "These weights have a closed form.", "")]
    accuracy = ACCURACIES.get(accuracy_name)
    return [
        (
            "Estimated weight error",
            f"{quality.estimated_error:.1e}",
            "Mean over the vertices of the L1 distance between a vertex's weights and exact ones.",
            f"{accuracy.tolerance:g} or less ({spelling(Hint('accuracy', accuracy_name))})"
            if accuracy
            else "",
        ),
        (
            "Panels",
            str(quality.panels),
            "Triangles into which the cage was divided to compute the weights.",
            "",
        ),
    ]
