"""What is under the pointer: highlights, cursors, ghosts, and what the model hides."""

import numpy as np
import pytest

from cageik_cli.view.player.clip import load_player_clip
from cageik_cli.view.player.section import render_view_page
from tests.browser.players import drag, settle

pytestmark = pytest.mark.browser

HAND, CHEST, CAGE_HAND = 1040, 889, 47


@pytest.fixture(scope="session")
def view_page(walk):
    return render_view_page(load_player_clip(walk[0]))


@pytest.fixture
def use(play, view_page):
    """A function that opens the page in a mode, and looks from the front."""

    def start(mode, **options):
        page = play(view_page, **options)
        page.get_by_role("button", name=mode, exact=True).click()
        page.keyboard.press("1")
        settle(page)
        return page

    return start


def pixel_of(page, point):
    """Where a point is in the window; `point` is a script that gives it in units of the picture."""
    settle(page)
    box = page.locator("#player canvas").bounding_box()
    x, y, _ = page.evaluate(f"P.stage.camera.project({point})")
    return box["x"] + x, box["y"] + y


def vertex_pixel(page, vertex):
    return pixel_of(page, f"pointOf(P.stage.positions, {vertex})")


def cage_pixel(page, vertex):
    return pixel_of(page, f"P.stage.cages.place({vertex})")


def add(page, kind, *vertices):
    page.locator(f"[data-tool={kind}]").click()
    for vertex in vertices:
        page.locator("[data-vertex]").fill(str(vertex))
        page.get_by_role("button", name="Add", exact=True).click()
    page.locator("[data-tool=move]").click()
    settle(page)


def cursor(page):
    return page.evaluate("getComputedStyle(P.stage.canvas).cursor")


