"""Records of plain values, read back from JSON: each value is checked against its field's type."""

from dataclasses import fields, is_dataclass
from enum import StrEnum
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from cageik_cli.util.errors import FormatError, SettingError
from cageik_cli.util.json_files import format_value

_NAMES = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a string",
    NoneType: "null",
}


def parse_record(kind: Any, value: Any, name: str) -> Any:
    """Return a JSON value as `kind`.

    Parameters
    ----------
    kind : type
        A dataclass of such kinds, `bool`, `int`, `float`, `str`, an enumeration of texts, None, a
        union, or a tuple of them.
    value : JSON value
        Its numbers are finite.
    name : str
        For messages.

    Raises
    ------
    FormatError
        Naming the value that is not of its kind.
    """
    if get_origin(kind) is UnionType:
        return _parse_union(kind, value, name)
    if get_origin(kind) is tuple:
        return _parse_tuple(kind, value, name)
    if is_dataclass(kind):
        return _parse_dataclass(kind, value, name)
    if issubclass(kind, StrEnum):
        return _parse_enum(kind, value, name)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind is float and is_number:
        return float(value)
    if not isinstance(value, kind) or (kind is int and not is_number):
        raise FormatError(f"`{name}` is {format_value(value)}, expected {_NAMES[kind]}")
    return value


def _parse_enum(kind: type[StrEnum], value: Any, name: str) -> StrEnum:
    if value not in list(kind):
        raise FormatError(
            f"`{name}` is {format_value(value)}, expected one of {', '.join(map(str, kind))}"
        )
    return kind(value)


def _parse_union(kind: Any, value: Any, name: str) -> Any:
    """Parse null where it may be, else the other kind."""
    others = [one for one in get_args(kind) if one is not NoneType]
    return None if value is None else parse_record(others[0], value, name)


def _parse_tuple(kind: Any, value: Any, name: str) -> tuple[Any, ...]:
    kinds = get_args(kind)
    if not isinstance(value, list):
        raise FormatError(f"`{name}` is {format_value(value)}, expected a list")
    if kinds[-1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(kinds) != len(value):
        raise FormatError(f"`{name}` has {len(value)} values, expected {len(kinds)}")
    return tuple(
        parse_record(one, held, f"{name}[{k}]")
        for k, (one, held) in enumerate(zip(kinds, value, strict=True))
    )


def _parse_dataclass(kind: Any, value: Any, name: str) -> Any:
    expected = [field.name for field in fields(kind)]
    if not isinstance(value, dict) or set(value) != set(expected):
        raise FormatError(f"`{name}` does not hold {', '.join(expected)}")
    kinds = get_type_hints(kind)
    values = {key: parse_record(kinds[key], value[key], f"{name}.{key}") for key in expected}
    try:
        return kind(**values)
    except SettingError as error:
        raise FormatError(f"`{name}`: {error}") from error
