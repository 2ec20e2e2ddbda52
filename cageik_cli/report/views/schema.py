"""The JSON schema of what programs read: reports, the record of a batch, attributes of results.

It is made of the declarations of the records, so that there is no second list of fields: names,
types, what may be null, and as descriptions the docstrings, which state units and meanings.
"""

import inspect
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from cageik_cli.report.limits import Gap
from cageik_cli.report.overview import ClipEntry
from cageik_cli.report.record import Report
from cageik_cli.report.views.data import CLIP_FIELDS, REPORT_FIELDS
from cageik_cli.store.result import Result
from cageik_cli.store.result_fields import list_json_fields
from cageik_cli.util.messages import Note, Text

DIALECT = "https://json-schema.org/draft/2020-12/schema"

_SCALARS: dict[Any, dict[str, Any]] = {
    Any: {},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
    str: {"type": "string"},
    NoneType: {"type": "null"},
}

_STORED_TEXT = {
    "description": "A sentence in pieces; a setting in it is its name and the value to give.",
    "type": "array",
    "items": {
        "anyOf": [
            {"type": "string"},
            {"type": "array", "prefixItems": [{"type": "string"}] * 2, "minItems": 2},
        ]
    },
}

_STORED_NOTE = {
    "type": "object",
    "properties": {
        "kind": {"enum": ["note", "warning"]},
        "place": {"type": "string"},
        "text": _STORED_TEXT,
    },
    "required": ["kind", "place", "text"],
    "additionalProperties": False,
}


def format_schema() -> str:
    """Format the schema: `$defs` are the records, and `result` the attributes of result files."""
    definitions = _Definitions()
    report, batch = definitions.refer(Report), definitions.describe_batch()
    report_definition = definitions.found["Report"]
    report_definition["properties"]["gaps"] = definitions.describe(tuple[Gap, ...])
    schema = {
        "$schema": DIALECT,
        "title": "Reports of cageik",
        "description": (
            "The JSON of `cageik report` is a report, or a list of several; a batch writes "
            "`report.json`. The JSON attributes of a result file are in `$defs/result`."
        ),
        "oneOf": [report, {"type": "array", "items": report}, {"$ref": "#/$defs/batch"}],
        "$defs": {
            "batch": batch,
            "result": definitions.describe_attributes(),
            **dict(sorted(definitions.found.items())),
        },
    }
    return json.dumps(schema, indent=1) + "\n"


class _Definitions:
    """The definitions of records, by the names of their classes."""

    def __init__(self) -> None:
        self.found: dict[str, dict[str, Any]] = {}

    def describe_batch(self) -> dict[str, Any]:
        """Describe the record of a batch."""
        clip, report = get_type_hints(ClipEntry), get_type_hints(Report)
        parts = {name: self.describe(clip[name]) for name in CLIP_FIELDS}
        for name in REPORT_FIELDS:
            part = self.describe(report[name])
            # What a failed clip has none of is null, and of lists an empty one.
            is_list = part.get("type") == "array"
            parts[name] = part if is_list else {"anyOf": [part, {"type": "null"}]}
        top = {
            "schema": self.describe(int),
            "tool": self.describe(report["tool"]),
            "notes": self.describe(tuple[str, ...]),
            "gaps": self.describe(tuple[Gap, ...]),
            "clips": {"type": "array", "items": _describe_object(parts)},
        }
        return _describe_object(top)

    def describe_attributes(self) -> dict[str, Any]:
        """Describe the attributes of a result file that hold JSON; each is left out if unknown."""
        hints = get_type_hints(Result)
        names = [name for name in list_json_fields(Result) if hints[name] not in _SCALARS]
        described = {name: self.describe(hints[name]) for name in names}
        described["notes"] = {"type": "array", "items": _STORED_NOTE}
        return {"type": "object", "properties": described, "additionalProperties": False}

    def refer(self, record: type) -> dict[str, Any]:
        """Describe a record by a reference to its definition."""
        name = record.__name__
        if name not in self.found:
            self.found[name] = {}  # it may refer to itself
            hints = get_type_hints(record)
            parts = {one.name: self.describe(hints[one.name]) for one in fields(record)}
            text = inspect.cleandoc(record.__doc__ or "")
            self.found[name] = {"description": text, **_describe_object(parts)}
        return {"$ref": f"#/$defs/{name}"}

    def describe(self, kind: Any) -> dict[str, Any]:
        """Describe values of a type that records have.

        Raises
        ------
        TypeError
            When there is no rule for the type.
        """
        origin, kinds = get_origin(kind), get_args(kind)
        if kind in _SCALARS:
            return dict(_SCALARS[kind])
        if kind is Note:
            return {"type": "string"}
        if kind is Text:
            return _STORED_TEXT
        if origin is Literal:
            return {"enum": list(kinds)}
        if origin is UnionType:
            return {"anyOf": [self.describe(one) for one in kinds]}
        if origin is tuple and kinds[-1] is Ellipsis:
            return {"type": "array", "items": self.describe(kinds[0])}
        if origin is tuple:
            items = [self.describe(one) for one in kinds]
            return {"type": "array", "prefixItems": items, "minItems": len(items), "items": False}
        if origin in (dict, Mapping):
            return {"type": "object", "additionalProperties": self.describe(kinds[1])}
        if is_dataclass(kind):
            assert isinstance(kind, type)
            return self.refer(kind)
        if isinstance(kind, type) and issubclass(kind, StrEnum):
            return {"enum": [str(one) for one in kind]}
        raise TypeError(f"no JSON schema for {kind}")


def _describe_object(parts: dict[str, Any]) -> dict[str, Any]:
    """Describe an object that has exactly these parts."""
    return {
        "type": "object",
        "properties": parts,
        "required": list(parts),
        "additionalProperties": False,
    }
