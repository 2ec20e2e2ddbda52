"""The views of an edited result: distances moved, and no errors."""

import json
import re
from dataclasses import replace
from decimal import Decimal
from functools import partial
from xml.etree import ElementTree

import pytest

from cageik_cli.batch.jobs import ClipState, Outcome
from cageik_cli.batch.run import _describe_outcome
from cageik_cli.report.html.index import render_index
from cageik_cli.report.html.page import render_page
from cageik_cli.report.limits import METRICS, Limit, Limits
from cageik_cli.report.overview import ClipEntry, Overview, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.report.views.data import format_csv, format_json, format_junit, format_overview_json
from cageik_cli.report.views.front import format_front
from cageik_cli.report.views.markdown import format_markdown
from cageik_cli.report.views.text import format_text
from cageik_cli.report.vocabulary import (
    EDIT_VOCABULARY,
    EXTRACTION_VOCABULARY,
    QUALITY_WORDS,
    SETTING_MEANINGS,
)
from tests.report.drawings import texts
from tests.report.markup import find_faults, parse_page

OF_ERRORS = re.compile(
    r"error|deviation|reconstruct|rebuilt|worst|best|extracted|of the input|E_RMS|KG", re.IGNORECASE
)
LIMITS = Limits(tuple(Limit(metric, Decimal("0.0001")) for metric in METRICS))


def _text(report):
    """The text without its rows on weights, which have an error of their own."""
    return re.sub(r"\n  (weights|accuracy) .*", "", format_text(report))


def _page(report, poses):
    """All texts of a page, with those of its pictures, without the section on weights."""
    page = parse_page(render_page(report, poses, pixels=8))
    page.by_id("weights").children.clear()
    names = ("alt", "aria-label", "data-cursor")
    told = [element.attributes.get(name, "") for element in page.all() for name in names]
    return "\n".join([page.text, *told])


def _figure(report):
    return "\n".join(texts(report))


def _markdown(report):
    return format_markdown(Overview([build_clip_entry(report)]))


def _junit(report):
    root = ElementTree.fromstring(format_junit(Overview([build_clip_entry(report)])))
    return "\n".join([*root.itertext(), *(case.attrib["name"] for case in root.iter("testcase"))])


def _index(report):
    """The heading "worst first" is for errors and edits."""
    page = parse_page(render_index(Overview([build_clip_entry(report)])))
    told = [element.attributes.get("aria-label", "") for element in page.all("svg")]
    return "\n".join([page.text, *told]).replace("worst first", "")


@pytest.fixture(scope="module")
def plain(poses):
    """Poses without a worst region, as those of an edit."""
    return replace(poses, region=None)


@pytest.fixture(params=[_text, _page, _figure, _markdown, _junit, _index])
def view(request, plain):
    return partial(_page, poses=plain) if request.param is _page else request.param


@pytest.fixture(params=["edited", "edited_open"])
def report(request):
    return build_report(request.getfixturevalue(request.param), LIMITS)


def test_no_view_of_an_edit_mentions_errors(view, report):
    assert OF_ERRORS.findall(view(report)) == []


def test_every_view_of_an_extraction_mentions_errors(view, closed):
    assert OF_ERRORS.search(view(build_report(closed.result, LIMITS)))


@pytest.mark.parametrize("limits", [LIMITS, Limits()])
def test_every_view_of_an_edit_says_that_it_moved(view, limits, edited):
    assert "moved" in view(build_report(edited, limits))


def test_the_text_names_the_edited_result_and_the_distance(edited):
    report = build_report(edited, LIMITS)
    lines = format_text(report).splitlines()
    rows = [(line[2:16].strip(), line[17:]) for line in lines[1:]]
    assert rows[0] == ("edited from", "cages.h5")
    found = dict(rows)
    assert found["distance moved"].startswith(f"{report.summary.rms_percent:.4f} % of the diagonal")
    assert found["most moved"].endswith(f" at {report.summary.worst_frame}")
    assert f"vertex {report.summary.max_deviation_vertex} of" in found["max distance"]
    assert "; drift from rest before the edit " in found["volume change"]
    assert "condition number" in found["extraction"]
    assert "metrics" not in found
    percent, worst = f"{report.summary.rms_percent:.4f} %", report.summary.worst_frame
    assert ("over limit", f"rms moved {percent}, limit 0.0001 %, most moved {worst}") in rows


