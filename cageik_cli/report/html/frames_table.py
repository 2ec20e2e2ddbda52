"""The frames of a report as a page's table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cageik_cli.cages.bind import MIN_HARMONIC_WEIGHT
from cageik_cli.coordinates.binding import WeightQuality
from cageik_cli.coordinates.weights import ACCURACIES
from cageik_cli.report.figures import FrameRecord, format_change, format_length, format_percent
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import choose_vocabulary
from cageik_cli.solver.dual_laplacian import MAX_CONDITION


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the table.

    Attributes
    ----------
    name : str
        Of the field of `FrameRecord`.
    label : str
    format_value : callable
        A value as text.
    kind : str
        "number" or "name": how it is sorted and set.
    cursor_label : str
        What it is called beside the figure's cursor; "" if it is not shown there.
    """

    name: str
    label: str
    format_value: Callable[[Any], str] = str
    kind: str = "number"
    cursor_label: str = ""


@dataclass(frozen=True, slots=True)
class FrameRow:
    """A frame, why it was skipped if it was, and its figures; "" where there is none."""

    index: int
    name: str
    skipped: str | None
    cells: tuple[str, ...]


INDEX_COLUMN, NAME_COLUMN = Column("index", "#"), Column("name", "Frame", kind="name")
"""What every frame has."""

LENGTH_COLUMNS = (
    Column("rms_percent", "RMS, %", format_percent, cursor_label="rms, %"),
    Column("rms", "RMS, units", format_length),
    Column(
        "max_deviation_percent", "Max deviation, %", format_percent, cursor_label="max deviation, %"
    ),
    Column("max_deviation", "Max deviation, units", format_length),
    Column("worst_vertex", "At vertex"),
)

VOLUME_COLUMNS = (
    Column("volume_change", "Volume change, %", format_change, cursor_label="volume change, %"),
    Column("volume", "Volume", format_length),
    Column("volume_reconstructed", "Volume rebuilt", format_length),
    Column("volume_drift", "Drift from rest, %", format_change),
)


def choose_columns(report: Report) -> tuple[Column, ...]:
    """The columns of figures that some frame has, without `INDEX_COLUMN` and `NAME`."""
    titles = choose_vocabulary(report.edited_from).columns
    return tuple(
        _set_column_label(column, titles.get(column.name, column.label))
        for column in (*LENGTH_COLUMNS, *VOLUME_COLUMNS)
        if any(getattr(frame, column.name) is not None for frame in report.frames)
    )


def _set_column_label(column: Column, label: str) -> Column:
    return replace(column, label=label, cursor_label=label.lower() if column.cursor_label else "")


def build_frame_row(frame: FrameRecord, columns: Sequence[Column]) -> FrameRow:
    """A frame's row, with a cell for each of the columns."""
    cells = tuple(_format_cell(frame, column) for column in columns)
    return FrameRow(frame.index, frame.name, frame.skipped, cells)


def _format_cell(frame: FrameRecord, column: Column) -> str:
    value = getattr(frame, column.name)
    return "" if value is None else column.format_value(value)


@dataclass(frozen=True, slots=True)
class QualityRow:
    """A figure as it is printed, what it means, and what is good; "" if nothing is better."""

    label: str
    found: str
    meaning: str
    good: str


def build_quality_rows(report: Report) -> list[QualityRow]:
    """The figures of a report's weights, then that of its system."""
    quality, settings = report.binding, report.settings
    return [
        *_exactness_rows(quality),
        _smallest_weight_row(quality, is_harmonic=settings.get("coordinates") == "harmonic"),
        *_accuracy_rows(quality, str(settings.get("accuracy"))),
        QualityRow(
            "Projected vertices",
            str(quality.projected),
            "They lay outside the cage, and have the weights of its nearest point.",
            "0",
        ),
        QualityRow(
            "Condition number",
            f"{quality.condition_number:.4g}",
            choose_vocabulary(report.edited_from).condition,
            f"far below {MAX_CONDITION:.0e}, where a run is refused",
        ),
    ]


def _exactness_rows(quality: WeightQuality) -> list[QualityRow]:
    """What holds of weights of any kind, but for rounding."""
    return [
        QualityRow(
            "Rows sum to 1 within",
            f"{quality.partition_of_unity:.1e}",
            "How far the sum of a vertex's weights is from one; where it is not one, moving "
            "the cage does not move the model as far.",
            "rounding: 1e-10 or less",
        ),
        QualityRow(
            "Rest pose rebuilt within",
            f"{quality.linear_precision:.1e}",
            "Largest distance of the weights times the rest cage from the rest pose, in "
            "diagonals; affine motions come out as exactly.",
            "rounding: 1e-10 or less",
        ),
    ]


def _smallest_weight_row(quality: WeightQuality, is_harmonic: bool) -> QualityRow:
    label, smallest = "Smallest weight", f"{quality.min_weight:.1e}"
    if is_harmonic:
        meaning = "Exact harmonic weights are never negative, so this is a measure of their error."
        return QualityRow(label, smallest, meaning, f"{MIN_HARMONIC_WEIGHT} or more")
    meaning = (
        "Mean value weights are negative across concave parts of a cage; the model moves "
        "against the cage there."
    )
    return QualityRow(label, smallest, meaning, "close to zero")


def _accuracy_rows(quality: WeightQuality, accuracy_name: str) -> list[QualityRow]:
    """How far weights are from exact ones, and what was divided for that."""
    if not quality.panels:
        return [QualityRow("Accuracy", "exact", "These weights are in closed form.", "")]
    accuracy = ACCURACIES.get(accuracy_name)
    return [
        QualityRow(
            "Mean row L1 error, estimated",
            f"{quality.estimated_error:.1e}",
            "How far a vertex's weights are from exact ones, summed over the cage and "
            "averaged over the vertices.",
            f"{accuracy.tolerance:g} or less, as asked for" if accuracy else "",
        ),
        QualityRow(
            "Panels",
            str(quality.panels),
            "Triangles that the cage's faces were divided into to compute the weights.",
            "as many as the accuracy needs",
        ),
    ]
