"""JSON with every promised key, and CSV that gives the numbers back."""

import csv
import io
import json
from dataclasses import asdict, fields

import pytest

from cageik_cli.report.record import FrameRecord, build_report
from cageik_cli.report.views.data import format_csv, format_json

KEYS = {
    "schema", "tool", "result", "edited_from", "sources", "settings", "notes", "clip", "binding",
    "summary", "vertices", "frames", "gates", "regions", "fit", "bound", "unfitted",
    "kept", "filled", "parts", "quality", "better", "gain", "hidden", "is_torn",
    "baseline_name",
}  # fmt: skip
CLIP = {"frames", "vertices", "cage_vertices", "diagonal", "closed"}
BINDING = {"partition_of_unity", "linear_precision", "min_weight", "condition_number"}
SUMMARY = {
    "rms", "rms_percent", "worst_frame", "max_deviation", "volume_change_percent_max", "e_rms",
    "kg_error", "floats_per_frame", "fixed_floats",
}  # fmt: skip
FRAME = {
    "rms", "rms_percent", "max_deviation", "worst_vertex", "volume", "volume_reconstructed",
    "volume_change", "volume_drift",
}  # fmt: skip


def strict(text):
    def refuse(word):
        raise ValueError(f"{word} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(params=["closed", "opened"])
def report(request):
    return build_report(request.getfixturevalue(request.param).result)


def test_json_holds_the_whole_record(report):
    text = format_json([report])
    record = strict(text)
    assert text.endswith("}\n")
    assert set(record) == KEYS
    for name, keys in {"clip": CLIP, "binding": BINDING, "summary": SUMMARY}.items():
        assert keys <= set(record[name])
    assert len(record["frames"]) == 5
    assert all(set(frame) >= FRAME for frame in record["frames"])
    expected = asdict(report)
    assert record == json.loads(json.dumps(expected, default=str))
    assert record["summary"]["rms"] == report.summary.rms


def test_several_records_are_a_list(report):
    records = strict(format_json([report, report]))
    assert records == [strict(format_json([report]))] * 2


def test_csv_gives_the_numbers_back(report):
    rows = list(csv.DictReader(io.StringIO(format_csv([report, report]))))
    assert len(rows) == 10
    assert rows[:5] == rows[5:]
    for row, frame in zip(rows, report.frames, strict=False):
        assert row.pop("result") == "cages.h5"
        assert set(row) == {field.name for field in fields(FrameRecord)}
        for name, text in row.items():
            value = getattr(frame, name)
            if value is None:
                assert text == ""
            else:
                assert type(value)(text) == value


def test_the_same_report_gives_the_same_text(report):
    assert format_json([report]) == format_json([report])
    assert format_csv([report]).count("\r") == 0
