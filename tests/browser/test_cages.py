"""Cage vertices moved in the page, by mouse, touch and keyboard: what it draws, `deform` gives."""

import json

import numpy as np
import pytest

from cageik_cli.report.html.page import render_page, render_result_page
from cageik_cli.report.record import build_report
from cageik_cli.store.result import read_binding, read_result
from cageik_cli.view.player.clip import make_single_pose
from cageik_cli.view.player.section import build_player, load_player
from tests.browser.players import check_positions, drag, run_cageik, settle

pytestmark = pytest.mark.browser

HAND = 47


@pytest.fixture
def edit(play):
    """A function that opens the page of the walk, or another, in the mode of cage vertices."""

    def start(*arguments, **options):
        page = play(*arguments, **options)
        page.get_by_role("button", name="Cage", exact=True).click()
        page.locator("#player canvas").scroll_into_view_if_needed()
        settle(page)
        return page

    return start


def place_of(page, vertex):
    """Return the pixel of a cage vertex in the window."""
    settle(page)
    box = page.locator("#player canvas").bounding_box()
    x, y, _ = page.evaluate(f"P.stage.camera.project(P.stage.cages.place({vertex}))")
    return box["x"] + x, box["y"] + y


def chosen(page):
    settle(page)
    return sorted(page.evaluate("[...P.stage.cages.selection.chosen]"))


def type_in(page, label, text):
    panel = page.get_by_role("group", name="Cage", exact=True)
    panel.get_by_label(label, exact=True).fill(str(text))
    page.keyboard.press("Enter")
    settle(page)


def go(page, frame):
    page.evaluate(f"P.stage.transport.go({frame}); P.stage.request(true)")
    settle(page)


def read_file(page):
    return page.evaluate("P.stage.editor.cageFile")


def save(page, folder):
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Save cage edits").click()
    path = folder / "cage_edits.json"
    waiting.value.save_as(path)
    return path


def load(page, content):
    text = content if isinstance(content, str) else json.dumps(content)
    page.locator("[data-cage-load]").set_input_files(
        {"name": "given.json", "mimeType": "application/json", "buffer": text.encode()}
    )
    page.wait_for_function("() => !document.querySelector('[data-cage-load]').value")
    settle(page)


def check_as_deform(page, result, path, folder, frames, *handles):
    """Compare what is drawn with `deform` of the written edit, and return its cages."""
    edited, meshes = folder / "edited.h5", folder / "edited.npz"
    run_cageik("pose", result.path, *handles, "--cage-edits", path, "-o", edited, "-q",
               "--overwrite")  # fmt: skip
    run_cageik("deform", edited, "-o", meshes, "-q", "--overwrite")
    with np.load(meshes) as file:
        for frame in frames:
            go(page, frame)
            check_positions(page, file["vertices"][frame], result.rest.diagonal)
        return file["vertices"]


def test_a_dragged_vertex_is_where_deform_puts_the_mesh(edit, walk, tmp_path):
    result, frames = walk
    page = edit()
    x, y = place_of(page, HAND)
    page.mouse.click(x, y)
    assert chosen(page) == [HAND]
    drag(page, (x, y), (x + 40, y - 70))
    np.testing.assert_allclose(place_of(page, HAND), (x + 40, y - 70), atol=2)
    path = save(page, tmp_path)
    (only,) = json.loads(path.read_text())["edits"]
    assert [move["vertex"] for move in only["moves"]] == [HAND]
    check_as_deform(page, result, path, tmp_path, (0, 6, 11))
    with pytest.raises(AssertionError):
        check_positions(page, frames[11], result.rest.diagonal)
    assert page.text_content("[data-cage-command]") == (
        "cageik pose walk.h5 --cage-edits cage_edits.json -o edited.h5"
    )


