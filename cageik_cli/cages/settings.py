"""Settings of cages that are built or repaired. This module imports no numerics."""

from dataclasses import dataclass
from typing import Literal, get_args

from cageik_cli.util.errors import SettingError

BUILDER_VERSION = 4
"""Raised when the same model and settings give another cage, so that kept ones are not used."""

MIN_VERTICES = 8
"""Fewer vertices make no useful cage."""

MAX_VERTICES = 2000
"""More vertices would make more faces than a cage may have."""

MAX_CLEARANCE = 0.2
"""The largest clearance, in diagonals."""


SymmetryChoice = Literal["auto", "x", "y", "z", "off"]
"""About which plane a cage is to be symmetric."""

DEFAULT_SYMMETRY: SymmetryChoice = "off"


@dataclass(frozen=True, slots=True)
class BuildSettings:
    """The size, the clearance and the symmetry of a cage that is built.

    Attributes
    ----------
    vertices : int
        Vertices of the cage, at most; it has at least nine tenths of them.
    clearance : float
        Its smallest distance from the model, in diagonals of the model.
    symmetric : {"auto", "x", "y", "z", "off"}
        About the plane across an axis; about the plane of a model that is its own mirror image; or
        about none.
    quads : bool
        Whether pairs of triangles become quads, which hold the model by either diagonal.
    loops : bool
        Whether loops of a few vertices go around limbs.
    """

    vertices: int = 100
    clearance: float = 0.004
    symmetric: SymmetryChoice = DEFAULT_SYMMETRY
    quads: bool = False
    loops: bool = False

    def __post_init__(self) -> None:
        if not MIN_VERTICES <= self.vertices <= MAX_VERTICES:
            raise SettingError(
                f"a cage of {self.vertices} vertices is asked for, expected {MIN_VERTICES} to "
                f"{MAX_VERTICES}"
            )
        if not 0 < self.clearance <= MAX_CLEARANCE:
            raise SettingError(
                f"the clearance is {100 * self.clearance:g} % of the diagonal, expected more than "
                f"0 and at most {100 * MAX_CLEARANCE:g} %"
            )
        if self.symmetric not in get_args(SymmetryChoice):
            raise SettingError(
                f"symmetric is {self.symmetric!r}, expected one of "
                f"{', '.join(map(repr, get_args(SymmetryChoice)))}"
            )
        if self.loops and self.symmetric != "off":
            raise SettingError(
                "`loops=True` and `symmetric=` do not go together: loops are not laid by pairs; "
                "leave out one"
            )


@dataclass(frozen=True, slots=True)
class RepairSettings:
    """The limits of a repair.

    Attributes
    ----------
    clearance : float
        How far parts of the cage that must move are moved off the model, in its diagonals.
    max_hole_edges : int
        Holes with more edges are not closed.
    allow_transform : bool
        Whether a cage in another unit, or with other axes, is brought to the model.
    """

    clearance: float = 0.002
    max_hole_edges: int = 16
    allow_transform: bool = True
