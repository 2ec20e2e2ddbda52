"""Tests whether a cage encloses a model: which vertices are outside, and by how much."""

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
from cageik_cli.util.errors import CageError, join_truncated

TOUCH_TOL = 1e-8
"""A vertex outside by at most this, in diagonals, counts as on the cage."""

MAX_OUTSIDE_SHARE = 0.5
"""With a larger share of vertices outside, none are projected: it is another model's cage."""


@dataclass(frozen=True, slots=True, eq=False)
class Enclosure:
    """A cage that encloses a model.

    Attributes
    ----------
    cage : TriMesh
        Closed, manifold, of one component, outward.
    points : (m, 3) float64
        The model's vertices; those outside are moved to the closest point of the cage.
    projected_indices : (k,) int64
        Vertices that were moved by more than rounding.
    notes : tuple of str
        Changes, one sentence each.
    """

    cage: TriMesh
    points: Floats
    projected_indices: Integers
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """The m vertices of a rest pose relative to a cage.

    Attributes
    ----------
    closest : ClosestPoints
        The closest points of the cage.
    outside : (m,) bool
        Whether a vertex is outside, even by rounding.
    tolerance : float
        Distance up to which a vertex is outside by rounding, file units.
    """

    closest: ClosestPoints
    outside: NDArray[np.bool_]
    tolerance: float

    @property
    def outside_indices(self) -> Integers:
        """Return the vertices that are outside by more than rounding, (k,)."""
        return np.flatnonzero(self.outside & (self.closest.distance > self.tolerance))


def check_enclosure(cage: TriMesh, rest: TriMesh, outside: str = "refuse") -> Enclosure:
    """Check the cage, turn it outward, and check that it encloses the rest pose.

    Parameters
    ----------
    cage, rest : TriMesh
    outside : str
        What to do with vertices outside: one of `OUTSIDE_POLICIES`.

    Raises
    ------
    CageError
        When the cage is not sound, or vertices are outside; asks whether cage and model are
        swapped if their sizes suggest it.
    """
    try:
        outward, notes = validate_cage(cage)
        return _project_outside(outward, rest, notes, outside)
    except CageError as error:
        if len(cage.vertices) <= len(rest.vertices):
            raise
        raise CageError(
            f"{error}; the cage has {len(cage.vertices)} vertices and the model "
            f"{len(rest.vertices)}: are they swapped?"
        ) from error


def locate_vertices(cage: TriMesh, rest: TriMesh) -> Placement:
    """Locate the vertices of the rest pose relative to a cage that is turned outward."""
    largest = max(np.abs(mesh.vertices).max() for mesh in (cage, rest))
    return Placement(
        closest=closest_points(cage, rest.vertices),
        outside=winding_numbers(cage, rest.vertices) < 0.5,
        tolerance=float(max(TOUCH_TOL * rest.diagonal, ROUNDING_TOL * largest)),
    )


def find_outside_vertices(placement: Placement, rest: TriMesh) -> Finding | None:
    """Return a finding of the vertices of the rest pose that are outside; None if none are."""
    outside = placement.outside_indices
    if len(outside) == 0:
        return None
    worst = outside[placement.closest.distance[outside].argmax()]
    percent = 100 * placement.closest.distance[worst] / rest.diagonal
    return Finding(
        kind="outside",
        severity="unfit",
        message=(
            f"{len(outside)} of {len(rest.vertices)} vertices of the rest pose are outside the "
            f"cage, the worst, {worst}, by {percent:.3g} % of the diagonal: numbers "
            f"{join_truncated(outside)} (from 0)"
        ),
        remedy=_likely_cause(placement.closest.mesh, rest)
        if _is_misplaced(placement)
        else "enlarge the cage there, give the rest pose it was made for, or take the "
        "nearest points of the cage with --outside project",
        elements="vertices",
        numbers=outside,
        value=float(percent),
    )


def _is_misplaced(placement: Placement) -> bool:
    """Whether so many vertices are outside that the cage must be for another rest pose."""
    return len(placement.outside_indices) > MAX_OUTSIDE_SHARE * len(placement.outside)


def _likely_cause(cage: TriMesh, rest: TriMesh) -> str:
    """Return the likely cause when most of a model is outside the cage."""
    ratio = cage.diagonal / rest.diagonal
    if not 0.2 < ratio < 5:
        return (
            f"the cage is {ratio:.3g} times as large as the model: export both in the same unit, "
            "or move the model into the cage"
        )
    low = np.maximum(cage.vertices.min(axis=0), rest.vertices.min(axis=0))
    high = np.minimum(cage.vertices.max(axis=0), rest.vertices.max(axis=0))
    if (low > high).any():
        return (
            "their bounding boxes do not overlap: move the cage to the model, or give the rest "
            "pose that it was made for"
        )
    return (
        "most of the model is outside: give the rest pose the cage was made for, or "
        "export both with the same axes and scale"
    )


def find_missing_extent(rest: TriMesh) -> Finding | None:
    """Return a finding if the rest pose has no extent, else None."""
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
    """Move vertices that are outside onto the cage; refuse large distances if `policy` says so."""
    if no_extent := find_missing_extent(rest):
        raise CageError(no_extent.sentence)
    placement = locate_vertices(cage, rest)
    if found := find_outside_vertices(placement, rest):
        if policy == "refuse" or _is_misplaced(placement):
            raise CageError(found.sentence)
        notes = (
            *notes,
            f"{found.message}; they have the weights of the nearest points of the cage",
        )
    moved = placement.outside[:, None]
    points = np.where(moved, placement.closest.position, rest.vertices)
    return Enclosure(cage, points, placement.outside_indices, notes)
