"""`cageik view` in the browser: handles that are applied give the file of `cageik pose`."""

import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest

from cageik_cli import extract_to_file, show
from tests.browser.conftest import Opened
from tests.browser.players import WALKER, run_cageik

pytestmark = pytest.mark.browser


@pytest.fixture
def serve(tmp_path, monkeypatch, browser):
    """Start `cageik view` with some words, and open its page."""
    monkeypatch.chdir(tmp_path)
    processes, contexts = [], []

    def start(*words) -> Opened:
        command = [sys.executable, "-m", "cageik_cli", "view", *map(str, words), "--no-browser"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        processes.append(process)
        context = browser.new_context()
        contexts.append(context)
        page = context.new_page()
        opened = Opened(page)
        page.on(
            "console", lambda told: opened.errors.append(told.text) if told.type == "error" else 0
        )
        page.on("pageerror", lambda error: opened.errors.append(str(error)))
        page.goto(process.stdout.readline().strip())
        page.wait_for_selector("#player.ready", timeout=60_000)
        return opened

    yield start
    for context in contexts:
        context.close()
    for process in processes:
        process.kill()
        process.communicate()


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
    run_cageik("pose", "walker.h5", "h.json", "--rigidity", 10, "-o", "reference.h5", "-q")
    np.testing.assert_array_equal(cages("e.h5"), cages("reference.h5"))
    (tmp_path / "e.h5").write_bytes(b"of someone else")
    assert apply(opened).startswith("e.h5: exists already")
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
        frame.locator("[data-posing] summary").click()
        frame.locator("[data-save]").evaluate("(one) => { one.disabled = false; one.click(); }")
    assert download.value.suggested_filename == "handles.json"
    assert faults == []
    context.close()
