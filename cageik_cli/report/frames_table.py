"""The frames of a report as a page's table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cageik_cli.report.figures import Frame, change_text, percent_text, units_text
from cageik_cli.report.record import Report
from cageik_cli.report.wording import wording_of


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
