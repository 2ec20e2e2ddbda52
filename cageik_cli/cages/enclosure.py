"""Tests whether a cage encloses a model: which vertices are outside, and by how much."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.cages.findings import Finding, format_elements
from cageik_cli.cages.misfit import MAX_OUTSIDE_SHARE, explain_misfit
from cageik_cli.cages.soundness import validate_cage
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import PointCloud
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

REST_NAME = "the rest pose"
"""What messages call the model."""


class OutsideError(CageError):
    """Vertices of a model are outside the cage.

    Attributes
    ----------
    outside : OutsideVertices, optional
        Which; unknown once the error has got a context.
    """

    outside: "OutsideVertices | None" = None


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
class OutsideVertices:
    """The vertices of a model that are outside its cage, by more than rounding.

    Attributes
    ----------
    numbers : (k,) int64
    count : int
        Of all vertices of the model that are in a face.
    worst : int
        The one that is furthest outside.
    percent : float
        By how much, percent of the diagonal.
    """

    numbers: Integers
    count: int
    worst: int
    percent: float

    @property
    def share(self) -> float:
        """The share of the vertices."""
        return len(self.numbers) / self.count

    @property
    def is_misplaced(self) -> bool:
        """Whether so many are outside that the cage must be for another rest pose."""
        return self.share > MAX_OUTSIDE_SHARE

    def describe(self, name: str = "") -> str:
        """Say which vertices they are, of a mesh of this name."""
        owner = f" of {name}" if name else ""
        return (
            f"{len(self.numbers)} of {self.count} vertices{owner} are outside the cage, the "
            f"worst, {self.worst}, by {self.percent:.3g} % of the diagonal: numbers "
            f"{join_truncated(self.numbers)} (from 0)"
        )

    def make_finding(self, remedy: str) -> Finding:
        """Make the finding of a check."""
        return Finding(
            kind="outside",
            severity="unfit",
            message=self.describe(REST_NAME),
            remedy=remedy,
            elements="vertices",
            numbers=self.numbers,
            value=self.percent,
            mesh="rest",
        )


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """The m vertices of a rest pose relative to a cage.

    Attributes
    ----------
    closest : ClosestPoints
        The closest points of the cage.
    outside : (m,) bool
        Whether a vertex is outside, even by rounding.
    is_tested : (m,) bool
        Whether a vertex is in a face: the others may be anywhere.
    tolerance : float
        Distance up to which a vertex is outside by rounding, file units.
    """

    closest: ClosestPoints
    outside: NDArray[np.bool_]
    is_tested: NDArray[np.bool_]
    tolerance: float

    @property
    def outside_indices(self) -> Integers:
        """Return the tested vertices that are outside by more than rounding, (k,)."""
        is_far = self.closest.distance > self.tolerance
        return np.flatnonzero(self.outside & self.is_tested & is_far)

    @property
    def clearance(self) -> Floats:
        """Return the distance of each vertex from the cage, (m,); inf of those not tested."""
        return np.where(self.is_tested, self.closest.distance, np.inf)


def check_enclosure(cage: TriMesh, rest: TriMesh, outside: str = "refuse") -> Enclosure:
    """Check the cage, turn it outward, and check that it encloses the rest pose.

    Parameters
    ----------
    outside : str
        What to do with vertices outside: one of `OUTSIDE_POLICIES`.

    Raises
    ------
    CageError
        When the cage is not sound, or vertices are outside (`OutsideError`); asks whether cage and
        model are swapped if their sizes suggest it.
    """
    try:
        outward, notes = validate_cage(cage)
        return _project_outside(outward, rest, notes, outside)
    except CageError as error:
        if len(cage.vertices) <= len(rest.vertices) or isinstance(rest, PointCloud):
            raise
        swapped = type(error)(
            f"{error}; the cage has {len(cage.vertices)} vertices and the model "
            f"{len(rest.vertices)}: are they swapped?"
        )
        if isinstance(swapped, OutsideError) and isinstance(error, OutsideError):
            swapped.outside = error.outside
        raise swapped from error


def locate_vertices(cage: TriMesh, rest: TriMesh) -> Placement:
    """Locate the vertices of the rest pose relative to a cage that is turned outward."""
    largest = max(np.abs(mesh.vertices[mesh.used_vertices]).max() for mesh in (cage, rest))
    return Placement(
        closest=closest_points(cage, rest.vertices),
        outside=winding_numbers(cage, rest.vertices) < 0.5,
        is_tested=rest.is_used,
        tolerance=float(max(TOUCH_TOL * rest.diagonal, ROUNDING_TOL * largest)),
    )


def find_outside_vertices(placement: Placement, rest: TriMesh) -> OutsideVertices | None:
    """Find the vertices of the rest pose that are outside; None if none are."""
    numbers = placement.outside_indices
    if len(numbers) == 0:
        return None
    worst = numbers[placement.closest.distance[numbers].argmax()]
    percent = 100 * placement.closest.distance[worst] / rest.diagonal
    return OutsideVertices(numbers, len(rest.used_vertices), int(worst), float(percent))


def describe_unused_vertices(rest: TriMesh) -> tuple[str, ...]:
    """Return a note on the vertices of the model that are in no face, if there are any."""
    numbers = rest.unused_vertices
    if len(numbers) == 0:
        return ()
    is_one = len(numbers) == 1
    subject = "it gets weight 0, is" if is_one else "they get weight 0, are"
    return (
        f"{format_elements('vertex', numbers)} of the model {'is' if is_one else 'are'} in no "
        f"face: {subject} deformed, and left out of all figures",
    )


def find_missing_extent(rest: TriMesh) -> Finding | None:
    """Return a finding if the rest pose has no extent, else None."""
    if rest.diagonal > 0:
        return None
    message, remedy = "the rest pose is one point, expected a surface", "export it again"
    if isinstance(rest, PointCloud):
        message = "all points of the model are at one place"
        remedy = "add a point that is elsewhere"
    return Finding("point", "unfit", message, remedy)


def _project_outside(
    cage: TriMesh, rest: TriMesh, notes: tuple[str, ...], policy: str
) -> Enclosure:
    """Move vertices that are outside onto the cage; refuse large distances if `policy` says so."""
    if no_extent := find_missing_extent(rest):
        raise CageError(no_extent.sentence)
    placement = locate_vertices(cage, rest)
    notes += describe_unused_vertices(rest)
    if outside := find_outside_vertices(placement, rest):
        if policy == "refuse" or outside.is_misplaced:
            raise _make_outside_error(cage, rest, outside)
        notes = (
            *notes,
            f"{outside.describe('the model')}; they have the weights of the nearest points of the "
            f"cage; that alone is an error of {_measure_projection(placement, rest):.2g} % of the "
            "diagonal (rms), in the rest pose too",
        )
    moved = placement.outside[:, None]
    points = np.where(moved, placement.closest.position, rest.vertices)
    return Enclosure(cage, points, placement.outside_indices, notes)


def _measure_projection(placement: Placement, rest: TriMesh) -> float:
    """Return the rms over all vertices of how far they are projected, percent of the diagonal."""
    moved = placement.closest.distance[placement.outside_indices]
    return float(100 * np.sqrt((moved**2).sum() / len(rest.used_vertices)) / rest.diagonal)


def _make_outside_error(cage: TriMesh, rest: TriMesh, outside: OutsideVertices) -> OutsideError:
    misfit = explain_misfit(cage, rest, outside.percent, outside.share)
    error = OutsideError(outside.make_finding(misfit.remedy).sentence)
    error.outside, error.is_repairable = outside, misfit.is_repairable
    return error
