"""Cage vertices and handles moved, rotated and scaled by keys, the pointer and typed numbers."""

import json

import numpy as np
import pytest

from cageik_cli.store.result import read_binding
from cageik_cli.view.player.clip import load_player_clip
from cageik_cli.view.player.section import render_view_page
from tests.browser.players import drag, run_cageik, settle
from tests.browser.test_pointing import add, pixel_of, vertex_pixel

pytestmark = pytest.mark.browser

CHOSEN = (40, 41, 42, 47)
HAND, CHEST = 1040, 889


@pytest.fixture(scope="session")
def view_page(walk):
    return render_view_page(load_player_clip(walk[0]))


@pytest.fixture
def edit(play, view_page):
    """A function that opens the page with cage vertices chosen, seen from the front."""

    def start(vertices=CHOSEN, **options):
        page = play(view_page, **options)
        page.get_by_role("button", name="Cage", exact=True).click()
        page.locator("[data-cage-vertices]").fill(", ".join(map(str, vertices)))
        page.keyboard.press("Enter")
        page.keyboard.press("1")
        settle(page)
        return page

    return start


def press(page, *keys):
    for key in keys:
        page.keyboard.press(key)
    settle(page)


def read_cage(page):
    """The drawn cage, (n, 3), in the units of the file."""
    settle(page)
    return np.array(page.evaluate("listPoints(P.stage.cage).map((p) => P.stage.clip.toFile(p))"))


def moves_of(page):
    settle(page)
    edits = page.evaluate("P.stage.editor.cageFile.edits")
    return {one["vertex"]: one["offset"] for edit in edits for one in edit["moves"]}


def middle_pixel(page):
    return pixel_of(page, "P.stage.cages.pivot")


def rotate(points, middle, axis, degrees):
    """Rotate points counterclockwise, as seen from the tip of an axis."""
    angle, turned = np.radians(degrees), np.eye(3)
    a, b = [k for k in range(3) if k != axis] if axis != 1 else (2, 0)
    turned[[a, b], [a, b]] = np.cos(angle)
    turned[b, a], turned[a, b] = np.sin(angle), -np.sin(angle)
    return (points - middle) @ turned.T + middle


