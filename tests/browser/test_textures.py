"""Vertex animation textures in three.js: its vertex shader moves vertices as the frames do."""

import json
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.write import Output, write_animation
from cageik_cli.util.progress import ProgressListener
from tests.character import make_character
from tests.formats.vat.truth import SCENES, angle_between, list_triangles, shade

pytestmark = pytest.mark.browser

MODULES = Path(__file__).parents[2] / "build" / "browser" / "node_modules"
PAGE = Path(__file__).parent / "textures.html"
KINDS = {".js": "text/javascript", ".html": "text/html"}


@pytest.fixture
def textures(browser, tmp_path):
    """A page with three.js that reads the files of `tmp_path` below `/out`."""
    if not (MODULES / "three").is_dir():
        pytest.skip("three.js is not installed: make test-browser")
    context = browser.new_context(viewport={"width": 1200, "height": 500})
    page, errors = context.new_page(), []

    def serve(route):
        path = route.request.url.partition("//files.test/")[2]
        if path == "":
            place = PAGE
        elif path.startswith("out/"):
            place = tmp_path / "a.vat" / path[4:]
        else:
            place = MODULES / (path if Path(path).suffix else f"{path}.js")
        route.fulfill(
            body=place.read_bytes(),
            content_type=KINDS.get(place.suffix, "application/octet-stream"),
        )

    context.route("**/*", serve)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.goto("http://files.test/")
    page.wait_for_function("() => window.isReady")
    yield page
    assert errors == []
    context.close()


@pytest.mark.parametrize("kind", ["png", "exr"])
@pytest.mark.parametrize("name", SCENES)
def test_three_moves_vertices_and_normals(textures, tmp_path, name, kind):
    (model, frames), (scene, change) = make_character(), SCENES[name]
    animation = Animation(model, len(frames), scene, "a", texture=kind)
    folder = Output(tmp_path / "a.vat")
    write_animation(folder, animation, iter([frames]), ProgressListener())
    remap = json.loads((folder.path / "a-remap_info.json").read_text())["os-remap"]
    steps = (np.array(remap["Max"]) - remap["Min"])[[0, 2, 1]] / 65535
    drawn = textures.evaluate("kind => load('a', kind)", kind)
    order, size = list_triangles(model), model.diagonal * scene.metres_per_unit
    turn = change / scene.metres_per_unit
    # 16 bits are right within half a step; single precision adds a little to that.
    allowed = (steps / 2 if kind == "png" else 0) + 1e-6 * size
    for frame, positions in enumerate(frames):
        places, normals = (
            np.concatenate(
                [
                    np.reshape(
                        textures.evaluate("words => readBack(...words)", [k, frame, what]), (-1, 4)
                    )[mesh["faces"], :3]
                    for k, mesh in enumerate(drawn)
                ]
            ).reshape(-1, 3, 3)
            for what in ("place", "turned")
        )
        assert (np.abs(places - (positions @ change)[model.faces[order]]) <= allowed).all()
        assert angle_between(normals, shade(model, positions)[order] @ turn) < 0.1
    middle = (model.vertices @ change).mean(axis=0).tolist()
    textures.evaluate("words => show(...words)", [[0, 2, len(frames) - 1], middle, size])
    picture = textures.screenshot()
    assert len(picture) > 10_000  # a white page has 3 kB
