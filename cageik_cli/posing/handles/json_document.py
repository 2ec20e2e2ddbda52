"""The JSON of a handles file, and the places in it as messages name them."""

from typing import Any

from cageik_cli.util.json_files import MAX_VALUE_LENGTH, JsonFormat, Steps, format_step

MAX_BYTES = 2_000_000
"""Largest file that is read: many thousands of handles."""


def describe_location(document: Any, steps: Steps) -> str:
    """Return the place of a value in words: its set, its handle by name, the field within it."""
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
            field = (field + format_step(step)).removeprefix(".")
        before = step
    return ": ".join([*words, field] if field else words)


def _describe_handle(value: Any) -> str:
    """Return what messages call a handle; nothing if it has no name."""
    name = value.get("name") if isinstance(value, dict) else None
    return f"handle {name[:MAX_VALUE_LENGTH]!r}" if isinstance(name, str) and name else ""


HANDLES_FORMAT = JsonFormat("a handles file", MAX_BYTES, describe_location)
"""What the JSON of a handles file should be."""
