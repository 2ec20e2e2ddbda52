"""The overview of many clips: its exit code, its curves, its tables."""

import csv
import io
import json
from dataclasses import asdict, fields, replace

import pytest

from cageik_cli.report.figures import ClipRecord, ReportSummary
from cageik_cli.report.overview import (
    ClipEntry,
    Overview,
    build_clip_entry,
    describe_poor,
    shorten_names,
)
from cageik_cli.report.record import build_report
from cageik_cli.report.views.data import format_overview_csv, format_overview_json
from tests.report.clips import clip, gate, poor

WELL, OVER, FAILED = clip("a", gate(True)), clip("b", gate(False)), ClipEntry("c", fault="broken")
UNJUDGED, BARE = clip("d", gate(None)), clip("e")


@pytest.mark.parametrize(
    ("entries", "code"),
    [
        ([], 0),
        ([WELL], 0),
        ([UNJUDGED, BARE, WELL], 0),
        ([poor("a"), poor("b", gate(True))], 0),
        ([OVER], 3),
        ([WELL, OVER, UNJUDGED], 3),
        ([clip("a", gate(True), gate(None), gate(False))], 3),
        ([FAILED], 1),
        ([FAILED, FAILED], 1),
        ([FAILED, WELL], 4),
        ([WELL, FAILED, FAILED], 4),
        ([OVER, FAILED], 4),
        ([OVER, WELL, FAILED, UNJUDGED], 4),
    ],
)
def test_the_exit_code(entries, code):
    assert Overview(entries).exit_code == code
    assert Overview(entries[::-1]).exit_code == code


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["walk/cages.h5", "run/cages.h5"], ["walk", "run"]),
        (["shots/s010/body.abc", "shots/s020/hat.abc"], ["s010/body", "s020/hat"]),
        (["a/b", "a/b/c"], ["b", "b/c"]),
        (["a/x/a", "a/a"], ["x/a", "a"]),
        (["walk.usdc", "run.abc"], ["walk.usdc", "run.abc"]),
        (["v1. old", "v2. old"], ["v1. old", "v2. old"]),
        (["alone/clip.abc"], ["alone/clip.abc"]),
        (["same", "same"], ["same", "same"]),
        ([], []),
    ],
)
def test_names_drop_what_all_share(names, short):
    assert shorten_names(names) == short


def test_poor_clips_come_before_others_and_are_named_by_what_helps():
    clips = [clip("a/well"), poor("a/x", better="--fit"), OVER, poor("a/y", better="--fit")]
    overview = Overview([*clips, poor("a/z")])
    assert [entry.name for entry in overview.worst_first] == ["b", "a/x", "a/y", "a/z", "a/well"]
    assert describe_poor(overview.clips) == ["poor: a/x, a/y; better: --fit", "poor: a/z"]


def build_curve(report, rms, other, worst):
    """Build the curve of a report whose frames have these metrics; None is a skipped frame."""
    frame = report.frames[0]
    frames = tuple(
        replace(frame, rms_percent=a, volume_change=b, max_deviation_percent=b)
        for a, b in zip(rms, other, strict=True)
    )
    figures = replace(report.summary, worst_frame_index=worst)
    return build_clip_entry(replace(report, frames=frames, summary=figures)).curve


@pytest.fixture(params=["closed", "opened"])
def report(request):
    return build_report(request.getfixturevalue(request.param).result)


def test_short_clips_keep_all_frames_and_gaps(report):
    curve = build_curve(report, [0.5, None, 0.25, 1.0], [-1.0, None, 2.0, None], 3)
    assert curve.rms_percent == (0.5, None, 0.25, 1.0)
    assert curve.other == (-1.0, None, 2.0, None)
    assert curve.worst == 3
    assert build_curve(report, [0.5], [-1.0], 0).rms_percent == (0.5,)


