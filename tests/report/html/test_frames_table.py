"""The table of frames and that of the weights: metrics as printed, and no empty columns."""

from dataclasses import fields, replace

import pytest

from cageik_cli.report.figures import FrameRecord
from cageik_cli.report.html.page import (
    FRAME_COLUMNS,
    build_quality_rows,
    choose_columns,
    format_cells,
)
from cageik_cli.report.record import build_report

FIGURES = FrameRecord(
    index=3,
    number=1003,
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


KEPT = ("missing", "rejected", "rms_kept_percent", "max_deviation_kept_percent")
VOLUMES = ("volume_change", "volume", "volume_reconstructed", "volume_drift")


def names_of(report):
    return [column.name for column in choose_columns(report)]


def test_every_metric_of_a_frame_has_a_column():
    names = [column.name for column in FRAME_COLUMNS]
    assert sorted([*names, "index", "skipped"]) == sorted(
        field.name for field in fields(FrameRecord)
    )


def test_cells_are_formatted_as_in_all_views():
    lengths = ["1.2346", "0.0123457", "0.0000", "2e-07", "7"]
    volumes = ["+0.5000", "", "8", "-1.0000"]
    assert format_cells(FIGURES, FRAME_COLUMNS) == ["1003", "a", *lengths, *[""] * 4, *volumes]


def test_a_column_without_values_is_left_out(report, opened):
    names = [column.name for column in FRAME_COLUMNS if column.name not in KEPT]
    assert names_of(report) == names
    assert names_of(build_report(opened.result)) == [name for name in names if name not in VOLUMES]


def test_one_frame_with_a_value_makes_a_column(report):
    first, *others = report.frames
    without = tuple(replace(frame, volume_drift=None) for frame in others)
    assert "volume_drift" in names_of(replace(report, frames=(first, *without)))
    assert "volume_drift" not in names_of(replace(report, frames=without))


@pytest.mark.parametrize(
    ("coordinates", "accuracy", "panels", "words"),
    [
        ("harmonic", "fine", 8, ["0.001 or less (`accuracy=fine`)", "never negative"]),
        ("mean-value", None, 0, ["closed form", "negative near concave parts"]),
        ("harmonic", "other", 8, ["never negative"]),
    ],
)
def test_weights_are_explained_by_their_kind(report, coordinates, accuracy, panels, words):
    settings = {"coordinates": coordinates, "accuracy": accuracy}
    binding = replace(report.binding, panels=panels)
    rows = build_quality_rows(replace(report, settings=settings, binding=binding))
    text = " ".join(f"{meaning} {expected}" for _, _, meaning, expected in rows)
    assert [word for word in words if word not in text] == []
    assert ("Panels" in [label for label, *_ in rows]) == bool(panels)
    assert ("accuracy=" in text) == (accuracy == "fine")