def test_keys_frames_and_handles_are_those_of_the_command(edit, walk, tmp_path):
    result, frames = walk
    page = edit()
    type_in(page, "Cage vertices", f"{HAND}, 40-42")
    assert chosen(page) == [40, 41, 42, HAND]
    page.get_by_role("button", name="New edit").click()
    for label, value in (("From", 4), ("To", 9), ("Fade", 3), ("Edit name", "arm")):
        type_in(page, label, value)
    for frame, height in ((3, 0.05), (5, 0.2), (8, 0.1)):
        go(page, frame)
        page.get_by_role("button", name="Set key").click()
        page.locator("[data-cage-move-y]").fill(str(height))
        page.keyboard.press("Enter")
        settle(page)
    assert page.locator("[data-strip] .key").count() == 3
    saved = read_file(page)["edits"][0]
    assert (saved["name"], saved["frames"], saved["falloff"]) == ("arm", [4, 9], 3)
    assert all(move["offset"]["frames"] == [4, 6, 9] for move in saved["moves"])
    path = save(page, tmp_path)
    check_as_deform(page, result, path, tmp_path, range(12))
    for frame in (0, 11):
        go(page, frame)
        check_positions(page, frames[frame], result.rest.diagonal)
    go(page, 5)
    page.get_by_role("button", name="Remove key").click()
    settle(page)
    assert read_file(page)["edits"][0]["moves"][0]["offset"]["frames"] == [4, 9]
    page.get_by_role("button", name="Undo").click()
    settle(page)
    page.get_by_role("button", name="Pose", exact=True).click()
    page.locator("[data-vertex]").fill("1040")
    page.locator("[data-tool=handle]").click()
    page.get_by_role("button", name="Add", exact=True).click()
    page.locator("[data-move-y]").fill("0.2")
    page.keyboard.press("Enter")
    settle(page)
    handles = tmp_path / "handles.json"
    handles.write_text(json.dumps(page.evaluate("P.stage.editor.file")))
    assert page.text_content("[data-command]").startswith(
        "cageik pose walk.h5 handles.json --cage-edits cage_edits.json"
    )
    words = (handles,)
    check_as_deform(page, result, path, tmp_path, (0, 4, 7), *words)


def test_clicks_boxes_and_numbers_choose(edit):
    page = edit()
    first, second = place_of(page, HAND), place_of(page, 30)
    page.mouse.click(*first)
    page.keyboard.down("Shift")
    page.mouse.click(*second)
    page.keyboard.up("Shift")
    assert chosen(page) == [30, HAND]
    box = page.locator("#player canvas").bounding_box()
    page.mouse.click(box["x"] + 5, box["y"] + box["height"] - 5)
    assert chosen(page) == []
    whole = (
        (box["x"] + 3, box["y"] + 60),
        (box["x"] + box["width"] - 3, box["y"] + box["height"] - 3),
    )
    page.keyboard.down("Control")
    drag(page, *whole)
    page.keyboard.up("Control")
    count = len(chosen(page))
    assert count > 40  # the model hides the others
    page.locator("#player canvas").focus()
    page.keyboard.press("Escape")
    assert chosen(page) == []
    page.get_by_role("button", name="Box").click()
    x, y = first
    drag(page, (x - 9, y - 9), (x + 9, y + 9))
    assert HAND in chosen(page)
    type_in(page, "Cage vertices", "99")
    assert "there is no cage vertex 99; the cage has 80" in page.text_content("[data-cage-said]")
    type_in(page, "Cage vertices", "x")
    assert "x is no number or range" in page.text_content("[data-cage-said]")


def test_a_selection_grows_and_shrinks_over_edges(edit, walk):
    page = edit()
    near = {HAND}
    for face in read_binding(walk[0]).cage.faces:
        if HAND in face:
            near |= set(face.tolist())
    type_in(page, "Cage vertices", HAND)
    page.get_by_role("button", name="Grow").click()
    grown = set(chosen(page))
    assert {HAND} < grown <= near
    page.get_by_role("button", name="Shrink").click()
    assert chosen(page) == [HAND]


def test_the_gizmo_moves_along_one_axis(edit):
    page = edit()
    type_in(page, "Cage vertices", HAND)
    box = page.locator("#player canvas").bounding_box()
    tip = page.evaluate(
        "(() => { const { middle, tips } = P.stage.cages.gizmo();"
        " return P.stage.camera.project(middle.map((x, k) => x + 0.8 * (tips[1].tip[k] - x))); })()"
    )
    x, y = box["x"] + tip[0], box["y"] + tip[1]
    drag(page, (x, y), (x + 30, y - 50))
    offset = read_file(page)["edits"][0]["moves"][0]["offset"]
    np.testing.assert_allclose([offset[0], offset[2]], 0, atol=1e-7)
    assert offset[1] > 0.05


