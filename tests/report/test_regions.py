"""The worst regions in every view, and nothing where there are none."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from cageik_cli.cli.group import spell_option
from cageik_cli.method.solve.regions import Cause
from cageik_cli.report.html.page import render_page
from cageik_cli.report.html.pictures import draw_pictures
from cageik_cli.report.overview import Overview, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.report.regions import CAUSES, REGIONS_UNKNOWN, describe_region, explain_regions
from cageik_cli.report.render.model_views import load_poses
from cageik_cli.report.views.data import format_json
from cageik_cli.report.views.markdown import format_markdown
from cageik_cli.report.views.text import format_text
from cageik_cli.report.vocabulary import EXTRACTION_VOCABULARY
from tests.report.markup import find_faults, parse_page
from tests.report.views.test_markdown import list_items
from tests.store.bindings import record
from tests.texts import texts


@pytest.fixture(scope="module")
def result(closed):
    """A result whose largest deviation is above 3 % of the diagonal."""
    assert closed.result.regions
    return closed.result


def within_the_usual(result):
    """The same result with a tenth of its deviations, and no regions."""
    metrics = replace(result.metrics, max_deviation=0.01 * result.metrics.max_deviation)
    return replace(result, metrics=metrics, regions=())


def test_the_record_has_the_regions_in_percent_too(result, report):
    for region, stored in zip(report.regions, result.regions, strict=True):
        percent = 100 / result.rest.diagonal
        assert region.size_percent == pytest.approx(percent * stored.size)
        assert region.max_deviation_percent == pytest.approx(percent * stored.max_deviation)
        assert (region.frame, region.frame_index) == (result.frames[stored.frame], stored.frame)
        assert region.cause in set(Cause)
    first = json.loads(format_json([report]))["regions"][0]
    largest = report.summary.max_deviation_percent  # measured from the same frame, in another order
    assert report.regions[0].max_deviation_percent == pytest.approx(largest, rel=1e-12)
    assert first["cage_faces"] == list(report.regions[0].cage_faces)
    assert first["evidence"]["smallest_angle"] > 0


def test_the_text_has_a_row_for_each_region(report):
    rows = [(line[2:16].strip(), line[17:]) for line in format_text(report).splitlines()[1:]]
    names = [name for name, _ in rows]
    start = names.index("worst regions")
    assert "3 % of the diagonal" in rows[start][1]
    count = len(report.regions)
    assert names[start + 1 : start + 1 + count] == [f"region {k + 1}" for k in range(count)]
    first, text = report.regions[0], rows[start + 1][1]
    assert text.startswith(f"{first.max_deviation_percent:.4f} % in {first.frame}, at (")
    assert f"size {first.size_percent:.1f} %" in text
    assert ", ".join(map(str, first.cage_faces)) in text
    assert text.endswith(CAUSES[Cause(first.cause)][0])
    assert str(CAUSES[Cause(first.cause)][1]) in dict(rows)["to do"]
    assert all(len(line) < 160 for line in format_text(report).splitlines())


def test_the_reason_is_the_limit_that_is_exceeded(report):
    for rms, largest, why in (
        (0.001, 0.02, "10 times the rms"),
        (0.02, 0.1, "3 % of the diagonal"),
        (0.001, 0.1, "10 times the rms and 3 % of the diagonal"),
    ):
        largest_percent = {"max_deviation": largest, "max_deviation_percent": 50 * largest}
        summary = replace(report.summary, rms=rms, **largest_percent)
        assert explain_regions(summary).endswith(f"more than {why}")


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_has_words(report, cause):
    region = replace(report.regions[0], cause=str(cause), cage_faces=(3,))
    told = replace(report, regions=(region,))
    assert describe_region(region).endswith(f"cage face 3: {CAUSES[cause][0]}")
    assert str(CAUSES[cause][1]) in format_text(told)
    assert CAUSES[cause][0] in parse_page(render_page(told)).by_id("regions").text


def test_a_fit_is_suggested_where_limbs_share_a_loop_and_there_is_none(report):
    region = replace(report.regions[0], cause=str(Cause.SHARED_LOOP))
    told = replace(report, regions=(region, region))
    fitted = replace(told, fit=record())
    for one, count in ((told, 1), (fitted, 0)):
        assert format_text(one).count("weights that are fitted with `fit=True`") == count
    page = parse_page(render_page(told, spelling=spell_option)).by_id("regions").text
    assert page.count("weights that are fitted with --fit") == 1
    assert "--rest-frame auto" in page
    other = replace(region, cause=str(Cause.COARSE_FACES))
    assert "fit=" not in format_text(replace(report, regions=(other,)))
    assert all(len(line) < 160 for line in format_text(told).splitlines())


def test_a_result_within_the_usual_says_nothing(result, poses):
    report = build_report(within_the_usual(result))
    page = render_page(report, replace(poses, region=None), pixels=8)
    assert report.regions == ()
    assert "region" not in format_text(report)
    assert REGIONS_UNKNOWN not in texts(report.notes)
    assert 'id="regions"' not in page
    assert 'href="#regions"' not in page
    assert "Worst regions" not in format_markdown(Overview([build_clip_entry(report)]))


def test_an_earlier_result_says_that_it_does_not_know(result):
    report = build_report(replace(result, regions=None))
    assert report.regions is None
    assert texts(report.notes) == (REGIONS_UNKNOWN, *texts(result.notes))
    assert "extract it again" in format_text(report)
    assert REGIONS_UNKNOWN in render_page(report)
    usual = replace(within_the_usual(result), regions=None)
    assert REGIONS_UNKNOWN not in texts(build_report(usual).notes)


def test_an_edit_has_no_regions_and_does_not_miss_them(edited):
    report = build_report(edited)
    assert report.regions is None
    assert REGIONS_UNKNOWN not in texts(report.notes)


def test_the_page_has_a_table_and_a_close_up(report, poses):
    text = render_page(report, poses, pixels=8)
    section = parse_page(text).by_id("regions")
    rows = section.rows[1:]
    assert [row[0] for row in rows] == [str(k + 1) for k in range(len(report.regions))]
    assert rows[0][1] == f"{report.regions[0].max_deviation_percent:.4f}"
    assert rows[0][2] == report.regions[0].frame
    assert [image.attributes["alt"] for image in section.all("img")] == [
        "Worst region, close up: the input",
        "Worst region, close up: the reconstruction, coloured by deviation",
        "Worst region, close up: the cage",
    ]
    assert 'href="#regions"' in text
    assert find_faults(text) == []


def test_a_page_without_pictures_has_the_table(report):
    section = parse_page(render_page(report)).by_id("regions")
    assert list(section.all("img")) == []
    assert len(list(section.all("tr"))) == 1 + len(report.regions)


def test_the_camera_looks_at_the_worst_region(result, poses):
    view, worst = poses.region, result.regions[0]
    assert view.pose.name == result.frames[worst.frame]
    off = np.linalg.norm(view.pose.reconstruction[worst.worst_vertex] - view.centre)
    assert off < view.extent


def test_all_poses_are_seen_from_the_side_of_the_worst_region(poses):
    regions = (None, *(replace(poses.region, turn=turn) for turn in (32.0, 212.0)))
    plain, usual, behind = (
        draw_pictures(replace(poses, region=region), EXTRACTION_VOCABULARY, 40)
        for region in regions
    )
    # The rest pose, a ball, looks the same from everywhere.
    for one, other in zip(usual["poses"][1:], behind["poses"][1:], strict=True):
        assert one["views"][0] != other["views"][0]
    assert usual["poses"] == plain["poses"]
    assert usual["rest_views"] == plain["rest_views"] == behind["rest_views"]
    assert (len(plain["close_up"]), len(usual["close_up"])) == (0, 3)


def test_without_its_frame_a_region_has_no_close_up(result, tmp_path):
    shortened = tmp_path / "cages.h5"
    shortened.write_bytes(result.path.read_bytes())
    with h5py.File(shortened, "r+") as file:
        file["poses/frame"][:] = 0
    assert load_poses(replace(result, path=shortened)).region is None
    assert load_poses(replace(result, regions=())).region is None


def test_markdown_names_the_worst_region_of_each_clip(report):
    text = format_markdown(Overview([build_clip_entry(report, "a.h5")]))
    part = text[text.index("### Worst regions") :].split("\n###")[0]
    assert list_items(part) == [f"cages.h5: {describe_region(report.regions[0])}"]
