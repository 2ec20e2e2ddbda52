"""Posing in the page, by mouse, touch and keyboard: what it draws, `cageik pose` computes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.formats.open import load_mesh
from cageik_cli.report.html.page import render_page, render_result_page
from cageik_cli.report.record import build_report
from cageik_cli.store.result import read_binding, read_result
from cageik_cli.view.player.clip import load_player_clip, make_single_pose
from cageik_cli.view.player.section import build_player, load_player
from tests.browser.players import WALKER, check_positions, drag, middle_of, run_cageik, settle

pytestmark = pytest.mark.browser

HAND, ELBOW, FEET, CHEST, HEAD = 1040, 1367, (994, 1090), 889, 389


@pytest.fixture
def pose(play):
    """A function that opens the page of the walk, or another, ready to be posed."""

    def start(*arguments, **options):
        page = play(*arguments, **options)
        page.get_by_role("button", name="Pose", exact=True).click()
        page.locator("#player canvas").scroll_into_view_if_needed()
        return page

    return start


@pytest.fixture(scope="session")
def single_page(walk):
    """A page that poses the walker at rest."""
    result = walk[0]
    clip = make_single_pose(read_binding(result), ["walker_1.obj", "--cage", "cage.obj"])
    return render_page(build_report(result), player=build_player(clip))


def place_of(page, vertex):
    """Return the pixel of a vertex in the window."""
    settle(page)
    box = page.locator("#player canvas").bounding_box()
    x, y, _ = page.evaluate(
        f"P.stage.camera.project([...P.stage.positions.subarray({3 * vertex}, {3 * vertex + 3})])"
    )
    return box["x"] + x, box["y"] + y


def add_vertex(page, vertex, kind="handle"):
    page.locator(f"[data-tool={kind}]").click()
    page.locator("[data-vertex]").fill(str(vertex))
    page.get_by_role("button", name="Add", exact=True).click()
    page.locator("#player canvas").scroll_into_view_if_needed()
    settle(page)


def pin_body(page):
    for vertex in (*FEET, CHEST, HEAD):
        add_vertex(page, vertex, "pin")


def save(page, folder):
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Save handles").click()
    path = folder / "handles.json"
    waiting.value.save_as(path)
    return path


def load(page, content):
    text = content if isinstance(content, str) else json.dumps(content)
    page.locator("[data-load]").set_input_files(
        {"name": "given.json", "mimeType": "application/json", "buffer": text.encode()}
    )
    page.wait_for_function("() => !document.querySelector('[data-load]').value")
    settle(page)


def read_file(page):
    return page.evaluate("P.stage.editor.file")


def edit_by_command(result, handles, folder, rigidity=0):
    """Return the frames of the edited result, as the command line writes them."""
    edited, frames = folder / "edited.h5", folder / "edited.npz"
    run_cageik("pose", result.path, handles, "--rigidity", rigidity, "-o", edited, "-q",
               "--overwrite")  # fmt: skip
    run_cageik("deform", edited, "-o", frames, "-q", "--overwrite")
    with np.load(frames) as file:
        return file["vertices"]


def check_frames(page, meshes, diagonal, frames, factor=1):
    for frame in frames:
        page.evaluate(f"P.stage.transport.go({frame}); P.stage.request(true)")
        check_positions(page, meshes[frame], diagonal, factor)


def go(page, frame):
    page.evaluate(f"P.stage.transport.go({frame}); P.stage.request(true)")
    settle(page)


def test_a_dragged_hand_is_where_the_command_line_puts_it(pose, walk, tmp_path):
    result, frames = walk
    page = pose()
    pin_body(page)
    add_vertex(page, HAND)
    x, y = place_of(page, HAND)
    drag(page, (x, y), (x + 40, y - 90))
    moved = place_of(page, HAND)
    np.testing.assert_allclose(moved, (x + 40, y - 90), atol=3)
    path = save(page, tmp_path)
    meshes = edit_by_command(result, path, tmp_path)
    check_frames(page, meshes, result.rest.diagonal, (0, 5, 11))
    with pytest.raises(AssertionError):
        check_frames(page, frames, result.rest.diagonal, (0,))
    assert "cageik pose walk.h5 handles.json -o" in page.text_content("[data-command]")


def test_a_model_at_rest_is_posed_as_by_the_command_line(pose, walk, single_page, tmp_path):
    result = walk[0]
    page = pose(single_page)
    assert page.get_by_role("button", name="Play").is_hidden()
    pin_body(page)
    add_vertex(page, HAND)
    x, y = place_of(page, HAND)
    drag(page, (x, y), (x + 30, y - 120))
    path = save(page, tmp_path)
    assert "frames" not in json.loads(path.read_text())
    model, cage = WALKER / "frames" / "walker_1.obj", WALKER / "cage.obj"
    run_cageik("pose", model, path, "--cage", cage, "-o",
               tmp_path / "posed.obj", "-q")  # fmt: skip
    posed = load_mesh(tmp_path / "posed.obj").mesh.vertices
    check_positions(page, posed, result.rest.diagonal)


def test_a_click_on_the_surface_sets_a_handle_there(pose):
    page = pose()
    page.locator("[data-tool=handle]").click()
    page.locator("#player canvas").scroll_into_view_if_needed()
    x, y = place_of(page, CHEST)
    page.mouse.move(x, y)
    page.wait_for_function("() => document.querySelector('[data-under]').textContent")
    assert f"vertex {CHEST}; face " in page.text_content("[data-under]")
    page.mouse.click(x, y)
    settle(page)
    assert read_file(page)["handles"] == [
        {"name": "handle 1", "vertex": CHEST, "offset": [0, 0, 0]}
    ]
    page.mouse.click(*place_of(page, CHEST))
    settle(page)
    assert len(read_file(page)["handles"]) == 1
    box = page.locator("#player canvas").bounding_box()
    page.mouse.click(box["x"] + 5, box["y"] + 5)
    settle(page)
    assert len(read_file(page)["handles"]) == 1


def test_a_click_between_vertices_sets_a_point_of_a_face(pose, walk, tmp_path):
    result = walk[0]
    page = pose()
    page.locator("#player canvas").focus()
    for _ in range(8):
        page.keyboard.press("+")
    page.locator("[data-tool=pin]").click()
    page.locator("#player canvas").scroll_into_view_if_needed()
    settle(page)
    for dx in range(0, 60, 6):
        x, y = middle_of(page)
        page.mouse.move(x + dx, y)
        page.mouse.click(x + dx, y)
        settle(page)
        faces = [one for one in read_file(page)["handles"] if "face" in one]
        if faces:
            break
    (pin,) = faces
    assert sum(pin["barycentric"]) == pytest.approx(1, abs=1e-6)
    assert min(pin["barycentric"]) >= 0
    assert pin["pin"] is True
    add_vertex(page, HAND)
    page.locator("[data-move-y]").fill("0.1")
    page.keyboard.press("Enter")
    meshes = edit_by_command(result, save(page, tmp_path), tmp_path)
    check_frames(page, meshes, result.rest.diagonal, (0, 7))


def test_an_axis_keeps_the_drag_on_it(pose):
    page = pose()
    pin_body(page)
    add_vertex(page, HAND)
    page.get_by_label("Drag").select_option("y")
    page.locator("#player canvas").scroll_into_view_if_needed()
    x, y = place_of(page, HAND)
    drag(page, (x, y), (x + 50, y - 60))
    offset = next(one for one in read_file(page)["handles"] if "offset" in one)["offset"]
    np.testing.assert_allclose([offset[0], offset[2]], 0, atol=1e-7)
    assert offset[1] > 0.1


def test_a_finger_drags_a_handle(pose):
    page = pose(has_touch=True)
    pin_body(page)
    add_vertex(page, HAND)
    x, y = place_of(page, HAND)
    session = page.context.new_cdp_session(page)
    for kind, at in [("touchStart", (x, y)), ("touchMove", (x, y - 20)),
                     ("touchMove", (x, y - 60)), ("touchEnd", None)]:  # fmt: skip
        points = [] if at is None else [{"x": at[0], "y": at[1]}]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    settle(page)
    np.testing.assert_allclose(place_of(page, HAND), (x, y - 60), atol=3)


def test_what_was_done_is_undone_and_done_again(pose):
    page = pose()
    add_vertex(page, CHEST, "pin")
    add_vertex(page, HAND)
    x, y = place_of(page, HAND)
    drag(page, (x, y), (x, y - 60))
    states = [read_file(page)]
    canvas = page.locator("#player canvas")
    canvas.focus()
    for _ in range(3):
        page.keyboard.press("Control+z")
        settle(page)
        states.append(read_file(page))
    assert [len(one["handles"]) for one in states] == [2, 2, 1, 0]
    assert states[1]["handles"][1]["offset"] == [0, 0, 0]
    for state in states[2::-1]:
        page.keyboard.press("Control+y")
        settle(page)
        assert read_file(page) == state
    page.get_by_role("button", name="Undo").click()
    settle(page)
    assert read_file(page) == states[1]


def test_a_handle_is_deleted(pose, walk):
    result, frames = walk
    page = pose()
    pin_body(page)
    add_vertex(page, HAND)
    x, y = place_of(page, HAND)
    drag(page, (x, y), (x, y - 60))
    page.locator("#player canvas").focus()
    page.keyboard.press("Delete")
    settle(page)
    assert all("pin" in one for one in read_file(page)["handles"])
    check_positions(page, frames[0], result.rest.diagonal)


def test_frames_falloff_and_keys_are_those_of_the_command_line(pose, walk, tmp_path):
    result, frames = walk
    page = pose()
    pin_body(page)
    add_vertex(page, HAND)
    for name, value in [("From", 4), ("To", 9), ("Fade", 3)]:
        panel = page.get_by_role("group", name="Pose", exact=True)
        panel.get_by_label(name, exact=True).fill(str(value))
        page.keyboard.press("Enter")
    for frame, height in [(3, 0.1), (5, 0.4), (8, 0.2)]:
        go(page, frame)
        page.get_by_role("button", name="Set key").click()
        page.locator("[data-move-y]").fill(str(height))
        page.keyboard.press("Enter")
        settle(page)
    path = save(page, tmp_path)
    saved = json.loads(path.read_text())
    assert (saved["frames"], saved["falloff"]) == ([4, 9], 3)
    assert saved["handles"][-1]["offset"]["frames"] == [4, 6, 9]
    assert page.locator("[data-strip] .key").count() == 3
    meshes = edit_by_command(result, path, tmp_path)
    check_frames(page, meshes, result.rest.diagonal, range(12))
    check_frames(page, frames, result.rest.diagonal, (0, 11))
    go(page, 5)
    page.get_by_role("button", name="Remove key").click()
    settle(page)
    assert read_file(page)["handles"][-1]["offset"]["frames"] == [4, 9]


FILES = {
    "pins and a target": {
        "handles": [
            {"name": "hand", "vertex": HAND, "target": [0.75, 1.75, 0.1], "weight": 3},
            {
                "name": "elbow",
                "face": 1490,
                "barycentric": [0.2, 0.6, 0.2],
                "offset": [0.1, 0.1, 0],
            },
            {"name": "chest", "vertex": CHEST, "pin": True, "hard": True},
            {"name": "foot", "vertex": FEET[0], "pin": True},
        ]
    },
    "one handle alone": {"handles": [{"name": "hand", "vertex": HAND, "offset": [0.1, 0.2, 0.3]}]},
    "two handles": {
        "handles": [
            {"name": "hand", "vertex": HAND, "offset": [0.1, 0.2, 0.3]},
            {"name": "foot", "vertex": FEET[0], "pin": True},
        ]
    },
    "locked vertices": {
        "locked": [0, 1, 2, 3],
        "handles": [{"name": "hand", "vertex": HAND, "offset": [0.1, 0.2, 0.3]}],
    },
    "two sets": {
        "sets": [
            {
                "handles": [
                    {"name": "hand", "vertex": HAND, "offset": [0, 0.3, 0]},
                    {"name": "chest", "vertex": CHEST, "pin": True},
                ],
                "frames": [3, 7],
                "falloff": 2,
            },
            {
                "handles": [
                    {"name": "head", "vertex": HEAD, "target": [0, 1.9, 0.2]},
                    {"name": "chest", "vertex": CHEST, "pin": True},
                ],
                "frames": [6, 10],
            },
        ]
    },
}


@pytest.mark.parametrize("rigidity", [0, 10])
@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_loaded_gives_what_the_command_line_gives(
    pose, walk, tmp_path, name, rigidity
):
    result = walk[0]
    page = pose()
    page.get_by_label("Rigidity, rounds").fill(str(rigidity))
    page.keyboard.press("Enter")
    load(page, FILES[name])
    assert page.text_content("[data-said]").split("vertices")[0].strip().isdigit() or not (
        page.text_content("[data-said]")
    )
    path = save(page, tmp_path)
    assert json.loads(path.read_text()) == FILES[name]
    meshes = edit_by_command(result, path, tmp_path, rigidity)
    check_frames(page, meshes, result.rest.diagonal, (0, 3, 6, 11))


@pytest.fixture(scope="session")
def symmetric(tmp_path_factory, animation, write_obj):
    """The result of a ball in a box, which is its own mirror image."""
    folder = tmp_path_factory.mktemp("symmetric")
    np.savez(folder / "clip.npz", verts=animation.frames, faces=animation.rest.faces)
    cage = write_obj(folder / "cage.obj", animation.cage.vertices, animation.cage.faces)
    run_cageik("extract", folder / "clip.npz", "--cage", cage, "-o", folder / "ball.h5", "-q")
    return read_result(folder / "ball.h5")


def test_a_symmetric_cage_is_posed_on_both_sides(pose, symmetric, tmp_path):
    page = pose(render_result_page(symmetric, build_report(symmetric), load_player(symmetric)))
    page.get_by_label("Symmetric").check()
    settle(page)
    handles = [
        {"name": "tip", "vertex": 3, "offset": [0.2, 0.3, -0.1]},
        {"name": "pin", "vertex": 7, "pin": True},
    ]
    load(page, {"mirror": read_file(page)["mirror"], "handles": handles})
    assert page.get_by_label("Symmetric").is_checked()
    meshes = edit_by_command(symmetric, save(page, tmp_path), tmp_path)
    check_frames(page, meshes, symmetric.rest.diagonal, (0, 4))
    page.get_by_label("Symmetric").uncheck()
    assert "mirror" not in json.loads(save(page, tmp_path).read_text())
    with pytest.raises(AssertionError):
        check_frames(page, meshes, symmetric.rest.diagonal, (4,))


BAD_FILES = {
    "no JSON": ("{", "given.json: "),
    "no object": ("[]", "is not a handles file"),
    "no handles": ({"handles": []}, "handles: expected a list"),
    "no such vertex": (
        {"handles": [{"name": "a", "vertex": 10_400, "pin": True}]},
        'handle "a": vertex: there is no vertex 10400; the mesh has 1570',
    ),
    "no such face": (
        {"handles": [{"name": "a", "face": 9999, "barycentric": [1, 0, 0], "pin": True}]},
        "there is no face 9999",
    ),
    "outside its face": (
        {"handles": [{"name": "a", "face": 9, "barycentric": [2, -1, 0], "pin": True}]},
        "barycentric",
    ),
    "on the screen": (
        {"handles": [{"name": "a", "screen": {"source": [1, 1], "offset": [1, 1]}}]},
        "on the screen",
    ),
    "same name": (
        {"handles": [{"name": "a", "vertex": k, "pin": True} for k in (1, 2)]},
        "a name of its own",
    ),
    "same vertex": (
        {"handles": [{"name": n, "vertex": 1, "pin": True} for n in "ab"]},
        "same vertex",
    ),
    "no motion": ({"handles": [{"name": "a", "vertex": 1}]}, "expected a target"),
    "no numbers": (
        {"handles": [{"name": "a", "vertex": 1, "offset": [1, "2", 3]}]},
        "expected three numbers",
    ),
    "keys out of order": (
        {
            "handles": [
                {
                    "name": "a",
                    "vertex": 1,
                    "offset": {"frames": [3, 2], "values": [[0, 0, 0], [0, 0, 0]]},
                }
            ]
        },
        "keyframes",
    ),
    "frames beyond the clip": (
        {"handles": [{"name": "a", "vertex": 1, "pin": True}], "frames": [2, 13]},
        "frames: expected two frames from 1 to 12",
    ),
    "no mirror": (
        {"handles": [{"name": "a", "vertex": 1, "pin": True}], "mirror": {"normal": [1]}},
        "mirror: expected",
    ),
    "no such cage vertex": (
        {"handles": [{"name": "a", "vertex": 1, "pin": True}], "locked": [80]},
        "locked: expected cage vertices",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_wrong_file_is_refused_and_changes_nothing(pose, walk, name):
    result, frames = walk
    content, message = BAD_FILES[name]
    page = pose()
    load(page, content)
    assert message in page.text_content("[data-said]")
    assert read_file(page) == {"handles": []}
    check_positions(page, frames[0], result.rest.diagonal)


def test_handles_that_conflict_are_said_to(pose):
    page = pose()
    near = {"face": 9, "barycentric": [0.2, 0.3, 0.5]}
    load(page, {"handles": [
        {"name": "a", **near, "offset": [0.1, 0, 0], "hard": True},
        {"name": "b", **near, "offset": [0, 0.1, 0], "hard": True},
    ]})  # fmt: skip
    assert "conflict" in page.text_content("[data-said]")


def test_what_moves_more_than_the_handles_is_marked(pose):
    page = pose()
    load(page, {"handles": [
        {"name": "hand", "vertex": HAND, "offset": [0, 0.5, 0]},
        {"name": "chest", "vertex": CHEST, "pin": True},
    ]})  # fmt: skip
    page.get_by_label("Rigidity, rounds").fill("0")
    page.keyboard.press("Enter")
    settle(page)
    marks = np.array(page.evaluate("[...P.stage.moved.marks]"))
    before = np.array(page.evaluate("[...P.stage.originalPositions(0)]")).reshape(-1, 3)
    after = np.array(page.evaluate("[...P.stage.positions]")).reshape(-1, 3)
    moved = np.linalg.norm(after - before, axis=1)
    np.testing.assert_array_equal(marks > 0, moved > 1.01 * moved[HAND] + 1e-6)
    if marks.any():
        assert "move more than the handles" in page.text_content("[data-said]")


def test_a_name_and_exactness_are_saved(pose, tmp_path):
    page = pose()
    add_vertex(page, HAND)
    page.get_by_label("Name", exact=True).fill("left <b>hand</b>")
    page.keyboard.press("Enter")
    page.get_by_label("Exact").check()
    saved = json.loads(save(page, tmp_path).read_text())
    assert saved["handles"] == [
        {"name": "left <b>hand</b>", "vertex": HAND, "offset": [0, 0, 0], "hard": True}
    ]
    assert page.locator("[data-handles] b").count() == 0
    page.get_by_label("Vertex", exact=True).fill("5000")
    page.get_by_role("button", name="Add", exact=True).click()
    settle(page)
    assert "there is no vertex 5000" in page.text_content("[data-said]")


def test_a_decimated_model_has_the_vertex_numbers_of_its_file(pose, walk, tmp_path, monkeypatch):
    from cageik_cli.view.player import section

    monkeypatch.setattr(section, "MAX_DRAWN_VERTICES", 400)
    result = walk[0]
    clip = load_player_clip(result)
    drawn = section.choose_vertices(clip.binding.rest, clip.binding.cage)[0]
    report = replace(build_report(result), notes=())
    page = pose(render_page(report, player=build_player(clip)))
    hand = int(drawn[np.abs(drawn - HAND).argmin()])
    for vertex in drawn[[10, 100, 200]].tolist():
        add_vertex(page, vertex, "pin")
    add_vertex(page, hand)
    page.locator("[data-move-y]").fill("0.2")
    page.keyboard.press("Enter")
    settle(page)
    path = save(page, tmp_path)
    assert json.loads(path.read_text())["handles"][-1]["vertex"] == hand
    meshes = edit_by_command(result, path, tmp_path)[:, drawn]
    # What is held, and the ways over the surface, are those of a quarter of the vertices.
    check_frames(page, meshes, result.rest.diagonal, (0, 6), factor=100)
    page.get_by_label("Hold the rest").uncheck()
    settle(page)
    path = save(page, tmp_path)
    assert json.loads(path.read_text())["hold"] is False
    meshes = edit_by_command(result, path, tmp_path)[:, drawn]
    check_frames(page, meshes, result.rest.diagonal, (0, 6))


def front_of_ring(page):
    """Return the pixel of the point of the ring that is nearest to the eye, in the window."""
    settle(page)
    points = np.array(page.evaluate("P.stage.editor.ring")).reshape(-1, 3)
    box = page.locator("#player canvas").bounding_box()
    seen = [page.evaluate(f"P.stage.camera.project({point.tolist()})") for point in points[::7]]
    front = min(seen, key=lambda place: place[2])
    return box["x"] + front[0], box["y"] + front[1]


def test_a_ring_shows_how_far_the_model_moves_and_is_dragged(pose, walk, tmp_path):
    page = pose()
    add_vertex(page, HAND)
    ring = page.evaluate("P.stage.editor.ring.length")
    assert ring > 60
    first = page.evaluate("P.stage.editor.reach.radius")
    page.locator("[data-tool=move]").click()
    drag(page, front_of_ring(page), place_of(page, ELBOW))
    settle(page)
    second = page.evaluate("P.stage.editor.reach.radius")
    assert second < first
    content = json.loads(save(page, tmp_path).read_text())
    assert content["handles"][0]["radius"] == pytest.approx(
        second * walk[0].rest.diagonal, rel=1e-3
    )
    page.locator("[data-undo]").click()
    assert page.evaluate("P.stage.editor.reach.radius") == first


def test_the_page_says_what_an_edit_does_and_goes_to_the_worst_frame(pose, walk):
    page = pose()
    add_vertex(page, HAND)
    page.locator("[data-move-y]").fill("0.4")
    page.keyboard.press("Enter")
    line = page.locator("[data-panel=pose] [data-measured]")
    page.wait_for_function("() => document.querySelector('[data-measured]').textContent")
    assert "% of the mesh moves" in line.text_content()
    assert page.locator("[data-edited]").get_attribute("d").startswith("M")
    button = page.locator("[data-panel=pose] [data-volume]")
    assert not button.is_visible()
    page.get_by_label("Hold the rest").uncheck()
    for vertex in (*FEET, CHEST):
        add_vertex(page, vertex, "pin")
    page.evaluate("P.stage.editor.select(0)")
    page.locator("[data-move-y]").fill("1.2")
    page.keyboard.press("Enter")
    page.wait_for_function(
        "() => !document.querySelector('[data-panel=pose] [data-volume]').hidden"
    )
    button.click()
    settle(page)
    assert f"in frame {page.evaluate('P.stage.number')}" in button.text_content()


def test_handles_stay_turn_and_ease_as_the_command_says(pose, walk, tmp_path):
    page = pose()
    result = walk[0]
    keys = {"frames": [1, 6, 12], "values": [[0, 0, 0], [0, 0.3, 0.1], [0.1, 0, 0]]}
    handles = [
        {"name": "hand", "vertex": HAND, "axes": "surface", "offset": keys | {"ease": "linear"}},
        {"name": "foot", "vertex": FEET[0], "stay": True, "radius": 0.5},
        {"name": "head", "vertex": HEAD, "offset": keys | {"ease": "stepped"}},
    ]
    load(page, {"handles": handles, "frames": [3, 9], "falloff": 2})
    path = tmp_path / "given.json"
    path.write_text(json.dumps({"handles": handles, "frames": [3, 9], "falloff": 2}))
    meshes = edit_by_command(result, path, tmp_path)
    check_frames(page, meshes, result.rest.diagonal, (1, 4, 8))


def test_a_click_on_the_ring_adds_a_handle_and_escape_ends_a_pull(pose):
    page = pose()
    add_vertex(page, HAND)
    start = front_of_ring(page)
    page.mouse.click(*start)
    settle(page)
    assert page.evaluate("P.stage.editor.set.handles.length") == 2
    page.locator("[data-undo]").click()
    page.evaluate("P.stage.editor.select(0)")
    page.locator("[data-tool=move]").click()
    first = page.evaluate("P.stage.editor.reach.radius")
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*place_of(page, ELBOW), steps=6)
    settle(page)
    assert page.evaluate("P.stage.editor.reach.radius") != first
    page.keyboard.press("Escape")
    page.mouse.up()
    settle(page)
    assert page.evaluate("P.stage.editor.reach.radius") == first


def test_sets_without_handles_are_in_no_file(pose, tmp_path):
    page = pose()
    hand = {"name": "hand", "vertex": HAND, "offset": [0, 0.1, 0]}
    load(page, {"sets": [{"handles": [hand]}, {"handles": [hand | {"name": "b"}]}]})
    page.evaluate("P.stage.editor.select(0)")
    page.get_by_role("button", name="Delete", exact=True).click()
    assert len(json.loads(save(page, tmp_path).read_text())["sets"]) == 1
