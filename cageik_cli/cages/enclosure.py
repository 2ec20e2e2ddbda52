"""Does this cage hold this model? Every vertex that is outside, with its number from 0."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.cages.findings import Finding
from cageik_cli.cages.soundness import validate_cage
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import (
    ROUNDING_TOL,
    ClosestPoints,
    closest_points,
    winding_numbers,
)
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError, join_truncated

TOUCH_TOL = 1e-8
"""A vertex outside by no more than this, in diagonals, is on the cage but for rounding."""

MAX_OUTSIDE_SHARE = 0.5
"""A cage with more than this share of the vertices outside is another's; they are not projected."""


@dataclass(frozen=True, slots=True, eq=False)
class Enclosure:
    """A cage that holds a model.

    Attributes
    ----------
    cage : TriMesh
        Closed, manifold, of one component, outward.
    points : (m, 3) float64
        The model's vertices, those outside moved to the nearest point of the cage.
    projected_indices : (k,) int64
        Vertices that were moved by more than rounding.
    notes : tuple of str
        What was changed, one sentence each.
    """

    cage: TriMesh
    points: Floats
    projected_indices: Integers
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where the m vertices of a rest pose lie against a cage.

    Attributes
    ----------
    closest : ClosestPoints
        The cage's nearest points.
    outside : (m,) bool
        Beyond the surface, be it by rounding.
    tolerance : float
        How far outside is rounding, file units.
    """

    closest: ClosestPoints
    outside: NDArray[np.bool_]
    tolerance: float

    @property
    def outside_indices(self) -> Integers:
        """The vertices that are outside by more than rounding."""
        return np.flatnonzero(self.outside & (self.closest.distance > self.tolerance))


def check_enclosure(cage: TriMesh, rest: TriMesh, outside: str = "refuse") -> Enclosure:
    """Check the cage, turn it outward, and check that it holds every vertex of the rest pose.

    Raises
    ------
    InputError
        With what is wrong, where, and whether cage and model look swapped.
    """
    try:
        outward, notes = validate_cage(cage)
        return _project_outside(outward, rest, notes, outside)
    except InputError as error:
        if len(cage.vertices) <= len(rest.vertices):
            raise
        raise InputError(
            f"{error}; the cage has {len(cage.vertices)} vertices and the model "
            f"{len(rest.vertices)}: are they swapped?"
        ) from error


def locate_vertices(cage: TriMesh, rest: TriMesh) -> Placement:
    """Find where the vertices of the rest pose are, against a cage that is turned outward."""
    largest = max(np.abs(mesh.vertices).max() for mesh in (cage, rest))
    return Placement(
        closest=closest_points(cage, rest.vertices),
        outside=winding_numbers(cage, rest.vertices) < 0.5,
        tolerance=float(max(TOUCH_TOL * rest.diagonal, ROUNDING_TOL * largest)),
    )


def find_outside_vertices(placement: Placement, rest: TriMesh) -> Finding | None:
    """Say which vertices of the rest pose are outside, if any are."""
    far = placement.outside_indices
    if len(far) == 0:
        return None
    worst = far[placement.closest.distance[far].argmax()]
    percent = 100 * placement.closest.distance[worst] / rest.diagonal
    return Finding(
        kind="outside",
        severity="unfit",
        message=(
            f"{len(far)} of {len(rest.vertices)} vertices of the rest pose are outside the cage, "
            f"the worst, {worst}, by {percent:.3g} % of the diagonal: numbers "
            f"{join_truncated(far)} "
            "(from 0)"
        ),
        remedy=_likely_cause(placement.closest.mesh, rest)
        if _is_misplaced(placement)
        else "enlarge the cage there, give the rest pose it was made for, or take the "
        "nearest points of the cage with --outside project",
        elements="vertices",
        numbers=far,
        value=float(percent),
    )


def _is_misplaced(placement: Placement) -> bool:
    """Whether so much is outside that the cage cannot have been made for this rest pose."""
    return len(placement.outside_indices) > MAX_OUTSIDE_SHARE * len(placement.outside)


def _likely_cause(cage: TriMesh, rest: TriMesh) -> str:
    """What is likely wrong between a cage and a model most of which is outside it."""
    ratio = cage.diagonal / rest.diagonal
    if not 0.2 < ratio < 5:
        return (
            f"the cage is {ratio:.3g} times as large as the model: export both in one unit, or "
            "move a model that is to be so into the cage"
        )
    low = np.maximum(cage.vertices.min(axis=0), rest.vertices.min(axis=0))
    high = np.minimum(cage.vertices.max(axis=0), rest.vertices.max(axis=0))
    if (low > high).any():
        return (
            "their boxes do not meet: move the cage to the model, or give the rest pose that it "
            "was made for"
        )
    return (
        "most of the model is outside: give the rest pose the cage was made for, or "
        "export both with the same axes and scale"
    )


def find_missing_extent(rest: TriMesh) -> Finding | None:
    """Say so if the rest pose has no extent."""
    if rest.diagonal > 0:
        return None
    return Finding(
        kind="point",
        severity="unfit",
        message="the rest pose is one point, expected a surface",
        remedy="export it again",
        elements="",
        numbers=np.empty(0, np.int64),
        value=0.0,
    )


def _project_outside(
    cage: TriMesh, rest: TriMesh, notes: tuple[str, ...], policy: str
) -> Enclosure:
    """Move vertices that are outside onto the cage: by rounding, or by more if `policy`."""
    if point := find_missing_extent(rest):
        raise InputError(point.sentence)
    placement = locate_vertices(cage, rest)
    if found := find_outside_vertices(placement, rest):
        if policy == "refuse" or _is_misplaced(placement):
            raise InputError(found.sentence)
        notes = (
            *notes,
            f"{found.message}; they have the weights of the nearest points of the cage",
        )
    moved = placement.outside[:, None]
    points = np.where(moved, placement.closest.position, rest.vertices)
    return Enclosure(cage, points, placement.outside_indices, notes)