@pytest.mark.parametrize("count", [120, 121, 239, 240, 1000])
def test_a_span_has_the_largest_of_its_frames(report, count):
    """Each frame is in one span, in order, and sizes of spans differ by at most one."""
    rms = [float((37 * k) % count) for k in range(count)]
    other = [value if k % 2 else -value for k, value in enumerate(rms)]
    worst = rms.index(max(rms))
    curve = build_curve(report, rms, other, worst)
    assert len(curve.rms_percent) == len(curve.other) == 120
    long, size = count % 120, count // 120
    start = 0
    for k in range(120):
        end = start + size + (k < long)
        assert curve.rms_percent[k] == max(rms[start:end])
        assert curve.other[k] == max(other[start:end], key=abs)
        assert (start <= worst < end) is (k == curve.worst)
        start = end
    assert start == count


def test_a_span_of_gaps_is_a_gap(report):
    """240 frames in spans of two: all of the second span is skipped, and half of the third."""
    rms = [1.0] * 240
    rms[2] = rms[3] = rms[4] = None
    curve = build_curve(report, rms, rms, 0)
    assert curve.rms_percent[:4] == (1.0, None, 1.0, 1.0)
    assert curve.other[:4] == (1.0, None, 1.0, 1.0)


@pytest.mark.parametrize(
    ("case", "field"), [("closed", "volume_change"), ("opened", "max_deviation_percent")]
)
def test_the_other_curve_is_the_volume_change_if_there_is_one(request, case, field):
    report = build_report(request.getfixturevalue(case).result)
    expected = tuple(getattr(frame, field) for frame in report.frames)
    assert build_clip_entry(report).curve.other == expected


def test_an_entry_has_the_values_of_its_report(closed):
    report = build_report(closed.result, name="walk/run")
    entry = build_clip_entry(report, "walk/run.h5", "walk/run.html")
    assert (entry.name, entry.result, entry.page) == ("walk/run", "walk/run.h5", "walk/run.html")
    assert entry.report == replace(report, frames=())
    assert not entry.has_failed


def test_json_is_the_whole_record(closed):
    report = build_report(closed.result)
    entry = build_clip_entry(report, "walk.h5", "walk.html")
    record = json.loads(format_overview_json(Overview([entry, OVER, FAILED, UNJUDGED])))
    names = (
        "baseline_name",
        "sources",
        "clip",
        "binding",
        "summary",
        "gates",
        "notes",
        "edited_from",
        "regions",
        "fit",
        "quality",
    )
    expected = {"name": "cages.h5", "fault": None, "result": "walk.h5", "page": "walk.html"}
    expected |= {name: asdict(report)[name] for name in names} | {"curve": asdict(entry.curve)}
    assert record["clips"][0] == json.loads(json.dumps(expected, default=str))
    assert record["clips"][2] == dict.fromkeys(expected) | {
        "name": "c",
        "fault": "broken",
        "gates": [],
        "notes": [],
    }
    assert record["schema"] == 1
    assert record["gaps"] == []
    assert [entry["fault"] for entry in record["clips"]] == [None, None, "broken", None]
    assert record["clips"][1]["gates"][0]["passed"] is False


def test_csv_has_one_line_per_clip():
    both = clip("x,y\n", gate(False), gate(False, metric="frame_rms"), gate(False))
    rows = list(csv.DictReader(io.StringIO(format_overview_csv(Overview([WELL, both, FAILED])))))
    columns = {field.name for record in (ClipRecord, ReportSummary) for field in fields(record)}
    assert set(rows[0]) == {"name", "fault", "over_limit", *columns}
    assert [row["name"] for row in rows] == ["a", "x,y\n", "c"]
    assert [row["fault"] for row in rows] == ["", "", "broken"]
    assert [row["over_limit"] for row in rows] == ["", "rms frame_rms", ""]
    assert [row["rms_percent"] for row in rows] == ["0.25", "0.25", ""]
    assert [row["frames"] for row in rows] == ["5", "5", ""]
