"""The JSON schema; that all reports of all tests keep to it is checked where they are written."""

import json
import re
from dataclasses import fields

import h5py
import pytest
from jsonschema import Draft202012Validator

from cageik_cli.report.figures import FrameRecord
from cageik_cli.report.record import Report, build_report
from cageik_cli.report.views.data import format_json
from cageik_cli.report.views.schema import _Definitions, format_schema
from cageik_cli.store.result import read_animation

SCHEMA = json.loads(format_schema())


def find_faults(value, name):
    """What is wrong with a value, as one of the definitions."""
    schema = {"$schema": SCHEMA["$schema"], "$defs": SCHEMA["$defs"], "$ref": f"#/$defs/{name}"}
    return [error.json_path for error in Draft202012Validator(schema).iter_errors(value)]


@pytest.fixture
def record(tiny_result):
    return json.loads(format_json([build_report(read_animation(tiny_result))]))


def test_it_is_a_schema_and_describes_each_field_of_the_records():
    Draft202012Validator.check_schema(SCHEMA)
    for kind in (Report, FrameRecord):
        described = SCHEMA["$defs"][kind.__name__]
        names = {field.name for field in fields(kind)}
        assert names <= set(described["properties"])
        assert set(described["required"]) == names
    assert "percent of the diagonal" in SCHEMA["$defs"]["FrameRecord"]["description"]


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda record: record.update(extra=1), "$"),
        (lambda record: record.pop("clip"), "$"),
        (lambda record: record["frames"][0].update(rms="0.1"), "$.frames[0].rms"),
        (lambda record: record["frames"][0].update(index=0.5), "$.frames[0].index"),
        (lambda record: record["clip"].update(closed=None), "$.clip.closed"),
        (lambda record: record.update(notes=[{"text": "a"}]), "$.notes[0]"),
        (lambda record: record.update(gaps=[{"name": "a"}]), "$.gaps[0]"),
    ],
)
def test_another_record_is_refused(record, change, place):
    assert find_faults(record, "Report") == []
    change(record)
    assert set(find_faults(record, "Report")) == {place}


def test_a_report_is_no_batch_and_a_batch_none(record):
    assert find_faults(record, "batch")
    clip = {"name": "a", "fault": "is empty", "gates": [], "notes": []}
    names = SCHEMA["$defs"]["batch"]["properties"]["clips"]["items"]["required"]
    batch = {
        **{name: record[name] for name in ("schema", "tool")},
        "notes": [],
        "gaps": [],
        "clips": [dict.fromkeys(names) | clip],
    }
    assert find_faults(batch, "batch") == []
    assert find_faults({**batch, "clips": [clip]}, "batch")


def read_attributes(path):
    with h5py.File(path) as file:
        names = SCHEMA["$defs"]["result"]["properties"]
        return {name: json.loads(file.attrs[name]) for name in names if name in file.attrs}


def test_attributes_of_results_are_described(run, folder, tiny_result, character_result):
    robust = ("--robust", "--missing", "--smooth", "auto", "-o", "robust.h5", "-q")
    assert run("extract", "frames", "--cage", "cage.obj", *robust).code == 0
    for path in (tiny_result, character_result.path, "robust.h5"):
        found = read_attributes(path)
        assert {"settings", "sources", "notes", "quality", "skipped"} <= set(found)
        assert find_faults(found, "result") == []
    assert find_faults({**found, "quality": {}}, "result")
    assert find_faults({**found, "notes": ["a sentence"]}, "result") == ["$.notes[0]"]


def test_a_type_without_a_rule_is_refused():
    with pytest.raises(TypeError, match="no JSON schema for <class 'set'>"):
        _Definitions().describe(set)


def test_the_page_lists_the_fields(fixtures_folder):
    page = (fixtures_folder.parent / "docs/reports-and-limits.md").read_text(encoding="utf-8")
    section = page.split("## JSON for programs")[1].split("\n## ")[0]
    rows = [line.split("|")[2] for line in section.splitlines() if line.startswith("|")][2:]
    listed = [re.findall("`([a-z_]+)`", row) for row in rows]
    names = ("Report", "FrameRecord", "LimitCheck", "Gap", "batch")
    assert listed == [list(SCHEMA["$defs"][name]["properties"]) for name in names]


def test_the_command_prints_it(run):
    outcome = run("report", "--schema")
    assert (outcome.code, outcome.err) == (0, "")
    assert json.loads(outcome.out) == SCHEMA