def test_numbers_move_along_an_axis(edit):
    page = edit()
    before = read_cage(page)
    press(page, "g", "y", "0", ".", "2", "5")
    assert page.text_content("[data-under]").startswith("Move along y: 0.25_ (")
    press(page, "Enter")
    moved = np.zeros_like(before)
    moved[list(CHOSEN)] = [0, 0.25, 0]
    np.testing.assert_allclose(read_cage(page) - before, moved, atol=2e-6)
    press(page, "Control+z")
    np.testing.assert_allclose(read_cage(page), before, atol=2e-6)
    press(page, "g", "-", "1", "Backspace", "2", "Enter")
    moved[list(CHOSEN)] = [-2, 0, 0]
    np.testing.assert_allclose(read_cage(page) - before, moved, atol=2e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_numbers_rotate_around_an_axis(edit, axis):
    page = edit()
    before = read_cage(page)
    places = before[list(CHOSEN)]
    press(page, "r", "xyz"[axis], "3", "0", "Enter")
    wanted = rotate(places, places.mean(axis=0), axis, 30)
    np.testing.assert_allclose(read_cage(page)[list(CHOSEN)], wanted, atol=5e-6)
    assert set(moves_of(page)) == set(CHOSEN)


def test_numbers_scale_all_or_along_an_axis(edit):
    page = edit()
    before = read_cage(page)
    places = before[list(CHOSEN)]
    middle = places.mean(axis=0)
    press(page, "s", "2", "Enter")
    wanted = middle + 2 * (places - middle)
    np.testing.assert_allclose(read_cage(page)[list(CHOSEN)], wanted, atol=5e-6)
    press(page, "Control+z", "s", "z", "0", "Enter")
    wanted = np.where([False, False, True], middle, places)
    np.testing.assert_allclose(read_cage(page)[list(CHOSEN)], wanted, atol=5e-6)


def test_the_pointer_rotates_and_scales_without_a_button(edit):
    page = edit()
    before = read_cage(page)
    places = before[list(CHOSEN)]
    middle = places.mean(axis=0)
    x, y = middle_pixel(page)
    page.mouse.move(x + 100, y)
    press(page, "r")
    # A quarter, counterclockwise on the screen, in steps.
    for angle in np.radians(np.arange(5, 91, 5)):
        page.mouse.move(x + 100 * np.cos(angle), y - 100 * np.sin(angle))
    page.mouse.down()
    page.mouse.up()
    wanted = rotate(places, middle, 2, 90)
    np.testing.assert_allclose(read_cage(page)[list(CHOSEN)], wanted, atol=5e-3)
    press(page, "Control+z")
    page.mouse.move(x + 60, y)
    press(page, "s")
    page.mouse.move(x + 120, y)
    press(page, "Enter")
    wanted = middle + 2 * (places - middle)
    np.testing.assert_allclose(read_cage(page)[list(CHOSEN)], wanted, atol=5e-3)


def test_more_than_a_whole_turn_counts(edit):
    page = edit()
    x, y = middle_pixel(page)
    page.mouse.move(x + 80, y)
    press(page, "r")
    for angle in np.radians(np.arange(20, 451, 20)):
        page.mouse.move(x + 80 * np.cos(angle), y - 80 * np.sin(angle))
    page.wait_for_function(
        "() => document.querySelector('[data-under]').textContent.startsWith('Rotate: 440')"
    )
    text = page.text_content("[data-under]")
    assert float(text.split(": ")[1].split("°")[0]) == pytest.approx(440, abs=2)
    press(page, "Escape")


@pytest.mark.parametrize("way", ["Escape", "right click"])
def test_what_is_put_back_leaves_nothing(edit, way):
    page = edit()
    before = read_cage(page)
    x, y = middle_pixel(page)
    page.mouse.move(x, y)
    press(page, "g")
    page.mouse.move(x + 60, y - 40)
    settle(page)
    assert np.abs(read_cage(page) - before).max() > 0.05
    assert page.evaluate("Boolean(P.stage.modes.transform)")
    if way == "Escape":
        press(page, "Escape")
    else:
        page.mouse.click(x + 60, y - 40, button="right")
    np.testing.assert_array_equal(read_cage(page), before)
    assert page.evaluate("P.stage.editor.cageFile.edits") == []
    assert page.evaluate("P.stage.editor.past.length") == 0
    assert not page.evaluate("P.stage.modes.transform")
    # What was chosen stays so, and the next drag turns the view again.
    assert page.evaluate("P.stage.cages.selection.chosen.size") == len(CHOSEN)


def test_an_axis_is_chosen_in_the_middle_of_a_drag(edit):
    page = edit([47])
    x, y = pixel_of(page, "P.stage.cages.place(47)")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y - 40, steps=4)
    press(page, "x")
    page.mouse.move(x + 50, y - 60, steps=4)
    page.mouse.up()
    offset = moves_of(page)[47]
    np.testing.assert_allclose(offset[1:], 0, atol=1e-7)
    assert offset[0] > 0.05
    # Escape in the middle of a drag puts it back, and the rest of the drag does nothing.
    page.mouse.move(*pixel_of(page, "P.stage.cages.place(47)"))
    page.mouse.down()
    page.mouse.move(x, y - 90, steps=4)
    press(page, "Escape")
    page.mouse.move(x + 20, y, steps=4)
    page.mouse.up()
    np.testing.assert_allclose(moves_of(page)[47], offset, atol=1e-9)


def test_what_is_pressed_beside_the_picture_keeps_the_transform(edit):
    page = edit()
    press(page, "g", "x", "1")
    page.get_by_role("button", name="Look", exact=True).click()
    settle(page)
    assert not page.evaluate("P.stage.modes.transform")
    assert moves_of(page)[CHOSEN[0]] == [1, 0, 0]


def test_other_keys_do_nothing_during_a_transform(edit):
    page = edit()
    press(page, "g", "1", "c", " ", "End", "Control+z")
    assert page.evaluate("[P.stage.view.cage, P.stage.frame]") == [True, 0]
    assert not page.evaluate("P.stage.transport.isPlaying")
    assert page.evaluate("P.stage.modes.transform.typed") == "1"


