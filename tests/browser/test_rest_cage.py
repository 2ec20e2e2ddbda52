"""`cageik view --edit-cage` in the browser: broken cages are mended, and edits are undone."""

import json
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cageik_cli import bind
from cageik_cli.cages.check.faults import find_cage_faults
from cageik_cli.cli import main
from cageik_cli.formats.obj.frames import encode_exact_obj
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.view.rest_cage import parse_cage
from tests.browser.players import WALKER, drag, settle
from tests.browser.test_accessibility import find_violations
from tests.shapes import QUADS, quad_box

pytestmark = pytest.mark.browser

BROKEN = WALKER.parent / "broken"


@pytest.fixture
def edit(serve):
    """Open a cage around a model, and wait until it is checked."""

    def start(cage, frame):
        opened = serve(frame, "--cage", cage, "--edit-cage", "-o", "new.obj", "--overwrite")
        assert opened.page.evaluate("window.cageikPlayer.then((p) => Boolean(window.P = p))")
        wait_for_check(opened.page)
        return opened

    return start


def wait_for_check(page):
    page.wait_for_function(
        "() => P.stage.cageService.verdict?.mesh === P.stage.cageEditor.mesh", timeout=30_000
    )
    settle(page)


def press(page, name):
    page.locator(f"[data-rest-{name}]").click()


def choose(page, kind, *numbers):
    page.evaluate("([kind, all]) => P.stage.cageEditor.choose(kind, all)", [kind, numbers])


def edge_of(page, a, b):
    return page.evaluate(
        "(ab) => P.stage.cageEditor.mesh.edges.findIndex((e) => ab.every((k) => e.includes(k)))",
        [a, b],
    )


def pixel_of(page, point):
    box = page.locator("#player canvas").bounding_box()
    x, y, _ = page.evaluate("(p) => P.stage.camera.project(P.stage.clip.fromFile(p))", point)
    return box["x"] + x, box["y"] + y


def drag_vertex(page, vertex, axis, to):
    """Drag with the mouse, along an axis, until a vertex is at a coordinate."""
    page.locator("[data-rest-axis]").select_option("xyz"[axis])
    # So far away that nothing is below the buttons over the picture.
    page.evaluate("P.stage.camera.distance = 8")
    place = page.evaluate("(k) => P.stage.cageEditor.mesh.vertices[k]", vertex)
    goal = [to if k == axis else x for k, x in enumerate(place)]
    drag(page, pixel_of(page, place), pixel_of(page, goal))
    settle(page)


def delete_face(page):
    choose(page, "faces", 12)
    press(page, "remove")


def delete_linked(page, face=12):
    choose(page, "faces", face)
    press(page, "link")
    press(page, "remove")


def face_outward(page):
    press(page, "orient")


def fill_holes(page):
    press(page, "fill")


def separate_and_delete(page):
    choose(page, "vertices", 7)
    press(page, "separate")
    delete_linked(page)


def pull_dent_out(page):
    drag_vertex(page, 16, 2, 2.0)
    # The corners have little influence on a model that is as far away.
    choose(page, "vertices", *range(8))
    for _ in range(3):
        press(page, "relax")


def enlarge(page):
    for axis, vertices in enumerate([(4, 5, 6, 7), (2, 3, 6, 7), (1, 3, 5, 7)]):
        choose(page, "vertices", *vertices)
        drag_vertex(page, 7, axis, 2.0)


def delete_loose_vertex(page):
    page.locator("[data-rest-list]").fill("8")
    page.locator("[data-rest-list]").press("Enter")
    press(page, "remove")


def turn_edge(page):
    choose(page, "edges", edge_of(page, 0, 1))
    press(page, "turn")


MENDED = {
    "degenerate_face": delete_face,
    "duplicate_faces": delete_face,
    "inside_out": face_outward,
    "mixed_orientation": face_outward,
    "non_manifold": delete_linked,
    "open": fill_holes,
    "pinched": separate_and_delete,
    "self_crossing": pull_dent_out,
    "too_small": enlarge,
    "two_components": delete_linked,
    "unreferenced_vertex": delete_loose_vertex,
    "zero_area": turn_edge,
}
"""How each broken cage is mended by hand."""