def test_an_arm_that_is_seen_end_on_is_not_there(edit):
    page = edit()
    type_in(page, "Cage vertices", HAND)
    for key, hidden in (("1", "z"), ("3", "x"), ("7", "y")):
        page.locator("#player canvas").press(key)
        settle(page)
        page.locator("#player canvas").press("f")
        settle(page)
        arms = page.evaluate("P.stage.cages.gizmo().tips.map(({ axis }) => axis)")
        assert set(arms) == set("xyz") - {hidden}


def test_a_finger_drags_a_vertex(edit):
    page = edit(has_touch=True)
    x, y = place_of(page, HAND)
    session = page.context.new_cdp_session(page)
    for kind, at in [("touchStart", (x, y)), ("touchMove", (x, y - 20)),
                     ("touchMove", (x, y - 60)), ("touchEnd", None)]:  # fmt: skip
        points = [] if at is None else [{"x": at[0], "y": at[1]}]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    np.testing.assert_allclose(place_of(page, HAND), (x, y - 60), atol=3)


def test_a_pen_drags_a_vertex(edit):
    page = edit()
    x, y = place_of(page, HAND)
    session = page.context.new_cdp_session(page)
    for kind, up in [("mousePressed", 0), ("mouseMoved", 20), ("mouseMoved", 60),
                     ("mouseReleased", 60)]:  # fmt: skip
        at = {"x": x, "y": y - up, "button": "left", "buttons": 1, "clickCount": 1}
        session.send("Input.dispatchMouseEvent", {"type": kind, "pointerType": "pen", **at})
    np.testing.assert_allclose(place_of(page, HAND), (x, y - 60), atol=3)


def test_all_modes_have_one_history(edit, walk):
    result, frames = walk
    page = edit()
    type_in(page, "Cage vertices", HAND)
    page.locator("[data-cage-move-x]").fill("0.1")
    page.keyboard.press("Enter")
    settle(page)
    page.get_by_role("button", name="Pose", exact=True).click()
    page.locator("[data-tool=pin]").click()
    page.locator("[data-vertex]").fill("5")
    page.get_by_role("button", name="Add", exact=True).click()
    settle(page)
    states = [page.evaluate("P.stage.editor.snapshot()")]
    canvas = page.locator("#player canvas")
    canvas.focus()
    for _ in range(2):
        page.keyboard.press("Control+z")
        settle(page)
        states.append(page.evaluate("P.stage.editor.snapshot()"))
    assert json.loads(states[1])[0]["handles"] == []
    assert json.loads(states[2])[1]["edits"] == []
    check_positions(page, frames[0], result.rest.diagonal)
    page.get_by_role("button", name="Cage", exact=True).click()
    canvas.focus()
    for state in states[1::-1]:
        page.keyboard.press("Control+y")
        settle(page)
        assert page.evaluate("P.stage.editor.snapshot()") == state


def test_vertices_are_put_back_and_edits_deleted(edit, walk):
    result, frames = walk
    page = edit()
    for name in ("Put back", "Delete edit"):
        type_in(page, "Cage vertices", HAND)
        page.locator("[data-cage-move-x]").fill("0.1")
        page.keyboard.press("Enter")
        settle(page)
        assert page.get_by_role("button", name="Save cage edits").is_enabled()
        page.get_by_role("button", name=name).click()
        check_positions(page, frames[0], result.rest.diagonal)
        assert page.get_by_role("button", name="Save cage edits").is_disabled()


def test_both_sides_of_a_symmetric_cage_move(edit, tmp_path_factory, animation, write_obj):
    folder = tmp_path_factory.mktemp("symmetric")
    np.savez(folder / "clip.npz", verts=animation.frames, faces=animation.rest.faces)
    cage = write_obj(folder / "cage.obj", animation.cage.vertices, animation.cage.faces)
    run_cageik("extract", folder / "clip.npz", "--cage", cage, "-o", folder / "ball.h5", "-q")
    result = read_result(folder / "ball.h5")
    page = edit(render_result_page(result, build_report(result), load_player(result)))
    page.get_by_label("Mirror", exact=True).check()
    type_in(page, "Cage vertices", 0)
    page.locator("[data-cage-move-x]").fill("0.2")
    page.keyboard.press("Enter")
    settle(page)
    moves = {
        move["vertex"]: np.array(move["offset"]) for move in read_file(page)["edits"][0]["moves"]
    }
    partner = page.evaluate("P.stage.cages.partners[0]")
    assert moves.keys() == {0, partner}
    assert np.linalg.norm(moves[partner]) == pytest.approx(0.2)
    normal = np.array(page.evaluate("turn(P.stage.cages.mirror.normal, P.stage.clip.rotation(0))"))
    np.testing.assert_allclose(
        moves[partner], moves[0] - 2 * (moves[0] @ normal) * normal, atol=1e-7
    )


