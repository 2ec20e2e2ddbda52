"""A browser, and pages that it opens from disk."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cageik_cli.report.html.page import render_result_page
from cageik_cli.report.record import build_report
from cageik_cli.store.result import read_result
from cageik_cli.view.player.section import load_player
from tests.browser.players import WALKER, run_cageik

ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",  # WebGL2 without a graphics card
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@dataclass
class Opened:
    """A page in the browser, its errors, and its requests."""

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=os.environ.get("CHROMIUM", "/usr/bin/chromium"), args=ARGUMENTS
        )
        yield found
        found.close()


@pytest.fixture
def opened(browser, tmp_path) -> Iterator[Callable[..., Opened]]:
    """A function that opens a page; the test fails if the page has an error or fetches."""
    contexts, pages = [], []

    def start(html: str, **options: Any) -> Opened:
        path: Path = tmp_path / "page.html"
        path.write_text(html)
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        context.set_default_timeout(30_000)  # for what hangs, not for what is slow
        contexts.append(context)
        page = Opened(context.new_page())
        pages.append(page)
        page.page.on("console", lambda message: page.errors.append(message.text))
        page.page.on("pageerror", lambda error: page.errors.append(str(error)))
        page.page.on("request", lambda request: page.requests.append(request.url))
        page.page.goto(path.as_uri())
        return page

    yield start
    for page in pages:
        own = page.page.url.split("#")[0]
        assert page.errors == []
        assert [url for url in page.requests if url != own and not url.startswith("data:")] == []
    for context in contexts:
        context.close()


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """The result of twelve frames of the walker, and the frames that `cageik deform` writes."""
    folder = tmp_path_factory.mktemp("walk")
    frames = [WALKER / "frames" / f"walker_{k}.obj" for k in range(1, 13)]
    run_cageik("extract", *frames, "--cage", WALKER / "cage.obj", "-o", folder / "walk.h5", "-q")
    run_cageik("deform", folder / "walk.h5", "-o", folder / "walk.npz", "-q")
    result = read_result(folder / "walk.h5")
    with np.load(folder / "walk.npz") as file:
        return result, file["vertices"]


@pytest.fixture(scope="session")
def walk_page(walk):
    return render_result_page(walk[0], build_report(walk[0]), load_player(walk[0]))


@pytest.fixture
def play(opened, walk_page):
    """A function that opens the page, and waits until its model is drawn."""

    def start(text=walk_page, **options):
        page = opened(text, **options).page
        assert page.evaluate("window.cageikPlayer.then((player) => Boolean(window.P = player))")
        page.locator("#player canvas").scroll_into_view_if_needed()
        return page

    return start


@pytest.fixture
def serve(tmp_path, monkeypatch, browser):
    """Start `cageik view` with some words, and open its page."""
    monkeypatch.chdir(tmp_path)
    processes, contexts = [], []

    def start(*words, **options) -> Opened:
        command = [sys.executable, "-m", "cageik_cli", "view", *map(str, words), "--no-browser"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        processes.append(process)
        context = browser.new_context(**options)
        contexts.append(context)
        page = context.new_page()
        opened = Opened(page)
        page.on(
            "console", lambda told: opened.errors.append(told.text) if told.type == "error" else 0
        )
        page.on("pageerror", lambda error: opened.errors.append(str(error)))
        page.goto(process.stdout.readline().strip())
        page.wait_for_selector("#player.ready", timeout=60_000)
        return opened

    yield start
    for context in contexts:
        context.close()
    for process in processes:
        process.kill()
        process.communicate()
