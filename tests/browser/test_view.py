"""`cageik view` in the browser: handles that are applied give the file of `cageik pose`."""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli import extract_to_file, show
from tests.browser.players import WALKER, run_cageik

pytestmark = pytest.mark.browser


def apply(opened) -> str:
    """Press Apply, and wait for what is said of it, which is not what was said before."""
    page = opened.page
    before = page.locator("[data-said]").text_content()
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.locator("[data-apply]").click()
    said = page.locator("[data-said]")
    page.wait_for_function(
        "([one, before]) => /^wrote|exists/.test(one.textContent) && one.textContent !== before",
        arg=[said.element_handle(), before],
        timeout=60_000,
    )
    return said.text_content()


def cages(name):
    with h5py.File(name) as file:
        return file["verts"][:]


def test_handles_that_are_applied_give_the_file_of_the_command(serve, tmp_path):
    run_cageik("extract", WALKER / "frames", "--cage", WALKER / "cage.obj", "-o", "walker.h5", "-q")
    shutil.copy(WALKER / "wave.json", "wave.json")
    opened = serve("walker.h5", "--handles", "wave.json", "-o", "e.h5", "--handles-out", "h.json")
    assert apply(opened) == "wrote e.h5, h.json"
    run_cageik("pose", "walker.h5", "h.json", "-o", "reference.h5", "-q")
    np.testing.assert_array_equal(cages("e.h5"), cages("reference.h5"))
    (tmp_path / "e.h5").write_bytes(b"of someone else")
    assert apply(opened).startswith("e.h5: exists already")
    assert opened.errors == []


def test_cage_edits_that_are_applied_give_the_file_of_the_command(serve):
    """With the vertex that is moved in the page, the frames outside keep their bits."""
    run_cageik("extract", WALKER / "frames", "--cage", WALKER / "cage.obj", "-o", "walker.h5", "-q")
    move = {"vertex": 47, "offset": [0.1, 0, 0]}
    first = {"edits": [{"name": "hand", "frames": [20, 24], "falloff": 2, "moves": [move]}]}
    Path("first.json").write_text(json.dumps(first))
    words = ("--cage-edits", "first.json", "-o", "e.h5", "--cage-edits-out", "c.json")
    opened = serve("walker.h5", *words)
    page = opened.page
    page.evaluate("window.cageikPlayer.then((player) => Boolean(window.P = player))")
    page.evaluate("P.stage.transport.go(21); P.stage.request(true)")
    page.get_by_label("Cage vertices").fill("3")
    page.keyboard.press("Enter")
    page.locator("[data-cage-move-y]").fill("0.05")
    page.keyboard.press("Enter")
    page.locator("[data-cage-apply]").click()
    page.wait_for_function(
        "() => /^wrote/.test(document.querySelector('[data-cage-said]').textContent)",
        timeout=60_000,
    )
    assert page.text_content("[data-cage-said]").startswith("wrote e.h5, c.json")
    first["edits"][0]["moves"].append({"vertex": 3, "offset": [0, 0.05, 0]})
    assert json.loads(Path("c.json").read_text()) == first
    run_cageik("pose", "walker.h5", "--cage-edits", "c.json", "-o", "reference.h5", "-q")
    np.testing.assert_array_equal(cages("e.h5"), cages("reference.h5"))
    changed = (cages("e.h5") != cages("walker.h5")).any(axis=(1, 2))
    assert np.flatnonzero(changed).tolist() == list(range(18, 25))
    assert opened.errors == []


def test_a_model_without_an_output_cannot_be_applied(serve):
    opened = serve(WALKER / "frames" / "walker_1.obj", "--cage", WALKER / "cage.obj")
    assert opened.page.locator("[data-apply]").is_hidden()
    assert opened.errors == []


def test_the_frame_of_a_notebook_plays(browser, tmp_path, monkeypatch):
    """In a frame that may run scripts, and has no origin of its own."""
    monkeypatch.chdir(tmp_path)
    result = extract_to_file(WALKER / "frames", WALKER / "cage.obj", "walker.h5")
    context = browser.new_context()
    page, faults = context.new_page(), []
    page.on("console", lambda told: faults.append(told.text) if told.type == "error" else None)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.set_content(show(result)._repr_html_())
    frame = page.frame_locator("iframe")
    frame.locator("#player.ready").wait_for(timeout=60_000)
    frame.locator("[data-on]").click()
    frame.locator("[data-frame]", has_text="walker_2.obj").wait_for(timeout=10_000)
    with page.expect_download() as download:
        frame.get_by_role("button", name="Pose", exact=True).click()
        frame.locator("[data-save]").evaluate("(one) => { one.disabled = false; one.click(); }")
    assert download.value.suggested_filename == "handles.json"
    assert faults == []
    context.close()
