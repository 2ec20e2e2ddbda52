"""The JSON Schema of reports, and of the attributes of results: made of the records themselves."""

import json
from collections.abc import Iterator
from dataclasses import MISSING, fields
from typing import Any, get_type_hints

from cageik_cli.report.figures import REPORT_SCHEMA
from cageik_cli.report.limits import Gap
from cageik_cli.report.overview import ClipEntry
from cageik_cli.report.record import Report
from cageik_cli.report.views.data import ENTRY_FIELDS, BatchRecord
from cageik_cli.report.vocabulary import RECORDED_SETTINGS, SETTING_MEANINGS
from cageik_cli.store.result import Edit, Result, StoredAnimation
from cageik_cli.store.result_fields import list_fields
from cageik_cli.util.json_schema import DIALECT, SchemaBuilder, allow_null, describe_object
from cageik_cli.util.messages import Note, Said
from cageik_cli.util.settings import Setting, list_settings

TEXT: dict[str, Any] = {"type": "string"}

PARTS: dict[str, Any] = {
    "description": "The parts of a text: words, or the name of a setting and the value to give it.",
    "type": "array",
    "items": {
        "anyOf": [
            TEXT,
            {"type": "array", "prefixItems": [TEXT, TEXT], "items": False, "minItems": 2},
        ]
    },
}

STORED_NOTE: dict[str, Any] = {
    "type": "object",
    "properties": {
        "kind": {"description": "What it is.", "enum": ["note", "warning"]},
        "place": {"description": "The file that it is about, or empty.", **TEXT},
        "text": PARTS,
    },
    "required": ["kind", "place", "text"],
    "additionalProperties": False,
}
"""A note as results hold it: reports have it as a sentence."""

SKIPPED_FRAMES: dict[str, Any] = {
    "type": "object",
    "patternProperties": {"^[0-9]+$": {"anyOf": [TEXT, PARTS]}},
    "additionalProperties": False,
}

OTHER_SETTINGS: dict[str, Any] = {
    "rest_frame": int | None,
    "vertex_weights": bool | str,
    "given_in": str,
}
"""The types of recorded settings that no record declares."""


def build_schema() -> dict[str, Any]:
    """Build the schema of all JSON of reports, with a definition for each record.

    The document itself is that of `report --json`, of one result or several, and of the
    `report.json` of a batch. The JSON attributes of a result and of an edit are the definitions
    `ResultAttributes` and `EditAttributes`, as objects of all attributes by name.
    """
    settings = {dict[str, Any]: {"$ref": "#/$defs/Settings"}}
    stored = SchemaBuilder(settings | {Note: STORED_NOTE, dict[int, Said]: SKIPPED_FRAMES})
    attributes = {
        f"{kind.__name__}Attributes": _describe_attributes(stored, kind) for kind in (Result, Edit)
    }
    clips = {"type": "array", "items": {"$ref": "#/$defs/ClipEntry"}}
    builder = SchemaBuilder(settings | {Note: TEXT, tuple[dict[str, Any], ...]: clips})
    report, batch = builder.add_record(Report), builder.add_record(BatchRecord)
    definitions = builder.definitions
    definitions["Report"]["properties"]["gaps"] = {
        "description": "Clips that the run or its baseline lacks; only if there are any.",
        **builder.describe(tuple[Gap, ...]),
    }
    for name in ("Report", "BatchRecord"):
        definitions[name]["properties"]["schema"] |= {"const": REPORT_SCHEMA}
    named = {
        "ClipEntry": describe_object(
            "A clip of a batch: parts of its report beside its files. A failed clip has a name and "
            "a fault; all else is null or empty.",
            dict(_describe_entry(builder)),
        ),
        "Settings": describe_object(
            "The settings on which the numbers depend; those of what was not done are missing.",
            dict(_describe_settings(builder)),
            SETTING_MEANINGS,
        ),
    }
    return {
        "$schema": DIALECT,
        "title": "Reports of cageik",
        "anyOf": [report, {"type": "array", "items": report, "minItems": 2}, batch],
        "$defs": dict(sorted((stored.definitions | definitions | named | attributes).items())),
    }


def format_schema() -> str:
    """Return the schema as text."""
    return json.dumps(build_schema(), indent=1, ensure_ascii=False) + "\n"


def _describe_entry(builder: SchemaBuilder) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what the record of a batch has of a clip."""
    for record, names in ENTRY_FIELDS:
        for name, schema in builder.describe_fields(record, names).items():
            has_none = record is ClipEntry or name in ("gates", "notes")  # which are then empty
            yield name, schema if has_none else allow_null(schema)


def _describe_settings(builder: SchemaBuilder) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the settings that a result records, by their names there."""
    for record in RECORDED_SETTINGS:
        kinds = get_type_hints(record)
        for one, setting in list_settings(record):
            if setting.name is not None:
                yield setting.name, _describe_setting(builder, kinds[one.name], setting)
    for name, kind in OTHER_SETTINGS.items():
        yield name, {"description": SETTING_MEANINGS[name], **builder.describe(kind)}


def _describe_setting(builder: SchemaBuilder, kind: Any, setting: Setting) -> dict[str, Any]:
    """Return the schema of a setting, with its choices or bounds, and the word for none of them."""
    bounds = {
        "minimum": setting.minimum,
        "maximum": setting.maximum,
        "exclusiveMinimum": setting.above,
    }
    schema = {"enum": list(setting.choices)} if setting.choices else builder.describe(kind)
    schema |= {name: bound for name, bound in bounds.items() if bound is not None}
    if setting.word is not None:
        schema = {"anyOf": [schema, {"const": setting.word}]}
    return {"description": setting.meaning, **schema}


def _describe_attributes(builder: SchemaBuilder, kind: type[StoredAnimation]) -> dict[str, Any]:
    """Return the schema of the JSON attributes of a result or an edit, by name."""
    declared = list_fields(kind)
    names = [name for name, stored in declared.items() if stored.is_json]
    defaults = {one.name: one.default for one in fields(kind)}
    optional = [name for name in names if defaults[name] is not MISSING]
    words = (
        f"The JSON attributes of a file `{kind.FORMAT}`; those that would be null or empty are "
        "missing."
    )
    return describe_object(words, builder.describe_fields(kind, names), optional)