def highlight(page):
    """Return the class of the highlight, and the middle of it."""
    settle(page)
    mark = page.locator("[data-highlight]")
    kind = mark.get_attribute("class")
    if not kind:
        return "", None
    box = mark.bounding_box()
    return kind, (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def empty_pixel(page):
    box = page.locator("#player canvas").bounding_box()
    return box["x"] + 8, box["y"] + box["height"] - 90


def test_a_handle_below_the_pointer_is_highlighted(use):
    page = use("Pose")
    add(page, "handle", HAND)
    add(page, "pin", CHEST)
    for vertex, shape in ((HAND, "move"), (CHEST, "pointer")):
        x, y = vertex_pixel(page, vertex)
        page.mouse.move(x + 3, y - 3)
        kind, place = highlight(page)
        assert kind == "ring"
        np.testing.assert_allclose(place, (x, y), atol=1.5)
        assert cursor(page) == shape
    assert page.text_content("[data-under]") == "pin 2"
    page.mouse.move(*empty_pixel(page))
    assert highlight(page) == ("", None)
    assert (cursor(page), page.text_content("[data-under]")) == ("grab", "")


def test_cage_vertices_and_arms_are_highlighted(use):
    page = use("Cage")
    x, y = cage_pixel(page, CAGE_HAND)
    page.mouse.move(x, y)
    kind, place = highlight(page)
    assert (kind, cursor(page)) == ("ring", "move")
    np.testing.assert_allclose(place, (x, y), atol=1.5)
    page.mouse.click(x, y)
    arm = "(({ middle, tips }) => middle.map((m, k) => m + 0.7 * (tips[1].tip[k] - m)))"
    page.mouse.move(*pixel_of(page, f"{arm}(P.stage.cages.gizmo())"))
    kind, place = highlight(page)
    assert (kind, cursor(page)) == ("arm", "move")
    middle = pixel_of(page, f"{arm.replace('0.7', '0.5')}(P.stage.cages.gizmo())")
    np.testing.assert_allclose(place, middle, atol=2.5)
    assert page.text_content("[data-under]") == "move along y"


def test_a_highlight_goes_where_the_view_goes(use):
    page = use("Cage")
    page.mouse.move(*cage_pixel(page, CAGE_HAND))
    assert highlight(page)[0] == "ring"
    page.keyboard.press("3")
    assert highlight(page)[0] == ""
    page.keyboard.press("1")
    page.keyboard.press("1")
    page.mouse.move(*empty_pixel(page))
    assert highlight(page)[0] == ""


def test_the_cursor_says_what_a_press_does(use):
    page = use("Cage")
    page.mouse.move(*empty_pixel(page))
    assert cursor(page) == "grab"
    page.mouse.down()
    assert cursor(page) == "grabbing"
    page.mouse.up()
    page.keyboard.down("Shift")
    page.mouse.down()
    assert cursor(page) == "move"
    page.mouse.up()
    page.keyboard.up("Shift")
    assert cursor(page) == "grab"
    page.keyboard.press("b")
    assert cursor(page) == "crosshair"
    page.mouse.down()
    assert cursor(page) == "crosshair"
    page.mouse.up()
    assert cursor(page) == "grab"
    page.mouse.move(*cage_pixel(page, CAGE_HAND))
    page.mouse.down()
    assert cursor(page) == "grabbing"
    page.mouse.up()


@pytest.mark.parametrize("kind", ["pin", "handle"])
def test_a_ghost_is_where_a_click_puts_a_pin(use, kind):
    page = use("Pose")
    x, y = vertex_pixel(page, CHEST)
    page.mouse.move(x + 2, y)
    assert highlight(page)[0] == ""
    page.locator(f"[data-tool={kind}]").click()
    page.mouse.move(x + 2, y + 1)
    shape, place = highlight(page)
    assert (shape, cursor(page)) == (f"ghost {kind}", "crosshair")
    page.mouse.click(x + 2, y + 1)
    settle(page)
    (handle,) = page.evaluate("P.stage.editor.file.handles")
    assert handle["vertex"] == CHEST
    np.testing.assert_allclose(place, (x, y), atol=1.5)
    for steps in range(1, 40):
        page.mouse.move(x + 2 * steps, y + 30)
        shape, place = highlight(page)
        if not shape or "face" in page.text_content("[data-under]").split(";")[0]:
            break
        page.mouse.click(x + 2 * steps, y + 30)
        settle(page)
        at = pixel_of(page, "P.stage.editor.anchors.at(-1)")
        np.testing.assert_allclose(place, at, atol=1.5)
        if "face" in page.evaluate("P.stage.editor.file.handles.at(-1)"):
            break
    assert "face" in page.evaluate("P.stage.editor.file.handles.at(-1)")
    page.mouse.move(*empty_pixel(page))
    assert highlight(page)[0] == ""


def list_hidden(page):
    """Look askew; return cage vertices that are seen and hidden, each by itself on the screen."""
    page.keyboard.press("0")
    page.keyboard.press("-")
    settle(page)
    return page.evaluate(
        """() => {
      const { stage } = P, { places } = stage.cages, seen = { true: [], false: [] };
      const pixels = places.map((place) => stage.camera.project(place));
      places.forEach((place, k) => {
        const away = pixels.map(([x, y], j) => j === k
          ? 99 : Math.hypot(x - pixels[k][0], y - pixels[k][1]));
        if (Math.min(...away) > 15) seen[stage.isSeen(place)].push(k);
      });
      return [seen.true, seen.false];
    }"""
    )


def test_cage_vertices_behind_the_model_are_not_picked_unless_it_is_seen_through(use):
    page = use("Cage")
    seen, hidden = list_hidden(page)
    assert seen
    assert hidden
    chosen = "[...P.stage.cages.selection.chosen]"
    page.mouse.click(*cage_pixel(page, seen[0]))
    assert page.evaluate(chosen) == [seen[0]]
    page.mouse.click(*cage_pixel(page, hidden[0]))
    assert page.evaluate(chosen) == []
    xray = page.get_by_role("button", name="X-ray")
    assert xray.get_attribute("aria-pressed") == "false"
    page.keyboard.press("x")
    assert xray.get_attribute("aria-pressed") == "true"
    page.mouse.click(*cage_pixel(page, hidden[0]))
    assert page.evaluate(chosen) == [hidden[0]]
    xray.click()
    assert xray.get_attribute("aria-pressed") == "false"


def test_a_box_leaves_out_what_the_model_hides(use):
    page = use("Cage")
    seen, hidden = list_hidden(page)
    box = page.locator("#player canvas").bounding_box()
    corners = (
        (box["x"] + 3, box["y"] + 60),
        (box["x"] + box["width"] - 3, box["y"] + box["height"] - 3),
    )
    page.keyboard.press("b")
    drag(page, *corners)
    chosen = set(page.evaluate("[...P.stage.cages.selection.chosen]"))
    assert set(seen) <= chosen
    assert not chosen & set(hidden)
    page.keyboard.press("x")
    page.keyboard.press("b")
    drag(page, *corners)
    assert set(hidden) < set(page.evaluate("[...P.stage.cages.selection.chosen]"))


def test_handles_behind_the_model_are_not_picked(use):
    page = use("Pose")
    add(page, "handle", CHEST)
    page.locator("#player canvas").focus()
    page.keyboard.press("Escape")
    page.keyboard.press("1")
    settle(page)
    page.mouse.click(*vertex_pixel(page, CHEST))
    assert page.evaluate("P.stage.editor.selected") == -1
    page.keyboard.press("x")
    page.mouse.click(*vertex_pixel(page, CHEST))
    assert page.evaluate("P.stage.editor.selected") == 0


def test_what_is_seen_through_is_drawn_so(use):
    page = use("Pose")
    add(page, "handle", CHEST)
    page.keyboard.press("1")
    x, y = vertex_pixel(page, CHEST)
    clip = {"x": x - 8, "y": y - 8, "width": 16, "height": 16}
    page.mouse.move(*empty_pixel(page))
    hidden = page.screenshot(clip=clip)
    page.keyboard.press("x")
    settle(page)
    assert page.screenshot(clip=clip) != hidden


def test_a_box_is_drawn_once_and_keeps_the_gizmo(use):
    page = use("Cage")
    button = page.get_by_role("button", name="Box", exact=True)
    x, y = cage_pixel(page, CAGE_HAND)
    button.click()
    assert button.get_attribute("aria-pressed") == "true"
    drag(page, (x - 9, y - 9), (x + 9, y + 9))
    settle(page)
    assert button.get_attribute("aria-pressed") == "false"
    assert CAGE_HAND in page.evaluate("[...P.stage.cages.selection.chosen]")
    # The arms move while the next box is waited for.
    button.click()
    arm = "(({ middle, tips }) => middle.map((m, k) => m + 0.7 * (tips[1].tip[k] - m)))"
    start = pixel_of(page, f"{arm}(P.stage.cages.gizmo())")
    drag(page, start, (start[0], start[1] - 30))
    settle(page)
    (move, *_) = page.evaluate("P.stage.editor.cageFile.edits[0].moves")
    assert move["offset"][1] > 0.02
    assert button.get_attribute("aria-pressed") == "true"
    page.keyboard.press("Escape")
    assert button.get_attribute("aria-pressed") == "false"
    before = page.evaluate("P.stage.camera.turn")
    drag(page, empty_pixel(page), (empty_pixel(page)[0] + 40, empty_pixel(page)[1]))
    assert page.evaluate("P.stage.camera.turn") != before
