"""Where a result deviates: the error of each part of a model, and the worst regions of a clip.

The rms of a part is the root of the mean square of its vertices over the clip, in percent of the
diagonal of the whole model, so that parts can be compared with each other and with the clip.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.parts import format_place, get_parts, name_part
from cageik_cli.method.solve.regions import (
    MAX_DEVIATION,
    MAX_RMS_RATIO,
    Cause,
    Evidence,
    has_bad_regions,
)
from cageik_cli.report.figures import ReportSummary, format_percent
from cageik_cli.store.result import Result, StoredAnimation
from cageik_cli.util.arrays import Floats
from cageik_cli.util.messages import Said, say
from cageik_cli.util.text import format_decimals

CAUSES: dict[Cause, tuple[str, Said]] = {
    Cause.SMOOTHING: (
        "smoothing takes quick motion away",
        say("smoothing: give a shorter period, or `smooth=auto`, which finds the strength"),
    ),
    Cause.LOOSE_CAGE: (
        "the cage is far too loose",
        "cage far too loose: move it closer to the model, or build one of more vertices",
    ),
    Cause.SHARED_LOOP: (
        "limbs share one loop of the cage",
        say(
            "limbs in one loop: give each limb its own part of the cage, by more vertices, "
            "by hand, or with `rest_frame=auto` if limbs touch at rest"
        ),
    ),
    Cause.THIN_FACES: (
        "thin faces of the cage",
        say("thin faces: move their vertices apart, or use `repair=True`"),
    ),
    Cause.FAR_CAGE: (
        "the cage is far away",
        "cage far away: bring the cage nearer to the model, and add vertices there",
    ),
    Cause.WEAK_INFLUENCE: (
        "no cage vertex has much influence",
        "little influence: add cage vertices there, or a loop of them across the limb",
    ),
    Cause.COARSE_FACES: (
        "the cage faces there are too large",
        "large faces: divide the cage faces that are named, or build a cage of more vertices",
    ),
    Cause.UNKNOWN: (
        "not known, the cage looks fit",
        "cause not known: try more cage vertices; if it stays, look at the input of that frame",
    ),
}
"""The probable causes of large deviations in words, and what to do about each."""

REGIONS_UNKNOWN = (
    "the result does not say where the largest deviations are, since it was written without worst "
    "regions; extract it again to see them"
)
"""The note on a result with large deviations that was written by an earlier version."""

MAX_PART_ROWS = 8
"""Parts that have a line each in the text of a report, the worst first; the others are counted."""


@dataclass(frozen=True, slots=True)
class RegionRecord:
    """A region of the model that deviates much.

    Attributes
    ----------
    centre : tuple of float
        In the rest pose, file units.
    vertices : int
        How many it has.
    size, size_percent : float
        Diagonal of the box around it, in file units and in percent of the model's diagonal.
    frame : str
        The name of the frame of the largest deviation.
    frame_index : int
        The number of that frame, counted from 0.
    max_deviation, max_deviation_percent : float
        In file units and in percent of the diagonal.
    worst_vertex : int
        The vertex that deviates most.
    cage_faces : tuple of int
        The nearest ones, that of the worst vertex first.
    cause : Cause
        The probable cause.
    evidence : Evidence
        What the cause was judged by.
    part : str, optional
        The part that it is of; None for a model of one part.
    """

    centre: tuple[float, float, float]
    size: float
    size_percent: float
    vertices: int
    frame: str
    frame_index: int
    max_deviation: float
    max_deviation_percent: float
    worst_vertex: int
    cage_faces: tuple[int, ...]
    cause: Cause
    evidence: Evidence
    part: str | None = None


def build_regions(result: Result) -> tuple[RegionRecord, ...] | None:
    """Build the records of a result's worst regions; None if it does not hold them."""
    if result.regions is None:
        return None
    percent = 100 / result.rest.diagonal
    return tuple(
        RegionRecord(
            centre=region.centre,
            size=region.size,
            size_percent=percent * region.size,
            vertices=region.vertices,
            frame=result.frames[region.frame],
            frame_index=region.frame,
            max_deviation=region.max_deviation,
            max_deviation_percent=percent * region.max_deviation,
            worst_vertex=region.worst_vertex,
            cage_faces=region.cage_faces,
            cause=region.cause,
            evidence=region.evidence,
            part=name_part(result.rest, region.worst_vertex),
        )
        for region in result.regions
    )


def list_region_notes(result: Result, summary: ReportSummary) -> list[str]:
    """List the note on regions that are not known, though the largest deviation is unusual."""
    is_unknown = result.regions is None
    diagonal = result.rest.diagonal
    if is_unknown and has_bad_regions(summary.rms, summary.max_deviation, diagonal):
        return [REGIONS_UNKNOWN]
    return []


