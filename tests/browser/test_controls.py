"""What the keys, fields and tooltips of the player do, and its controls on a phone."""

import numpy as np
import pytest

from cageik_cli.view.player.clip import load_player_clip
from cageik_cli.view.player.section import render_view_page
from tests.browser.players import settle
from tests.browser.test_accessibility import find_violations, show_everything

pytestmark = pytest.mark.browser

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
MODES = ("Look", "Pose", "Cage", "Influence")


@pytest.fixture(scope="session")
def view_page(walk):
    return render_view_page(load_player_clip(walk[0]))


@pytest.fixture
def use(play, view_page):
    return lambda **options: play(view_page, **options)


def frame_of(page):
    settle(page)
    return page.evaluate("P.stage.frame")


@pytest.mark.parametrize(
    "click",
    [
        "[data-edges]",
        "[data-xray]",
        "[data-on]",
        "[data-mode=pose]",
        "details summary",
        "[data-side]",
    ],
)
def test_keys_act_after_a_click_on_any_control(use, click):
    page = use()
    page.locator(click).first.click()
    page.evaluate("P.stage.transport.go(0); P.stage.request(true)")
    page.keyboard.press(".")
    assert frame_of(page) == 1
    page.keyboard.press("End")
    assert frame_of(page) == 11
    checked = page.locator("[data-edges]").is_checked()
    page.keyboard.press("Space")
    assert page.evaluate("P.stage.transport.isPlaying")
    assert page.locator("[data-edges]").is_checked() == checked


def test_keys_act_after_a_choice_in_a_list_and_on_the_bar_of_time(use):
    page = use()
    page.get_by_label("Speed").select_option("0.5")
    page.keyboard.press("x")
    assert page.evaluate("P.stage.view.xray")
    box = page.locator("[data-time]").bounding_box()
    page.mouse.click(box["x"] + 9, box["y"] + 20)
    page.keyboard.press("ArrowRight")
    assert frame_of(page) == 1
    page.keyboard.press("x")
    assert not page.evaluate("P.stage.view.xray")


def test_keys_do_not_act_in_text_fields_and_enter_leaves_them(use):
    page = use()
    page.get_by_role("button", name="Cage", exact=True).click()
    field = page.locator("[data-cage-vertices]")
    field.click()
    page.keyboard.type("3, 8x.")
    assert field.input_value() == "3, 8x."
    assert page.evaluate("[P.stage.view.xray, P.stage.frame]") == [False, 0]
    page.keyboard.press("Backspace")
    page.keyboard.press("Backspace")
    page.keyboard.press("Enter")
    settle(page)
    assert page.evaluate("[...P.stage.cages.selection.chosen]") == [3, 8]
    page.keyboard.press("x")
    assert page.evaluate("P.stage.view.xray")


def test_buttons_that_tab_went_to_keep_their_keys(use):
    page = use()
    page.locator("[data-edges]").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.matches('[data-grid]')")
    page.keyboard.press("Space")
    assert not page.locator("[data-grid]").is_checked()
    assert not page.evaluate("P.stage.transport.isPlaying")
    assert page.evaluate("document.activeElement.matches('[data-grid]')")
    page.keyboard.press("x")
    assert page.evaluate("P.stage.view.xray")


def test_keys_do_not_act_behind_the_list_of_keys(use):
    page = use()
    page.keyboard.press("?")
    page.keyboard.press("x")
    assert not page.evaluate("P.stage.view.xray")


CONTROLS = "#player :is(button, input, select)"


def list_without_sentence(page):
    """Return the controls without a tooltip of one sentence."""
    return page.eval_on_selector_all(
        CONTROLS,
        "all => all.filter((one) => !/^[A-Z].*[^.]\\.$/.test(one.title))"
        ".map((one) => one.outerHTML)",
    )


def test_every_control_has_a_tooltip(play, view_page, character_result):
    for text in (view_page, render_view_page(load_player_clip(character_result))):
        page = play(text)
        if text == view_page:
            show_everything(page)
            page.get_by_role("button", name="Influence", exact=True).click()
            page.get_by_label("Vertex of the model").fill("389")
            page.keyboard.press("Enter")
            settle(page)
            assert page.locator("[data-handles] button").count() == 2
            assert page.locator("[data-weights] button").count() > 1
        assert page.locator(CONTROLS).count() > 60
        assert list_without_sentence(page) == []
        page.evaluate("() => { document.querySelector('[data-loop]').title = 'Loop'; }")
        assert len(list_without_sentence(page)) == 1


def test_a_tooltip_is_shown_when_tab_goes_to_a_control(use):
    page = use(bypass_csp=True)
    tip = page.locator("[data-tip]")
    assert tip.is_hidden()
    page.locator("[data-undo]").focus()
    page.locator("[data-help]").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.matches('[data-fold]')")
    assert tip.text_content() == "Show or hide the panel (N)."
    box, width = tip.bounding_box(), page.viewport_size["width"]
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width
    assert find_violations(page) == []
    page.keyboard.press("Escape")
    assert tip.is_hidden()
    page.keyboard.press("Tab")
    assert tip.is_visible()
    page.locator("[data-play]").click()
    assert tip.is_hidden()


