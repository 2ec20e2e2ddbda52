"""The text report: error first, the numbers of the record, notes last."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.report.html.page import render_page
from cageik_cli.report.record import build_report
from cageik_cli.report.views.text import format_text
from cageik_cli.util.messages import Note
from tests.shapes import rotation


def test_the_text_shows_the_numbers_of_the_record(report):
    lines = format_text(replace(report, regions=())).splitlines()
    summary = report.summary
    assert lines[0].startswith("cages.h5: 5 frames of 18 vertices in a cage of 8, diagonal 3.4641")
    rows = {line[2:16].strip(): line[17:] for line in lines[1:]}
    assert rows["error"].startswith(f"{summary.rms_percent:.4f} % of the diagonal")
    assert rows["worst frame"].endswith(f" at {summary.worst_frame}")
    assert f"vertex {summary.max_deviation_vertex} of " in rows["max deviation"]
    assert rows["volume change"].startswith(f"largest {summary.volume_change_percent_max:+.4f} % (")
    assert f"E_RMS {summary.e_rms:.4g} (" in rows["metrics"]
    assert f"KG error {summary.kg_error:.4g} (" in rows["metrics"]
    assert rows["size"] == "24 floats per frame instead of 54, plus one 18 x 8 weight matrix"
    quality = report.binding
    assert rows["accuracy"] == (
        f"standard: estimated weight error {quality.estimated_error:.1e} (mean sum per vertex), "
        f"{quality.panels} panels (pieces of faces)"
    )
    assert "alpha 0.001, beta 1" in rows["system"]
    assert "nan" not in format_text(report)
    assert max(map(len, lines)) < 120


def test_closed_forms_have_no_panels(report):
    text = format_text(replace(report, binding=replace(report.binding, panels=0)))
    assert "  accuracy       exact (closed form)" in text


def test_an_open_model_is_noted_once(opened):
    text = format_text(build_report(opened.result))
    assert "volume change  not defined, the model is open" in text
    assert text.count("  note           the model is open") == 1


def test_missing_settings_are_unknown(report):
    text = format_text(
        replace(report, settings={}, notes=(Note("first"), Note("second", "warning")))
    )
    assert ", alpha unknown, beta unknown" in text
    assert text.splitlines()[-2:] == ["  note           first", "  warning        second"]


def test_the_error_by_radius_is_in_all_views_and_does_not_follow_the_axes(make_case, animation):
    def view(turn):
        frames, cage = animation.frames @ turn, animation.cage.vertices @ turn
        return build_report(make_case(frames, animation.rest.faces, cage).result)

    report, turned = view(np.eye(3)), view(rotation(1))
    assert turned.clip.diagonal != pytest.approx(report.clip.diagonal, rel=0.01)
    assert turned.summary.radius_rms_percent == pytest.approx(
        report.summary.radius_rms_percent, rel=1e-5
    )
    percent = f"{report.summary.radius_rms_percent:.4f}"
    assert f"by radius      {percent} % of the radius" in format_text(report)
    page = render_page(report)
    assert "Error by radius" in page
    assert percent in page
