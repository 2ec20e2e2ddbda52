"""Calls of the system that a signal interrupts: repeated, as Python does with most of its own."""

from collections.abc import Callable
from typing import Any, TypeVar

Value = TypeVar("Value")


def repeat_if_interrupted(call: Callable[[], Value]) -> Value:
    """Return what a call gives, made again as long as a signal interrupts it."""
    while True:
        try:
            return call()
        except InterruptedError:
            continue


def set_size(file: Any, size: int) -> None:
    """Set the size of an open binary file; Python gives up when a signal interrupts that."""
    repeat_if_interrupted(lambda: file.truncate(size))
