"""Tests whether a cage encloses a model: which vertices are outside, and by how much."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cageik_cli.cages.check.faults import Finding, find_cage_faults, format_elements, validate_cage
from cageik_cli.cages.check.misfit import (
    MAX_DENTED_SHARE,
    MAX_OUTSIDE_SHARE,
    OTHER_POSE_REMEDY,
    Dent,
    Misfit,
    explain_misfit,
    find_dents,
)
from cageik_cli.cages.transform import MAX_SIZE_RATIO, find_transform
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import PartShare, count_by_part, describe_by_part, name_vertex
from cageik_cli.geometry.points import PointCloud
from cageik_cli.geometry.surface import (
    SURFACE_ROUNDING_TOL,
    ClosestPoints,
    closest_points,
    winding_numbers,
)
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import MAX_LISTED, CageError, join_truncated
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.text import group_digits

TOUCH_TOL = 1e-8
"""A vertex outside by at most this, in diagonals, counts as on the cage."""


class MisfitError(CageError):
    """A cage does not fit its model, for the reason `misfit`, if it is known."""

    misfit: Misfit | None = None


class OutsideError(MisfitError):
    """Vertices of a model are outside the cage, in a `placement`, if it is known."""

    placement: "Placement | None" = None


@dataclass(frozen=True, eq=False)
class Placement:
    """The m vertices of a rest pose in a cage.

    Attributes
    ----------
    closest : ClosestPoints
        The closest points of the cage, which is turned outward.
    is_outside : (m,) bool
        Whether a vertex is outside, even by rounding.
    tolerance : float
        Distance up to which a vertex is outside by rounding, file units.
    notes : tuple of Note
        What was changed so that the cage holds the model, one sentence each.
    """

    rest: TriMesh
    closest: ClosestPoints
    is_outside: Mask
    tolerance: float
    notes: tuple[Note, ...] = ()

    @property
    def cage(self) -> TriMesh:
        """Return the cage, outward."""
        return self.closest.mesh

    @property
    def points(self) -> Floats:
        """Return the model's vertices, (m, 3); those outside at the closest points of the cage."""
        return np.where(self.is_outside[:, None], self.closest.position, self.rest.vertices)

    @property
    def clearance(self) -> Floats:
        """Return the distance of each vertex from the cage, (m,); inf of those in no face."""
        return np.where(self.rest.is_used, self.closest.distance, np.inf)

    @cached_property
    def outside_indices(self) -> Integers:
        """Return the vertices in a face that are outside by more than rounding, (k,)."""
        is_far = self.closest.distance > self.tolerance
        return np.flatnonzero(self.is_outside & self.rest.is_used & is_far)

    @property
    def outside_share(self) -> float:
        """Return the share of the vertices in a face that are outside."""
        return len(self.outside_indices) / len(self.rest.used_vertices)

    @property
    def outside_parts(self) -> list[PartShare]:
        """Return how many of these each part has, the most first; nothing for one part."""
        return count_by_part(self.rest, self.outside_indices)

    @property
    def dents(self) -> tuple[Dent, ...]:
        """Return the few cage vertices at which these come out; see `find_dents`."""
        numbers, closest = self.outside_indices, self.closest
        return find_dents(self.cage, self.rest, closest.face[numbers], closest.distance[numbers])

    def explain(self) -> Misfit:
        """Explain why these are outside."""
        worst, share = self.worst_percent, self.outside_share
        return explain_misfit(self.cage, self.rest, worst, share, self.dents)

    @property
    def is_misplaced(self) -> bool:
        """Return whether so many are outside that the cage must be for another rest pose."""
        return self.outside_share > MAX_OUTSIDE_SHARE

    @property
    def worst_vertex(self) -> int:
        """Return the vertex that is furthest outside; there is one."""
        numbers = self.outside_indices
        return int(numbers[self.closest.distance[numbers].argmax()])

    @property
    def worst_percent(self) -> float:
        """Return how far that vertex is outside, percent of the diagonal."""
        return float(100 * self.closest.distance[self.worst_vertex] / self.rest.diagonal)

    def describe_outside(self, name: str = "") -> str:
        """Say which vertices are outside, of a mesh of this name; how many, if most are."""
        owner = f" of {name}" if name else ""
        counted = (
            f"{group_digits(len(self.outside_indices))} of "
            f"{group_digits(len(self.rest.used_vertices))} vertices{owner} are "
            f"outside the cage{describe_by_part(self.outside_parts)}"
        )
        if self.is_misplaced:
            return counted
        worst = name_vertex(self.rest, self.worst_vertex)
        return (
            f"{counted}, the worst, {worst}, by {self.worst_percent:.3g} % of the diagonal: "
            f"numbers {join_truncated(self.outside_indices, MAX_LISTED)} (from 0)"
        )

    def find_outside(self, remedy: Said) -> Finding:
        """Make the finding that these vertices are outside."""
        message, numbers = self.describe_outside("the rest pose"), self.outside_indices
        place = "vertices", numbers, self.worst_percent, "rest"
        return Finding("outside", "unfit", message, remedy, *place)


