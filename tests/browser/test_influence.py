"""What moves what: the weights of a cage vertex as colours, and the cage vertices of a point."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.store.result import read_binding
from cageik_cli.view.player.clip import load_player_clip
from cageik_cli.view.player.section import render_view_page
from tests.browser.players import settle

pytestmark = pytest.mark.browser


@pytest.fixture
def weights(walk):
    return read_binding(walk[0]).weights


@pytest.fixture
def page(play, walk):
    """The page of `cageik view`, in the mode."""
    found = play(render_view_page(load_player_clip(walk[0])))
    found.get_by_role("button", name="Influence", exact=True).click()
    return found


def type_number(page, name, number):
    page.get_by_label(name).fill(str(number))
    page.keyboard.press("Enter")
    settle(page)


def read_list(page):
    """The numbers and the weights of the list, in its order."""
    texts = page.locator("[data-weights] button").all_text_contents()
    rows = [text.removeprefix("cage vertex ").replace("\u2212", "-").split(": ") for text in texts]
    return [int(vertex) for vertex, _ in rows], [float(weight) for _, weight in rows]


def place_on_page(page, script):
    """Where a point of the picture is on the page; `script` gives it in the page's units."""
    box = page.locator("#player canvas").bounding_box()
    x, y, *_ = page.evaluate(f"P.stage.camera.project({script})")
    return box["x"] + x, box["y"] + y


def test_the_mesh_has_the_colours_of_the_weights(page, weights):
    for vertex in (0, 7):
        type_number(page, "Cage vertex", vertex)
        scale = page.evaluate("(({low, end, unit}) => ({low, end, unit}))(P.stage.scale)")
        found = np.array(page.evaluate("[...P.stage.colours.values]"))
        wanted = weights[:, vertex]
        read = scale["low"] + found * (scale["end"] - scale["low"])
        np.testing.assert_allclose(read, np.clip(wanted, scale["low"], None), atol=2e-4)
        assert scale["end"] == pytest.approx(np.abs(wanted).max(), abs=1e-4)
        assert scale["unit"] == f"weight of cage vertex {vertex}"
        assert page.locator("[data-scale] figcaption").text_content() == scale["unit"]
        assert f"Cage vertex {vertex}: weights " in page.locator("[data-told]").text_content()
    assert np.abs(found - weights[:, 0]).max() > 0.1


def test_negative_weights_have_colours_of_their_own(page):
    """One weight of the page is made negative: the scale is then symmetric."""
    page.evaluate("P.stage.skin.weights[5 * P.stage.skin.cageCount + 7] = -0.5")
    type_number(page, "Cage vertex", 7)
    scale = page.evaluate("P.stage.scale")
    assert scale["low"] == -scale["end"] < 0
    assert page.evaluate("P.stage.colours.values[5]") == pytest.approx(
        0.5 - 0.25 / scale["end"], abs=1e-6
    )
    ticks = page.locator("[data-scale] .ticks span").all_text_contents()
    assert ticks[0] == "\u2212" + ticks[-1]


def test_a_vertex_of_the_model_lists_what_moves_it(page, weights):
    for vertex in (400, 1040):
        type_number(page, "Vertex of the model", vertex)
        order = np.argsort(-np.abs(weights[vertex]), kind="stable")[:12]
        order = order[np.abs(weights[vertex][order]) >= 0.0101]
        numbers, found = read_list(page)
        np.testing.assert_allclose(found[: len(order)], weights[vertex][order], atol=1e-3)
        np.testing.assert_allclose(found, weights[vertex][numbers], atol=1e-3)
        told = page.locator("[data-told]").text_content()
        assert told.startswith(f"Vertex {vertex} is moved most by these")
        rest = float(told.split(" have ")[1].rstrip(".").replace("\u2212", "-"))
        assert rest == pytest.approx(1 - sum(found), abs=0.01)


