"""`cageik view RESULT --edit-cage` in the browser: bad places are mended, clips extracted again."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.obj.frames import encode_exact_obj
from cageik_cli.formats.open import load_mesh
from cageik_cli.store.result import read_result
from tests.browser.players import WALKER, run_cageik, settle
from tests.browser.test_accessibility import find_violations
from tests.view.rest_cages import dent

pytestmark = pytest.mark.browser


@pytest.fixture
def result(tmp_path, monkeypatch):
    """The folder of a result of some frames of the walker, which are one folder below."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(WALKER / "frames", "frames")
    for path in Path("frames").iterdir():
        if int(path.stem.split("_")[1]) > 12:
            path.unlink()
    run_cageik("extract", "frames", "--cage", WALKER / "cage.obj", "-o", "walk.h5", "-q")


def open_page(serve, *words, **options):
    opened = serve(*words, "--edit-cage", **options)
    assert opened.page.evaluate("window.cageikPlayer.then((p) => Boolean(window.P = p))")
    return opened


def wait_for_check(page):
    page.wait_for_function(
        "() => P.stage.cageService.verdict?.mesh === P.stage.cageEditor.mesh", timeout=60_000
    )
    settle(page)


def test_the_worst_place_is_mended_where_it_is_seen(serve, result):
    opened = open_page(serve, "walk.h5")
    page = opened.page
    assert page.locator("[data-colours]").input_value() == "rms"
    assert page.locator("[data-scale]").is_visible()
    assert "on average" in page.text_content("[data-rest-before]")
    levels = page.evaluate("[...P.stage.colours.values]")
    percents = 100 * read_result(Path("walk.h5")).vertex_rms / load_walker().diagonal
    end = page.evaluate("P.stage.clip.rms.end")
    np.testing.assert_allclose(levels, percents / end, atol=1e-4)

    page.locator("[data-rest-places] button").first.click()
    assert page.evaluate("[P.stage.cageEditor.kind, P.stage.cageEditor.chosen.size]") == [
        "faces",
        1,
    ]
    page.locator("[data-rest-subdivide]").click()
    page.locator("[data-rest-again]").click()
    page.locator("[data-rest-again-said]", has_text="wrote walk-2.h5, walk-2.cage.obj").wait_for(
        timeout=120_000
    )
    before, after = (page.text_content(f"[data-rest-{name}]") for name in ("before", "after"))
    assert before.startswith("walk.h5: ")
    assert after.startswith("walk-2.h5: ")
    assert before[9:] != after[11:]
    assert page.locator("[data-rest-again-name]").input_value() == "walk-3.h5"
    found = read_result(Path("walk-2.h5"))
    assert len(found.cage.vertices) == page.evaluate("P.stage.cageEditor.mesh.vertices.length") > 80
    for name, stored in (("after", found), ("before", read_result(Path("walk.h5")))):
        page.locator("[data-rest-which]").select_option(name)
        settle(page)
        shown = page.evaluate("[...P.stage.colours.values]")
        expected = 100 * stored.vertex_rms / stored.rest.diagonal / end
        np.testing.assert_allclose(shown, expected, atol=1e-4)
    assert opened.errors == []


def load_walker():
    return load_mesh(WALKER / "frames" / "walker_1.obj").mesh


def test_frames_that_are_gone_are_told_and_the_cage_can_be_saved(serve, result):
    shutil.rmtree("frames")
    opened = open_page(serve, "walk.h5")
    page, said = opened.page, opened.page.locator("[data-rest-again-said]")
    assert "not found in the current folder" in said.text_content()
    assert "--clip" in said.text_content()
    page.locator("[data-rest-again]").click()
    page.wait_for_function("() => !document.querySelector('[data-rest-again]').disabled")
    assert "not found in the current folder" in said.text_content()
    assert not Path("walk-2.h5").exists()
    page.get_by_role("button", name="Save as").click()
    page.locator("[data-keep-said]", has_text="wrote walk-2.obj").wait_for(timeout=30_000)
    assert load_mesh(Path("walk-2.obj")).mesh.vertices.shape == (80, 3)


