"""JSON out of a file, within bounds, and what its values and places are called."""

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from cageik_cli.util.errors import InputError
from cageik_cli.util.text import format_bytes

MAX_BYTES = 2_000_000
"""Of a handles file: many thousands of handles."""

MAX_DEPTH = 16
"""Levels of lists and objects in each other; a handles file needs half of them."""

MAX_SHOWN_LENGTH = 40
"""Characters of a value that are shown."""


def read_document(path: Path) -> Any:
    """Read what a JSON file holds: finite numbers, no key twice.

    Raises
    ------
    InputError
        Without the file's name, when it cannot be read as that.
    """
    try:
        document = json.loads(_read_text(path), object_pairs_hook=_build_object)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error}); check the path") from error
    except json.JSONDecodeError as error:
        raise InputError(
            f"is not JSON at line {error.lineno}, column {error.colno}; check commas, quotes and "
            "brackets there, and leave comments out"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not UTF-8 text at byte {error.start}; save it as UTF-8, or name a handles file"
        ) from error
    except ValueError as error:
        raise InputError("holds a number of thousands of digits; shorten it") from error
    except RecursionError as error:
        raise _make_nesting_error() from error
    for steps, value in _iterate_values(document):
        if len(steps) > MAX_DEPTH:
            raise _make_nesting_error()
        if isinstance(value, float) and not math.isfinite(value):
            sentence = f"is {format_value(value)}, expected a finite number"
            raise InputError(": ".join([*describe_location(document, steps), sentence]))
    return document


def describe_location(document: Any, steps: Sequence[str | int]) -> list[str]:
    """Words for a place in a handles file: its set, its handle by name, the field within it."""
    words: list[str] = []
    field, value = "", document
    before: str | int = ""
    for step in steps:
        value = value[step]
        if before in ("sets", "handles") and isinstance(step, int):
            name = _describe_handle(value) if before == "handles" else ""
            words.append(name or f"{field}[{step}]")
            field = ""
        else:
            field += _format_step(step, field)
        before = step
    return [*words, field] if field else words


def format_value(value: Any) -> str:
    """A value in few words."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return f"a list of {len(value)}" if value else "an empty list"
    text = json.dumps(value)
    return text if len(text) <= MAX_SHOWN_LENGTH else f"{text[: MAX_SHOWN_LENGTH - 3]}..."


def _read_text(path: Path) -> str:
    size = path.stat().st_size
    if not path.is_file():
        raise InputError("is not a plain file; name a handles file")
    if size > MAX_BYTES:
        raise InputError(
            f"is of {format_bytes(size)}, more than the {format_bytes(MAX_BYTES)} that are read; "
            "name a handles file"
        )
    return path.read_text(encoding="utf-8-sig")


def _build_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON whose keys are not the same."""
    found = dict(pairs)
    if len(found) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        twice = next(key for key, count in counts.items() if count > 1)
        sentence = f"{format_value(twice)} stands twice in one object; keep one of them"
        raise InputError(": ".join(filter(None, (_describe_handle(found), sentence))))
    return found


def _iterate_values(document: Any) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """All values with the steps to them, in the file's order."""
    waiting: list[tuple[tuple[str | int, ...], Any]] = [((), document)]
    while waiting:
        steps, value = waiting.pop()
        yield steps, value
        inner: list[tuple[Any, Any]] = []
        if isinstance(value, dict):
            inner = list(value.items())
        elif isinstance(value, list):
            inner = list(enumerate(value))
        waiting += [((*steps, step), one) for step, one in reversed(inner)]


def _describe_handle(value: Any) -> str:
    """What an object that may be a handle is called; nothing if it has no name."""
    name = value.get("name") if isinstance(value, dict) else None
    return f"handle {name[:MAX_SHOWN_LENGTH]!r}" if isinstance(name, str) and name else ""


def _format_step(step: str | int, prefix: str) -> str:
    if isinstance(step, int):
        return f"[{step}]"
    text = step if step.isidentifier() else format_value(step)
    return f".{text[:MAX_SHOWN_LENGTH]}" if prefix else text[:MAX_SHOWN_LENGTH]


def _make_nesting_error() -> InputError:
    return InputError("holds lists or objects nested too deeply; name a handles file")
