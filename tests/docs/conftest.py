"""What the tests of the documents share."""

import pytest


@pytest.fixture(scope="session")
def docs_cache(tmp_path_factory):
    """The cache of weights that all pages share, so that a cage is bound once."""
    return tmp_path_factory.mktemp("docs-cache")


@pytest.fixture
def page_folder(tmp_path, monkeypatch):
    """The current folder, in which the blocks of a page run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def write_page(tmp_path_factory):
    """Write a page for a test, outside the folder in which it runs."""

    def write(text):
        path = tmp_path_factory.mktemp("page") / "page.md"
        path.write_text(text, encoding="utf-8")
        return path

    return write
