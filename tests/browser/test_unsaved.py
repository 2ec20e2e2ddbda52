"""Pages of `cageik view`: what is not saved is asked for, kept, and offered again."""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.browser.players import WALKER, run_cageik, settle
from tests.browser.test_accessibility import find_violations

pytestmark = pytest.mark.browser

HANDLES = {
    "handles": [
        {"name": "hand", "vertex": 1040, "offset": [0.1, 0.2, 0]},
        {"name": "head", "vertex": 389, "pin": True},
    ]
}


@pytest.fixture
def result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frames = [WALKER / "frames" / f"walker_{k}.obj" for k in range(1, 7)]
    run_cageik("extract", *frames, "--cage", WALKER / "cage.obj", "-o", "walk.h5", "-q")


def get_player(opened):
    page = opened.page
    page.wait_for_selector("#player.ready", timeout=60_000)
    assert page.evaluate("window.cageikPlayer.then((p) => Boolean(window.P = p))")
    return page


def pose(page):
    """Load handles, which are then unsaved work."""
    page.get_by_role("button", name="Pose", exact=True).click()
    upload = {"name": "h.json", "mimeType": "application/json"}
    page.set_input_files("[data-load]", [upload | {"buffer": json.dumps(HANDLES).encode()}])
    page.wait_for_function("() => P.stage.editor.file.handles.length === 2")
    settle(page)


def leave(page):
    """Whether the page asks before it is left; the answer is to stay."""
    asked = []

    def answer(dialog):
        asked.append(dialog.type)
        dialog.dismiss()

    page.once("dialog", answer)
    # A page asks nobody who has not touched it.
    page.mouse.click(*[5, page.viewport_size["height"] - 5])
    page.close(run_before_unload=True)
    try:
        page.wait_for_event("close", timeout=1500)
    except Exception:  # it stays
        page.wait_for_timeout(100)
    return asked == ["beforeunload"]


def read_kept(page):
    return page.evaluate("Object.entries(localStorage).filter(([k]) => k.startsWith('cageik '))")


def test_a_page_is_left_without_a_question_if_nothing_is_unsaved(serve, result):
    page = get_player(serve("walk.h5"))
    assert not leave(page)
    assert page.is_closed()


def test_a_page_is_not_left_without_a_question_if_something_is(serve, result):
    page = get_player(serve("walk.h5"))
    pose(page)
    assert leave(page)
    assert not page.is_closed()


def test_what_is_undone_is_not_unsaved(serve, result):
    page = get_player(serve("walk.h5"))
    pose(page)
    page.locator("[data-undo]").click()
    settle(page)
    assert not leave(page)


def test_what_is_saved_is_not_asked_for(serve, result):
    page = get_player(serve("walk.h5"))
    pose(page)
    with page.expect_download():
        page.locator("[data-save]").click()
    page.wait_for_function("() => P.stage.keeper.list(true).length === 0")
    page.evaluate("P.stage.keeper.keep()")
    assert read_kept(page) == []
    assert not leave(page)


def test_an_edit_is_saved_beside_the_result(serve, result):
    """And what of the work that does not keep is said."""
    opened = serve("walk.h5")
    page = get_player(opened)
    assert page.locator("[data-keep-as]").is_hidden()
    pose(page)
    assert page.locator("[data-apply]").is_hidden()
    assert page.get_by_label("New file").input_value() == "walk-2.h5"
    page.get_by_role("button", name="Save as").click()
    said = page.locator("[data-keep-said]", has_text="wrote walk-2.h5")
    said.wait_for(timeout=60_000)
    assert said.text_content().endswith("not saved: the handles, for which there is Save handles")
    Path("h.json").write_text(json.dumps(HANDLES))
    run_cageik("pose", "walk.h5", "h.json", "--rigidity", 10, "-o", "reference.h5", "-q")
    with h5py.File("walk-2.h5") as saved, h5py.File("reference.h5") as reference:
        np.testing.assert_array_equal(saved["verts"][:], reference["verts"][:])
    assert page.get_by_label("New file").input_value() == "walk-3.h5"
    for name, told in (("walk-2.h5", "exists already"), ("../x.h5", "expected a plain name")):
        page.get_by_label("New file").fill(name)
        page.get_by_role("button", name="Save as").click()
        page.locator("[data-keep-said]", has_text=told).wait_for(timeout=30_000)
    assert not Path("../x.h5").exists()
    assert not leave(page)


def test_after_apply_what_is_not_saved_is_said(serve, result):
    page = get_player(serve("walk.h5", "-o", "edited.h5"))
    pose(page)
    page.locator("[data-apply]").click()
    said = page.locator("[data-said]", has_text="wrote edited.h5")
    said.wait_for(timeout=60_000)
    assert said.text_content() == (
        "wrote edited.h5; not saved: the handles, for which there is Save handles"
    )
    assert not leave(page)


def test_after_apply_with_handles_all_is_saved(serve, result):
    page = get_player(serve("walk.h5", "-o", "edited.h5", "--handles-out", "h.json"))
    pose(page)
    page.locator("[data-apply]").click()
    said = page.locator("[data-said]", has_text="wrote edited.h5")
    said.wait_for(timeout=60_000)
    assert said.text_content() == "wrote edited.h5, h.json"
    page.evaluate("P.stage.keeper.keep()")
    assert read_kept(page) == []


def reload(page):
    page.once("dialog", lambda dialog: dialog.accept())
    page.reload()
    page.wait_for_selector("#player.ready", timeout=60_000)
    assert page.evaluate("window.cageikPlayer.then((p) => Boolean(window.P = p))")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1440, 390])
