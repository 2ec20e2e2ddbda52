"""The section of the page on fitted weights: its numbers, its pictures, and when it is left out."""

from dataclasses import replace

import pytest

from cageik_cli.report.figures import format_percent
from cageik_cli.report.html.fit_section import FitPictures
from cageik_cli.report.html.page import render_page, render_result_page
from cageik_cli.report.html.pictures import PosePictures
from cageik_cli.report.record import build_report
from tests.report.html.test_page import pictures_of_one_point, png
from tests.report.markup import find_faults, parse_page

DRAWN = FitPictures(
    poses=tuple(
        PosePictures(
            label, f"{label}_<frame>", dict.fromkeys(("original", "unfitted", "fitted"), png())
        )
        for label in ("worst", "median")
    ),
    moved=tuple(
        PosePictures("moved", name, dict.fromkeys(("unfitted", "fitted"), png()))
        for name in ("close up", "whole model")
    ),
    vertex=17,
    max_deviation_percent=4.0,
    max_move_percent=1.5,
    unfitted_range=(-1e-9, 2.5),
    fitted_range=(-0.25, 2.0),
)


@pytest.fixture(scope="module")
def report(fitted):
    return build_report(fitted)


@pytest.fixture(scope="module")
def page(report):
    return render_page(report, pictures_of_one_point(), DRAWN)


def test_both_errors_are_given(page, report):
    words, unfitted = parse_page(page).by_id("fit").text, report.unfitted
    assert unfitted.mean_rms_percent > unfitted.fitted_rms_percent
    assert abs(unfitted.fitted_rms_percent - report.summary.rms_percent) < 1e-12
    assert "RMS over all frames" in words
    assert f"{format_percent(unfitted.mean_rms_percent)} % with mean-value weights" in words
    assert f"{format_percent(unfitted.fitted_rms_percent)} % with fitted" in words


def test_a_sample_of_the_frames_says_so(report):
    some = replace(report.unfitted, frames=(0, 4, 11), rms_percent=(0.0, 1.0, 2.0))
    page = render_page(replace(report, unfitted=some), pictures_of_one_point(), DRAWN)
    assert "RMS over 3 of 12 frames" in parse_page(page).by_id("fit").text


def test_the_moved_vertex_has_its_numbers_and_scale(page):
    section = parse_page(page).by_id("fit")
    assert "Cage vertex 17, moved outward by 5 % of the diagonal" in section.text
    assert section.rows[1:] == [["mean-value", "0.0000", "2.5000"], ["fitted", "-0.2500", "2.0000"]]
    assert "−1.5 −0.75 0 0.75 1.5" in section.text
    assert "clamped beyond ±1.5 %" in section.text
    assert "clamped above 4 %" in section.text


def test_the_same_frames_are_shown_with_both_weights(page):
    section = parse_page(page).by_id("fit")
    texts = [image.attributes["alt"] for image in section.all("img")]
    assert texts[:3] == [
        "Worst frame: the input",
        "Worst frame with mean-value weights, coloured by deviation",
        "Worst frame with fitted weights, coloured by deviation",
    ]
    assert len(texts) == 2 * 3 + 2 * 2
    assert "worst_<frame>" in section.text


def test_the_page_is_sound(page):
    assert find_faults(page) == []


def test_the_plot_describes_both_curves(page, report):
    plot = next(parse_page(page).by_id("per-frame").all("img")).attributes["alt"]
    assert f"{format_percent(max(report.unfitted.rms_percent))} % with mean-value weights" in plot


@pytest.mark.parametrize("missing", ["record", "pictures"])
def test_without_the_weights_before_the_fit_there_is_no_section(report, missing):
    drawn = None if missing == "pictures" else DRAWN
    told = replace(report, unfitted=None) if missing == "record" else report
    page = render_page(told, pictures_of_one_point(), drawn)
    assert 'id="fit"' not in page
    assert 'href="#fit"' not in page


@pytest.mark.slow
def test_a_result_without_a_fit_has_no_section(closed):
    assert build_report(closed.result).unfitted is None
    assert 'id="fit"' not in render_result_page(closed.result, build_report(closed.result))


@pytest.mark.slow
def test_a_fitted_result_has_its_section(fitted, report):
    page = render_result_page(fitted, report)
    assert len(list(parse_page(page).by_id("fit").all("img"))) == 12
    assert find_faults(page) == []
