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
from typing import TypedDict

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


class ToolRecord(TypedDict):
    """The program that wrote the result, or the report of a batch.

    Attributes
    ----------
    name : str
        cageik.
    version : str
        Its version.
    """

    name: str
    version: str


@dataclass(frozen=True, slots=True)
class ClipRecord:
    """The clip: counts, lengths in file units, whether the model is closed, and its time.

    Attributes
    ----------
    frames : int
        Number of frames, skipped ones, too.
    vertices, cage_vertices : int
        Number of vertices of the model and of the cage.
    diagonal : float
        Diagonal of the box around the faces of the rest pose, file units.
    radius : float
        Radius of the smallest sphere around them, file units.
    closed : bool
        Whether the model is closed.
    fps : float
        Frames per second.
    start : float
        Number of the first frame on the timeline.
    frame_step : float
        From the number of a frame to that of the next.
    body : bool
        Whether the model is closed, and more than a sheet: `TriMesh.is_body`.
    metres_per_unit : float
        Length of a file unit, metres.
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

    All metrics of a skipped frame are None. Metrics of volumes are None for an open model, or when
    vertices are missing data; changes also relative to less volume than that of a sheet.

    Attributes
    ----------
    index : int
        Counts frames from 0.
    number : float
        The place on the timeline.
    name : str
        The file of the frame, or its place in a file.
    rms, rms_percent : float, optional
        Root mean square of the deviations of the vertices, file units; percent of the diagonal.
    max_deviation, max_deviation_percent : float, optional
        The largest deviation of a vertex, file units; percent of the diagonal.
    worst_vertex : int, optional
        The vertex that deviates most.
    volume, volume_reconstructed : float, optional
        Volume of the frame and of its reconstruction, cubic file units.
    volume_change : float, optional
        Of the reconstruction relative to the frame, percent; signed.
    volume_drift : float, optional
        Of the frame relative to the rest pose, percent; signed.
    skipped : str, optional
        Why the frame was skipped; None if it was not.
    missing, rejected : int, optional
        Number of vertices that are missing, and of those rejected as outliers; None if all count
        alike in all frames.
    rms_kept_percent, max_deviation_kept_percent : float, optional
        The metrics of the vertices that were kept, percent of the diagonal; None as `missing`.
    area_rms_percent, area_rms_kept_percent : float, optional
        The rms by area of all data, and of what was kept, percent of the diagonal; None as
        `missing`, and for results of earlier versions.
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

    Attributes
    ----------
    rms_percent, max_deviation_percent : float
        In percent of the diagonal.
    missing_percent : float
        Missing vertices, percent of all vertices in all frames that were not skipped.
    most_missing : int
        How many are missing in the frame that lacks most.
    most_missing_frame : str
        The name of that frame.
    rejected_percent : float
        Vertices rejected as outliers, percent of those that are data.
    most_rejected : int
        How many are rejected in the frame with most of them.
    most_rejected_frame : str
        The name of that frame.
    area_rms_percent : float, optional
        The rms by area of what was kept, percent of the diagonal; None for a model without area,
        and for results of earlier versions.
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

    Attributes
    ----------
    rms, rms_percent : float
        The root of the mean square of the frames' rms, file units; percent of the diagonal.
    worst_frame : str
        The name of the frame with the largest rms.
    worst_frame_index : int
        Its number, counted from 0.
    worst_frame_rms, worst_frame_rms_percent : float
        Its rms, file units; percent of the diagonal.
    max_deviation, max_deviation_percent : float
        The largest deviation of a vertex in any frame, file units; percent of the diagonal.
    max_deviation_frame : str
        The name of that frame.
    max_deviation_vertex : int
        That vertex.
    volume_change_percent_max : float, optional
        The largest change of volume in absolute value, with its sign, percent; None if no frame has
        one.
    volume_change_frame : str, optional
        The name of that frame.
    volume_drift_percent_max : float, optional
        The same of the drift of volume.
    radius_rms_percent : float
        `rms` in percent of the radius of the smallest sphere around the model.
    e_rms : float
        1154.70 rms/D, D the diagonal (Kavan, Sloan and O'Sullivan 2010).
    kg_error : float, optional
        Error relative to the motion, percent (Karni and Gotsman 2004); None if nothing moves.
    frames_skipped : int
        Number of frames that were skipped.
    floats_per_frame : int
        The coordinates of a cage.
    fixed_floats : int
        The weights that must be stored, once.
    area_rms, area_rms_percent : float, optional
        The rms in which each vertex counts by its area in the rest pose, file units; percent of the
        diagonal; None for a model without area, and for results of earlier versions in which
        vertices count differently in each frame.
    best_possible_percent : float, optional
        The smallest rms that a cage with as many vertices can have, percent of the diagonal; None
        if it is not known, or says nothing.
    gap_closed_percent : float, optional
        How much of the gap from the unfitted weights to it the fit closes; None without a fit to
        this clip.
    held_out_rms_percent : float, optional
        The error of fitted weights on frames that were held out, percent of the diagonal; None as
        above.
    worst_part : str, optional
        The part with the largest rms; None for a model of one part.
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


class WorstVertex(TypedDict):
    """A vertex with a large error.

    Attributes
    ----------
    vertex : int
        Its number.
    rms, rms_percent : float
        Over the frames, file units; percent of the diagonal.
    position : tuple of float
        In the rest pose, file units.
    """

    vertex: int
    rms: float
    rms_percent: float
    position: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class VertexMetrics:
    """The distribution of the error over the model.

    Attributes
    ----------
    edges_percent : tuple of float
        The k + 1 edges of the histogram's k bins, in percent of the diagonal.
    counts : tuple of int
        Number of vertices whose rms is in each bin; missing data is in none.
    worst : tuple of WorstVertex
        The worst ones, the worst first.
    """

    edges_percent: tuple[float, ...]
    counts: tuple[int, ...]
    worst: tuple[WorstVertex, ...]


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
    return describe_length(clip.diagonal * percent / 100, clip.metres_per_unit, digits, group=group)


def describe_length(
    length: float, metres_per_unit: float, digits: int = 2, *, group: str = " "
) -> str:
    """Return a length in file units in the unit of a scene, as of `format_scene_length`."""
    unit = find_unit(metres_per_unit)
    if unit in METRIC_UNITS:
        metres = length * metres_per_unit
        unit = next((name for name in METRIC_UNITS if metres >= UNIT_LENGTHS[name]), "mm")
        length = metres / UNIT_LENGTHS[unit]
    number = group_digits(format_briefly(length, digits), group)
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
