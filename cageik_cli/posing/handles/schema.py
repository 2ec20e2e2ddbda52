"""The JSON schema of the handles file, and its faults in our own words.

The schema's titles are the words for what is expected.
"""

import json
from collections.abc import Iterator
from difflib import get_close_matches
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from cageik_cli.posing.handles.json_document import place_of, value_text
from cageik_cli.util.errors import InputError

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError


ALIKE = 0.7
"""How alike a field is, of 1, to be what was meant; `name` and `frames` are 0.6."""


def schema_text() -> str:
    """The schema, draft 2020-12, as JSON."""
    return files("cageik_cli.posing.handles").joinpath("schema.json").read_text(encoding="utf-8")


def refuse_faults(document: Any) -> None:
    """Refuse what is not as the schema says.

    Raises
    ------
    InputError
        Naming the first fault in the file's order: handle, field, what is found and expected.
    """
    from jsonschema import Draft202012Validator

    validator = Draft202012Validator(json.loads(schema_text()))
    faults = validator.iter_errors(document)
    first = min(faults, key=lambda fault: _order(document, fault), default=None)
    if first is not None:
        place = place_of(document, list(first.absolute_path))
        raise InputError(": ".join([*place, _sentence(first)]))


def _order(document: Any, fault: "ValidationError") -> tuple[int, ...]:
    """Sorts faults by where in the file they are; what is missing, by its object's end."""
    numbers, value = [], document
    for step in fault.absolute_path:
        numbers.append(step if isinstance(step, int) else list(value).index(step))
        value = value[step]
    if fault.validator == "additionalProperties":
        numbers.append(list(value).index(next(_unknown(fault))))
    elif fault.validator in _OF_OBJECTS:
        numbers.append(len(value) if isinstance(value, dict) else 0)
    return tuple(numbers)


def _sentence(fault: "ValidationError") -> str:
    if fault.validator in _OF_OBJECTS:
        return _OF_OBJECTS[fault.validator](fault)
    return f"is {value_text(fault.instance)}, expected {fault.schema['title']}"


def _of_unknown(fault: "ValidationError") -> str:
    known, unknown = list(fault.schema["properties"]), next(_unknown(fault))
    near = get_close_matches(unknown, known, n=1, cutoff=ALIKE)
    near = near or [name for name in known if unknown and name.startswith(unknown)]
    hint = f"did you mean {near[0]}?" if near else f"expected some of {', '.join(known)}"
    return f"{value_text(unknown)} is not a field of {fault.schema['title']}; {hint}"


def _of_missing(fault: "ValidationError") -> str:
    missing = next(name for name in fault.validator_value if name not in fault.instance)
    return f"has no {missing}, which {fault.schema['title']} needs; add it"


def _of_alone(fault: "ValidationError") -> str:
    """Of a field that another has to stand beside."""
    alone, missing = next(
        (name, other)
        for name, others in fault.validator_value.items()
        for other in others
        if name in fault.instance and other not in fault.instance
    )
    return f"has {alone} without {missing}; add it, or leave {alone} out"


def _of_choice(fault: "ValidationError") -> str:
    """Of an object that should have exactly one of some fields."""
    title, names = fault.schema["title"], [one["required"][0] for one in fault.validator_value]
    found = [name for name in names if name in fault.instance]
    if not found:
        return f"has no {title}; expected exactly one of {', '.join(names)}"
    return f"has {len(found)} {title}s, {' and '.join(found)}; keep one of them"


def _unknown(fault: "ValidationError") -> Iterator[str]:
    return (name for name in fault.instance if name not in fault.schema["properties"])


_OF_OBJECTS = {
    "additionalProperties": _of_unknown,
    "required": _of_missing,
    "dependentRequired": _of_alone,
    "oneOf": _of_choice,
}
"""Sentences about objects that have other fields than they should, by the schema's keyword."""
