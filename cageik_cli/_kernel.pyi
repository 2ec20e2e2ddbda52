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
def sum_moments(
    frames: Any, weights: Any, rest: Any, centres: Any, covariances: Any, /
) -> None: ...
def align_frames(frames: Any, centres: Any, rotations: Any, rest: Any, columns: Any, /) -> None: ...
def place_columns(columns: Any, centres: Any, frames: Any, first: int, /) -> None: ...
def compare_frames(
    frames: Any,
    reconstructions: Any,
    is_data: Any,
    faces: Any,
    squares: Any,
    sums: Any,
    worst: Any,
    /,
) -> None: ...
def closest_points(
    points: Any,
    vertices: Any,
    faces: Any,
    boxes: tuple[Any, Any],
    squares: Any,
    nearest: Any,
    positions: Any,
    /,
) -> None: ...
def draw_triangles(corners: Any, face: Any, depth: Any, /) -> None: ...
def winding_numbers(points: Any, vertices: Any, faces: Any, winding: Any, /) -> None: ...
