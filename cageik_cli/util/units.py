"""Units of length: their names, and how long they are in metres."""

from math import isclose

from cageik_cli.util.messages import Hint, Said, say

UNIT_LENGTHS = {
    "mm": 0.001,
    "cm": 0.01,
    "dm": 0.1,
    "m": 1.0,
    "km": 1000.0,
    "in": 0.0254,
    "ft": 0.3048,
}
"""Lengths in metres, by the names that a user types."""

LONG_UNIT_NAMES = {
    "mm": "millimetres",
    "cm": "centimetres",
    "dm": "decimetres",
    "m": "metres",
    "km": "kilometres",
    "in": "inches",
    "ft": "feet",
}

PROGRAM_UNITS = ("m", "cm", "mm", "in", "ft")
"""What programs count in, the usual ones first: what explains that two sizes differ."""

MIN_USUAL_SIZE, MAX_USUAL_SIZE = 0.01, 50.0
"""Models with a smaller or a larger diagonal, metres, are noted: no animal is, and a man is, whose
inches, centimetres or millimetres are taken for metres."""

SAME_UNIT_TOL = 1e-6
"""Lengths of units that differ by less, relative to each other, are the same: files have them in
single precision."""


def find_unit(length: float) -> str | None:
    """Return the short name of a unit of a length in metres; None if it has none."""
    for name, known in UNIT_LENGTHS.items():
        if isclose(length, known, rel_tol=SAME_UNIT_TOL):
            return name
    return None


def spell_unit(length: float) -> str:
    """Return how a unit is typed: by its name, or as a number of metres."""
    return find_unit(length) or f"{length:.6g}"


def describe_unit(length: float) -> str:
    """Return a unit in words: `centimetres`, or `units of 0.3 m`."""
    name = find_unit(length)
    return f"units of {length:.6g} m" if name is None else LONG_UNIT_NAMES[name]


def list_unit_ratios() -> dict[tuple[str, str], float]:
    """Return how long a unit of a program is in another one, by the short names of both."""
    return {
        (own, other): UNIT_LENGTHS[own] / UNIT_LENGTHS[other]
        for own in PROGRAM_UNITS
        for other in PROGRAM_UNITS
        if own != other
    }


def find_units_of_ratio(ratio: float, tolerance: float) -> tuple[str, str] | None:
    """Return two units of programs of which the first is `ratio` times as long as the other.

    The nearest ratio counts. `tolerance` is how much it may differ, relative to itself.
    """
    if not 0 < ratio < float("inf"):
        return None
    misses = {pair: abs(known / ratio - 1) for pair, known in list_unit_ratios().items()}
    best = min(misses, key=lambda pair: round(misses[pair], 9))
    return best if misses[best] < tolerance else None


def list_size_notes(diagonal: float, metres_per_unit: float, says: str) -> list[Said]:
    """Return a note if a model has a size that no character has, in its unit.

    Parameters
    ----------
    diagonal : float
        In units.
    says : str
        The beginning of the sentence: who says how long a unit is.
    """
    size = diagonal * metres_per_unit
    if not size or MIN_USUAL_SIZE <= size <= MAX_USUAL_SIZE:
        return []
    note = f"{says} {metres_per_unit:g} m, and so the model is {size:.3g} m large"
    for other in (UNIT_LENGTHS[name] for name in PROGRAM_UNITS):
        if 0.1 <= diagonal * other <= 10:
            unit = describe_unit(other)
            return [
                f"{note}; if its numbers are {unit}, state it by "
                + Hint("metres_per_unit", f"{other:g}")
            ]
    return [f"{note}; " + say("if a unit is another length, state it by `metres_per_unit=`")]