@pytest.mark.parametrize("name", MENDED)
def test_broken_cages_are_mended_by_hand(edit, name):
    folder = BROKEN / f"cage_{name}"
    frame = folder / "frames" / "frame_1.obj"
    opened = edit(folder / "cage.obj", frame)
    page = opened.page
    verdict = page.locator("[data-rest-verdict]")
    assert verdict.text_content() in ("unfit", "usable")
    assert page.locator("[data-rest-findings] button").count() >= 1
    MENDED[name](page)
    wait_for_check(page)
    assert verdict.text_content() == "fit", page.locator("[data-rest-findings]").text_content()
    assert page.locator("[data-rest-findings] button").count() == 0
    save(page)
    words = ["check", "--cage", "new.obj", "--rest", str(frame), "-q"]
    assert main.main(words, standalone_mode=False) in (None, 0)
    assert opened.errors == []


def save(page):
    page.locator("[data-rest-said]").evaluate("(one) => { one.textContent = ''; }")
    press(page, "apply")
    page.locator("[data-rest-said]", has_text="wrote new.obj").wait_for(timeout=30_000)


EDITS = """([seed, count]) => {
  const editor = P.stage.cageEditor, found = [], done = {}, first = writeCage(editor.mesh);
  let state = seed;
  const random = (n) => { state = (state * 48271) % 2147483647; return state % n; };
  const offset = () => (random(201) - 100) / 2000, refusal = /nothing was changed|can be turned/;
  const actions = {
    split: () => editor.split(), collapse: () => editor.collapse(), turn: () => editor.turn(),
    drag: () => editor.set(editor.mesh.move(editor.vertices, [0, 1, 2].map(offset))),
  };
  while (found.length < count) {
    const name = Object.keys(actions)[random(4)], mesh = editor.mesh;
    editor.choose("edges", [random(mesh.edges.length)]);
    try { actions[name](); done[name] = (done[name] ?? 0) + 1; found.push(writeCage(editor.mesh)); }
    catch (error) {
      if (editor.mesh !== mesh || !refusal.test(error.message)) throw error;
      done.refused = (done.refused ?? 0) + 1;
    }
  }
  while (editor.past.length) editor.undo();
  const isBack = writeCage(editor.mesh) === first;
  while (editor.future.length) editor.redo();
  const isAgain = writeCage(editor.mesh) === found.at(-1);
  while (editor.past.length) editor.undo();
  return { found, done, isBack, isAgain };
}"""


def is_manifold(polygons):
    """Whether every side has two faces that turn alike, and faces at a vertex hold together."""
    sides = Counter()
    for polygon in polygons:
        sides.update(pairwise([*polygon, polygon[0]]))
    if any(count > 1 or (b, a) not in sides for (a, b), count in sides.items()):
        return False
    for vertex in {corner for polygon in polygons for corner in polygon}:
        after = {}
        for polygon in polygons:
            if vertex in polygon:
                k = polygon.index(vertex)
                after[polygon[k - 1]] = polygon[(k + 1) % len(polygon)]
        at, count = after[next(iter(after))], 1
        while at != next(iter(after)):
            at, count = after[at], count + 1
        if count < len(after):
            return False
    return True


TOPOLOGY = {
    "repeated-vertex", "duplicate-face", "unreferenced-vertex", "non-manifold-edge", "open-edge",
    "orientation", "pinched-vertex", "components",
}  # fmt: skip


def test_random_edits_keep_a_cage_manifold_and_are_undone(edit):
    opened = edit(WALKER / "cage.obj", WALKER / "frames" / "walker_1.obj")
    page = opened.page
    save(page)
    first = Path("new.obj").read_bytes()
    assert load_mesh(Path("new.obj")).mesh.vertices.tobytes() == (
        load_mesh(WALKER / "cage.obj").mesh.vertices.tobytes()
    )
    for seed in (1, 2, 3, 4, 5):
        answer = page.evaluate(EDITS, [seed, 200])
        assert (answer["isBack"], answer["isAgain"]) == (True, True)
        assert min(answer["done"][name] for name in ("split", "collapse", "turn", "drag")) > 20
        for k, text in enumerate(answer["found"]):
            assert is_manifold(json.loads(text)["polygons"])
            if k % 40 == 39:
                cage = parse_cage(text.encode())
                assert not TOPOLOGY & {found.kind for found in find_cage_faults(cage)}
    save(page)
    assert Path("new.obj").read_bytes() == first
    assert opened.errors == []