def write_three_faults():
    """A hole, a face that is turned over, and a vertex inside the model."""
    cage, rest = load_mesh(WALKER / "cage.obj").mesh, load_walker()
    dented = dent(cage, rest, [40], 0.012)
    faces = [face[::-1] if k == 100 else face for k, face in enumerate(cage.faces) if k != 3]
    Path("faults.obj").write_bytes(encode_exact_obj(dented.vertices, faces))


def test_a_cage_of_three_faults_is_mended_by_two_clicks(serve, tmp_path):
    """All faults are marked, and found in the picture where the model hides them."""
    write_three_faults()
    words = (WALKER / "frames/walker_1.obj", "--cage", "faults.obj")
    opened = open_page(serve, *words, "-o", "mended.obj")
    page = opened.page
    wait_for_check(page)
    sentences = page.locator("[data-rest-findings] button").all_text_contents()
    assert len(sentences) == 3
    assert any("vertex 40 of the cage is" in one and "drag it out" in one for one in sentences)
    assert not any("nflate" in one for one in sentences)
    for turn in (0, 90, 180, 270):
        page.evaluate("(turn) => { P.stage.camera.turn = turn; P.stage.request(); }", turn)
        settle(page)
        assert count_red(page) > 20, f"no fault is seen from {turn} degrees"
    page.locator("[data-rest-findings] button", has_text="vertex 40").click()
    assert page.evaluate("[...P.stage.cageEditor.chosen]") == [40]
    page.locator("[data-rest-repair]").click()
    page.locator("[data-rest-verdict]", has_text="fit").wait_for(timeout=60_000)
    page.wait_for_function(
        "() => document.querySelector('[data-rest-verdict]').textContent === 'fit'", timeout=60_000
    )
    page.locator("[data-rest-apply]").click()
    page.locator("[data-rest-said]", has_text="wrote mended.obj").wait_for(timeout=60_000)
    page.locator("[data-undo]").click()
    assert page.evaluate("P.stage.cageEditor.mesh.polygons.length") == 155
    assert opened.errors == []


def count_red(page):
    """How many pixels of the picture have the red of faults."""
    return page.evaluate("""() => {
      const { stage } = P, { gl } = stage.renderer;
      const { drawingBufferWidth: w, drawingBufferHeight: h } = gl;
      stage.draw();
      const pixels = new Uint8Array(4 * w * h);
      gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      let count = 0;
      for (let k = 0; k < pixels.length; k += 4)
        if (pixels[k] > 190 && pixels[k + 1] < 60 && pixels[k + 2] < 60) count++;
      return count;
    }""")


def test_a_fit_cage_has_no_red(serve, tmp_path):
    opened = open_page(serve, WALKER / "frames/walker_1.obj", "--cage", WALKER / "cage.obj")
    wait_for_check(opened.page)
    assert count_red(opened.page) == 0


def test_all_of_the_cage_is_in_the_picture(serve, tmp_path):
    """Also where it is much larger than the model."""
    cage = load_mesh(WALKER / "cage.obj").mesh
    Path("large.obj").write_bytes(encode_exact_obj(3 * cage.vertices, list(cage.faces)))
    page = open_page(serve, WALKER / "frames/walker_1.obj", "--cage", "large.obj").page
    settle(page)
    width, height = page.evaluate("[P.stage.canvas.clientWidth, P.stage.canvas.clientHeight]")
    pixels = np.array(
        page.evaluate(
            "P.stage.cageEditor.mesh.vertices.map("
            "(one) => P.stage.camera.project(P.stage.clip.fromFile(one)))"
        )
    )
    assert (pixels[:, :2] >= 0).all()
    assert (pixels[:, :2] <= [width, height]).all()
    spread = np.ptp(pixels[:, :2], axis=0) / [width, height]
    assert spread.max() > 0.6


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1440, 390])
def test_nothing_is_in_the_way_of_anybody(serve, result, width, scheme):
    size = {"width": width, "height": 900 if width > 500 else 844}
    opened = open_page(serve, "walk.h5", viewport=size, color_scheme=scheme, bypass_csp=True)
    page = opened.page
    if page.locator("#player.folded").count():
        page.locator("[data-fold]").click()
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.locator("[data-rest-places] button").first.click()
    wait_for_check(page)
    assert find_violations(page) == []