def test_work_is_kept_and_offered_again(serve, result, width, scheme):
    size = {"width": width, "height": 844}
    page = get_player(serve("walk.h5", viewport=size, color_scheme=scheme, bypass_csp=True))
    if page.locator("#player.folded").count():
        page.locator("[data-fold]").click()
    pose(page)
    page.wait_for_function("() => Object.keys(localStorage).some((k) => k.startsWith('cageik '))")
    reload(page)
    dialog = page.locator("[data-keep-ask]")
    dialog.wait_for(timeout=10_000)
    assert "Work on walk.h5 of " in dialog.text_content()
    assert find_violations(page) == []
    dialog.get_by_role("button", name="Go on with it").click()
    assert page.evaluate("P.stage.editor.file") == HANDLES
    assert page.locator("#player").get_attribute("data-mode") == "pose"
    page.locator("[data-undo]").click()
    assert page.evaluate("P.stage.editor.file.handles.length") == 0


def test_work_that_is_discarded_is_gone(serve, result):
    page = get_player(serve("walk.h5"))
    pose(page)
    page.wait_for_function("() => Object.keys(localStorage).some((k) => k.startsWith('cageik '))")
    reload(page)
    page.get_by_role("button", name="Discard it").click()
    assert read_kept(page) == []
    reload(page)
    assert not page.locator("[data-keep-ask]").is_visible()


def test_work_that_is_put_off_is_offered_again(serve, result):
    page = get_player(serve("walk.h5"))
    pose(page)
    page.wait_for_function("() => Object.keys(localStorage).some((k) => k.startsWith('cageik '))")
    reload(page)
    page.keyboard.press("Escape")
    page.evaluate("P.stage.keeper.keep()")
    reload(page)
    assert page.locator("[data-keep-ask]").is_visible()


def test_work_on_another_file_is_not_offered(serve, result):
    page = get_player(serve("walk.h5"))
    pose(page)
    page.evaluate("P.stage.keeper.keep()")
    ((key, _),) = read_kept(page)
    other = get_player(serve(WALKER / "frames/walker_1.obj", "--cage", WALKER / "cage.obj"))
    assert key != "cageik " + other.evaluate("P.stage.keeper.session.key")


def test_what_is_kept_is_bounded(serve, result):
    page = get_player(serve("walk.h5"))
    pose(page)
    found = page.evaluate("""() => {
      for (let k = 0; k < 12; k++)
        localStorage['cageik ' + k] = `20${10 + k}-01-01T00:00:00.000Z{}`;
      localStorage.other = 'x';
      P.stage.keeper.keep();
      return Object.keys(localStorage).sort();
    }""")
    assert "other" in found
    kept = [name for name in found if name.startswith("cageik ")]
    assert len(kept) == 8
    assert "cageik 11" in kept
    assert "cageik 0" not in kept
    told = page.evaluate("""() => {
      const { kept } = P.stage.keeper, isKept = kept.write('x'.repeat(2e6 + 1));
      return [isKept, kept.read()];
    }""")
    assert told == [False, ""]


def test_without_room_the_page_says_so(serve, result):
    page = get_player(serve("walk.h5"))
    page.evaluate("() => { Storage.prototype.setItem = () => { throw new Error('full'); }; }")
    pose(page)
    page.evaluate("P.stage.keeper.keep(); P.stage.request()")
    page.locator("[data-keep-said]", has_text="no room to keep").wait_for(timeout=10_000)


def test_what_is_kept_and_damaged_is_refused_in_words(serve, result):
    page = get_player(serve("walk.h5"))
    key = page.evaluate("P.stage.keeper.session.key")
    bad = json.dumps({"handles": '{"handles": [{"name": 3}]}', "cageEdits": ""})
    page.evaluate(
        "([k, v]) => { localStorage[k] = v; }", [f"cageik {key}", "2026-01-01T00:00:00.000Z" + bad]
    )
    reload(page)
    page.get_by_role("button", name="Go on with it").click()
    assert "what was kept cannot be opened: " in page.text_content("[data-keep-said]")


def test_a_cage_is_kept_and_saved(serve, tmp_path):
    shutil.copy(WALKER / "cage.obj", "cage.obj")
    words = (WALKER / "frames/walker_1.obj", "--cage", "cage.obj", "--edit-cage")
    page = get_player(serve(*words, "-o", "new.obj"))
    assert not page.evaluate("P.stage.keeper.list(true).length")
    page.locator("[data-rest-list]").fill("3")
    page.locator("[data-rest-list]").press("Enter")
    page.locator("[data-rest-x]").fill("1.5")
    page.locator("[data-rest-x]").press("Enter")
    page.wait_for_function("() => Object.keys(localStorage).some((k) => k.startsWith('cageik '))")
    reload(page)
    page.get_by_role("button", name="Go on with it").click()
    assert page.evaluate("P.stage.cageEditor.mesh.vertices[3][0]") == 1.5
    assert page.evaluate("P.stage.keeper.list(true)") == ["cage"]
    page.locator("[data-rest-apply]").click()
    page.locator("[data-rest-said]", has_text="wrote new.obj").wait_for(timeout=60_000)
    assert read_kept(page) == []
    assert not leave(page)


def test_the_key_for_help_shows_the_keys(serve, result):
    page = get_player(serve("walk.h5"))
    page.keyboard.press("?")
    page.get_by_text("Keys and pointers").wait_for(timeout=10_000)


def test_other_pages_keep_nothing(play):
    page = play()
    assert page.evaluate("typeof Keeper") == "undefined"
