"""The player in Chromium, by mouse, touch and keyboard: it draws the frames of `cageik deform`."""

import numpy as np
import pytest

from cageik_cli.geometry.parts import split_parts
from cageik_cli.report.html.page import render_result_page
from cageik_cli.report.record import build_report
from cageik_cli.view.player.section import load_player
from tests.browser.players import (
    WALKER,
    camera_of,
    check_positions,
    drag,
    middle_of,
    settle,
)
from tests.character import NAMES

pytestmark = pytest.mark.browser


def test_each_frame_is_that_of_deform(play, walk):
    result, frames = walk
    page = play()
    check_positions(page, frames[0], result.rest.diagonal)
    slider = page.get_by_role("slider", name="Frame", exact=True)
    slider.focus()
    for frame in (1, 2):
        page.keyboard.press("ArrowRight")
        check_positions(page, frames[frame], result.rest.diagonal)
    page.keyboard.press("End")
    check_positions(page, frames[11], result.rest.diagonal)
    assert slider.get_attribute("aria-valuetext").startswith("frame 12 of 1 to 12: walker_12.obj")
    with pytest.raises(AssertionError):
        check_positions(page, frames[5], result.rest.diagonal)


def test_a_drag_of_the_slider_scrubs(play, walk):
    result, frames = walk
    page = play()
    page.locator("[data-time]").scroll_into_view_if_needed()
    box = page.locator("[data-time]").bounding_box()
    start = box["x"] + 10, box["y"] + box["height"] / 2
    drag(page, start, (box["x"] + box["width"] * 0.5, start[1]))
    settle(page)
    frame = page.evaluate("P.stage.frame")
    assert 4 <= frame <= 7
    check_positions(page, frames[frame], result.rest.diagonal)


def test_the_clip_plays_in_time_and_stops_where_it_is(play, walk):
    result, frames = walk
    page = play()
    page.get_by_label("Speed").select_option("0.25")  # so that it is paused before it loops
    page.get_by_role("button", name="Play").click()
    page.wait_for_function("() => P.stage.frame >= 4")
    page.get_by_role("button", name="Pause").click()
    settle(page)
    frame = page.evaluate("P.stage.frame")
    assert frame >= 4
    check_positions(page, frames[frame], result.rest.diagonal)


def test_a_loop_goes_on_and_without_it_the_clip_ends(play):
    page = play()
    page.get_by_label("Speed").select_option("2")
    page.get_by_role("button", name="Play").click()
    page.wait_for_function("() => P.stage.frame >= 6")
    page.wait_for_function("() => P.stage.frame < 4")
    page.get_by_label("Loop").click()
    page.wait_for_function("() => !P.stage.transport.isPlaying")
    assert page.evaluate("P.stage.frame") == 11
    page.get_by_role("button", name="Play").click()
    page.wait_for_function("() => P.stage.frame < 9")


def test_slow_motion_shows_moments_between_frames_unless_told_not_to(play):
    page = play()
    seen = """() => new Promise((done) => {
      const shares = [];
      const look = () => { shares.push(P.stage.transport.share);
        shares.length < 12 ? requestAnimationFrame(look) : done(Math.max(...shares)); };
      look(); })"""
    page.get_by_label("Speed").select_option("0.1")
    page.get_by_role("button", name="Play").click()
    assert page.evaluate(seen) > 0
    page.get_by_label("Between frames").click()
    assert page.evaluate(seen) == 0


def test_buttons_step_and_jump_to_held_frames(play, walk):
    result, frames = walk
    page = play()
    page.get_by_role("button", name="One frame on").click()
    page.get_by_role("button", name="One frame on").click()
    page.get_by_role("button", name="One frame back").click()
    check_positions(page, frames[1], result.rest.diagonal)
    page.get_by_role("button", name="worst frame", exact=True).click()
    check_positions(page, frames[result.metrics.rms.argmax()], result.rest.diagonal)


def test_keys_on_the_picture_play_step_and_turn(play):
    page = play()
    page.locator("#player canvas").focus()
    for key, frame in [(".", 1), ("End", 11), (",", 10), ("Home", 0), ("PageDown", 10)]:
        page.keyboard.press(key)
        settle(page)
        assert page.evaluate("P.stage.frame") == frame
    page.keyboard.press("Space")
    assert page.evaluate("P.stage.transport.isPlaying")
    page.keyboard.press("Space")
    assert not page.evaluate("P.stage.transport.isPlaying")
    before = camera_of(page)
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("+")
    page.keyboard.press("Shift+ArrowUp")
    after = camera_of(page)
    assert after["turn"] > before["turn"]
    assert after["tilt"] < before["tilt"]
    assert after["distance"] < before["distance"]
    assert after["target"] != before["target"]
    page.keyboard.press("0")
    assert camera_of(page)["turn"] == before["turn"]