def test_the_pivot_is_the_last_that_was_chosen_or_the_cursor(edit):
    page = edit()
    before = read_cage(page)
    places = before[list(CHOSEN)]
    page.locator("[data-cage-pivot]").select_option("last")
    press(page, "s", "0", "Enter")
    wanted = np.broadcast_to(places[-1], places.shape)
    np.testing.assert_allclose(read_cage(page)[list(CHOSEN)], wanted, atol=5e-6)
    press(page, "Control+z")
    page.get_by_role("button", name="Set cursor").click()
    assert page.locator("[data-cage-pivot]").input_value() == "cursor"
    page.locator("[data-cage-vertices]").fill("0, 1")
    page.keyboard.press("Enter")
    press(page, "s", "0", "Enter")
    np.testing.assert_allclose(
        read_cage(page)[:2], np.broadcast_to(places.mean(axis=0), (2, 3)), atol=5e-6
    )


def measure_over_edges(cage, faces, start):
    """The length of the shortest way over edges to each vertex, by relaxing all edges."""
    edges = np.unique(
        np.sort(np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])), axis=0
    )
    lengths = np.linalg.norm(cage[edges[:, 0]] - cage[edges[:, 1]], axis=1)
    away = np.full(len(cage), np.inf)
    away[start] = 0
    for _ in range(len(cage)):
        for a, b in (edges.T, edges[:, ::-1].T):
            np.minimum.at(away, b, away[a] + lengths)
    return away


@pytest.mark.parametrize("kind", ["edges", "space"])
def test_others_within_the_radius_move_along(edit, walk, kind):
    page = edit([47])
    before = read_cage(page)
    page.locator("[data-cage-falloff]").select_option(kind)
    page.locator("[data-cage-radius]").fill("0.4")
    page.keyboard.press("Enter")
    press(page, "g", "y", "1", "Enter")
    away = np.linalg.norm(before - before[47], axis=1)
    if kind == "edges":
        away = measure_over_edges(before, read_binding(walk[0]).cage.faces, 47)
    share = np.clip(1 - away / 0.4, 0, 1)
    wanted = np.zeros_like(before)
    wanted[:, 1] = share**2 * (3 - 2 * share)
    assert 2 < np.count_nonzero(share) < 40
    np.testing.assert_allclose(read_cage(page) - before, wanted, atol=1e-5)


def test_falloff_over_edges_does_not_jump_to_what_is_near_in_space(edit):
    page = edit([47])
    sizes = []
    for kind in ("edges", "space"):
        page.locator("[data-cage-falloff]").select_option(kind)
        page.locator("[data-cage-radius]").fill("0.9")
        page.keyboard.press("Enter")
        settle(page)
        sizes.append(page.evaluate("P.stage.cages.selection.shares.size"))
    assert sizes[0] < sizes[1]


def test_the_wheel_changes_the_radius_of_a_move(edit):
    page = edit([47])
    before = read_cage(page)
    x, y = middle_pixel(page)
    press(page, "o")
    assert page.locator("[data-cage-falloff]").input_value() == "edges"
    radius, distance = "P.stage.cages.selection.radius", "P.stage.camera.distance"
    first, far = page.evaluate(f"[{radius}, {distance}]")
    page.mouse.move(x, y)
    press(page, "g")
    page.mouse.move(x, y - 40)
    page.mouse.wheel(0, -300)
    page.wait_for_function(f"() => {radius} > {1.2 * first}")
    wide = np.count_nonzero(np.abs(read_cage(page) - before).max(axis=1) > 1e-7)
    press(page, *["PageDown"] * 20)
    narrow = np.count_nonzero(np.abs(read_cage(page) - before).max(axis=1) > 1e-7)
    assert page.evaluate(distance) == far
    assert narrow < wide
    press(page, "Enter", "o")
    assert page.locator("[data-cage-falloff]").input_value() == ""
    page.locator("[data-cage-falloff]").select_option("space")
    page.locator("[data-cage-radius]").fill("-1")
    page.keyboard.press("Enter")
    settle(page)
    assert "Radius: expected a number above 0" in page.text_content("[data-cage-said]")