BAD_FILES = {
    "no JSON": ("{", "given.json: "),
    "a handles file": ({"handles": []}, "is not a cage edits file"),
    "no edits": ({"edits": []}, "is not a cage edits file"),
    "no name": ({"edits": [{"moves": []}]}, "expected a name of its own"),
    "no moves": ({"edits": [{"name": "a"}]}, 'edit "a": moves: expected a list'),
    "no such vertex": (
        {"edits": [{"name": "a", "moves": [{"vertex": 80, "offset": [0, 0, 0]}]}]},
        "there is no cage vertex 80; the cage has 80",
    ),
    "twice": (
        {"edits": [{"name": "a", "moves": 2 * [{"vertex": 8, "offset": [0, 0, 0]}]}]},
        "vertex 8: is moved twice",
    ),
    "no numbers": (
        {"edits": [{"name": "a", "moves": [{"vertex": 8, "offset": [0, "1", 0]}]}]},
        "expected three numbers",
    ),
    "frames beyond": (
        {"edits": [{"name": "a", "frames": [2, 13],
                    "moves": [{"vertex": 8, "offset": [0, 0, 0]}]}]},
        "expected two frames from 1 to 12",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_wrong_file_is_refused_and_changes_nothing(edit, name):
    content, message = BAD_FILES[name]
    page = edit()
    load(page, content)
    assert message in page.text_content("[data-cage-said]")
    assert read_file(page) == {"edits": []}


def test_a_file_that_is_loaded_is_saved_again(edit, walk, tmp_path):
    keys = {"frames": [2, 5, 9], "values": [[0, 0, 0], [0, 0.2, 0], [0.1, 0, 0]]}
    document = {
        "edits": [
            {"name": "a", "moves": [{"vertex": HAND, "offset": [0.1, 0.05, 0]}]},
            {"name": "b", "frames": [4, 6], "falloff": 2,
             "moves": [{"vertex": HAND, "offset": keys}, {"vertex": 3, "offset": [0, 0, 0.1]}]},
        ]
    }  # fmt: skip
    page = edit()
    load(page, document)
    path = save(page, tmp_path)
    assert json.loads(path.read_text()) == document
    check_as_deform(page, walk[0], path, tmp_path, range(12))


def test_a_model_at_rest_is_edited_without_keys(edit, walk, tmp_path):
    result = walk[0]
    clip = make_single_pose(read_binding(result), ["walker_1.obj", "--cage", "cage.obj"])
    page = edit(render_page(build_report(result), player=build_player(clip)))
    type_in(page, "Cage vertices", HAND)
    page.locator("[data-cage-move-y]").fill("0.3")
    page.keyboard.press("Enter")
    settle(page)
    assert page.get_by_role("button", name="Set key").is_hidden()
    binding = read_binding(result)
    expected = binding.rest.vertices + 0.3 * binding.weights[:, [HAND]] * [0, 1, 0]
    check_positions(page, expected, result.rest.diagonal)
    assert "posed.obj" in page.text_content("[data-cage-command]")


def test_an_edit_without_strength_is_said_to_be(edit):
    page = edit()
    type_in(page, "Cage vertices", HAND)
    page.get_by_role("button", name="New edit").click()
    for label, value in (("From", 4), ("To", 9)):
        type_in(page, label, value)
    page.locator("[data-cage-move-y]").fill("0.3")
    page.keyboard.press("Enter")
    settle(page)
    assert "has no strength in this frame" in page.text_content("[data-cage-said]")
    assert read_file(page)["edits"][0]["moves"] == []


def test_a_large_file_is_saved_as_short_as_it_can_be_read_again(edit, tmp_path):
    """Indented it would have more bytes than files may have."""
    moves = [{"vertex": k, "offset": [0.015625, 0.0078125, 0.00390625]} for k in range(80)]
    content = {"edits": [{"name": f"edit {k}", "moves": moves} for k in range(300)]}
    text = json.dumps(content, separators=(",", ":"))
    assert len(text) < 2_000_000 < len(json.dumps(content, indent=2))
    page = edit()
    load(page, text)
    saved = save(page, tmp_path).read_text()
    assert json.loads(saved) == content
    assert len(saved) <= 2_000_000
