"""Templates: the security policy, escaped values, and pictures."""

import base64
import hashlib

import pytest
from jinja2 import DictLoader, UndefinedError

from cageik_cli.report.html.templating import REPORT_TEMPLATES, make_data_url
from tests.report.markup import parse_page


@pytest.fixture
def template(monkeypatch):
    """A function that adds a template of this text."""

    def add(text):
        parts = {
            name: REPORT_TEMPLATES.read(name) for name in ("base.html.j2", "style.css", "script.js")
        }
        monkeypatch.setattr(
            REPORT_TEMPLATES._environment, "loader", DictLoader(parts | {"test.html.j2": text})
        )

    return add


TEXT = (
    '{% extends "base.html.j2" %}'
    '{% block body %}<p title="{{ value }}">{{ value }}</p>{% endblock %}'
)


def test_values_are_escaped(template):
    template(TEXT)
    value = "<b>\"'&</b>"
    page = REPORT_TEMPLATES.render_page("test.html.j2", value=value)
    (paragraph,) = parse_page(page).all("p")
    assert (paragraph.text, paragraph.attributes["title"]) == (value, value)


def test_a_value_that_is_missing_is_an_error(template):
    template(TEXT)
    with pytest.raises(UndefinedError, match="value"):
        REPORT_TEMPLATES.render_page("test.html.j2")


def test_the_policy_allows_only_our_script_and_no_fetches(template):
    template(TEXT)
    page = parse_page(REPORT_TEMPLATES.render_page("test.html.j2", value=""))
    (script,) = page.all("script")
    digest = base64.b64encode(hashlib.sha256(script.source.encode()).digest()).decode()
    assert dict(rule.split(" ", 1) for rule in page.policy.split("; ")) == {
        "default-src": "'none'",
        "img-src": "data:",
        "style-src": "'unsafe-inline'",
        "script-src": f"'sha256-{digest}'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }


def test_a_picture_becomes_a_data_url():
    kind, content = make_data_url(b"\x89PNG", "png").split(",")
    assert (kind, base64.b64decode(content)) == ("data:image/png;base64", b"\x89PNG")
