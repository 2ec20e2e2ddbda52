"""Calls of the Python API: an argument that cannot be is refused in one sentence."""

import inspect
from collections.abc import Callable
from difflib import get_close_matches
from functools import cache, wraps
from numbers import Integral, Real
from os import PathLike
from typing import Any, ParamSpec, TypeVar, get_type_hints

from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint, Text
from cageik_cli.util.settings import matches, show_value

FilePath = str | PathLike[str]
"""The name of a file or a folder."""

ReportProgress = Callable[[int, int], None]
"""Takes how much is done, and how much there is."""

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")

MAX_BITS = 64
"""Bits of a whole number, at most."""

TYPE_WORDS = {
    "ArrayLike": "an array",
    "FilePath": "a path",
    "None": "None",
    "ReportProgress": "a callable",
    "Sequence[FilePath]": "a sequence of paths",
    "Sequence[str]": "a sequence of text",
    "bool": "True or False",
    "float": "a number",
    "int": "a whole number",
    "str": "text",
}
"""What the names of types in signatures mean to a reader."""


class ShownType(str):
    """The type of a parameter as the code states it: help shows the name, not what it stands for.

    What a NumPy array is of, for instance, takes a line of names that nobody reads.
    """

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)

    def describe(self) -> str:
        """Return in words which values are of the type."""
        return " or ".join(
            TYPE_WORDS.get(one) or (one[9:-2] if one.startswith("Literal[") else f"a {one}")
            for one in self.split(" | ")
        )


def check_call(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Return a function of the Python API that checks its arguments; their types are shown by name.

    Its module states annotations as text, by `from __future__ import annotations`.

    Raises
    ------
    SettingError
        By the function, when a keyword is unknown, an argument is missing, or one is blank or of
        another type.
    """
    plain = inspect.signature(function)
    shown = plain.replace(
        parameters=[
            one.replace(annotation=ShownType(one.annotation)) for one in plain.parameters.values()
        ],
        return_annotation=ShownType(plain.return_annotation),
    )
    find_types = cache(lambda: get_type_hints(function))

    @wraps(function)
    def call(*args: Parameters.args, **keywords: Parameters.kwargs) -> Returned:
        bind_arguments(function.__name__, plain, args, keywords)
        args = tuple(map(to_plain_number, plain.parameters, args))  # type: ignore[assignment]
        for name, value in keywords.items():
            keywords[name] = to_plain_number(name, value)
        arguments = bind_arguments(function.__name__, plain, args, keywords)
        for name, value in arguments.items():
            if plain.parameters[name].kind is not inspect.Parameter.VAR_KEYWORD:
                check_argument(
                    name, value, find_types().get(name, Any), shown.parameters[name].annotation
                )
        return function(*args, **keywords)

    call.__signature__ = shown  # type: ignore[attr-defined]  # which inspect and help read
    return call


def to_plain_number(name: str, value: Any) -> Any:
    """Return a number as Python has it, as files record it; other values as they are.

    Raises
    ------
    SettingError
        When no float holds it, or it is a whole number of more than 64 bits: nothing is so large.
    """
    if getattr(value, "ndim", None) == 0 and hasattr(value, "item"):
        value = value.item()
    if not isinstance(value, Real) or isinstance(value, bool | float):
        return value
    try:
        plain = int(value) if isinstance(value, Integral) else float(value)
    except OverflowError:
        raise SettingError(Hint(name) + " is a fraction that no float holds; round it") from None
    if isinstance(plain, int) and plain.bit_length() > MAX_BITS:
        raise SettingError(
            Hint(name) + f" is {show_value(plain)}, expected one of at most {MAX_BITS} bits"
        )
    return plain


def bind_arguments(
    function: str, signature: inspect.Signature, args: Any, keywords: Any
) -> dict[str, Any]:
    """Return the arguments of a call by their names; refuse those that no call can have."""
    try:
        return signature.bind(*args, **keywords).arguments
    except TypeError:
        raise SettingError(_explain_call(function, signature, args, keywords)) from None


def _explain_call(function: str, signature: inspect.Signature, args: Any, keywords: Any) -> Text:
    """Return what is wrong with the arguments of a call."""
    known = signature.parameters
    takes_any = any(one.kind is inspect.Parameter.VAR_KEYWORD for one in known.values())
    unknown = [name for name in keywords if name not in known and not takes_any]
    if unknown:
        nearest = get_close_matches(unknown[0], known, n=1)
        remedy = (
            "do you mean " + Hint(nearest[0]) if nearest else f"see help(cageik_cli.{function})"
        )
        return f"{function}: " + Hint(unknown[0]) + " is not one of its keywords; " + remedy
    by_place = [
        one for one in known.values() if one.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
    ]
    if len(args) > len(by_place):
        return Text(
            f"{function}: given {len(args)} arguments without a keyword, expected at most "
            f"{len(by_place)}; give the others by keyword"
        )
    twice = [one.name for one in by_place[: len(args)] if one.name in keywords]
    if twice:
        return f"{function}: " + Hint(twice[0]) + " is given twice; leave one out"
    names = [one.name for one in by_place[len(args) :] if one.default is inspect.Parameter.empty]
    missing = next(name for name in names if name not in keywords)
    return f"{function}: " + Hint(missing) + " is missing; give it"


def check_argument(name: str, value: Any, kind: Any, shown: ShownType) -> None:
    """Refuse a value of another type, and a blank name."""
    check_not_blank(name, value)
    if not matches(value, kind):
        raise SettingError(Hint(name) + f" is {show_value(value)}, expected {shown.describe()}")


def check_not_blank(name: str, value: Any) -> None:
    """Refuse a text without any letter, also in a list."""
    if any(
        isinstance(one, str) and not one.strip()
        for one in [value] + (list(value) if isinstance(value, list | tuple) else [])
    ):
        raise SettingError(Hint(name) + " is blank; give a name, or leave it out")
