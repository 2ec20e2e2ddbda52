"""The frames of a report as a page's table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cageik_cli.cages.bind import LOWEST_WEIGHT
from cageik_cli.coordinates.binding import WeightQuality
from cageik_cli.coordinates.weights import ACCURACIES
from cageik_cli.report.figures import Frame, change_text, percent_text, units_text
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import wording_of
from cageik_cli.solver.dual_laplacian import WORST_CONDITION


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the table.

    Attributes
    ----------
    name : str
        Of the field of `Frame`.
    label : str
    printed : callable
        A value as text.
    kind : str
        "number" or "name": how it is sorted and set.
    told : str
        What it is called beside the figure's cursor; "" if it is not shown there.
    """

    name: str
    label: str
    printed: Callable[[Any], str] = str
    kind: str = "number"
    told: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """A frame, why it was skipped if it was, and its figures; "" where there is none."""

    index: int
    name: str
    skipped: str | None
    cells: tuple[str, ...]


FRAME, NAME = Column("index", "#"), Column("name", "Frame", kind="name")
"""What every frame has."""

LENGTHS = (
    Column("rms_percent", "RMS, %", percent_text, told="rms, %"),
    Column("rms", "RMS, units", units_text),
    Column("max_deviation_percent", "Max deviation, %", percent_text, told="max deviation, %"),
    Column("max_deviation", "Max deviation, units", units_text),
    Column("worst_vertex", "At vertex"),
)

VOLUMES = (
    Column("volume_change", "Volume change, %", change_text, told="volume change, %"),
    Column("volume", "Volume", units_text),
    Column("volume_reconstructed", "Volume rebuilt", units_text),
    Column("volume_drift", "Drift from rest, %", change_text),
)


def columns_of(report: Report) -> tuple[Column, ...]:
    """The columns of figures that some frame has, without `FRAME` and `NAME`."""
    titles = wording_of(report.edited_from).columns
    return tuple(
        _titled(column, titles.get(column.name, column.label))
        for column in (*LENGTHS, *VOLUMES)
        if any(getattr(frame, column.name) is not None for frame in report.frames)
    )


def _titled(column: Column, label: str) -> Column:
    return replace(column, label=label, told=label.lower() if column.told else "")


def row_of(frame: Frame, columns: Sequence[Column]) -> Row:
    """A frame's row, with a cell for each of the columns."""
    cells = tuple(_cell(frame, column) for column in columns)
    return Row(frame.index, frame.name, frame.skipped, cells)


def _cell(frame: Frame, column: Column) -> str:
    value = getattr(frame, column.name)
    return "" if value is None else column.printed(value)


@dataclass(frozen=True, slots=True)
class QualityRow:
    """A figure as it is printed, what it means, and what is good; "" if nothing is better."""

    label: str
    found: str
    meaning: str
    good: str


def quality_rows(report: Report) -> list[QualityRow]:
    """The figures of a report's weights, then that of its system."""
    found, settings = report.binding, report.settings
    return [
        *_exactness(found),
        _smallest(found, is_harmonic=settings.get("coordinates") == "harmonic"),
        *_accuracy(found, str(settings.get("accuracy"))),
        QualityRow(
            "Projected vertices",
            str(found.projected),
            "They lay outside the cage, and have the weights of its nearest point.",
            "0",
        ),
        QualityRow(
            "Condition number",
            f"{found.condition_number:.4g}",
            wording_of(report.edited_from).condition,
            f"far below {WORST_CONDITION:.0e}, where a run is refused",
        ),
    ]


def _exactness(found: WeightQuality) -> list[QualityRow]:
    """What holds of weights of any kind, but for rounding."""
    return [
        QualityRow(
            "Rows sum to 1 within",
            f"{found.partition_of_unity:.1e}",
            "How far the sum of a vertex's weights is from one; where it is not one, moving "
            "the cage does not move the model as far.",
            "rounding: 1e-10 or less",
        ),
        QualityRow(
            "Rest pose rebuilt within",
            f"{found.linear_precision:.1e}",
            "Largest distance of the weights times the rest cage from the rest pose, in "
            "diagonals; affine motions come out as exactly.",
            "rounding: 1e-10 or less",
        ),
    ]


def _smallest(found: WeightQuality, is_harmonic: bool) -> QualityRow:
    label, smallest = "Smallest weight", f"{found.min_weight:.1e}"
    if is_harmonic:
        meaning = "Exact harmonic weights are never negative, so this is a measure of their error."
        return QualityRow(label, smallest, meaning, f"{LOWEST_WEIGHT} or more")
    meaning = (
        "Mean value weights are negative across concave parts of a cage; the model moves "
        "against the cage there."
    )
    return QualityRow(label, smallest, meaning, "close to zero")


def _accuracy(found: WeightQuality, asked: str) -> list[QualityRow]:
    """How far weights are from exact ones, and what was divided for that."""
    if not found.panels:
        return [QualityRow("Accuracy", "exact", "These weights are in closed form.", "")]
    accuracy = ACCURACIES.get(asked)
    return [
        QualityRow(
            "Mean row L1 error, estimated",
            f"{found.estimated_error:.1e}",
            "How far a vertex's weights are from exact ones, summed over the cage and "
            "averaged over the vertices.",
            f"{accuracy.tolerance:g} or less, as asked for" if accuracy else "",
        ),
        QualityRow(
            "Panels",
            str(found.panels),
            "Triangles that the cage's faces were divided into to compute the weights.",
            "as many as the accuracy needs",
        ),
    ]
