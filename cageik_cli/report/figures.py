"""The numbers of a report, and how they are printed.

Error definitions, for F frames of m vertices, D the rest bounding box's diagonal:

- rms of a frame: sqrt(mean_i |v̂_i − v_i|²); of the clip: the root of the mean square over frames;
  of a vertex: the root of its mean square over frames.
- area_rms of the clip: the same with Σ a_i |v̂_i − v_i|² / Σ a_i, a_i a third of the area of the
  faces at a vertex in the rest pose. Where vertices count differently in each frame, each frame has
  its own sums, over its data or what was kept of it, and the clip the root of their mean square.
- radius_rms_percent of the clip: 100 rms/R, R the radius of the smallest sphere that holds the rest
  pose. It does not depend on the axes, as D does.
- e_rms = 2000/√3 · rms/D = 1154.70 · rms/D (Kavan, Sloan and O'Sullivan 2010, eq. 8).
- kg_error = 100 |V − V̂|_F / |V − E(V)|_F, E(V) each frame's centroid (Karni and Gotsman 2004).
- volume_change = 100 (V̂ − V)/V and volume_drift = 100 (V − V_rest)/V_rest, percent; signed.
"""

from dataclasses import dataclass
from typing import Any

from cageik_cli.util.text import format_count, format_decimals, group_digits
from cageik_cli.util.units import UNIT_LENGTHS, find_unit

REPORT_SCHEMA = 1
"""Version of the JSON of a report and of a batch; it changes when a field does."""

PERCENT_DECIMALS = 4
"""Decimals of values in percent, and of the limits that they are compared with."""

LENGTH_DIGITS = 6
"""Digits of lengths in file units."""

METRIC_UNITS = ("m", "cm", "mm")
"""Units in which metric lengths are read, the longest first."""


@dataclass(frozen=True, slots=True)
class ClipRecord:
    """The clip: counts, lengths in file units, whether the model is closed, and its time.

    `diagonal` is that of the box around the faces of the rest pose, and `radius` that of the
    smallest sphere around them.

    The numbers of frames begin with `start` and go in steps of `frame_step`. `body` tells whether
    the model is closed, and more than a sheet: `TriMesh.is_body`.
    """

    frames: int
    vertices: int
    cage_vertices: int
    diagonal: float
    radius: float
    closed: bool
    fps: float
    start: float = 1.0
    frame_step: float = 1.0
    body: bool = True
    metres_per_unit: float = 1.0

    def frame_number(self, index: float) -> float:
        """Return the number of a frame; `index` counts frames from 0."""
        return self.start + index * self.frame_step


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """Metrics of a frame: lengths in file units and percent of the diagonal, changes in percent.

    `index` counts frames from 0, and `number` is the place on the timeline.

    Metrics of volumes are None for an open model, or when vertices are missing data; changes also
    relative to less volume than that of a sheet. All metrics of a skipped frame are None, and
    `skipped` is the reason. The fields behind it count vertices that are missing or rejected, and
    measure the others; None if all count alike in all frames.
    """

    index: int
    number: float
    name: str
    rms: float | None
    rms_percent: float | None
    max_deviation: float | None
    max_deviation_percent: float | None
    worst_vertex: int | None
    volume: float | None
    volume_reconstructed: float | None
    volume_change: float | None
    volume_drift: float | None
    skipped: str | None
    missing: int | None = None
    rejected: int | None = None
    rms_kept_percent: float | None = None
    max_deviation_kept_percent: float | None = None
    area_rms_percent: float | None = None
    area_rms_kept_percent: float | None = None


@dataclass(frozen=True, slots=True)
class KeptSummary:
    """Metrics of the clip over the vertices that were kept, and counts of the others.

    `missing_percent` is of all vertices in all frames that were not skipped, `rejected_percent` of
    those that are data. `most_missing` and `most_rejected` are the counts of the worst frames.
    `area_rms_percent` is None for a model without area, and for results of earlier versions.
    """

    rms_percent: float
    max_deviation_percent: float
    missing_percent: float
    most_missing: int
    most_missing_frame: str
    rejected_percent: float
    most_rejected: int
    most_rejected_frame: str
    area_rms_percent: float | None = None


@dataclass(frozen=True, slots=True)
class ReportSummary:
    """Metrics of the clip, over the frames that were not skipped.

    `volume_change_percent_max` is the largest change in absolute value, with its sign.
    `fixed_floats` counts the weights that must be stored, `floats_per_frame` the coordinates of a
    cage. `best_possible_percent` is the smallest rms that a cage with as many vertices can have.
    `area_rms` weighs each vertex by its area in the rest pose; None for a model without area, and
    for results of earlier versions in which vertices count differently in each frame.
    `radius_rms_percent` is `rms` in percent of the radius of the smallest sphere around the model.
    Of weights that were fitted to this clip, `gap_closed_percent` tells how much of the gap from
    the unfitted weights to it they close, and `held_out_rms_percent` their error on frames that
    were held out. `worst_part` is the part with the largest rms; None for a model of one part.
    """

    rms: float
    rms_percent: float
    worst_frame: str
    worst_frame_index: int
    worst_frame_rms: float
    worst_frame_rms_percent: float
    max_deviation: float
    max_deviation_percent: float
    max_deviation_frame: str
    max_deviation_vertex: int
    volume_change_percent_max: float | None
    volume_change_frame: str | None
    volume_drift_percent_max: float | None
    radius_rms_percent: float
    e_rms: float
    kg_error: float | None
    frames_skipped: int
    floats_per_frame: int
    fixed_floats: int
    area_rms: float | None = None
    area_rms_percent: float | None = None
    best_possible_percent: float | None = None
    gap_closed_percent: float | None = None
    held_out_rms_percent: float | None = None
    worst_part: str | None = None