def test_a_frame_is_typed(use):
    page = use()
    field = page.get_by_role("spinbutton", name="Frame", exact=True)
    assert field.input_value() == "1"
    field.fill("7")
    page.keyboard.press("Enter")
    assert frame_of(page) == 6
    page.keyboard.press(".")
    settle(page)
    assert field.input_value() == "8"
    for typed, number in (("99", "12"), ("-3", "1"), ("4.4", "4"), ("", "4")):
        field.fill(typed)
        field.press("Enter")
        settle(page)
        assert field.input_value() == number


def test_the_rate_is_shown_and_changed(use):
    page = use()
    field = page.get_by_label("fps", exact=True)
    assert field.input_value() == "24"
    for typed, rate in (("6", 6), ("1000", 240), ("0", 240), ("-2", 240), ("", 240), ("1", 1)):
        field.fill(typed)
        field.press("Enter")
        assert page.evaluate("P.stage.transport.fps") == rate
        assert float(field.input_value()) == rate
    # In 400 ms, at one frame per second.
    page.evaluate("P.stage.transport.advance(0); P.stage.transport.advance(400)")
    assert page.evaluate("P.stage.transport.time") == pytest.approx(0.4)


def test_the_number_of_the_frame_below_the_pointer_is_shown(use):
    page = use()
    bubble, box = page.locator("[data-bubble]"), page.locator("[data-strip]").bounding_box()
    assert bubble.is_hidden()
    for frame in (0, 4, 11):
        x = box["x"] + box["width"] * frame / 11
        page.mouse.move(x, box["y"] + 15)
        assert bubble.text_content() == str(frame + 1)
        found = bubble.bounding_box()
        assert found["x"] + found["width"] / 2 == pytest.approx(x, abs=8)
        assert found["y"] + found["height"] <= box["y"]
        assert frame_of(page) == 0
    page.mouse.move(box["x"], box["y"] - 200)
    assert bubble.is_hidden()


def test_both_kinds_of_edits_have_the_same_words(use):
    page = use()
    words = [
        page.locator(f"[data-panel={panel}] label[for$='-{name}']").text_content()
        for panel in ("pose", "cage")
        for name in ("first", "last", "fade")
    ]
    assert words == 2 * ["From", "To", "Fade"]


@pytest.mark.parametrize("mode", MODES)
def test_a_tap_on_a_mode_opens_its_tools(use, mode):
    page = use(**PHONE)
    assert page.locator("[data-side]").is_hidden()
    page.get_by_role("button", name=mode, exact=True).tap()
    panel = page.locator(f"[data-panel={mode.lower()}]")
    assert panel.is_visible()
    box, side = panel.bounding_box(), page.locator("[data-side]").bounding_box()
    assert side["y"] <= box["y"] < side["y"] + 60
    assert page.locator("[data-fold]").get_attribute("aria-expanded") == "true"
    page.get_by_role("button", name=mode, exact=True).tap()
    assert page.locator("[data-side]").is_hidden()


def test_a_click_on_a_mode_leaves_the_panel_of_a_desk(use):
    page = use()
    for mode in ("Pose", "Pose", "Look"):
        page.get_by_role("button", name=mode, exact=True).click()
        assert page.locator("[data-side]").is_visible()
    page.keyboard.press("n")
    page.get_by_role("button", name="Pose", exact=True).click()
    assert page.locator("[data-side]").is_hidden()


SMALL = """(all) => all.filter((one) => {
  if (!one.checkVisibility()) return false;
  const boxes = [one, ...one.labels ?? []].map((each) => each.getBoundingClientRect());
  const own = one.matches("[type=checkbox]") ? boxes : boxes.slice(0, 1);
  const edge = (which, name) => which(...own.map((box) => box[name]));
  const span = (low, high) => edge(Math.max, high) - edge(Math.min, low);
  return span("left", "right") < 43.5 || span("top", "bottom") < 43.5;
}).map((one) => one.outerHTML)"""


@pytest.mark.parametrize("mode", MODES)
def test_targets_of_a_phone_are_as_large_as_a_finger(use, mode):
    page = use(**PHONE)
    selector = f"{CONTROLS}, #player summary"
    assert page.eval_on_selector_all(selector, SMALL) == []
    if mode == "Pose":
        show_everything(page)
        page.locator("[data-fold]").tap()
    page.get_by_role("button", name=mode, exact=True).tap()
    if mode == "Cage":
        page.evaluate("P.stage.cages.selection.choose([47]); P.stage.cages.add()")
        page.evaluate("P.stage.cages.selection.falloff = 'edges'; P.stage.request(true)")
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    settle(page)
    assert page.eval_on_selector_all(selector, SMALL) == []
    page.evaluate("() => { document.querySelector('[data-play]').style.minHeight = '20px'; }")
    page.evaluate("() => { document.querySelector('[data-play]').style.height = '20px'; }")
    assert len(page.eval_on_selector_all(selector, SMALL)) == 1


def test_the_bar_of_time_of_a_phone_is_as_wide_as_the_screen(use):
    page = use(**PHONE)
    box = page.locator("[data-time]").bounding_box()
    assert (box["x"], box["width"]) == (0, 390)
    for name in ("data-play", "data-back", "data-on", "data-number", "data-fps"):
        one = page.locator(f"[{name}]").bounding_box()
        assert one["y"] >= box["y"] + box["height"]
        assert 0 <= one["x"] <= 390 - one["width"]
    tops = {page.locator(f"[{name}]").bounding_box()["y"] for name in ("data-play", "data-fps")}
    assert np.ptp(list(tops)) < 2
