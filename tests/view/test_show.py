"""Pages in notebooks: what the frame holds, and what it may do."""

from html.parser import HTMLParser
from pathlib import Path

import pytest

import cageik_cli
from cageik_cli.util.errors import SettingError


@pytest.fixture
def result(extracted):
    return cageik_cli.read_result("cages.h5")


def read_frame(page):
    """The attributes of the one element that the notebook gets."""
    found = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag, attributes):
            found.append((tag, dict(attributes)))

    Reader().feed(page._repr_html_())
    ((tag, attributes),) = found
    assert tag == "iframe"
    return attributes


def test_the_frame_holds_the_page(result):
    page = cageik_cli.show(result, height=500)
    attributes = read_frame(page)
    assert attributes["srcdoc"] == page.html
    assert attributes["sandbox"] == "allow-scripts allow-downloads"
    assert "height: 500px" in attributes["style"]
    assert repr(page) == "ShownPage(height=500)"


def test_the_page_needs_no_network(result):
    html = cageik_cli.show(result).html
    assert "default-src 'none'" in html
    assert "connect-src" not in html


def test_a_binding_is_shown_as_a_model(animation, coarse_panels):
    binding = cageik_cli.bind(animation.rest, animation.cage)
    assert 'data-mode="pose"' in cageik_cli.show(binding).html


def test_the_same_result_gives_the_same_page(result):
    assert cageik_cli.show(result) == cageik_cli.show(cageik_cli.read_result("cages.h5"))


def test_names_are_escaped(result):
    Path("cages.h5").rename('"><script>.h5')
    page = cageik_cli.show(cageik_cli.read_result('"><script>.h5'))
    assert "<script>.h5" not in page.html
    assert read_frame(page)["srcdoc"] == page.html


def test_a_result_without_weights_is_refused(folder, run):
    words = ("extract", "frames", "--cage", "cage.obj", "-o", "bare.h5", "--no-weights", "-q")
    assert run(*words).code == 0
    with pytest.raises(SettingError, match=r"^bare\.h5: has no weights"):
        cageik_cli.show(cageik_cli.read_result("bare.h5"))