@dataclass(frozen=True, slots=True)
class VertexMetrics:
    """The distribution of the error over the model.

    Attributes
    ----------
    edges_percent : tuple of float
        The k + 1 edges of the histogram's k bins, in percent of the diagonal.
    counts : tuple of int
        Number of vertices whose rms is in each bin; missing data is in none.
    worst : tuple of dict
        The worst ones, the worst first: the number of the `vertex`, its `rms` over the frames in
        file units and in percent, and its `position` in the rest pose.
    """

    edges_percent: tuple[float, ...]
    counts: tuple[int, ...]
    worst: tuple[dict[str, Any], ...]


def format_percent(value: float) -> str:
    """Format a value in percent as in all views."""
    return format_decimals(value, PERCENT_DECIMALS)


def format_length(value: float, group: str = " ") -> str:
    """Format a length in file units as in all views."""
    return group_digits(f"{value:.{LENGTH_DIGITS}g}", group)


def format_scene_length(
    clip: ClipRecord, percent: float, digits: int = 2, *, group: str = " "
) -> str:
    """Return a share of the size, in percent, as a length in the unit of the scene.

    Metric lengths take the unit that suits them.
    """
    size = clip.diagonal * percent / 100
    unit = find_unit(clip.metres_per_unit)
    if unit in METRIC_UNITS:
        metres = size * clip.metres_per_unit
        unit = next((name for name in METRIC_UNITS if metres >= UNIT_LENGTHS[name]), "mm")
        size = metres / UNIT_LENGTHS[unit]
    number = group_digits(format_briefly(size, digits), group)
    return number if unit is None else f"{number} {unit}"


def format_briefly(value: float, digits: int = 2) -> str:
    """Format a number, zero or above, with the few digits that are read, and never fewer."""
    if value == 0 or value >= 10 ** (digits - 1):
        return f"{value:.0f}"
    return f"{value:#.{digits}g}"


def format_change(value: float) -> str:
    """Format a change in percent, with its sign, as in all views."""
    text = format_percent(value + 0.0)  # −0 + 0 is 0
    return text if text.startswith("-") else f"+{text}"


def format_metric(value: float) -> str:
    """Format a published metric as in all views."""
    return f"{value:.4g}"


def convert_to_integer(number: float) -> float:
    """Return a whole number as an integer, which is written without a point."""
    return int(number) if number == int(number) else number


def explain_missing_volume(clip: ClipRecord) -> str:
    """Say why no frame has a change of volume."""
    if not clip.closed:
        return "the model is open"
    return "some vertices are missing data" if clip.body else "the model is a sheet without volume"


def describe_kept(kept: KeptSummary | None, vertices: int) -> list[tuple[str, str]]:
    """Say what was missing and rejected, and how large the error is over what was kept, in rows."""
    if kept is None:
        return []
    rows = []
    if kept.most_missing:
        text = (
            f"{format_decimals(kept.missing_percent, 2)} % of the vertices of the frames, most in "
            f"{kept.most_missing_frame}: {group_digits(kept.most_missing)} of "
            f"{group_digits(vertices)}"
        )
        rows.append(("missing", text))
    if kept.most_rejected:
        text = (
            f"{format_decimals(kept.rejected_percent, 2)} % of the data, most in "
            f"{kept.most_rejected_frame}: {format_count(kept.most_rejected, 'vertex')}"
        )
        area = kept.area_rms_percent
        by_area = "" if area is None else f"by area {format_percent(area)} %, "
        error = (
            f"error {format_percent(kept.rms_percent)} %, {by_area}max deviation "
            f"{format_percent(kept.max_deviation_percent)} % over what was not rejected"
        )
        rows += [("rejected", text), ("kept", error)]
    return rows or [("kept", "all vertices of all frames: none is missing or rejected")]


def describe_size(clip: ClipRecord, fixed_floats: int, group: str = " ") -> str:
    """Describe what the floats per frame of the cages replace, and what is stored once.

    Digits are grouped in threes by `group`.
    """
    counts = 3 * clip.vertices, clip.vertices, fixed_floats
    mesh, rows, fixed = (group_digits(count, group) for count in counts)
    if fixed_floats != clip.vertices * clip.cage_vertices:
        return f"instead of {mesh}, plus {fixed} floats of fitted weights"
    return f"instead of {mesh}, plus one {rows} x {clip.cage_vertices} weight matrix"
