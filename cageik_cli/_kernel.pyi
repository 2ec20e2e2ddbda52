"""The compiled functions, whose sources are in `cageik_cli/kernel`."""

from typing import Any

def compute_potentials(
    limits: Any,
    panels: tuple[Any, ...],
    hats: tuple[Any, ...],
    terms: tuple[Any, ...] | None,
    points: Any,
    is_inside: bool,
    results: tuple[Any, ...],
    /,
) -> None: ...
def compute_functions(y: Any, x: Any, log: Any, arctan2: Any, /) -> None: ...
def parse_words(
    text: bytes, bounds: Any, is_long: bool, has_integers: bool, numbers: Any, /
) -> bool: ...
def parse_positions(text: bytes, length: int, positions: Any, /) -> bool: ...
