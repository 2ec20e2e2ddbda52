"""Findings of a check, as sentences for users and as numbers for programs."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.util.arrays import Integers
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.text import format_count

SEVERITIES = ("unfit", "warning", "note")
"""From the worst: it does not bind; it binds, but something will be poor; a remark."""

Point = tuple[float, float, float]
"""A place, file units."""


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """One fault or remark.

    Attributes
    ----------
    kind : str
        An identifier for programs, such as `open-edge`.
    severity : str
        One of `SEVERITIES`.
    message : str
        What was found, and where.
    remedy : str
        What to do.
    elements : str
        What `numbers` are: `vertices`, `edges`, `faces`, `face pairs`; empty without numbers.
    numbers : (k,) or (k, 2) int64
        All elements, from 0; an edge is its two vertices.
    value : float
        The measured value: the number of elements, unless the message has another one.
    mesh : str
        Of which mesh the elements are: `cage`, `rest`, or `both` for pairs of a face of the rest
        pose and one of the cage.
    place : tuple of float, optional
        Where it is, if it has no elements, file units.
    """

    kind: str
    severity: str
    message: str
    remedy: str
    elements: str = ""
    numbers: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    value: float = 0.0
    mesh: str = "cage"
    place: Point | None = None

    def at(self, elements: str, numbers: Integers, mesh: str = "cage") -> "Finding":
        """Return the finding with the elements of a mesh where it is."""
        return replace(self, elements=elements, numbers=numbers, mesh=mesh)

    @property
    def sentence(self) -> str:
        """Return the message and the remedy."""
        return f"{self.message}; {self.remedy}"


def format_elements(noun: str, numbers: ArrayLike) -> str:
    """Return a text such as `face 12`, `edge 3-7` or `3 edges (1-3, 3-7, 1-7)`."""
    names = ["-".join(map(str, np.ravel(number))) for number in np.asarray(numbers).tolist()]
    if len(names) == 1:
        return f"{noun} {names[0]}"
    return f"{format_count(len(names), noun)} ({join_truncated(names)})"