def test_without_a_choice_nothing_begins(edit):
    page = edit()
    press(page, "Escape", "r")
    assert not page.evaluate("P.stage.modes.transform")
    assert page.text_content("[data-under]") == "choose cage vertices first"
    assert page.get_by_role("button", name="Rotate").is_disabled()


def test_rotated_vertices_are_where_the_command_puts_them(edit, walk, tmp_path):
    page = edit()
    press(page, "r", "y", "4", "0", "Enter")
    cage = read_cage(page)
    path, out = tmp_path / "cage_edits.json", tmp_path / "edited.h5"
    path.write_text(json.dumps(page.evaluate("P.stage.editor.actingCageFile")))
    run_cageik("pose", walk[0].path, "--cage-edits", path, "-o", out, "-q")
    import h5py

    with h5py.File(out) as file:
        np.testing.assert_allclose(cage, file["verts"][0], atol=2e-6)


def test_a_finger_rotates_after_a_tap_on_the_button(edit):
    page = edit(has_touch=True, viewport={"width": 390, "height": 844})
    before = read_cage(page)
    places = before[list(CHOSEN)]
    page.locator("[data-cage-rotate]").tap()
    settle(page)
    x, y = middle_pixel(page)
    session = page.context.new_cdp_session(page)
    angles = np.radians(np.arange(90, 181, 10))
    for kind, angle in [
        ("touchStart", np.pi / 2),
        *(("touchMove", one) for one in angles),
        ("touchEnd", None),
    ]:
        points = (
            [] if angle is None else [{"x": x + 70 * np.cos(angle), "y": y - 70 * np.sin(angle)}]
        )
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    wanted = rotate(places, places.mean(axis=0), 2, 90)
    np.testing.assert_allclose(read_cage(page)[list(CHOSEN)], wanted, atol=2e-2)


@pytest.fixture
def pose(play, view_page):
    page = play(view_page)
    page.get_by_role("button", name="Pose", exact=True).click()
    add(page, "pin", CHEST)
    add(page, "handle", HAND)
    press(page, "1")
    return page


def read_offset(page):
    return page.evaluate("P.stage.editor.file.handles[1].offset")


def test_a_handle_is_moved_by_keys_and_numbers(pose):
    press(pose, "g", "z", "0", ".", "1", "Enter")
    np.testing.assert_allclose(read_offset(pose), [0, 0, 0.1], atol=1e-7)
    x, y = vertex_pixel(pose, HAND)
    pose.mouse.move(x, y)
    press(pose, "g")
    pose.mouse.move(x + 30, y - 50)
    press(pose, "Escape")
    np.testing.assert_allclose(read_offset(pose), [0, 0, 0.1], atol=1e-7)
    press(pose, "g")
    pose.mouse.move(x, y - 120)
    pose.mouse.down()
    pose.mouse.up()
    settle(pose)
    assert read_offset(pose)[1] > 0.05


def test_an_axis_constrains_the_drag_of_a_handle(pose):
    x, y = vertex_pixel(pose, HAND)
    pose.mouse.move(x, y)
    pose.mouse.down()
    pose.mouse.move(x + 20, y - 20, steps=3)
    press(pose, "y")
    pose.mouse.move(x + 30, y - 50, steps=3)
    pose.mouse.up()
    offset = read_offset(pose)
    np.testing.assert_allclose([offset[0], offset[2]], 0, atol=1e-7)
    assert offset[1] > 0.05


def test_a_pin_does_not_move(pose):
    pose.locator("[data-handles] button").first.click()
    press(pose, "g", "1", "Enter")
    assert pose.evaluate("P.stage.editor.file.handles[0]") == {
        "name": "pin 1", "vertex": CHEST, "pin": True
    }  # fmt: skip
    before = pose.evaluate("P.stage.camera.turn")
    drag(pose, vertex_pixel(pose, CHEST), (600, 300))
    assert pose.evaluate("P.stage.camera.turn") != before
