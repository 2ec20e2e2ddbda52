"""Which axis of an array of positions is frames, vertices or coordinates."""

from dataclasses import dataclass

from cageik_cli.sequence.clip import LAYOUTS
from cageik_cli.util.errors import InputError


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read an array of positions.

    Attributes
    ----------
    layout : str
        One of `LAYOUTS`.
    frames, vertices : int
    """

    layout: str
    frames: int
    vertices: int

    def __str__(self) -> str:
        return f"{self.layout} ({self.frames} frames of {self.vertices} vertices)"


def readings_of(shape: tuple[int, ...], layout: str | None) -> list[Reading]:
    """Every way to read an array of this shape, in `layout` if one is given.

    Raises
    ------
    InputError
        When there is none.
    """
    found = [
        Reading(order, shape[order.index("f")], shape[order.index("v")])
        for order in LAYOUTS
        if len(shape) == 3 and shape[order.index("x")] == 3 and layout in (None, order)
    ]
    if not found or min(shape) < 1:
        expected = " or ".join(map(_spelt, LAYOUTS if layout is None else (layout,)))
        raise InputError(f"positions have shape {shape}, expected {expected}")
    return found


def likeliest(readings: list[Reading], named: int | None) -> Reading:
    """The one reading that is possible.

    Parameters
    ----------
    readings : list of Reading
    named : int, optional
        How many vertices the faces name. A reading with as many goes before one with more, and
        fewer there cannot be.

    Raises
    ------
    InputError
        When several readings are as likely, naming them.
    """
    if len(readings) == 1:
        return readings[0]
    exact = [reading for reading in readings if reading.vertices == named]
    larger = [reading for reading in readings if named is None or reading.vertices > named]
    best = exact or larger or readings
    if len(best) > 1:
        raise InputError(
            f"positions can be read as {' or '.join(map(str, best))}; say which with --layout"
        )
    return best[0]


def _spelt(layout: str) -> str:
    return (
        "(" + ", ".join({"f": "frames", "v": "vertices", "x": "3"}[axis] for axis in layout) + ")"
    )
