"""JSON out of a file, within bounds, and what its values and places are called."""

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from cageik_cli.util.errors import InputError
from cageik_cli.util.text import bytes_text

MOST_BYTES = 2_000_000
"""Of a handles file: many thousands of handles."""

DEEPEST = 16
"""Levels of lists and objects in each other; a handles file needs half of them."""

LONGEST = 40
"""Characters of a value that are shown."""


def read_document(path: Path) -> Any:
    """Read what a JSON file holds: finite numbers, no key twice.

    Raises
    ------
    InputError
        Without the file's name, when it cannot be read as that.
    """
    try:
        document = json.loads(_text_of(path), object_pairs_hook=_object)
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
        raise _too_deep() from error
    for steps, value in _values(document):
        if len(steps) > DEEPEST:
            raise _too_deep()
        if isinstance(value, float) and not math.isfinite(value):
            sentence = f"is {value_text(value)}, expected a finite number"
            raise InputError(": ".join([*place_of(document, steps), sentence]))
    return document


def place_of(document: Any, steps: Sequence[str | int]) -> list[str]:
    """Words for a place in a handles file: its set, its handle by name, the field within it."""
    words: list[str] = []
    field, value = "", document
    before: str | int = ""
    for step in steps:
        value = value[step]
        if before in ("sets", "handles") and isinstance(step, int):
            name = _handle_name(value) if before == "handles" else ""
            words.append(name or f"{field}[{step}]")
            field = ""
        else:
            field += _field_text(step, field)
        before = step
    return [*words, field] if field else words


def value_text(value: Any) -> str:
    """A value in few words."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return f"a list of {len(value)}" if value else "an empty list"
    text = json.dumps(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _text_of(path: Path) -> str:
    size = path.stat().st_size
    if not path.is_file():
        raise InputError("is not a plain file; name a handles file")
    if size > MOST_BYTES:
        raise InputError(
            f"is of {bytes_text(size)}, more than the {bytes_text(MOST_BYTES)} that are read; "
            "name a handles file"
        )
    return path.read_text(encoding="utf-8-sig")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON whose keys are not the same."""
    found = dict(pairs)
    if len(found) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        twice = next(key for key, count in counts.items() if count > 1)
        sentence = f"{value_text(twice)} stands twice in one object; keep one of them"
        raise InputError(": ".join(filter(None, (_handle_name(found), sentence))))
    return found


def _values(document: Any) -> Iterator[tuple[tuple[str | int, ...], Any]]:
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


def _handle_name(value: Any) -> str:
    """What an object that may be a handle is called; nothing if it has no name."""
    name = value.get("name") if isinstance(value, dict) else None
    return f"handle {name[:LONGEST]!r}" if isinstance(name, str) and name else ""


def _field_text(step: str | int, before: str) -> str:
    if isinstance(step, int):
        return f"[{step}]"
    text = step if step.isidentifier() else value_text(step)
    return f".{text[:LONGEST]}" if before else text[:LONGEST]


def _too_deep() -> InputError:
    return InputError("holds lists or objects nested too deeply; name a handles file")
