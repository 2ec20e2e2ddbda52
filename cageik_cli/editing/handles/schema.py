"""The JSON of a file of handles or cage edits: schemas, and messages for violations, with places.

The schema's titles are the words for what is expected.
"""

import json
import re
from collections.abc import Iterator
from difflib import get_close_matches
from importlib.resources import files
from itertools import islice
from typing import TYPE_CHECKING, Any

from cageik_cli.util.errors import HandlesError
from cageik_cli.util.json_files import (
    MAX_VALUE_LENGTH,
    JsonFormat,
    Steps,
    format_step,
    format_value,
)

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError

MAX_HANDLES_BYTES = 2_000_000
"""Largest file that is read: many thousands of handles."""


def describe_location(document: Any, steps: Steps) -> str:
    """Return the place of a value in words: its set, its handle by name, the field within it.

    In a file of cage edits: its edit by name, its move, the field within it.
    """
    words: list[str] = []
    field, value = "", document
    before: str | int = ""
    for step in steps:
        value = value[step]
        if before in ("sets", "handles", "edits", "moves") and isinstance(step, int):
            name = _describe_named(str(before), value)
            words.append(name or f"{field}[{step}]")
            field = ""
        else:
            field = (field + format_step(step)).removeprefix(".")
        before = step
    return ": ".join([*words, field] if field else words)


def _describe_named(field: str, value: Any) -> str:
    """Return what messages call a handle or an edit; nothing if it has no name."""
    kind = {"handles": "handle", "edits": "edit"}.get(field)
    name = value.get("name") if isinstance(value, dict) and kind else None
    return f"{kind} {name[:MAX_VALUE_LENGTH]!r}" if isinstance(name, str) and name else ""


HANDLES_FORMAT = JsonFormat("a handles file", MAX_HANDLES_BYTES, describe_location)
"""What the JSON of a handles file should be."""


def read_schema(name: str = "handles") -> str:
    """Return the JSON schema, draft 2020-12, of "handles" or "cage_edits" as text.

    That of cage edits refers to definitions of that of handles, and is returned with them.
    """
    folder = files("cageik_cli.editing.handles")
    text = folder.joinpath("schema.json").read_text(encoding="utf-8")
    if name == "handles":
        return text
    schema = json.loads(folder.joinpath(f"{name}.json").read_text(encoding="utf-8"))
    shared, waiting = json.loads(text)["$defs"], [schema]
    while waiting:
        for named in re.findall(r'"#/\$defs/(\w+)"', json.dumps(waiting.pop())):
            if named not in schema["$defs"]:
                schema["$defs"][named] = shared[named]
                waiting.append(shared[named])
    return json.dumps(schema, indent=2) + "\n"


def check_schema(document: Any, name: str = "handles") -> None:
    """Check a document against the schema of "handles" or "cage_edits".

    Raises
    ------
    HandlesError
        For the first fault in the file, among the first 1000 found: handle, field, what was found
        and what is expected.
    """
    from jsonschema import Draft202012Validator

    validator = Draft202012Validator(json.loads(read_schema(name)))
    faults = islice(validator.iter_errors(document), 1000)
    first = min(faults, key=lambda fault: _file_order(document, fault), default=None)
    if first is not None:
        place = describe_location(document, list(first.absolute_path))
        fault = f"is {format_value(first.instance)}, expected {first.schema['title']}"
        if first.validator in _OBJECT_FAULTS:
            fault = _OBJECT_FAULTS[first.validator](first)
        raise HandlesError(f"{place}: {fault}" if place else fault)


def _file_order(document: Any, fault: "ValidationError") -> tuple[int, ...]:
    """Return a key that sorts faults by place in the file; missing fields are at the end."""
    numbers, value = [], document
    for step in fault.absolute_path:
        numbers.append(step if isinstance(step, int) else list(value).index(step))
        value = value[step]
    if fault.validator == "additionalProperties":
        numbers.append(list(value).index(next(_unknown_fields(fault))))
    elif fault.validator in _OBJECT_FAULTS:
        numbers.append(len(value) if isinstance(value, dict) else 0)
    return tuple(numbers)


def _describe_unknown_field(fault: "ValidationError") -> str:
    known, unknown = list(fault.schema["properties"]), next(_unknown_fields(fault))
    near = get_close_matches(unknown, known, n=1, cutoff=0.7)  # `name` and `frames` have 0.6
    near = near or [name for name in known if unknown and name.startswith(unknown)]
    hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(known)}"
    return f"{format_value(unknown)} is not a field of {fault.schema['title']}; {hint}"


def _describe_missing_field(fault: "ValidationError") -> str:
    missing = next(name for name in fault.validator_value if name not in fault.instance)
    return f"has no {missing}, which {fault.schema['title']} needs; add it"


def _describe_lone_field(fault: "ValidationError") -> str:
    """Describe a field that needs another one."""
    alone, missing = next(
        (name, other)
        for name, others in fault.validator_value.items()
        for other in others
        if name in fault.instance and other not in fault.instance
    )
    return f"has {alone} without {missing}; add it, or remove {alone}"


def _describe_choice(fault: "ValidationError") -> str:
    """Describe an object that should have exactly one of several fields."""
    title, names = fault.schema["title"], [one["required"][0] for one in fault.validator_value]
    found = [name for name in names if name in fault.instance]
    if not found:
        return f"has no {title}; expected exactly one of {', '.join(names)}"
    return f"has {len(found)} {title}s, {' and '.join(found)}; keep one of them"


def _unknown_fields(fault: "ValidationError") -> Iterator[str]:
    return (name for name in fault.instance if name not in fault.schema["properties"])


_OBJECT_FAULTS = {
    "additionalProperties": _describe_unknown_field,
    "required": _describe_missing_field,
    "dependentRequired": _describe_lone_field,
    "oneOf": _describe_choice,
}
"""Messages on the fields of objects, by the keyword of the schema."""