def test_the_mouse_turns_moves_and_zooms(play):
    page = play()
    middle, before = middle_of(page), camera_of(page)
    drag(page, middle, (middle[0] + 60, middle[1] + 20))
    turned = camera_of(page)
    assert turned["turn"] < before["turn"]
    assert turned["tilt"] > before["tilt"]
    page.keyboard.down("Shift")
    drag(page, middle, (middle[0] + 60, middle[1]))
    page.keyboard.up("Shift")
    moved = camera_of(page)
    assert moved["target"] != turned["target"]
    assert moved["turn"] == turned["turn"]
    page.mouse.wheel(0, 300)
    page.wait_for_function(f"() => P.stage.camera.distance > {moved['distance']}")


def test_two_fingers_zoom_and_one_turns(play):
    page = play(has_touch=True)
    (x, y), before = middle_of(page), camera_of(page)
    touch = page.context.new_cdp_session(page)

    def send(kind, *points):
        touch.send(
            "Input.dispatchTouchEvent",
            {"type": kind, "touchPoints": [{"x": a, "y": b, "id": k} for k, a, b in points]},
        )

    send("touchStart", (0, x, y))
    send("touchMove", (0, x + 30, y))
    send("touchMove", (0, x + 60, y))
    send("touchEnd")
    settle(page)
    turned = camera_of(page)
    assert turned["turn"] < before["turn"]
    send("touchStart", (0, x - 40, y))
    send("touchStart", (0, x - 40, y), (1, x + 40, y))
    for away in (60, 90, 120):
        send("touchMove", (0, x - away, y), (1, x + away, y))
    send("touchEnd")
    settle(page)
    zoomed = camera_of(page)
    assert zoomed["distance"] < 0.6 * turned["distance"]
    assert zoomed["turn"] == turned["turn"]


def test_input_and_reconstruction_are_shown_side_by_side(play, walk):
    result, _ = walk
    page = play()
    page.get_by_role("button", name="worst frame", exact=True).click()
    page.get_by_label("Show", exact=True).select_option("both")
    settle(page)
    assert page.locator("#player.split .labels").is_visible()
    worst = int(result.metrics.rms.argmax())
    found = np.array(page.evaluate("[...P.stage.input]")).reshape(-1, 3)
    found = found * result.rest.diagonal + result.cage.vertices.mean(axis=0)
    wanted = np.array([
        line.split()[1:4] for line in
        (WALKER / "frames" / f"walker_{worst + 1}.obj").read_text().splitlines()
        if line.startswith("v ")
    ], float)  # fmt: skip
    assert np.abs(found - wanted).max() / result.rest.diagonal < 2e-5
    others = set(range(12)) - set(page.evaluate("[...P.stage.clip.held.keys()]"))
    page.evaluate(f"P.stage.transport.go({min(others)}); P.stage.request(true)")
    settle(page)
    assert "No input in this frame" in page.text_content("[data-note]")
    assert page.locator("#player.split").count() == 0


def _read_pixels(page):
    return page.evaluate(
        "() => new Promise((done) => { P.stage.request(true); P.stage.listeners.push(() => {"
        " const gl = P.stage.renderer.gl, w = gl.drawingBufferWidth, h = gl.drawingBufferHeight;"
        " const data = new Uint8Array(4 * w * h);"
        " gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, data);"
        " const drawn = [], same = (k) => [0, 1, 2].every((a) => data[k + a] === data[a]);"
        " for (let k = 0; k < data.length; k += 4) if (!same(k))"
        " drawn.push(data[k], data[k + 1], data[k + 2]);"
        " P.stage.listeners.pop(); done(drawn); }); })"
    )


def test_colours_show_the_error_of_the_clip_and_of_a_frame(play):
    page = play()
    page.get_by_role("checkbox", name="Cage", exact=True).click()
    plain = np.array(_read_pixels(page)).reshape(-1, 3)
    assert len(plain) > 3000
    for mode in ("rms", "frame"):
        page.get_by_label("Colours").select_option(mode)
        if mode == "frame":
            page.get_by_role("button", name="worst frame", exact=True).click()
        painted = np.array(_read_pixels(page)).reshape(-1, 3)
        assert np.ptp(painted[:, 0] - painted[:, 2]) > 2 * np.ptp(plain[:, 0] - plain[:, 2])
        assert page.locator("[data-scale]").is_visible()
    page.get_by_label("Colours").select_option("clay")
    settle(page)
    assert page.locator("[data-scale]").is_hidden()


def test_the_cage_is_drawn_unless_it_is_hidden(play):
    page = play()
    with_cage = np.array(_read_pixels(page)).reshape(-1, 3)
    page.get_by_role("checkbox", name="Cage", exact=True).click()
    without = np.array(_read_pixels(page)).reshape(-1, 3)

    def count_blue(pixels):
        return np.count_nonzero(pixels[:, 2].astype(int) > pixels[:, 0] + 60)

    assert count_blue(with_cage) > 300 > count_blue(without)


