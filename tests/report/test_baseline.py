"""A baseline is read from the JSON of report and batch; errors say what is wrong and where."""

import json
import os
from dataclasses import asdict, replace
from decimal import Decimal
from xml.etree import ElementTree

import pytest

from cageik_cli.batch.run import REPORT_FILES
from cageik_cli.report import limits as baseline
from cageik_cli.report.limits import Limits, read_baseline
from cageik_cli.report.overview import ClipEntry, Overview, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.report.views.data import format_json, format_overview_json
from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.text import to_unicode
from tests.report.clips import HOSTILE, clip, percent_metrics, summary

TEN = Decimal(10)


@pytest.fixture
def old(tmp_path):
    return tmp_path / "old.json"


@pytest.mark.parametrize("case", ["closed", "opened"])
def test_one_result_is_read(request, old, case):
    report = build_report(request.getfixturevalue(case).result)
    old.write_text(format_json([report]))
    found = read_baseline(old, TEN)
    digest = report.sources["frames"]["sha256"]
    expected = {"cages.h5": percent_metrics(report.summary)}
    assert found == baseline.Baseline(old, expected, TEN, {"cages.h5": digest})


def test_several_results_and_a_batch_are_read(closed, opened, old):
    first, second = (
        build_report(case.result, name=name) for case, name in ((closed, "a/b"), (opened, "ü"))
    )
    expected = {"a/b": percent_metrics(first.summary), "ü": percent_metrics(second.summary)}
    old.write_text(format_json([first, second]))
    assert read_baseline(old, TEN).metrics == expected
    failed = ClipEntry("c", fault="it is broken")
    old.write_text(
        format_overview_json(Overview([build_clip_entry(first), failed, build_clip_entry(second)]))
    )
    assert read_baseline(old, TEN).metrics == expected
    old.write_text(old.read_text(), encoding="utf-8-sig")
    assert read_baseline(old, TEN).metrics == expected


def record(**changes):
    """A record with changed metrics in its summary; `...` removes one."""
    figures = {key: v for key, v in (asdict(summary()) | changes).items() if v is not ...}
    return {"schema": 1, "result": "a.h5", "summary": figures}


def without(key):
    return {name: value for name, value in record().items() if name != key}


NAN = float("nan")
FAULTS = {
    "no JSON": ("{", "line 1, column 2"),
    "empty": ("", "the file is empty"),
    "no text": (b"\xff\xfe\x00", "byte 0"),
    "nan": (json.dumps(record(rms_percent=NAN)), "NaN"),
    "infinite": (json.dumps(record(rms_percent=-float("inf"))), "-Infinity"),
    "very deep": ("[" * 200_000, "16 levels"),
    "a number of many digits": ("1" * 5000, "thousands of digits"),
    "a number": (5, "old.json: is 5, "),
    "null": (None, "old.json: is null, "),
    "nothing": ([], "no result"),
    "failed alone": ({"schema": 1, "clips": [{"name": "a"}]}, "no result"),
    "a list of others": ([record(), 7], "old.json: [1]: is 7, "),
    "no schema": (without("schema"), "schema is null, expected 1"),
    "schema 2": ({**record(), "schema": 2}, "schema is 2, expected 1"),
    "schema true": ({**record(), "schema": True}, "schema is true, expected 1"),
    "schema of a batch": ({"schema": "x" * 99, "clips": []}, 'schema is "xxxxx'),
    "no name": (without("result"), "result: is null, "),
    "no summary": (without("summary"), "old.json: summary: is null, "),
    "clips no list": ({"schema": 1, "clips": {}}, "clips: is an object, "),
    "clip no object": ({"schema": 1, "clips": ["a"]}, 'clips[0]: is "a", '),
    "clip no name": (
        {"schema": 1, "clips": [{"name": 3, "summary": {}}]},
        "clips[0]: name: is 3, ",
    ),
    "clip no summary": (
        {"schema": 1, "clips": [{"name": "a", "summary": 3}]},
        "clips[0]: summary: is 3, ",
    ),
    "a key twice": ('[{"schema": 1, "schema": 1}]', '[0]: has "schema" twice'),
    "sources no object": ({**record(), "sources": 3}, "sources: is 3, expected an object"),
    "twice": ([record(), record()], "a.h5"),
    "too large": ('{"schema": 1, "result": "a", "summary": {"rms_percent": 1e999}}', "Infinity"),
    **{
        f"{name} {value!r}": (
            [record(), {**record(**{name: value}), "result": "b"}],
            f"old.json: [1]: summary.{name} is ",
        )
        for name in baseline.SUMMARY_FIELDS.values()
        for value in ("1", True, [1])
    },
    "too many digits": (record(rms_percent=10**400), "summary.rms_percent: is 1000000000"),
    "no change": (record(volume_change_percent_max=...), "summary.volume_change_percent_max is "),
    **{
        f"{name} {value!r}": (
            record(**{name: value}),
            f"old.json: summary.{name} is {json.dumps(value)}, ",
        )
        for name in list(baseline.SUMMARY_FIELDS.values())[:3]
        for value in (None, -0.1)
    },
}


