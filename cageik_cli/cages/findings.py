"""What a check finds, in words that every command uses, and in numbers for other programs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.util.arrays import Integers
from cageik_cli.util.errors import join_truncated

SEVERITIES = ("unfit", "usable", "note")
"""It does not bind; it binds, but something will be poor; worth a thought."""

_PLURALS = {
    "vertex": "vertices",
    "pair of a rest and a cage face": "pairs of a rest and a cage face",
}


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """One thing that is wrong, or worth knowing.

    Attributes
    ----------
    kind : str
        A word for programs, such as `open`.
    severity : str
        One of `SEVERITIES`.
    message : str
        What was found and where.
    remedy : str
        What to do.
    elements : str
        What `read_array` count: `vertices`, `edges`, `faces`, `face pairs`; empty if there are
        none.
    numbers : (k,) or (k, 2) int64
        All of them, from 0; an edge is its two vertices.
    value : float
        The measure of it: how many there are, unless the message says another figure.
    """

    kind: str
    severity: str
    message: str
    remedy: str
    elements: str
    numbers: Integers
    value: float

    @property
    def sentence(self) -> str:
        """The message and what to do."""
        return f"{self.message}; {self.remedy}"


def format_elements(noun: str, numbers: ArrayLike) -> str:
    """Such as `face 12`, `edge 3-7` or `3 edges (1-3, 3-7, 1-7)`."""
    names = ["-".join(map(str, np.ravel(number))) for number in np.asarray(numbers).tolist()]
    if len(names) == 1:
        return f"{noun} {names[0]}"
    return f"{len(names)} {pluralize(noun)} ({join_truncated(names)})"


def pluralize(noun: str) -> str:
    """Of the nouns for parts of a mesh."""
    return _PLURALS.get(noun, f"{noun}s")
