"""Draw the pictures of the walkthrough in docs/viewing.md: `cageik view` in Chromium, by mouse.

python data_fixtures/make_view_pictures.py CHROMIUM

Needs playwright and Pillow. The pictures depend on the browser, so no test compares their bytes.
"""

import io
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

FIXTURES = Path(__file__).resolve().parent
PICTURES = FIXTURES / "pictures"
WALKER = FIXTURES / "walker"
HAND, BODY = 1040, (994, 1090, 889, 389)
FIRST, LAST, FADE, SHOWN = 20, 36, 6, 28
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
ARGUMENTS.append("--enable-unsafe-swiftshader")


def main(chromium: str) -> None:
    """Edit the walker by mouse, and draw the page before and after."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        os.chdir(folder)
        cage, result = WALKER / "cage.obj", "walker.h5"
        run("extract", WALKER / "frames", "--cage", cage, "-o", result, "-q")
        words = ("view", result, "-o", "waving.h5", "--handles-out", "wave.json", "--no-browser")
        command = [sys.executable, "-m", "cageik_cli", *words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
            page = browser.new_page(viewport={"width": 1100, "height": 780})
            page.goto(server.stdout.readline().strip())
            page.wait_for_selector("#player.ready", timeout=60_000)
            walk_through(page)
            browser.close()
            server.kill()


def run(*words: object) -> None:
    """Run cageik."""
    subprocess.run([sys.executable, "-m", "cageik_cli", *map(str, words)], check=True)


def walk_through(page: Page) -> None:
    """Follow the steps of the walkthrough."""
    page.evaluate("window.cageikPlayer.then((player) => Boolean(window.P = player))")
    go(page, SHOWN - 1)  # the first frame is number 1
    page.locator("#player canvas").press("0")
    shoot(page, "view_open.webp")
    page.get_by_role("button", name="Pose", exact=True).click()
    for vertex in BODY:
        add(page, vertex, "pin")
    add(page, HAND, "handle")
    panel = page.get_by_role("group", name="Pose", exact=True)
    for label, number in (("From", FIRST), ("To", LAST), ("Fade", FADE)):
        panel.get_by_label(label, exact=True).fill(str(number))
        page.keyboard.press("Tab")
    page.locator("#player canvas").scroll_into_view_if_needed()
    x, y = place_of(page, HAND)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 50, y - 150, steps=12)
    page.mouse.up()
    settle(page)
    shoot(page, "view_posed.webp")
    page.locator("[data-apply]").click()
    said = page.locator("[data-said]")
    page.wait_for_function(
        "(one) => /^wrote/.test(one.textContent)", arg=said.element_handle(), timeout=60_000
    )
    print(said.text_content())


def settle(page: Page) -> None:
    """Wait until what was asked for is drawn."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 300)))")


def go(page: Page, frame: int) -> None:
    """Show a frame."""
    page.evaluate(f"P.stage.transport.go({frame}); P.stage.request(true)")
    settle(page)


def add(page: Page, vertex: int, kind: str) -> None:
    """Add a handle or a pin by its vertex."""
    page.locator(f"[data-tool={kind}]").click()
    page.locator("[data-vertex]").fill(str(vertex))
    page.get_by_role("button", name="Add", exact=True).click()
    settle(page)


def place_of(page: Page, vertex: int) -> tuple[float, float]:
    """Return the pixel of a vertex in the window."""
    settle(page)
    box = page.locator("#player canvas").bounding_box()
    x, y, _ = page.evaluate(
        f"P.stage.camera.project([...P.stage.positions.subarray({3 * vertex}, {3 * vertex + 3})])"
    )
    return box["x"] + x, box["y"] + y


def shoot(page: Page, name: str) -> None:
    """Write a picture of the player."""
    page.evaluate("window.scrollTo(0, 0)")
    settle(page)
    picture = Image.open(io.BytesIO(page.locator("#player").screenshot()))
    picture.save(PICTURES / name, quality=80, method=6)


if __name__ == "__main__":
    main(sys.argv[1])
