"""The README is short, every page is in the site, and the site builds and needs no network."""

import os
import re
import subprocess
import sys
import tomllib

import pytest
import yaml

import cageik_cli
from cageik_cli.cli import main
from tests.docs.pages import ROOT

LONGEST_README = 150


class _Loader(yaml.SafeLoader):
    """YAML of MkDocs, which may name Python objects."""


_Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda *_: None)


def list_nav(entries):
    """Return the pages that a nav names, at any depth."""
    found = []
    for entry in entries:
        target = next(iter(entry.values())) if isinstance(entry, dict) else entry
        found += list_nav(target) if isinstance(target, list) else [target]
    return found


def list_unnamed(page):
    """Return the public names that have no entry on the page of the reference."""
    entries = re.findall(r"^::: cageik_cli\.[\w.]*?(\w+)$", page, flags=re.M)
    return sorted(set(cageik_cli.__all__) - set(entries))


def list_rows(page):
    """Return the names in the tables of the API, and the entries of the reference they link to."""
    return re.findall(r"^\| \[`(\w+)`\]\(reference\.md#([\w.]+)\) \| \S", page, flags=re.M)


def find_broken_links(path):
    """Return the relative links of a page that lead to no file."""
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    links = [link.split("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text)]
    return [
        link for link in links if link and "://" not in link and not (path.parent / link).exists()
    ]


def read_config():
    return yaml.load((ROOT / "mkdocs.yml").read_text(), _Loader)


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= LONGEST_README


def test_every_page_is_in_the_nav_once():
    pages = sorted(str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md"))
    assert sorted(list_nav(read_config()["nav"])) == pages


def test_the_nav_is_read_at_any_depth():
    assert list_nav(["a.md", {"B": "b.md"}, {"C": [{"D": "d.md"}]}]) == ["a.md", "b.md", "d.md"]


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_at_the_top_lead_to_files(name):
    assert find_broken_links(ROOT / name) == []


def test_a_broken_link_is_found(write_page):
    page = write_page("[a](page.md) [b](gone.md#x) [c](https://example.org) [d](#here)\n")
    assert find_broken_links(page) == ["gone.md"]


def test_the_readme_links_every_page_but_the_generated():
    text = (ROOT / "README.md").read_text()
    built = {"index.md", "api.md", "commands.md", "reference.md"}
    pages = set(list_nav(read_config()["nav"])) - built
    assert sorted(page for page in pages if f"(docs/{page})" not in text) == []


def test_the_readme_names_every_command():
    text = (ROOT / "README.md").read_text()
    assert sorted(name for name in main.commands if f"`cageik {name} " not in text) == []


def test_the_makefile_names_tests_that_exist():
    named = set(re.findall(r"tests/[\w/]+(?:\.py)?", (ROOT / "Makefile").read_text()))
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_the_citation_is_complete():
    content = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(content)
    (paper,) = content["references"]
    assert paper["title"].startswith("CageIK")


def test_one_version_is_stated_everywhere():
    """The package states it; the citation and the newest release of the changelog follow."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "version" not in project["project"]
    assert "version" in project["project"]["dynamic"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == cageik_cli.__version__
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert headings[:2] == ["Unreleased", cageik_cli.__version__]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs_click", reason="the extra `docs` is not installed")
    pytest.importorskip("mkdocstrings", reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(
        words, capture_output=True, text=True, cwd=ROOT, timeout=120, check=False,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow
class TestTheSite:
    def test_it_loads_nothing_from_a_network(self, site):
        loads = re.compile(
            r"<(?:script|link|img|iframe|source)[^>]+(?:src|href)=[\"']?(?:https?:)?//"
        )
        pages = sorted(site.rglob("*.html"))
        assert len(pages) > 15
        assert [str(page) for page in pages if loads.search(page.read_text())] == []
        styles = [path.read_text() for path in site.rglob("*.css")]
        assert not any(re.search(r"url\([\"']?(?:https?:)?//|@import", style) for style in styles)

    def test_it_holds_the_pictures(self, site):
        for page in site.glob("*.html"):
            for source in re.findall(r"<img[^>]+src=\"([^\"]+)\"", page.read_text()):
                assert (page.parent / source).is_file(), f"{page.name}: {source}"
        assert (site / "data_fixtures/walker/handles.json").is_file()

    def test_it_holds_every_command(self, site):
        text = (site / "commands.html").read_text()
        for name in ("extract", "batch", "pose", "report"):
            assert f"cageik {name}" in text
        assert "Sentinel" not in text


def test_every_public_name_is_in_the_reference():
    page = (ROOT / "docs/reference.md").read_text(encoding="utf-8")
    assert list_unnamed(page) == []
    assert list_unnamed(page.replace(".PointCloud", ".Cloud")) == ["PointCloud"]


def test_every_public_name_has_a_row_that_links_its_entry():
    page = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    entries = re.findall(r"^::: ([\w.]+)$", (ROOT / "docs/reference.md").read_text(), flags=re.M)
    rows = list_rows(page)
    assert sorted(name for name, _ in rows) == sorted(cageik_cli.__all__)
    assert [(name, link) for name, link in rows if link not in entries or name not in link] == []
    assert ":::" not in page
    assert len(list_rows(page.replace("| [`Camera`]", "| [`Camra`]"))) == len(rows)
    assert list_rows("| `Camera` | no link |") == []
