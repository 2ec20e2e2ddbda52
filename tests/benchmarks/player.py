"""Measure the player of a page in Chromium: `python -m tests.benchmarks.player PAGE.html`.

It prints the milliseconds to the first picture, the frames per second while the clip plays and
while a cage vertex is dragged, and the script's own milliseconds per frame while it plays. Needs
playwright and Chromium; see `make test-browser`.
"""

import math
import os
import sys
import time
from pathlib import Path
from typing import Any

from tests.browser.conftest import ARGUMENTS

SECONDS = 5

MEASURE = """() => {
  const t = window.P.stage.timings, f = t.frames;
  const middle = (a) => [...a].sort((x, y) => x - y)[a.length >> 1];
  return {fps: 1000 * (f.length - 1) / (f[f.length - 1] - f[0]), solve: middle(t.solve),
          skinning: middle(t.skin), normals: middle(t.normals), drawing: middle(t.draw)};
}"""


CLEAR = "() => { for (const list of Object.values(P.stage.timings)) list.length = 0; }"

HIGHEST = """() => {
  const { camera, cages: { places } } = P.stage, [, up] = camera.axes();
  const heights = places.map((place) => dot(place, up));
  return camera.project(places[heights.indexOf(Math.max(...heights))]);
}"""


def measure_drag(page: Any) -> float:
    """Drag the highest cage vertex in circles; return the frames per second."""
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Cage", exact=True).click()
    page.wait_for_timeout(1000)
    box, (x, y, _) = page.locator("#player canvas").bounding_box(), page.evaluate(HIGHEST)
    x, y = x + box["x"], y + box["y"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y)
    page.evaluate(CLEAR)
    end, steps = time.monotonic() + SECONDS, 0
    while time.monotonic() < end:
        steps += 1
        page.mouse.move(x + 40 * math.cos(steps / 9), y + 40 * math.sin(steps / 9))
    fps: float = page.evaluate(MEASURE)["fps"]
    page.mouse.up()
    return fps


def measure_player(path: Path) -> dict[str, float]:
    """Play the clip of a page for some seconds; return what was measured."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=os.environ.get("CHROMIUM", "/usr/bin/chromium"), args=ARGUMENTS
        )
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(path.resolve().as_uri())
        first = page.evaluate(
            "window.cageikPlayer.then((player) => { window.P = player; return performance.now(); })"
        )
        page.get_by_role("button", name="Play").click()
        page.wait_for_timeout(1000)
        page.evaluate(CLEAR)
        page.wait_for_timeout(1000 * SECONDS)
        measured: dict[str, float] = page.evaluate(MEASURE)
        dragged = measure_drag(page)
        browser.close()
    return {"first picture": first, **measured, "fps of a drag": dragged}


if __name__ == "__main__":
    for name, value in measure_player(Path(sys.argv[1])).items():
        print(f"{name:14} {value:8.1f}")
