"""The player as an app, and as a card: its layout, bar of time, ground, axes and list of keys."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.report.html.page import render_result_page
from cageik_cli.report.record import build_report
from cageik_cli.store.result import read_binding
from cageik_cli.view.player.clip import load_player_clip, make_single_pose
from cageik_cli.view.player.section import load_player, render_view_page
from tests.browser.players import camera_of, check_positions, settle

pytestmark = pytest.mark.browser

SIZES = {"desk": (1440, 900), "tablet": (1024, 768), "phone": (390, 844)}


@pytest.fixture(scope="session")
def view_page(walk):
    return render_view_page(load_player_clip(walk[0]))


def open_size(play, text, size, **options):
    width, height = SIZES[size]
    viewport = {"width": width, "height": height}
    return play(text, viewport=viewport, has_touch=size == "phone", **options)


def measure_share(page):
    """Return how much of the picture the model takes, across and from top to bottom."""
    settle(page)
    spans = page.evaluate(
        "() => { const { camera, positions } = P.stage, places = [];"
        " for (let k = 0; k < positions.length / 3; k++)"
        " places.push(camera.project([...positions.subarray(3 * k, 3 * k + 3)]));"
        " return [0, 1].map((a) => [Math.min(...places.map((p) => p[a])),"
        " Math.max(...places.map((p) => p[a]))]); }"
    )
    box = page.locator("#player canvas").bounding_box()
    return [
        (low / size, high / size)
        for (low, high), size in zip(spans, (box["width"], box["height"]), strict=True)
    ]


@pytest.mark.parametrize("is_folded", [False, True])
@pytest.mark.parametrize("size", SIZES)
def test_the_page_fills_the_window_and_does_not_scroll(play, view_page, size, is_folded):
    page = open_size(play, view_page, size)
    if page.locator("#player.folded").count() != is_folded:
        page.get_by_role("button", name="Panel").click()
    width, height = SIZES[size]
    root = "document.documentElement"
    assert page.evaluate(f"[{root}.scrollWidth, {root}.scrollHeight]") == [width, height]
    canvas = page.locator("#player canvas").bounding_box()
    assert canvas["height"] > (0.5 if size == "phone" and not is_folded else 0.75) * height
    assert canvas["width"] > 0.65 * width
    bar = page.locator("#player .timeline").bounding_box()
    assert bar["y"] >= canvas["y"] + canvas["height"] - 1


def test_the_panel_of_a_phone_is_folded_at_first(play, view_page):
    phone = open_size(play, view_page, "phone")
    assert phone.locator("[data-side]").is_hidden()
    phone.locator("[data-fold]").tap()
    assert phone.locator("[data-side]").is_visible()
    assert phone.locator("[data-fold]").get_attribute("aria-expanded") == "true"


def test_a_key_folds_the_panel(play, view_page):
    page = open_size(play, view_page, "desk")
    assert page.locator("[data-side]").is_visible()
    page.keyboard.press("n")
    assert page.locator("[data-side]").is_hidden()
    page.locator("#player canvas").focus()
    page.keyboard.press("n")
    assert page.locator("[data-side]").is_visible()


@pytest.mark.parametrize("size", SIZES)
def test_the_model_fills_the_picture_at_first(play, view_page, size):
    (left, right), (top, bottom) = measure_share(open_size(play, view_page, size))
    assert min(left, top) > 0
    assert max(right, bottom) < 1
    assert max(right - left, bottom - top) > 0.85


def test_a_card_shows_the_same_player(play):
    page = play()
    assert max(high - low for low, high in measure_share(page)) > 0.8
    page.keyboard.press("n")  # the keys belong to the page until the picture has the focus
    assert page.locator("[data-side]").is_visible()


def test_a_single_pose_has_no_time(play, walk):
    page = play(render_view_page(make_single_pose(read_binding(walk[0]))))
    assert page.locator(".timeline").is_hidden()
    assert page.get_by_label("Colours").is_hidden()
    assert page.get_by_label("Speed").is_hidden()
    assert page.locator("[data-mode=pose]").first.get_attribute("aria-pressed") != "false"


@pytest.mark.parametrize("skipped", [(), (4, 5)])
def test_the_bar_of_time_has_the_error_of_each_frame(play, walk, skipped):
    clip = load_player_clip(walk[0])
    errors = clip.frame_rms.copy()
    errors[list(skipped)] = np.nan
    page = play(render_view_page(replace(clip, frame_rms=errors, skipped=skipped)))
    columns = page.locator("[data-bars] .error").get_attribute("d").count("M")
    assert columns == len(errors) - len(skipped)
    assert page.locator("[data-bars] .skipped").get_attribute("d").count("M") == len(skipped)
    ticks = page.locator("[data-ticks] .worst").evaluate_all("all => all.map((e) => e.style.left)")
    worst = 100 * int(clip.frame_rms.argmax()) / 11
    assert min(abs(float(one.rstrip("%")) - worst) for one in ticks) < 0.01


def test_a_click_on_the_bar_goes_to_the_frame_below(play, view_page, walk):
    result, frames = walk
    page = open_size(play, view_page, "desk")
    box = page.locator("[data-bars]").bounding_box()
    for frame in (11, 0, 7):
        page.mouse.click(box["x"] + box["width"] * frame / 11, box["y"] + box["height"] / 2)
        settle(page)
        assert page.evaluate("P.stage.frame") == frame
        check_positions(page, frames[frame], result.rest.diagonal)


def test_marks_of_edits_are_on_the_bar(play, view_page):
    page = open_size(play, view_page, "desk")
    marks = page.locator("[data-strip] i")
    page.evaluate("P.stage.timeline.mark('cage', { range: [4, 8], falloff: 2, keys: [5, 7] })")
    classes = marks.evaluate_all("all => all.map((one) => one.className)")
    assert classes == ["fade", "full", "key", "key"]
    lefts = marks.evaluate_all("all => all.map((one) => parseFloat(one.style.left))")
    np.testing.assert_allclose(lefts, [100 * k / 11 for k in (1, 3, 4, 6)], rtol=1e-4)
    page.evaluate("P.stage.timeline.mark('cage')")
    assert marks.count() == 0


DIRECTIONS = {"1": [0, 0, 1], "3": [1, 0, 0], "7": [0, 1, 0]}


@pytest.mark.parametrize("key", DIRECTIONS)
def test_keys_look_along_the_axes_and_again_from_opposite(play, view_page, key):
    page = open_size(play, view_page, "desk")
    for sign in (1, -1, 1):
        page.keyboard.press(key)
        found = page.evaluate("P.stage.camera.axes()[2]")
        np.testing.assert_allclose(found, sign * np.array(DIRECTIONS[key]), atol=1e-9)


@pytest.mark.parametrize("size", ["desk", "phone"])
def test_the_axes_in_the_corner_are_clicked(play, view_page, size):
    page = open_size(play, view_page, size)
    ball = page.get_by_role("button", name="Look along Z", exact=True)
    for sign in (1, -1):
        ball.click(force=True)  # one axis hides the other from here
        found = page.evaluate("P.stage.camera.axes()[2]")
        np.testing.assert_allclose(found, [0, 0, sign], atol=1e-9)
        settle(page)


def test_the_axes_of_a_model_whose_z_is_up(play, walk):
    page = play(render_view_page(replace(load_player_clip(walk[0]), up_axis="Z")))
    for key, wanted in {"1": [0, -1, 0], "3": [1, 0, 0], "7": [0, 0, 1]}.items():
        page.keyboard.press(key)
        np.testing.assert_allclose(page.evaluate("P.stage.camera.axes()[2]"), wanted, atol=1e-9)


def test_f_shows_what_is_chosen_else_the_model(play, view_page):
    page = open_size(play, view_page, "desk")
    first = camera_of(page)
    box = page.locator("#player canvas").bounding_box()
    vertex = 889  # of the chest
    x, y, _ = page.evaluate(
        f"P.stage.camera.project([...P.stage.positions.subarray({3 * vertex}, {3 * vertex + 3})])"
    )
    page.mouse.click(box["x"] + x, box["y"] + y)
    assert f"vertex {vertex}; face " in page.text_content("[data-under]")
    page.keyboard.press("f")
    settle(page)
    x, y, _ = page.evaluate(
        f"P.stage.camera.project([...P.stage.positions.subarray({3 * vertex}, {3 * vertex + 3})])"
    )
    np.testing.assert_allclose([x, y], [box["width"] / 2, box["height"] / 2], atol=2)
    assert camera_of(page)["distance"] < 0.5 * first["distance"]
    page.keyboard.press("Escape")
    page.keyboard.press("f")
    assert camera_of(page)["distance"] == pytest.approx(first["distance"], rel=1e-3)


def test_the_keys_are_listed(play, view_page):
    page = open_size(play, view_page, "desk")
    assert page.locator("#player dialog").is_hidden()
    page.keyboard.press("?")
    rows = page.locator("#player dialog tr").all_inner_texts()
    assert any("Space" in row for row in rows)
    removal = page.locator("#player dialog tr", has_text="Pose: remove the chosen handle")
    assert removal.is_hidden()
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Pose", exact=True).click()
    page.locator("#player canvas").press("?")
    assert removal.is_visible()
    assert page.locator("#player dialog tr", has_text="Cage: ").first.is_hidden()
    page.keyboard.press("Escape")
    assert page.locator("#player dialog").is_hidden()
    page.get_by_role("button", name="Keys").click()
    page.get_by_role("button", name="Close").click()
    assert page.locator("#player dialog").is_hidden()


def test_the_ground_can_be_switched_off(play, view_page):
    page = open_size(play, view_page, "desk")
    canvas = page.locator("#player canvas")
    settle(page)
    drawn = canvas.screenshot()
    page.get_by_label("Ground").uncheck()
    settle(page)
    assert canvas.screenshot() != drawn


def test_only_the_group_of_the_mode_is_shown(play, view_page):
    page = open_size(play, view_page, "desk")
    pose = page.get_by_role("group", name="Pose", exact=True)
    assert pose.is_hidden()
    button = page.get_by_role("button", name="Pose", exact=True)
    button.click()
    assert pose.is_visible()
    assert button.get_attribute("aria-pressed") == "true"
    page.get_by_role("button", name="Look", exact=True).click()
    assert pose.is_hidden()


def test_the_report_and_the_app_draw_the_same(play, view_page, walk):
    result, frames = walk
    for text in (view_page, render_result_page(result, build_report(result), load_player(result))):
        check_positions(play(text), frames[0], result.rest.diagonal)


def test_the_model_stays_whole_in_a_picture_of_another_size(play, view_page):
    page = open_size(play, view_page, "phone")
    page.locator("[data-fold]").tap()
    settle(page)
    (left, right), (top, bottom) = measure_share(page)
    assert min(left, top) > 0
    assert max(right, bottom) < 1
    page.evaluate("P.stage.camera.zoom(0.5); P.stage.request()")
    before = camera_of(page)
    page.locator("[data-fold]").tap()
    settle(page)
    assert camera_of(page) == before
