"""The tables of a page: the frames, and the quality of the weights."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cageik_cli.cages.bind import MIN_HARMONIC_WEIGHT
from cageik_cli.coordinates.binding import WeightQuality
from cageik_cli.coordinates.settings import ACCURACIES
from cageik_cli.report.figures import (
    FrameRecord,
    format_change,
    format_length,
    format_number,
    format_percent,
)
from cageik_cli.report.record import Report
from cageik_cli.solver.dual_laplacian import MAX_CONDITION


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the table.

    Attributes
    ----------
    name : str
        Field of `FrameRecord`.
    format_value : callable
        Formats a value as text.
    kind : str
        "number" or "name"; decides sorting and alignment.
    cursor_label : str
        Label at the plot's cursor; "" if the column is not shown there.
    """

    name: str
    label: str
    format_value: Callable[[Any], str] = str
    kind: str = "number"
    cursor_label: str = ""


@dataclass(frozen=True, slots=True)
class FrameRow:
    """A frame, the reason if it was skipped, and its metrics; "" where not defined."""

    number: str
    name: str
    skipped: str | None
    cells: tuple[str, ...]


NUMBER_COLUMN, NAME_COLUMN = Column("number", "#"), Column("name", "Frame", kind="name")
"""Columns of every frame."""

LENGTH_COLUMNS = (
    Column("rms_percent", "RMS, %", format_percent, cursor_label="rms, %"),
    Column("rms", "RMS, file units", format_length),
    Column(
        "max_deviation_percent", "Max deviation, %", format_percent, cursor_label="max deviation, %"
    ),
    Column("max_deviation", "Max deviation, file units", format_length),
    Column("worst_vertex", "At vertex"),
)

VOLUME_COLUMNS = (
    Column("volume_change", "Volume change, %", format_change, cursor_label="volume change, %"),
    Column("volume", "Volume", format_length),
    Column("volume_reconstructed", "Volume reconstructed", format_length),
    Column("volume_drift", "Drift from rest, %", format_change),
)


KEPT_COLUMNS = (
    Column("missing", "Missing", cursor_label="missing"),
    Column("rejected", "Rejected", cursor_label="rejected"),
    Column("rms_kept_percent", "RMS of kept, %", format_percent),
    Column("max_deviation_kept_percent", "Max deviation of kept, %", format_percent),
)
"""Columns of results whose vertices do not all count alike."""


def choose_columns(report: Report) -> tuple[Column, ...]:
    """Choose the columns in which some frame has a value, besides number and name."""
    titles = report.vocabulary.columns
    return tuple(
        _set_column_label(column, titles.get(column.name, column.label))
        for column in (*LENGTH_COLUMNS, *KEPT_COLUMNS, *VOLUME_COLUMNS)
        if any(getattr(frame, column.name) is not None for frame in report.frames)
    )


def _set_column_label(column: Column, label: str) -> Column:
    return replace(column, label=label, cursor_label=label.lower() if column.cursor_label else "")


def build_frame_row(frame: FrameRecord, columns: Sequence[Column]) -> FrameRow:
    """Build a frame's row, with a cell for each of the columns."""
    cells = tuple(_format_cell(frame, column) for column in columns)
    return FrameRow(format_number(frame.number), frame.name, frame.skipped, cells)


def _format_cell(frame: FrameRecord, column: Column) -> str:
    value = getattr(frame, column.name)
    return "" if value is None else column.format_value(value)


@dataclass(frozen=True, slots=True)
class QualityRow:
    """A metric as it is printed, its meaning, and the expected value; "" if there is none."""

    label: str
    value: str
    meaning: str
    expected: str


FITTED_MEANING = (
    "Weights that are fitted to frames may be negative, unless they have few influences."
)


def build_quality_rows(report: Report) -> list[QualityRow]:
    """Build the rows on a report's weights, then the one on its system."""
    quality, settings = report.binding, report.settings
    has_offsets = report.fit is not None and report.fit.settings.influences is not None
    smallest = (
        _smallest_weight_row(quality, is_harmonic=settings.get("coordinates") == "harmonic")
        if report.fit is None
        else QualityRow("Smallest weight", f"{quality.min_weight:.1e}", FITTED_MEANING, "")
    )
    return [
        *_exactness_rows(quality)[: 1 if has_offsets else None],
        smallest,
        *_accuracy_rows(quality, str(settings.get("accuracy"))),
        QualityRow(
            "Projected vertices",
            str(quality.projected),
            "Vertices outside the cage. They have the weights of the nearest point on it.",
            "0",
        ),
        QualityRow(
            "Condition number",
            f"{quality.condition_number:.4g}",
            report.vocabulary.condition,
            f"far below {MAX_CONDITION:.0e}; a run above it is refused",
        ),
    ]


def _exactness_rows(quality: WeightQuality) -> list[QualityRow]:
    """Build the rows on properties that weights of any type have, up to rounding."""
    return [
        QualityRow(
            "Partition of unity error",
            f"{quality.partition_of_unity:.1e}",
            "Largest difference between the sum of a vertex's weights and 1. Where the sum is not "
            "1, the model does not move as far as the cage.",
            "1e-10 or less (rounding)",
        ),
        QualityRow(
            "Rest pose error",
            f"{quality.linear_precision:.1e}",
            "Largest distance between the rest pose and the weights times the rest cage, in "
            "diagonals. Affine motions are reproduced with the same error.",
            "1e-10 or less (rounding)",
        ),
    ]


def _smallest_weight_row(quality: WeightQuality, is_harmonic: bool) -> QualityRow:
    label, smallest = "Smallest weight", f"{quality.min_weight:.1e}"
    if is_harmonic:
        meaning = (
            "Exact harmonic weights are never negative; a negative one shows the size of the error."
        )
        return QualityRow(label, smallest, meaning, f"{MIN_HARMONIC_WEIGHT} or more")
    meaning = (
        "Mean value weights can be negative near concave parts of a cage. There the model moves "
        "against the cage."
    )
    return QualityRow(label, smallest, meaning, "close to zero")


def _accuracy_rows(quality: WeightQuality, accuracy_name: str) -> list[QualityRow]:
    """Build the rows on the error of the weights and on the panels used to compute them."""
    if not quality.panels:
        return [QualityRow("Accuracy", "exact", "These weights have a closed form.", "")]
    accuracy = ACCURACIES.get(accuracy_name)
    return [
        QualityRow(
            "Estimated weight error",
            f"{quality.estimated_error:.1e}",
            "Mean over the vertices of the L1 distance between a vertex's weights and exact ones.",
            f"{accuracy.tolerance:g} or less (--accuracy {accuracy_name})" if accuracy else "",
        ),
        QualityRow(
            "Panels",
            str(quality.panels),
            "Triangles into which the cage was divided to compute the weights.",
            "",
        ),
    ]