def test_the_list_leads_to_a_cage_vertex_and_escape_to_nothing(page):
    type_number(page, "Vertex of the model", 1040)
    (first, *_), _ = read_list(page)
    page.locator("[data-weights] button").first.press("Enter")
    assert page.get_by_label("Cage vertex").input_value() == str(first)
    assert read_list(page) == ([], [])
    page.locator("#player canvas").focus()
    page.keyboard.press("]")
    assert page.get_by_label("Cage vertex").input_value() == str(first + 1)
    page.keyboard.press("[")
    page.keyboard.press("Escape")
    assert page.get_by_label("Cage vertex").input_value() == ""
    settle(page)
    assert page.evaluate("P.stage.scale.end === undefined")


def test_keys_go_around_the_cage(page, weights):
    page.locator("#player canvas").focus()
    for key, number in (("]", 0), ("[", weights.shape[1] - 1), ("]", 0)):
        page.keyboard.press(key)
        assert page.get_by_label("Cage vertex").input_value() == str(number)


def test_clicks_choose_cage_vertices_and_points_of_the_surface(page, weights):
    nearest = page.evaluate(
        "[...Array(P.stage.skin.cageCount).keys()].sort((a, b) => P.stage.camera.project("
        "pointOf(P.stage.cage, a))[2] - P.stage.camera.project(pointOf(P.stage.cage, b))[2])[0]"
    )
    page.mouse.click(*place_on_page(page, f"pointOf(P.stage.cage, {nearest})"))
    assert page.get_by_label("Cage vertex").input_value() == str(nearest)
    middle = page.evaluate("meanOf(P.stage.positions)")
    x, y = place_on_page(page, str(middle))
    page.evaluate("P.stage.cage = new Float64Array(P.stage.cage.length).fill(50)")  # out of the way
    page.mouse.click(x, y)
    numbers, found = read_list(page)
    assert len(numbers) > 2
    assert found == sorted(found, key=abs, reverse=True)
    vertex = int(page.get_by_label("Vertex of the model").input_value())
    assert np.abs(weights[vertex][numbers] - found).max() < 0.2


@pytest.mark.parametrize("typed", ["-1", "99999", "1.5"])
@pytest.mark.parametrize("name", ["Cage vertex", "Vertex of the model"])
def test_numbers_that_are_none_are_refused(page, name, typed):
    type_number(page, name, typed)
    thing = "cage vertex" if name == "Cage vertex" else "vertex"
    assert f"there is no {thing} {typed}; the " in page.locator("[data-under]").text_content()
    assert read_list(page) == ([], [])


def test_other_modes_have_their_own_colours(page):
    type_number(page, "Cage vertex", 3)
    assert page.evaluate("P.stage.scale.unit") == "weight of cage vertex 3"
    page.get_by_role("button", name="Look", exact=True).click()
    settle(page)
    assert page.evaluate("P.stage.scale.unit === undefined")
    page.get_by_role("button", name="Influence", exact=True).click()
    settle(page)
    assert page.evaluate("P.stage.scale.unit") == "weight of cage vertex 3"


def test_the_colours_of_the_file_are_drawn(play, walk):
    clip = load_player_clip(walk[0])
    rest = clip.binding.rest
    paints = np.tile([0.9, 0.1, 0.1], (len(rest.vertices), 1))
    attributes = replace(rest.polygons, colours=paints)
    binding = replace(clip.binding, rest=replace(rest, attributes=attributes))
    page = play(render_view_page(replace(clip, binding=binding)))
    page.get_by_role("checkbox", name="Cage").uncheck()

    def read_red():
        settle(page)
        script = """() => {
            const { gl } = P.stage.renderer;
            const size = [gl.drawingBufferWidth, gl.drawingBufferHeight];
            P.stage.draw();
            const bytes = new Uint8Array(4 * size[0] * size[1]);
            gl.readPixels(0, 0, ...size, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
            let count = 0;
            for (let k = 0; k < bytes.length; k += 4) {
              const [red, green] = bytes.subarray(k);
              if (red > 60 && red > 5 * green) count++;
            }
            return count;
        }"""
        return page.evaluate(script)

    assert read_red() == 0
    page.get_by_label("Colours").select_option("base")
    assert read_red() > 2000
    page.get_by_label("Colours").select_option("rms")
    assert read_red() == 0


def test_a_file_without_colours_offers_none(play):
    assert play().locator('#player [value="base"]').is_disabled()