@pytest.mark.parametrize(("content", "says"), FAULTS.values(), ids=FAULTS)
def test_any_other_content_is_an_error_that_says_where(old, content, says):
    if isinstance(content, str | bytes):
        old.write_bytes(content if isinstance(content, bytes) else content.encode())
    else:
        old.write_text(json.dumps(content))
    with pytest.raises(FormatError) as error:
        read_baseline(old, TEN)
    assert str(error.value).startswith(f"{old}: ")
    assert says in str(error.value)
    assert len(str(error.value)) < len(str(old)) + 250


def test_a_file_that_is_too_large_is_not_read(old, monkeypatch):
    old.write_text(json.dumps(record()))
    monkeypatch.setattr(baseline, "MAX_BASELINE_BYTES", old.stat().st_size)
    assert read_baseline(old, TEN).metrics
    monkeypatch.setattr(baseline, "MAX_BASELINE_BYTES", old.stat().st_size - 1)
    with pytest.raises(FileAccessError, match=rf"old\.json: .*{baseline.MAX_BASELINE_BYTES} bytes"):
        read_baseline(old, TEN)


def test_a_missing_file_and_a_folder_are_refused(old):
    with pytest.raises(FileAccessError, match=r"old\.json: .*no such file"):
        read_baseline(old, TEN)
    old.mkdir()
    with pytest.raises(FileAccessError, match=r"old\.json: "):
        read_baseline(old, TEN)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_refused_without_waiting(old):
    os.mkfifo(old)
    with pytest.raises(FileAccessError, match=r"old\.json: "):
        read_baseline(old, TEN)


@pytest.mark.parametrize("name", HOSTILE.values(), ids=HOSTILE)
def test_clips_of_any_name_that_are_missing_are_in_all_views(old, name):
    old.write_text(json.dumps(record() | {"result": name}))
    entry, limits = clip("a/b"), Limits((), read_baseline(old, TEN)).match_several(["a/b"])
    overview = Overview([entry], limits={"a/b": limits})
    assert [gap.is_new for gap in overview.gaps] == [True, False]
    assert overview.exit_code == 3
    views = {file: view(overview) for file, view in REPORT_FILES.items()}
    assert all(text.encode() for text in views.values())
    found = json.loads(views["report.json"])["gaps"]
    assert [gap["name"] for gap in found] == ["a/b", to_unicode(name)]
    suite = ElementTree.fromstring(views["junit.xml"])[-1]
    assert (suite.get("name"), suite.get("failures"), len(suite.findall("testcase"))) == (
        "baseline", "2", 2,
    )  # fmt: skip
    for file, heading in (("report.md", "### Not in both"), ("index.html", "2 clips not in both")):
        assert heading in views[file]
    allowed = replace(limits.baseline, allow_new=True, allow_missing=True)
    assert Overview([entry], limits={"a/b": Limits((), allowed)}).exit_code == 0
