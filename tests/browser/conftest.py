"""A browser, and pages that it opens from disk."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

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
        context.set_default_timeout(5000)
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
