"""The tables of `report-json.md` are those of the schema; REWRITE_GOLDENS writes them."""

import json
import os
import re
from pathlib import Path

import pytest

from cageik_cli.report.views.schema import build_schema

PAGE = Path(__file__).parents[2] / "docs" / "report-json.md"
TABLE = re.compile(r"<!-- record: (\w+) -->\n(?:\n.+\n\n\| field (?:.+\n)+|$|(?=\n))")


def name_type(schema: dict) -> str:
    """Write a type as a reader would."""
    if "$ref" in schema:
        return f"[{schema['$ref'].split('/')[-1]}](#{schema['$ref'].split('/')[-1].lower()})"
    if "anyOf" in schema:
        return " or ".join(map(name_type, schema["anyOf"]))
    if "enum" in schema:
        return ", ".join(f"`{json.dumps(one)}`" for one in schema["enum"])
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "prefixItems" in schema:
        return f"list of {len(schema['prefixItems'])}"
    if "items" in schema:
        return f"list of {name_type(schema['items'])}"
    kind = schema["type"]
    if isinstance(schema.get("additionalProperties"), dict):
        return f"{name_type(schema['additionalProperties'])} by name"
    return kind if isinstance(kind, str) else " or ".join(kind)


def write_table(schema: dict) -> str:
    """Write what a record is, and its fields."""
    rows = ["| field | type | meaning |", "|---|---|---|"]
    for name, field in schema["properties"].items():
        meaning = field.get("description", "").replace("|", "\\|")
        kind = name_type({key: one for key, one in field.items() if key != "description"})
        rows.append(f"| `{name}` | {kind} | {meaning} |")
    return "\n".join([schema["description"].replace("\n", " "), "", *rows, ""])


def fill(page: str) -> str:
    """Return the page with a table behind each comment that names a record."""
    records = build_schema()["$defs"]
    return TABLE.sub(
        lambda found: f"<!-- record: {found[1]} -->\n\n{write_table(records[found[1]])}", page
    )


def test_the_tables_are_those_of_the_schema():
    page = PAGE.read_text(encoding="utf-8")
    if os.environ.get("REWRITE_GOLDENS"):
        PAGE.write_text(page := fill(page), encoding="utf-8")
    assert fill(page) == page
    assert page.count("\n| `rms_percent` | number | ") > 2


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("| `e_rms` |", "| `rms` |"),
        ("| `kg_error` | number or null |", "| `kg_error` | number |"),
        ("| Frames per second. |", "| Frames per minute. |"),
    ],
)
def test_a_changed_table_is_found(old, new):
    page = PAGE.read_text(encoding="utf-8")
    assert old in page
    assert fill(page.replace(old, new)) == page


def test_every_record_has_a_table():
    shown = re.findall(r"### (\w+)\n\n<!-- record: (\w+) -->", PAGE.read_text(encoding="utf-8"))
    assert all(title == name for title, name in shown)
    assert {name for _, name in shown} == build_schema()["$defs"].keys()
