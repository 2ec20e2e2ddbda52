"""Measure the player of a page in Chromium: `python -m tests.benchmarks.player PAGE.html`.

It prints the milliseconds to the first picture, the frames per second while the clip plays, and the
script's own milliseconds per frame. Needs playwright and Chromium; see `make test-browser`.
"""

import os
import sys
from pathlib import Path

from tests.browser.conftest import ARGUMENTS

SECONDS = 5

MEASURE = """() => {
  const t = window.P.stage.timings, f = t.frames;
  const middle = (a) => [...a].sort((x, y) => x - y)[a.length >> 1];
  return {fps: 1000 * (f.length - 1) / (f[f.length - 1] - f[0]), solve: middle(t.solve),
          skinning: middle(t.skin), normals: middle(t.normals), drawing: middle(t.draw)};
}"""


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
        page.evaluate(
            "() => { for (const list of Object.values(P.stage.timings)) list.length = 0; }"
        )
        page.wait_for_timeout(1000 * SECONDS)
        measured: dict[str, float] = page.evaluate(MEASURE)
        browser.close()
    return {"first picture": first, **measured}


if __name__ == "__main__":
    for name, value in measure_player(Path(sys.argv[1])).items():
        print(f"{name:14} {value:8.1f}")