def test_the_worst_region_is_shown_in_its_frame(play):
    page = play()
    before = camera_of(page)
    page.get_by_role("button", name="worst region", exact=False).click()
    settle(page)
    frame, vertex = page.evaluate("[P.stage.clip.focus.frame, P.stage.clip.focus.vertex]")
    assert page.evaluate("P.stage.frame") == frame
    assert camera_of(page)["distance"] < 0.6 * before["distance"]
    x, y, _ = page.evaluate(
        f"P.stage.camera.project([...P.stage.positions.subarray({3 * vertex}, {3 * vertex + 3})])"
    )
    box = page.locator("#player canvas").bounding_box()
    np.testing.assert_allclose([x, y], [box["width"] / 2, box["height"] / 2], atol=2)


def test_without_webgl_there_is_a_still_picture(browser, tmp_path, walk_page):
    path = tmp_path / "page.html"
    path.write_text(walk_page)
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(path.as_uri())
    assert page.evaluate("window.cageikPlayer") is None
    assert page.locator("#player canvas").is_hidden()
    assert page.locator("#player [data-still] img").is_visible()
    assert "WebGL2" in page.text_content("#player [data-still]")
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [360, 390, 760, 1280, 1920])
def test_nothing_is_wider_than_the_window(play, scheme, width):
    page = play(viewport={"width": width, "height": 800}, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_nothing_moves_by_itself(play):
    page = play(reduced_motion="reduce")
    page.wait_for_timeout(300)
    assert page.evaluate("P.stage.frame") == 0
    assert not page.evaluate("P.stage.transport.isPlaying")


def test_the_player_is_not_printed(play):
    page = play()
    page.emulate_media(media="print")
    assert page.locator("#player").is_hidden()


@pytest.fixture
def character_page(play, character_result):
    """The page of the character of four parts, with the list of parts open."""
    page = play(
        render_result_page(
            character_result, build_report(character_result), load_player(character_result)
        )
    )
    page.locator("#player [data-parts] summary").click()
    return page


def test_parts_are_listed_and_hidden(character_page, character_result):
    page, count = character_page, "P.stage.renderer.counts.faces / 3"
    names = page.locator("#player [data-parts] label").all_inner_texts()
    assert names == list(NAMES)
    whole = page.evaluate(count)
    assert whole == len(character_result.rest.faces)
    page.get_by_label(NAMES[1], exact=True).uncheck()
    assert page.evaluate(count) == whole - 2 * 6 * 16
    page.get_by_role("button", name="Hide all").click()
    assert page.evaluate(count) == 0
    page.get_by_role("button", name="Show all").click()
    assert page.evaluate(count) == whole


def test_edges_are_those_of_the_polygons_of_shown_parts(character_page, character_result):
    page, model = character_page, character_result.rest
    canvas = page.locator("#player canvas")
    plain = canvas.screenshot()
    page.get_by_label("Edges", exact=True).check()
    settle(page)
    edges = "P.stage.renderer.counts.edges / 2"
    assert page.evaluate(edges) == len(model.polygon_sides) < len(model.edges.ends)
    assert canvas.screenshot() != plain
    page.get_by_label(NAMES[1], exact=True).uncheck()
    assert page.evaluate(edges) == len(model.polygon_sides) - len(
        split_parts(model)[1].mesh.polygon_sides
    )


def test_each_part_has_the_colour_of_its_swatch(character_page, character_result):
    page, values = character_page, "[...P.stage.colours.values]"
    shades = page.locator("#player [data-parts] .swatch").evaluate_all(
        "all => all.map((each) => each.style.background)"
    )
    assert len(set(shades)) == len(NAMES)
    found = np.array(page.evaluate(values))
    parts = split_parts(character_result.rest)
    assert [set(found[part.vertices].tolist()) for part in parts] == [
        {k / 8} for k in range(len(NAMES))
    ]


def test_a_hidden_part_is_not_clicked(character_page):
    ray = "{origin: P.stage.clip.fromFile([9, 0.01, 1]), direction: [-1, 0, 0]}"
    vertex = f"P.stage.clip.fileVertex(P.stage.skin.pick(P.stage.positions, {ray}).corners[0])"
    assert 208 <= character_page.evaluate(vertex) < 320  # the jacket is around the body
    character_page.get_by_label(NAMES[1], exact=True).uncheck()
    assert character_page.evaluate(vertex) < 208


def test_a_model_of_one_mesh_has_no_list_of_parts(play):
    assert play().locator("#player [data-parts]").is_hidden()


@pytest.mark.parametrize(
    ("name", "is_software"),
    [
        ("ANGLE (Google, Vulkan 1.3.0 (SwiftShader Device (Subzero)))", True),
        ("llvmpipe (LLVM 15.0.7, 256 bits)", True),
        ("ANGLE (NVIDIA, NVIDIA GeForce RTX 3070 Direct3D11 vs_5_0)", False),
    ],
)
def test_edges_are_smooth_where_there_is_a_graphics_card(play, name, is_software):
    page = play()
    assert not page.evaluate("P.stage.renderer.gl.getContextAttributes().antialias")
    given = "(name) => isSoftware({ getExtension: () => null, getParameter: () => name })"
    assert page.evaluate(given, name) == is_software