def explain_regions(summary: ReportSummary) -> str:
    """Say why regions are listed at all."""
    largest, reasons = summary.max_deviation_percent, []
    if summary.max_deviation > MAX_RMS_RATIO * summary.rms:
        reasons.append(f"{MAX_RMS_RATIO:g} times the rms")
    if largest > 100 * MAX_DEVIATION:
        reasons.append(f"{100 * MAX_DEVIATION:g} % of the diagonal")
    return (
        f"the largest deviation, {format_percent(largest)} %, is more than {' and '.join(reasons)}"
    )


def describe_region(region: RegionRecord) -> str:
    """Describe a region in one line, its probable cause at the end."""
    faces = ", ".join(map(str, region.cage_faces))
    noun = "cage face" if len(region.cage_faces) == 1 else "cage faces"
    return (
        f"{format_percent(region.max_deviation_percent)} % in {region.frame}, "
        f"{'' if region.part is None else f'of {region.part}, '}at "
        f"{format_centre(region)}, size {format_size(region)}, {noun} {faces}: "
        f"{name_cause(region)}"
    )


def format_centre(region: RegionRecord) -> str:
    """Format the centre of a region as in all views."""
    return f"({', '.join(f'{round(place, 4) + 0.0:.4g}' for place in region.centre)})"


def format_size(region: RegionRecord) -> str:
    """Format the size of a region, percent of the diagonal, as in all views."""
    return f"{format_decimals(region.size_percent, 1)} %"


def name_cause(region: RegionRecord) -> str:
    """Return the probable cause of a region's deviation in words."""
    return CAUSES[region.cause][0]


def list_remedies(regions: tuple[RegionRecord, ...], is_fitted: bool) -> list[Said]:
    """List what to do about regions, once for each cause, that of the worst region first.

    Weights that are not fitted yet can be the remedy in the same cage.
    """
    remedies: list[Said] = []
    for cause in dict.fromkeys(region.cause for region in regions):
        remedies.append(CAUSES[cause][1])
        if cause == Cause.SHARED_LOOP and not is_fitted:
            remedies.append(
                say(
                    "limbs in one loop: in the same cage, weights that are fitted with "
                    "`fit=True` can part them"
                )
            )
    return remedies


@dataclass(frozen=True, slots=True)
class PartRecord:
    """A part of the model, and its error.

    Attributes
    ----------
    name : str
        The name of the part.
    first_vertex : int
        The number of its first vertex in the model.
    vertices : int
        How many vertices it has.
    rms, rms_percent : float, optional
        Of its vertices over the clip, file units; percent of the diagonal of the whole model; None
        if none is data.
    """

    name: str
    first_vertex: int
    vertices: int
    rms: float | None
    rms_percent: float | None


def build_parts(result: StoredAnimation) -> tuple[PartRecord, ...] | None:
    """Measure each part, in the order of the model; None for a model of one part."""
    parts = get_parts(result.rest)
    if parts is None:
        return None
    records = []
    for name, vertices in zip(parts.names, parts.vertex_slices, strict=True):
        rms = measure_rms(result.vertex_rms[vertices])
        percent = None if rms is None else 100 * rms / result.rest.diagonal
        count = vertices.stop - vertices.start
        records.append(PartRecord(name, vertices.start, count, rms, percent))
    return tuple(records)


def measure_rms(vertex_rms: Floats) -> float | None:
    """Return the rms of the vertices that are data, whose own is given, (m,); None if none is."""
    known = vertex_rms[np.isfinite(vertex_rms)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def sort_parts(parts: Sequence[PartRecord] | None) -> list[PartRecord]:
    """Return the parts, those with the largest rms first, those without data last."""
    return sorted(parts or (), key=lambda part: 1.0 if part.rms is None else -part.rms)


def place_vertex(parts: Sequence[PartRecord] | None, vertex: int) -> str:
    """Return where a vertex is in its part, such as `/hero/jacket[102]`; empty for one part."""
    for part in parts or ():
        if part.first_vertex <= vertex < part.first_vertex + part.vertices:
            return format_place(vertex, part.name, part.first_vertex)
    return ""


def label_vertex(parts: Sequence[PartRecord] | None, vertex: int) -> str:
    """Return the number of a vertex, and of a model of several parts its place in its part."""
    place = place_vertex(parts, vertex)
    return f"{vertex} ({place})" if place else str(vertex)


def format_part_rows(parts: Sequence[PartRecord] | None, worst: str) -> list[tuple[str, str]]:
    """Return a line per part, the worst first, which `worst` labels; nothing for one part."""
    rows = []
    for k, part in enumerate(sort_parts(parts)):
        text = f"no data in {part.name}"
        if part.rms_percent is not None:
            text = f"{format_percent(part.rms_percent)} % in {part.name}"
        rows.append((f"{worst} part" if not k else "part", text))
    if len(rows) > MAX_PART_ROWS:
        rows = [*rows[:MAX_PART_ROWS], ("parts", f"and {len(rows) - MAX_PART_ROWS} more")]
    return rows
