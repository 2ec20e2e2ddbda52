"""The frames' table: figures as they are printed, and no column without any."""

from dataclasses import fields, replace

from cageik_cli.report.figures import Frame
from cageik_cli.report.html.frames_table import (
    FRAME,
    LENGTHS,
    NAME,
    VOLUMES,
    Row,
    columns_of,
    row_of,
)
from cageik_cli.report.record import report_of

FIGURES = Frame(
    index=3,
    name="a",
    rms=0.0123456789,
    rms_percent=1.23456789,
    max_deviation=2e-7,
    max_deviation_percent=2e-5,
    worst_vertex=7,
    volume=None,
    volume_reconstructed=8.0,
    volume_change=0.5,
    volume_drift=-1.0,
    skipped=None,
)


def test_every_figure_of_a_frame_has_a_column():
    names = [column.name for column in (FRAME, NAME, *LENGTHS, *VOLUMES)]
    assert sorted([*names, "skipped"]) == sorted(field.name for field in fields(Frame))


def test_figures_are_printed_as_everywhere():
    lengths = ("1.2346", "0.0123457", "0.0000", "2e-07", "7")
    assert row_of(FIGURES, LENGTHS) == Row(3, "a", None, lengths)
    assert row_of(FIGURES, VOLUMES).cells == ("+0.5000", "", "8", "-1.0000")


def test_a_column_without_figures_is_left_out(closed, opened):
    assert columns_of(report_of(closed.result)) == (*LENGTHS, *VOLUMES)
    assert columns_of(report_of(opened.result)) == LENGTHS


def test_one_frame_with_a_figure_makes_a_column(closed):
    report = report_of(closed.result)
    first, *others = report.frames
    without = tuple(replace(frame, volume_drift=None) for frame in others)
    assert VOLUMES[-1] in columns_of(replace(report, frames=(first, *without)))
    assert VOLUMES[-1] not in columns_of(replace(report, frames=without))
