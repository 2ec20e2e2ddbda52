"""What axe-core finds in the pages: names, roles, contrast, and order, in light and dark."""

import json

import pytest

from cageik_cli.view.player.clip import load_player_clip
from cageik_cli.view.player.section import render_view_page

pytestmark = pytest.mark.browser

WIDTHS = (1440, 390)

HANDLES = {
    "frames": [2, 8],
    "falloff": 2,
    "handles": [
        {"name": "left hand", "vertex": 1040, "offset": [0.1, 0.2, 0]},
        {"name": "head", "vertex": 389, "pin": True},
    ],
}


def find_violations(page):
    """Return what axe-core objects to, by name and element."""
    from axe_playwright_python.sync_playwright import Axe

    violations = Axe().run(page).response["violations"]
    return [(one["id"], node["html"]) for one in violations for node in one["nodes"]]


def show_everything(page):
    """Open the panel, and in it the mode for posing, with handles, and a handle that is chosen."""
    if page.locator("#player.folded").count():
        page.locator("[data-fold]").click()
    page.get_by_role("button", name="Pose", exact=True).click()
    upload = {"name": "handles.json", "mimeType": "application/json"}
    page.set_input_files("[data-load]", [upload | {"buffer": json.dumps(HANDLES).encode()}])
    page.locator("[data-handles] button").first.click()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("kind", ["report", "view"])
def test_nothing_is_in_the_way_of_anybody(play, walk, walk_page, kind, width, scheme):
    text = walk_page
    if kind == "view":
        text = render_view_page(load_player_clip(walk[0]))
    page = play(
        text,
        viewport={"width": width, "height": 1000},
        color_scheme=scheme,
        has_touch=width < 500,
        bypass_csp=True,  # axe-core is a script of its own
    )
    show_everything(page)
    assert find_violations(page) == []
    page.get_by_role("button", name="Influence", exact=True).click()
    page.get_by_label("Vertex of the model").fill("389")
    page.keyboard.press("Enter")
    assert page.locator("[data-weights] button").count() > 1
    assert find_violations(page) == []


def test_what_is_in_the_way_is_found(play):
    page = play(bypass_csp=True)
    page.evaluate(
        "() => { const play = document.querySelector('[data-play]');"
        " play.replaceChildren(); play.title = ''; }"
    )
    assert [name for name, _ in find_violations(page)] == ["button-name"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_every_mode_and_the_list_of_keys_are_open_to_anybody(play, character_result, width, scheme):
    page = play(
        render_view_page(load_player_clip(character_result)),
        viewport={"width": width, "height": 900},
        color_scheme=scheme,
        bypass_csp=True,
    )
    if page.locator("#player.folded").count():
        assert find_violations(page) == []
        page.locator("[data-fold]").click()
    for button in page.locator("[data-modes] button").all():
        button.click()
        page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert find_violations(page) == []
    page.get_by_role("button", name="Keys", exact=True).click()
    assert find_violations(page) == []