def test_the_page_of_an_edit_says_so_in_its_title(edited, plain):
    report = build_report(edited)
    page = parse_page(render_page(report, plain, pixels=8))
    title = next(page.all("title"))
    assert title.text.startswith(f"edited.h5: moved {report.summary.rms_percent:.4f} %")
    assert "edited from cages.h5" in page.text
    assert "does not measure how well the cage follows the animation" in page.text
    assert "Edited by cageik" in page.text
    titles = [heading.text for heading in page.all("h3")]
    assert titles[1] == f"Most moved frame {plain.poses[1].name}"
    assert [column.text for column in page.by_id("frames-table").all("th")][2:11] == [
        "RMS, %", "RMS, file units", "Max distance, %", "Max distance, file units", "At vertex",
        "Volume change, %", "Volume before", "Volume after", "Drift before, %",
    ]  # fmt: skip
    assert "Of the extraction" in page.by_id("weights").text


def test_the_page_of_an_edit_is_sound(report, plain):
    assert find_faults(render_page(report, plain, pixels=8)) == []


def test_records_name_the_edited_result(edited, closed):
    reports = [build_report(edited), build_report(closed.result)]
    clips = json.loads(
        format_overview_json(Overview([build_clip_entry(report) for report in reports]))
    )["clips"]
    for records in (json.loads(format_json(reports)), clips):
        assert [record["edited_from"] for record in records] == ["cages.h5", None]


def test_edits_are_marked_among_extractions(edited, closed):
    both = Overview(
        [build_clip_entry(build_report(edited)), build_clip_entry(build_report(closed.result))]
    )
    name = "edited (edited: distance moved from cages.h5)"
    assert name in parse_page(render_index(both)).text
    assert name in format_markdown(both).replace("\\", "")
    assert "| edited |" in format_markdown(both)
    assert "| **poor** |" in format_markdown(both)
    cases = [
        case.attrib["name"] for case in ElementTree.fromstring(format_junit(both)).iter("testcase")
    ]
    assert cases == ["edited", "extracted"]


def test_several_results_use_the_words_of_edits_if_all_are_edited(edited, closed):
    clip = build_clip_entry(build_report(edited))
    failed = ClipEntry("broken", fault="it is empty")
    assert Overview([clip, failed]).vocabulary is EDIT_VOCABULARY
    extracted = build_clip_entry(build_report(closed.result))
    assert Overview([clip, extracted]).vocabulary is EXTRACTION_VOCABULARY
    assert Overview([failed]).vocabulary is EXTRACTION_VOCABULARY


def test_every_setting_of_an_edit_has_a_meaning(edited):
    assert {"pose_alpha", "pose_beta", "rigidity", "hard", "snap"} < set(edited.settings)
    assert set(edited.settings) <= set(SETTING_MEANINGS)


def test_a_verdict_is_worded_in_one_place_and_is_a_key_for_programs(closed, monkeypatch):
    report = replace(build_report(closed.result), quality="poor")
    entry = ClipEntry("a", report=report)
    before = [format_json([report]), format_csv([report]), format_overview_json(Overview([entry]))]
    monkeypatch.setitem(QUALITY_WORDS, "poor", "lousy")
    assert before == [
        format_json([report]), format_csv([report]), format_overview_json(Overview([entry]))
    ]  # fmt: skip
    assert json.loads(before[0])["quality"] == "poor"
    for text in (
        _describe_outcome(Outcome(entry, ClipState.DONE)),
        format_front(report),
        render_page(report),
        format_markdown(Overview([entry])),
        render_index(Overview([build_clip_entry(report)])),
    ):
        assert "lousy" in text.lower()
        shown = re.sub("<script.*?</script>|<style.*?</style>", "", text, flags=re.S)
        assert not re.search(r"\bpoor\b", shown, re.I)
