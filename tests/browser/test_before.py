"""Before and after in the page: what is drawn, the key, ghosts, and the view that is copied."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.open import load_mesh
from cageik_cli.store.result import read_animation
from tests.browser.players import WALKER, run_cageik, settle

pytestmark = pytest.mark.browser


HANDLES = {
    "handles": [
        {"name": "hand", "vertex": 1040, "offset": [0.2, 0.3, 0]},
        {"name": "head", "vertex": 389, "pin": True},
    ]
}


def positions(page, name="P.stage.input"):
    """Return positions that are drawn, in the units of the file."""
    return np.array(
        page.evaluate(
            f"Array.from({{ length: {name}.length / 3 }}, (_, k) =>"
            f" P.stage.clip.toFile([...{name}.subarray(3 * k, 3 * k + 3)]))"
        )
    )


def choose(page, name, value):
    page.evaluate(
        "([name, value]) => { const list = document.querySelector(`[data-${name}]`);"
        " list.value = value; list.dispatchEvent(new Event('change')); }",
        [name, value],
    )


def go(page, frame):
    page.evaluate(f"P.stage.transport.go({frame}); P.stage.request(true)")


def wait_for_mesh(page):
    """Wait until the mesh before is there; the policy of the page forbids to wait for a text."""
    for _ in range(200):
        if page.evaluate("Boolean(P.stage.before.mesh)"):
            return
        page.wait_for_timeout(50)
    pytest.fail(page.text_content("[data-note]"))


def open_page(serve, *words):
    opened = serve(*words)
    opened.page.evaluate("window.cageikPlayer.then((player) => Boolean(window.P = player))")
    return opened


@pytest.fixture
def walker(tmp_path, monkeypatch):
    """A result of ten frames, which are in a folder beside it, and an edit of it."""
    monkeypatch.chdir(tmp_path)
    Path("frames").mkdir()
    for k in range(1, 11):
        shutil.copy(WALKER / "frames" / f"walker_{k}.obj", "frames")
    run_cageik("extract", "frames", "--cage", WALKER / "cage.obj", "-o", "walker.h5", "-q")
    Path("handles.json").write_text(json.dumps(HANDLES))
    run_cageik("pose", "walker.h5", "handles.json", "-o", "edit.h5", "-q")


def load_input(number):
    return load_mesh(Path("frames") / f"walker_{number}.obj").mesh.vertices


def test_the_input_of_any_frame_is_shown(walker, serve):
    opened = open_page(serve, "walker.h5")
    page = opened.page
    assert page.evaluate("P.stage.before.kept.size") == 0  # nothing is read that nobody wants
    choose(page, "show", "both")
    for frame in range(10):
        go(page, frame)
        wait_for_mesh(page)
        settle(page)
        assert np.abs(positions(page) - load_input(1 + frame)).max() < 5e-5
        assert page.locator("#player.split").count() == 1
    assert page.text_content("[data-before-name]") == "input"
    choose(page, "show", "ghost")
    settle(page)
    assert page.evaluate("P.stage.before.isGhost")
    assert opened.errors == []


def test_an_edit_is_compared_with_what_it_was_made_from(walker, serve):
    opened = open_page(serve, "edit.h5")
    page = opened.page
    choose(page, "show", "input")
    go(page, 5)
    run_cageik("deform", "walker.h5", "-o", "before.npz", "-q")
    with np.load("before.npz") as file:
        before = file["vertices"]
    for kind, wanted in (("unedited", before[5]), ("input", load_input(6))):
        choose(page, "before", kind)
        page.wait_for_timeout(100)
        wait_for_mesh(page)
        settle(page)
        diagonal = read_animation(Path("edit.h5")).rest.diagonal
        assert np.abs(positions(page) - wanted).max() < 1e-4 * diagonal
    choose(page, "before", "live")
    settle(page)
    assert np.abs(positions(page) - positions(page, "P.stage.positions")).max() < 1e-6
    assert opened.errors == []


def test_what_is_not_there_is_said_and_looked_for_again(walker, serve):
    shutil.move("frames", "moved")
    Path("deep").mkdir()
    shutil.move("moved", "deep/frames")
    opened = open_page(serve, "walker.h5")
    page = opened.page
    page.evaluate(
        "P.stage.transport.go([...Array(10).keys()].find((k) => !P.stage.clip.held.has(k)))"
    )
    choose(page, "show", "both")
    page.wait_for_timeout(2000)
    assert "is not beside walker.h5" in page.text_content("[data-note]")
    assert page.locator("#player.split").count() == 0
    shutil.move("deep/frames", "frames")
    choose(page, "show", "ghost")
    wait_for_mesh(page)
    assert all("422" in error for error in opened.errors)


def test_a_key_and_a_button_show_it_while_they_are_held(play):
    page = play()
    page.evaluate("P.stage.transport.go([...P.stage.clip.held.keys()][0]); P.stage.request(true)")
    page.locator("#player canvas").focus()
    settle(page)
    shown = "[P.stage.before.isHeld, P.stage.before.isAlone]"
    assert page.evaluate(shown) == [False, False]
    page.keyboard.down("v")
    settle(page)
    assert page.evaluate(shown) == [True, True]
    page.keyboard.up("v")
    settle(page)
    assert page.evaluate(shown) == [False, False]
    button = page.get_by_role("button", name="Hold to see")
    button.focus()
    page.keyboard.down("Enter")
    assert button.get_attribute("aria-pressed") == "true"
    page.keyboard.up("Enter")
    assert button.get_attribute("aria-pressed") == "false"
    button.hover()
    page.mouse.down()
    assert button.get_attribute("aria-pressed") == "true"
    page.mouse.move(5, 5)
    page.mouse.up()
    assert button.get_attribute("aria-pressed") == "false"


def test_without_my_edits_a_page_shows_its_clip(play):
    page = play()
    go(page, 6)
    choose(page, "before", "live")
    choose(page, "show", "both")
    settle(page)
    before = positions(page, "P.stage.positions")
    upload = {"name": "handles.json", "mimeType": "application/json"}
    page.set_input_files("[data-load]", [upload | {"buffer": json.dumps(HANDLES).encode()}])
    settle(page)
    np.testing.assert_allclose(positions(page), before, rtol=0, atol=1e-6)
    assert np.abs(positions(page, "P.stage.positions") - before).max() > 0.1


def test_ghosts_are_the_neighbouring_frames(play):
    page = play()
    choose(page, "ghosts", "2")
    choose(page, "every", "4")
    names = "P.stage.before.drawn.map(({ name, paint }) => paint[0] > paint[2] ? 'past' : 'future')"
    for frame, wanted in ((6, ["past", "future"]), (2, ["future"]), (11, ["past", "past"])):
        go(page, frame)
        settle(page)
        assert page.evaluate(names) == (wanted if frame != 2 else ["future", "future"])
    page.evaluate("P.stage.transport.play(true); P.stage.request(true)")
    settle(page)
    assert page.evaluate("P.stage.before.drawn.length") == 0


def test_the_copied_view_is_that_of_the_picture(play, walk, tmp_path):
    """A film from there has the model where the page has it."""
    from PIL import Image

    result, _ = walk
    page = play(viewport={"width": 1000, "height": 700})
    page.evaluate("Object.assign(P.stage.camera, { turn: -40, tilt: 25 }); P.stage.frameModel()")
    page.evaluate(
        "P.stage.view.follow = false; P.stage.view.grid = false; P.stage.view.cage = false"
    )
    page.evaluate("P.stage.camera.zoom(1.2); P.stage.camera.pan(20, -10); P.stage.request(true)")
    settle(page)
    page.locator("[data-copy]").click()
    page.wait_for_timeout(200)
    view = page.text_content("[data-under]").split()[-1]
    width, height = page.evaluate("[P.stage.canvas.clientWidth, P.stage.canvas.clientHeight]")
    film = tmp_path / "film" / "walk_##.png"
    size = f"{2 * (width // 2)}x{2 * (height // 2)}"
    words = ("--film", film, "--film-size", size, "--film-view", view, "--film-no-cage", "-q")
    run_cageik("report", result.path, *words)
    with Image.open(tmp_path / "film" / "walk_01.png") as image:
        drawn = (np.asarray(image) < 245).any(axis=2)
    drawn[-24:, :120] = False  # the number of the frame
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    found = page.evaluate(
        "(() => { const { stage } = P, list = [];"
        " for (let k = 0; k < stage.positions.length; k += 3)"
        " list.push(stage.camera.project([...stage.positions.subarray(k, k + 3)]));"
        " return list; })()"
    )
    x, y = np.array(found)[:, :2].T
    box = [x.min(), y.min(), x.max(), y.max()]
    assert np.abs(np.array(box) - (columns[0], rows[0], columns[-1], rows[-1])).max() < 2.5
