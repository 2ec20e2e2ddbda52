"""The tables of a page: the frames, and the quality of the weights."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cageik_cli.cages.bind import MIN_HARMONIC_WEIGHT
from cageik_cli.formats.timeline import format_frame_number
from cageik_cli.method.solve.dual_laplacian import MAX_CONDITION
from cageik_cli.method.weights.binding import WeightQuality
from cageik_cli.method.weights.settings import ACCURACIES
from cageik_cli.report.figures import (
    FrameRecord,
    format_change,
    format_length,
    format_percent,
)
from cageik_cli.report.record import Report


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


FRAME_COLUMNS = (
    Column("number", "#", format_frame_number),
    Column("name", "Frame", kind="name"),
    Column("rms_percent", "RMS, %", format_percent, is_at_cursor=True),
    Column("rms", "RMS, file units", format_length),
    Column("max_deviation_percent", "Max deviation, %", format_percent, is_at_cursor=True),
    Column("max_deviation", "Max deviation, file units", format_length),
    Column("worst_vertex", "At vertex"),
    Column("missing", "Missing", is_at_cursor=True),
    Column("rejected", "Rejected", is_at_cursor=True),
    Column("rms_kept_percent", "RMS of kept, %", format_percent),
    Column("max_deviation_kept_percent", "Max deviation of kept, %", format_percent),
    Column("volume_change", "Volume change, %", format_change, is_at_cursor=True),
    Column("volume", "Volume", format_length),
    Column("volume_reconstructed", "Volume reconstructed", format_length),
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


def build_quality_rows(report: Report, word: Callable[[str], str] = str) -> list[WeightRow]:
    """Build the rows on a report's weights, then the one on its system.

    `word` puts parameters that they name into the words of the reader.
    """
    quality, settings = report.binding, report.settings
    kind = "fitted" if report.fit is not None else settings.get("coordinates")
    return [
        *_exactness_rows(quality)[: 1 if report.has_offsets else None],
        _smallest_weight_row(quality, kind),
        *_accuracy_rows(quality, str(settings.get("accuracy")), word),
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


def _exactness_rows(quality: WeightQuality) -> list[WeightRow]:
    """Build the rows on properties that weights of any type have, up to rounding."""
    return [
        (
            "Partition of unity error",
            f"{quality.partition_of_unity:.1e}",
            "Largest difference between the sum of a vertex's weights and 1. Where the sum is not "
            "1, the model does not move as far as the cage.",
            "1e-10 or less (rounding)",
        ),
        (
            "Rest pose error",
            f"{quality.linear_precision:.1e}",
            "Largest distance between the rest pose and the weights times the rest cage, in "
            "diagonals. Affine motions are reproduced with the same error.",
            "1e-10 or less (rounding)",
        ),
    ]


def _smallest_weight_row(quality: WeightQuality, kind: object) -> WeightRow:
    """Build the row on the smallest weight, which means different things for different weights."""
    if kind == "fitted":
        meaning = (
            "Weights that are fitted to frames may be negative, unless they have few influences."
        )
        expected = ""
    elif kind == "harmonic":
        meaning = (
            "Exact harmonic weights are never negative; a negative one shows the size of the error."
        )
        expected = f"{MIN_HARMONIC_WEIGHT} or more"
    else:
        meaning = (
            "Mean value weights can be negative near concave parts of a cage. There the model "
            "moves against the cage."
        )
        expected = "close to zero"
    return "Smallest weight", f"{quality.min_weight:.1e}", meaning, expected


def _accuracy_rows(
    quality: WeightQuality, accuracy_name: str, word: Callable[[str], str]
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
            word(f"{accuracy.tolerance:g} or less (`accuracy={accuracy_name}`)")
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
