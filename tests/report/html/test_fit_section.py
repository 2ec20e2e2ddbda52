"""Fitted weights beside those before the fit: what is drawn, its numbers, and when it is absent."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from cageik_cli.report.figures import format_percent
from cageik_cli.report.fit_rows import format_fit_rows
from cageik_cli.report.html import pictures
from cageik_cli.report.html.page import render_page, render_result_page
from cageik_cli.report.html.pictures import draw_fit_section, load_fit_shapes
from cageik_cli.report.record import build_report
from cageik_cli.report.render.model_views import load_poses
from cageik_cli.store.result import read_binding
from cageik_cli.view.player.section import load_player
from tests.report.html.test_pictures import PIXELS, open_png
from tests.report.markup import find_faults, parse_page
from tests.shapes import box, quad_box


@pytest.fixture(scope="module")
def report(fitted):
    return build_report(fitted)


@pytest.fixture(scope="module")
def poses(fitted):
    poses = load_poses(fitted)
    named = [replace(pose, name=f"{pose.label}_<frame>") for pose in poses.poses]
    return replace(poses, poses=tuple(named))


@pytest.fixture(scope="module")
def shapes(fitted, poses):
    return load_fit_shapes(fitted, load_poses(fitted))


@pytest.fixture(scope="module")
def draw(report, poses):
    """A function that draws the section of other shapes, or other poses."""
    return lambda shapes, drawn=poses: draw_fit_section(report, drawn, shapes, PIXELS)


@pytest.fixture(scope="module")
def page(report, poses, shapes):
    return render_page(report, poses, shapes, pixels=8)


def tint(view):
    """How much more red than blue each visible pixel is."""
    pixels = open_png(view)
    return (pixels[..., 0] - pixels[..., 2])[pixels[..., 3] > 0]


def test_a_frame_differs_from_its_unfitted_mesh_by_what_is_kept(fitted, shapes):
    assert [fitted.label for _, fitted in shapes.poses] == ["worst", "median"]
    with h5py.File(fitted.path) as file:
        numbers, rms = file["unfitted/frame"][:].tolist(), file["unfitted/rms"][:]
    for one, _ in shapes.poses:
        misses = np.linalg.norm(one.original - one.reconstruction, axis=1)
        expected = rms[numbers.index(fitted.frames.index(one.name))]
        assert abs(np.sqrt(np.mean(misses**2)) - expected) < 1e-6
        percent = 100 * misses / fitted.rest.diagonal
        np.testing.assert_allclose(one.deviation, percent, rtol=0, atol=1e-5)


def test_a_cage_vertex_is_moved_outward_by_a_twentieth_of_the_diagonal(fitted, shapes):
    moved, cage = shapes, fitted.cage.vertices
    assert abs(np.linalg.norm(moved.move) / fitted.rest.diagonal - 0.05) < 1e-12
    assert moved.move @ (cage[moved.vertex] - cage.mean(axis=0)) > 0
    assert (moved.faces_around.faces == moved.vertex).any(axis=1).all()
    weights = read_binding(fitted).weights
    np.testing.assert_array_equal(moved.fitted, weights[:, moved.vertex])
    assert np.abs(moved.fitted - moved.unfitted).max() > 1e-3


def test_whole_polygons_are_drawn_around_a_vertex():
    """A corner of a box has three quads, of which some are cut beside it; of triangles, five."""
    quads, triangles = (pictures._cut_polygons(cage, 0) for cage in (quad_box(), box()))
    assert (len(quads.faces), len(quads.polygon_sides)) == (6, 9)
    assert (triangles.faces == 0).any(axis=1).all()
    assert len(triangles.faces) == (box().faces == 0).any(axis=1).sum()


def test_both_weights_are_drawn_and_look_different(draw, shapes):
    section = draw(shapes)
    assert [[caption for caption, *_ in views] for *_, views in section["poses"]] == [
        ["Input", "Mean-value", "Fitted"]
    ] * 2
    (_, before), (_, after) = section["moved"]
    pairs = [views[1:] for *_, views in section["poses"]] + list(zip(before, after, strict=True))
    assert len(pairs) == 2 + 3
    assert all((open_png(one) != open_png(other)).any() for one, other in pairs)
    assert draw(shapes) == section


def test_what_moves_against_the_vertex_is_blue(draw, shapes):
    m = len(shapes.fitted)
    section = draw(replace(shapes, unfitted=np.full(m, 0.4), fitted=np.full(m, -0.4)))
    assert section["ranges"][1][1:] == ("-2.0000", "-2.0000")
    (_, before), (_, after) = section["moved"]
    assert all(np.median(tint(view)) > 20 for view in before)
    assert all(np.median(tint(view)) < -20 for view in after)


def test_weights_that_are_all_zero_are_drawn(draw, shapes):
    nothing = np.zeros(len(shapes.fitted))
    section = draw(replace(shapes, unfitted=nothing, fitted=nothing))
    assert section["signed_ticks"][-1] == "0.001"


def test_missing_data_is_grey(draw, poses, shapes):
    missing = replace(poses, vertex_rms=np.full(len(poses.vertex_rms), np.nan))
    (*_, views), _ = draw(shapes, missing)["poses"]
    assert abs(np.median(tint(views[2]))) < 12


def test_both_errors_are_given(page, report):
    words, unfitted = parse_page(page).by_id("fit").text, report.unfitted
    assert unfitted.mean_rms_percent > unfitted.fitted_rms_percent
    assert abs(unfitted.fitted_rms_percent - report.summary.rms_percent) < 1e-12
    assert "RMS over all frames" in words
    assert f"{format_percent(unfitted.mean_rms_percent)} % with mean-value weights" in words
    assert f"{format_percent(unfitted.fitted_rms_percent)} % with fitted" in words
    plot = next(parse_page(page).by_id("per-frame").all("img")).attributes["alt"]
    assert f"{format_percent(max(unfitted.rms_percent))} % with mean-value weights" in plot


def test_the_page_says_how_weights_were_fitted(page, report):
    weights = parse_page(page).by_id("weights").text
    assert "How they were fitted" in weights
    for label, text in format_fit_rows(report.fit, is_verbose=True):
        assert f"{label.capitalize()} {text}" in " ".join(weights.split())
    plain = render_page(replace(report, fit=None), None, None, pixels=8)
    assert "How they were fitted" not in plain


def test_a_sample_of_the_frames_says_so(report, poses, shapes):
    some = replace(report.unfitted, frames=(0, 4, 11), rms_percent=(0.0, 1.0, 2.0))
    section = draw_fit_section(replace(report, unfitted=some), poses, shapes, PIXELS)
    assert section["summary"].startswith("RMS over 3 of 12 frames")


def test_the_moved_vertex_has_its_numbers_and_scale(report, poses, shapes):
    """Weights of 0.3 and a move of 5 % make a displacement of 1.5 %."""
    m, spread = len(shapes.fitted), np.linspace(-1, 1, len(shapes.fitted))
    changed = replace(shapes, unfitted=np.full(m, -1e-9), fitted=0.3 * spread)
    section = parse_page(render_page(report, poses, changed, pixels=8)).by_id("fit")
    assert f"Cage vertex {shapes.vertex}, moved outward by 5 % of the diagonal" in section.text
    assert section.rows[1:] == [["mean-value", "-5e-09", "-5e-09"], ["fitted", "-1.5000", "1.5000"]]
    assert "−1.5 −0.75 0 0.75 1.5" in section.text
    assert "clamped beyond ±1.5 %" in section.text
    assert "clamped above" in section.text


def test_the_same_frames_are_shown_with_both_weights(page):
    section = parse_page(page).by_id("fit")
    texts = [image.attributes["alt"] for image in section.all("img")]
    assert texts[:3] == [
        "Worst frame: the input",
        "Worst frame with mean-value weights, coloured by deviation",
        "Worst frame with fitted weights, coloured by deviation",
    ]
    assert len(texts) == 2 * 3 + 2 * 3
    assert find_faults(page) == []


@pytest.mark.parametrize("missing", ["record", "shapes"])
def test_without_the_weights_before_the_fit_there_is_no_section(report, poses, shapes, missing):
    drawn = None if missing == "shapes" else shapes
    told = replace(report, unfitted=None) if missing == "record" else report
    page = render_page(told, poses, drawn, pixels=8)
    assert 'id="fit"' not in page
    assert 'href="#fit"' not in page


def test_a_result_without_a_fit_has_nothing_to_compare(closed):
    assert build_report(closed.result).unfitted is None
    assert load_fit_shapes(closed.result, load_poses(closed.result)) is None


@pytest.mark.slow
def test_a_fitted_result_has_its_section(fitted, report):
    page = render_result_page(fitted, report, load_player(fitted))
    assert len(list(parse_page(page).by_id("fit").all("img"))) == 12
    assert find_faults(page) == []