@pytest.mark.parametrize("name", ["non_manifold", "pinched", "open"])
def test_random_edits_of_broken_cages_leave_a_finding(edit, name):
    folder = BROKEN / f"cage_{name}"
    page = edit(folder / "cage.obj", folder / "frames" / "frame_1.obj").page
    answer = page.evaluate(EDITS, [7, 60])
    assert answer["isBack"]
    for text in answer["found"]:
        cage = parse_cage(text.encode())
        kinds = {found.kind for found in find_cage_faults(cage)}
        assert is_manifold(json.loads(text)["polygons"]) or TOPOLOGY & kinds


def test_a_folded_bow_tie_is_not_manifold():
    """The test of the tests."""
    assert is_manifold([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert not is_manifold([[0, 2, 1], [0, 1, 3], [0, 3, 2]])
    two = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    touching = [[{0: 0}.get(k, k + 3) for k in polygon] for polygon in two]
    assert not is_manifold([*two, *touching])


def test_the_model_follows_a_cage_that_is_tried(edit):
    opened = edit(WALKER / "cage.obj", WALKER / "frames" / "walker_1.obj")
    page = opened.page
    before = np.array(page.evaluate("P.positions()"))
    press(page, "solve")
    page.wait_for_function("() => P.stage.cageService.solved", timeout=60_000)
    choose(page, "vertices", 3)
    page.evaluate("P.stage.request(true)")
    settle(page)
    page.locator("[data-rest-influence]", has_text="largest weight").wait_for()
    page.locator("[data-rest-try]").check()
    settle(page)
    assert page.evaluate("Boolean(P.stage.mold(new Float32Array(P.stage.positions.length)))")
    cage = load_mesh(WALKER / "cage.obj").mesh
    place = cage.vertices[3].tolist()
    page.locator("[data-rest-y]").fill(str(place[1] + 0.2))
    page.locator("[data-rest-y]").press("Enter")
    settle(page)
    moved = np.array(page.evaluate("P.positions()"))
    binding = bind(load_mesh(WALKER / "frames" / "walker_1.obj").mesh, cage)
    after = cage.vertices.copy()
    after[3, 1] = round(place[1] + 0.2, 12)
    expected = binding.weights @ after
    rms = np.sqrt(((moved - expected) ** 2).sum(axis=1).mean()) / binding.rest.diagonal
    assert rms < 1e-5
    assert np.abs(moved - before).max() > 0.01
    # The cage at rest stays, and cannot be edited meanwhile.
    assert page.evaluate("P.stage.cageEditor.mesh.vertices[3]") == place
    press(page, "subdivide")
    page.locator("[data-rest-said]", has_text="switch it off to edit").wait_for()
    page.locator("[data-rest-try]").uncheck()
    settle(page)
    np.testing.assert_allclose(page.evaluate("P.positions()"), before, atol=1e-5)
    assert opened.errors == []


def test_pointer_and_keys_choose_and_edit(edit):
    opened = edit(BROKEN / "cage_quads" / "cage.obj", BROKEN / "cage_quads/frames/frame_1.obj")
    page = opened.page
    page.evaluate("P.stage.camera.distance = 8")
    corner = page.evaluate("P.stage.cageEditor.mesh.vertices[7]")
    page.mouse.click(*pixel_of(page, corner))
    assert page.evaluate("[...P.stage.cageEditor.chosen]") == [7]
    other = page.evaluate("P.stage.cageEditor.mesh.vertices[5]")
    page.keyboard.down("Shift")
    page.mouse.click(*pixel_of(page, other))
    page.keyboard.up("Shift")
    assert page.evaluate("[...P.stage.cageEditor.chosen]") == [7, 5]
    page.locator("#player canvas").focus()
    page.keyboard.press("s")
    assert page.evaluate("P.stage.cageEditor.mesh.vertices.length") == 9
    page.keyboard.press("Control+z")
    assert page.evaluate("P.stage.cageEditor.mesh.vertices.length") == 8
    # An edge without a pointer: its ends by their numbers.
    page.locator("[data-rest-list]").fill("7, 5")
    page.locator("[data-rest-list]").press("Enter")
    page.locator("#player canvas").focus()
    page.keyboard.press("2")
    assert page.evaluate("P.stage.cageEditor.edges.map((edge) => edge.toSorted())") == [[5, 7]]
    page.keyboard.press("3")
    page.keyboard.press("a")
    page.keyboard.press("d")
    assert page.evaluate("P.stage.cageEditor.mesh.polygons.length") == 24
    wait_for_check(page)
    assert page.locator("[data-rest-verdict]").text_content() == "fit"
    page.keyboard.press("1")
    page.keyboard.press("Escape")
    box = page.locator("#player canvas").bounding_box()
    page.keyboard.down("Shift")
    start, stop = (
        (box["x"] + 20, box["y"] + 80),
        (box["x"] + box["width"] - 20, box["y"] + box["height"] - 20),
    )
    drag(page, start, stop)
    page.keyboard.up("Shift")
    assert page.evaluate("P.stage.cageEditor.chosen.size") == 26
    assert opened.errors == []


def test_other_pages_have_no_such_mode(serve):
    opened = serve(WALKER / "frames" / "walker_1.obj", "--cage", WALKER / "cage.obj")
    assert opened.page.locator('[data-panel="rest"]').count() == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_in_the_way_of_anybody(edit, browser, scheme):
    folder = BROKEN / "cage_open"
    address = edit(folder / "cage.obj", folder / "frames" / "frame_1.obj").page.url
    for width in (1440, 390):
        # axe-core is a script of its own
        options = {"viewport": {"width": width, "height": 1000}, "color_scheme": scheme}
        context = browser.new_context(**options, bypass_csp=True, has_touch=width < 500)
        page = context.new_page()
        page.goto(address)
        page.wait_for_selector("#player.ready")
        if page.locator("#player.folded").count():
            page.locator("[data-fold]").click()
        page.locator("[data-rest-findings] button").click()
        assert find_violations(page) == []
        context.close()


@pytest.fixture
def mirrored(edit, tmp_path):
    """The page of a box in which both sides are edited; of its vertices, k and k + 4 are pairs."""
    path = tmp_path / "box.obj"
    path.write_bytes(encode_exact_obj(quad_box(2.0).vertices, np.array(QUADS)))
    opened = edit(path, BROKEN / "cage_open" / "frames" / "frame_1.obj")
    opened.page.locator("[data-rest-mirror]").check()
    return opened


def find_vertices(page):
    return np.array(page.evaluate("P.stage.cageEditor.mesh.vertices"))


def is_symmetric(page):
    vertices = find_vertices(page)
    return Mirror([1.0, 0, 0], [0.0, 0, 0]).find_pairs(vertices, 1e-12) is not None


def test_both_sides_are_dragged(mirrored):
    page, before = mirrored.page, quad_box(2.0).vertices
    choose(page, "vertices", 7)
    drag_vertex(page, 7, 0, 2.5)
    moved = find_vertices(page) - before
    assert moved[7, 0] == pytest.approx(0.5, abs=0.05)
    assert moved[3, 0] == -moved[7, 0]
    assert np.count_nonzero(moved.any(axis=1)) == 2
    assert is_symmetric(page)
    assert mirrored.errors == []


def test_both_sides_are_split_and_placed(mirrored):
    page = mirrored.page
    choose(page, "edges", edge_of(page, 6, 7), edge_of(page, 3, 7))
    press(page, "split")
    vertices = find_vertices(page)
    assert len(vertices) == 11  # the edge between 3 and 7 is its own image
    assert is_symmetric(page)
    (middle,) = np.flatnonzero(vertices[:, 0] == 0)
    choose(page, "vertices", int(middle))
    page.locator("[data-rest-x]").fill("0.4")
    page.locator("[data-rest-x]").press("Enter")
    assert find_vertices(page)[middle, 0] == 0  # it stays on the plane
    choose(page, "vertices", 7)
    page.locator("[data-rest-y]").fill("2.25")
    page.locator("[data-rest-y]").press("Enter")
    assert find_vertices(page)[[3, 7], 1].tolist() == [2.25, 2.25]
    assert is_symmetric(page)
    assert mirrored.errors == []


def test_a_cage_that_lost_its_symmetry_is_not_mirrored(mirrored):
    page = mirrored.page
    page.locator("[data-rest-mirror]").uncheck()
    choose(page, "vertices", 7)
    drag_vertex(page, 7, 1, 2.5)
    page.locator("[data-rest-mirror]").check()
    choose(page, "edges", 0)
    press(page, "split")
    settle(page)
    assert len(find_vertices(page)) == 8
    assert "not its own mirror image" in page.locator("[data-rest-said]").text_content()
