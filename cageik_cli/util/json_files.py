"""JSON files, read within limits: size and depth, finite numbers only, no key twice."""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cageik_cli.util.errors import FormatError
from cageik_cli.util.files import read_input

MAX_DEPTH = 16
"""Levels of lists and objects inside each other; our files have at most half as many."""

MAX_VALUE_LENGTH = 40
"""Characters of a value that messages show."""

Steps = Sequence[str | int]
"""The keys and indices that lead to a value."""


def format_steps(document: Any, steps: Steps) -> str:
    """Return the place of a value, such as `clips[2].summary`; empty for the whole document."""
    return "".join(map(format_step, steps)).removeprefix(".")


@dataclass(frozen=True, slots=True)
class JsonFormat:
    """What a JSON file should be.

    Attributes
    ----------
    name : str
        For messages: "a handles file".
    locate : callable
        The place of a value in words, by the document and the steps to the value.
    """

    name: str
    max_bytes: int
    locate: Callable[[Any, Steps], str] = format_steps


EMBEDDED_JSON = JsonFormat("plain values", 1 << 40)
"""JSON inside other files, whose readers say in their own words what is wrong."""


def read_json(path: Path, expected: JsonFormat) -> Any:
    """Read the content of a JSON file.

    Raises
    ------
    FileAccessError
        When it is missing, not a plain file, or too large. Messages do not name the file.
    FormatError
        As `parse_json`.
    """
    return parse_json(read_input(path, expected.max_bytes, expected.name, is_json=True), expected)


def parse_json(data: bytes, expected: JsonFormat = EMBEDDED_JSON) -> Any:
    """Return the content of JSON that was read; who reads it keeps to the limit of size.

    Raises
    ------
    FormatError
        When it is not UTF-8 text or not JSON, is nested too deeply, or holds a key twice or a
        number that is not finite; the message says where.
    """
    repeated_keys: dict[int, tuple[Any, str]] = {}  # with the object, so that its id stays its own

    def build_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            key, _ = Counter(key for key, _ in pairs).most_common(1)[0]
            repeated_keys[id(found)] = found, key
        return found

    try:
        document = json.loads(data.decode("utf-8-sig"), object_pairs_hook=build_object)
    except UnicodeDecodeError as error:
        raise FormatError(
            f"is not UTF-8 text at byte {error.start}; save it as UTF-8, or give {expected.name}"
        ) from error
    except json.JSONDecodeError as error:
        raise FormatError(
            f"is not JSON at line {error.lineno}, column {error.colno}; check commas, quotes and "
            "brackets there, and remove comments"
        ) from error
    except ValueError as error:
        raise FormatError("holds a number with thousands of digits; shorten it") from error
    except RecursionError as error:
        raise _make_depth_error(expected) from error
    _check_containers(document, repeated_keys, expected)
    return document


def format_value(value: Any) -> str:
    """Return a value in a few words."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return f"a list of {len(value)}" if value else "an empty list"
    text = json.dumps(value)
    return text if len(text) <= MAX_VALUE_LENGTH else f"{text[: MAX_VALUE_LENGTH - 3]}..."


def format_step(step: str | int) -> str:
    """Return one step to a value: `[3]` or `.name`; an odd key is quoted."""
    if isinstance(step, int):
        return f"[{step}]"
    text = step if step.isidentifier() else format_value(step)
    return f".{text[:MAX_VALUE_LENGTH]}"


def _check_containers(
    document: Any, repeated_keys: dict[int, tuple[Any, str]], expected: JsonFormat
) -> None:
    """Refuse deep nesting, a repeated key of an object (by its id), and numbers not finite.

    Lists and objects are looked at in the file's order; of millions, only those above one are kept.
    The document itself is in a list, so that it may be a number: all steps begin with 0.
    """
    steps: list[str | int] = []
    above: list[Iterator[tuple[str | int, Any]]] = []
    container: Any = [document]
    while True:
        if len(steps) > MAX_DEPTH:
            raise _make_depth_error(expected)
        if id(container) in repeated_keys:
            fault = f"has {format_value(repeated_keys[id(container)][1])} twice; keep one of them"
            raise _make_error(document, steps, fault, expected)
        for step, value in _list_items(container):
            if isinstance(value, int | float) and not _is_finite(value):
                fault = f"is {format_value(value)}, expected a finite number"
                raise _make_error(document, (*steps, step), fault, expected)
        above.append(iter(_list_items(container)))
        while above:
            inner = next((item for item in above[-1] if isinstance(item[1], dict | list)), None)
            if inner is not None:
                break
            above.pop()
        else:
            return
        del steps[len(above) - 1 :]
        steps.append(inner[0])
        container = inner[1]


def _is_finite(number: float) -> bool:
    """Return whether a number is finite; a whole one, as a float."""
    try:
        return math.isfinite(number)
    except OverflowError:
        return False


def _list_items(container: Any) -> Iterable[tuple[str | int, Any]]:
    """Return the steps into a list or an object, and what is there."""
    return container.items() if isinstance(container, dict) else enumerate(container)


def _make_error(document: Any, steps: Steps, fault: str, expected: JsonFormat) -> FormatError:
    place = expected.locate(document, steps[1:])
    return FormatError(f"{place}: {fault}" if place else fault)


def _make_depth_error(expected: JsonFormat) -> FormatError:
    return FormatError(
        f"holds lists or objects nested more than {MAX_DEPTH} levels deep; give {expected.name}"
    )