def check_enclosure(cage: TriMesh, rest: TriMesh, outside: str = "refuse") -> Placement:
    """Check the cage, turn it outward, and check that it encloses the rest pose.

    Parameters
    ----------
    outside : str
        What to do with vertices outside: one of `OUTSIDE_POLICIES`.

    Raises
    ------
    CageError
        When the cage is not sound, or vertices are outside (`OutsideError`); says so if cage and
        model are swapped, and asks if their sizes suggest it.
    """
    try:
        outward, notes = validate_cage(cage)
        placement = _check_vertices(outward, rest, outside)
    except CageError as error:
        if len(cage.vertices) <= len(rest.vertices) or isinstance(rest, PointCloud):
            if not isinstance(error, MisfitError) and _is_of_other_pose(cage, rest):
                # To mend its faults would not help.
                fault = next(f for f in find_cage_faults(cage) if f.severity == "unfit")
                message = f"much of the model is far outside, and {fault.message}"
                raise CageError(message + "; " + OTHER_POSE_REMEDY) from error
            raise
        if are_swapped(cage, rest):
            raise CageError(make_swap_finding(cage, rest).sentence) from error
        swapped = type(error)(
            error.text
            + f"; the cage has {group_digits(len(cage.vertices))} vertices and the model "
            f"{len(rest.vertices)}: are they swapped?"
        )
        if isinstance(swapped, OutsideError) and isinstance(error, OutsideError):
            swapped.placement, swapped.misfit = error.placement, error.misfit
        raise swapped from error
    return replace(placement, notes=notes + placement.notes)


def _is_of_other_pose(cage: TriMesh, rest: TriMesh) -> bool:
    """Return whether a cage with faults is closed, and leaves much of the model far outside."""
    if isinstance(rest, PointCloud) or rest.diagonal <= 0 or not cage.is_closed:
        return False
    if (placement := locate_vertices(cage, rest)).outside_share <= MAX_DENTED_SHARE:
        return False
    return placement.worst_percent > 1.0  # such a cage is not merely a little too small


def are_swapped(cage: TriMesh, rest: TriMesh) -> bool:
    """Return whether a cage of more vertices than the model is inside it: each is the other."""
    is_of_its_size = rest.diagonal <= MAX_SIZE_RATIO * cage.diagonal  # else a unit is at fault
    if len(cage.vertices) <= len(rest.vertices) or not is_of_its_size:
        return False
    try:
        outward, _ = validate_cage(rest)
    except CageError:
        return False
    return not locate_vertices(outward, cage).is_misplaced


def make_swap_finding(cage: TriMesh, rest: TriMesh) -> Finding:
    """Make the finding that cage and model are swapped."""
    message = (
        f"cage and model are swapped: this mesh of {group_digits(len(cage.vertices))} vertices "
        "is inside the "
        f"other, of {len(rest.vertices)}"
    )
    remedy = say("give the other as `cage=`, and this as the model")
    return Finding("swapped", "unfit", message, remedy, value=len(cage.vertices))


def refuse_other_unit(cage: TriMesh, rest: TriMesh) -> None:
    """Refuse a cage that holds its model because it is in a smaller unit.

    Raises
    ------
    MisfitError
    """
    if cage.diagonal <= MAX_SIZE_RATIO * rest.diagonal:
        return
    transform = find_transform(cage, rest)
    if transform is None or transform.is_fitted:
        return
    ratio = cage.diagonal / rest.diagonal
    error = MisfitError(
        f"the cage is {transform.name}: it is {ratio:.3g} times as large as the model; export it "
        "as the model was"
    )
    error.misfit, error.is_repairable = Misfit(error.text, transform=transform), True
    raise error


def locate_vertices(cage: TriMesh, rest: TriMesh) -> Placement:
    """Locate the vertices of the rest pose relative to a cage that is turned outward."""
    largest = max(np.abs(mesh.vertices[mesh.used_vertices]).max() for mesh in (cage, rest))
    return Placement(
        rest=rest,
        closest=closest_points(cage, rest.vertices),
        is_outside=winding_numbers(cage, rest.vertices) < 0.5,
        tolerance=float(max(TOUCH_TOL * rest.diagonal, SURFACE_ROUNDING_TOL * largest)),
    )


def describe_unused_vertices(rest: TriMesh) -> tuple[Note, ...]:
    """Return a note on the vertices of the model that are in no face, if there are any."""
    numbers = rest.unused_vertices
    if len(numbers) == 0:
        return ()
    is_one = len(numbers) == 1
    subject = "it gets weight 0, is" if is_one else "they get weight 0, are"
    return (
        Note(
            f"{format_elements('vertex', numbers)} of the model {'is' if is_one else 'are'} in no "
            f"face: {subject} deformed, and left out of all figures"
        ),
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


def _check_vertices(cage: TriMesh, rest: TriMesh, policy: str) -> Placement:
    """Locate the vertices; refuse those outside if the policy says so, or they are too many."""
    if no_extent := find_missing_extent(rest):
        raise CageError(no_extent.sentence)
    placement = locate_vertices(cage, rest)
    notes = describe_unused_vertices(rest)
    if len(placement.outside_indices):
        if policy == "refuse" or placement.is_misplaced:
            misfit = placement.explain()
            error = OutsideError(placement.find_outside(misfit.remedy).sentence)
            error.placement, error.misfit = placement, misfit
            error.is_repairable = misfit.is_repairable
            raise error
        moved = placement.closest.distance[placement.outside_indices]
        rms = 100 * np.sqrt((moved**2).sum() / len(rest.used_vertices)) / rest.diagonal
        notes = (
            *notes,
            Note(
                f"{placement.describe_outside('the model')}; they have the weights of the nearest "
                f"points of the cage; that alone is an error of {rms:.2g} % of the diagonal "
                "(rms), in the rest pose too"
            ),
        )
    return replace(placement, notes=notes)
