"""JSON Schema of records, made of their declarations: types, and what docstrings say of fields.

A record is a dataclass or a `TypedDict`. It has the fields that it declares and no others, and of a
dataclass all of them. Its docstring without sections describes it, the section `Attributes` its
fields. A record derived from another one describes what it adds.
"""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from inspect import cleandoc
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

from cageik_cli.util.settings import list_settings

DIALECT = "https://json-schema.org/draft/2020-12/schema"

_SIMPLE = {bool: "boolean", int: "integer", float: "number", str: "string", NoneType: "null"}

_SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}\n", re.MULTILINE)
_ATTRIBUTE = re.compile(r"^(\w[\w, ]*?) : .*\n((?:    .*\n?|\n)*)", re.MULTILINE)


class SchemaBuilder:
    """Collects the definitions of records that a schema refers to.

    Parameters
    ----------
    forms : mapping of type to dict, optional
        Schemas of types that are written in a form of their own.
    prefix : str
        Of the names of definitions.

    Attributes
    ----------
    definitions : dict
        The schemas of records, by name.
    """

    def __init__(self, forms: Mapping[Any, dict[str, Any]] | None = None, prefix: str = "") -> None:
        self.definitions: dict[str, dict[str, Any]] = {}
        self._forms, self._prefix = forms or {}, prefix

    def describe(self, kind: Any) -> dict[str, Any]:
        """Return the schema of a type; records become definitions, to which it refers.

        Raises
        ------
        TypeError
            For a type that does not say what its values are.
        """
        if kind in self._forms:
            return self._forms[kind]
        if kind in _SIMPLE:
            return {"type": _SIMPLE[kind]}
        origin, inner = get_origin(kind), get_args(kind)
        if origin in (Union, UnionType):
            return _join(list(map(self.describe, inner)))
        if origin is Literal or (isinstance(kind, type) and issubclass(kind, StrEnum)):
            return {"enum": list(map(str, inner or kind))}
        if origin is tuple and inner[-1] is Ellipsis:
            return {"type": "array", "items": self.describe(inner[0])}
        if origin is tuple:
            places = list(map(self.describe, inner))
            return {"type": "array", "prefixItems": places, "items": False, "minItems": len(inner)}
        if origin is dict and inner[0] is str and inner[1] is not Any:
            return {"type": "object", "additionalProperties": self.describe(inner[1])}
        if is_dataclass(kind) or is_typeddict(kind):
            return self.add_record(kind)
        raise TypeError(f"{kind} does not say what its values are; declare it")

    def add_record(self, kind: Any) -> dict[str, str]:
        """Define a record, and return the reference to it."""
        name = self._prefix + kind.__name__
        if name not in self.definitions:
            self.definitions[name] = {}  # for a record that holds others of its kind
            optional = kind.__optional_keys__ if is_typeddict(kind) else ()
            self.definitions[name] = describe_object(
                describe_record(kind), self.describe_fields(kind), optional
            )
        return {"$ref": f"#/$defs/{name}"}

    def describe_fields(
        self, kind: Any, names: Iterable[str] | None = None
    ) -> dict[str, dict[str, Any]]:
        """Return the schemas of fields of a record by name, all by default, with what they are."""
        said = dict(list_field_words(kind))
        if is_dataclass(kind):
            said |= {one.name: setting.meaning for one, setting in list_settings(kind)}
        kinds = get_type_hints(kind)
        if names is None:
            names = [one.name for one in fields(kind)] if is_dataclass(kind) else kinds
        return {name: _add_words(self.describe(kinds[name]), said.get(name)) for name in names}


def describe_object(
    words: str, properties: Mapping[str, Any], optional: Collection[str] = ()
) -> dict[str, Any]:
    """Return the schema of an object that has these properties and no others."""
    return {
        "description": words,
        "type": "object",
        "properties": dict(properties),
        "required": [name for name in properties if name not in optional],
        "additionalProperties": False,
    }


def allow_null(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of the same values and null, with the same description."""
    plain = {key: value for key, value in schema.items() if key != "description"}
    return _add_words(_join([plain, {"type": "null"}]), schema.get("description"))


def describe_record(kind: Any) -> str:
    """Return what the docstring of a record says before its sections, a paragraph per line.

    None is null, as it is in JSON.
    """
    text = _SECTION.split(_get_docstring(kind))[0]
    return "\n".join(" ".join(part.split()) for part in text.strip().split("\n\n"))


def list_field_words(kind: Any) -> Iterator[tuple[str, str]]:
    """Yield the fields of a record that its docstring describes, and what it says."""
    for base in reversed(getattr(kind, "__mro__", (kind,))):
        sections = _SECTION.split(_get_docstring(base))
        for title, text in zip(sections[1::2], sections[2::2], strict=True):
            for names, words in _ATTRIBUTE.findall(text + "\n") if title == "Attributes" else ():
                for name in names.split(", "):
                    yield name, " ".join(words.split())


def _get_docstring(kind: Any) -> str:
    return re.sub(r"\bNone\b", "null", cleandoc(kind.__dict__.get("__doc__") or "")) + "\n"


def _join(schemas: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the schema of the values that any of these allows."""
    parts = [
        part for one in schemas for part in (one["anyOf"] if one.keys() == {"anyOf"} else [one])
    ]
    simple = [part["type"] for part in parts if part.keys() == {"type"}]
    others = [part for part in parts if part.keys() != {"type"}]
    names = [name for one in simple for name in (one if isinstance(one, list) else [one])]
    names = list(dict.fromkeys(names))
    plain = [{"type": names if len(names) > 1 else names[0]}] if names else []
    choices = [*others, *plain]
    return choices[0] if len(choices) == 1 else {"anyOf": choices}


def _add_words(schema: dict[str, Any], words: str | None) -> dict[str, Any]:
    return schema if not words else {"description": words, **schema}
