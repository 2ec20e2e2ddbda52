"""Is this cage fit to hold this model? Every fault, with numbers that count from 0."""

from collections.abc import Iterator
from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.surface import (
    ROUNDING,
    NearestOnSurface,
    nearest_on_surface,
    winding_numbers,
)
from cageik_cli.errors import InputError, first_few
from cageik_cli.findings import Finding, at, plural
from cageik_cli.intersections import self_intersections
from cageik_cli.mesh import Floats, Integers, TriMesh
from cageik_cli.shape import bounds_volume, face_areas, is_flat

FLATTEST = 1e-9
"""Smallest volume of a cage over its area and diagonal; below it there is no inside."""

TOUCHING = 1e-8
"""A vertex outside by no more than this, in diagonals, is on the cage but for rounding."""

OUTSIDE = ("refuse", "project")
"""What may be done with vertices further outside."""

MISPLACED = 0.5
"""A cage with more than this share of the vertices outside is another's; they are not projected."""

_REMEDIES = {
    "repeated-vertex": "delete {it}",
    "degenerate-face": "move or merge vertices there",
    "duplicate-face": "delete {it}",
    "unreferenced-vertex": "delete {it}",
    "non-manifold-edge": "remove the inner faces",
    "open-edge": "close the hole",
    "unmerged-edge": "merge the vertices that lie at one place, then close what is left",
    "orientation": "recalculate its normals",
    "pinched-vertex": "separate them there",
    "self-intersection": "move vertices until its faces meet at common edges and corners alone",
}


@dataclass(frozen=True, slots=True, eq=False)
class Enclosure:
    """A cage that holds a model.

    Attributes
    ----------
    cage : TriMesh
        Closed, manifold, of one component, outward.
    points : (m, 3) float64
        The model's vertices, those outside moved to the nearest point of the cage.
    projected : (k,) int64
        Vertices that were moved by more than rounding.
    notes : tuple of str
        What was changed, one sentence each.
    """

    cage: TriMesh
    points: Floats
    projected: Integers
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where the m vertices of a rest pose lie against a cage.

    Attributes
    ----------
    nearest : NearestOnSurface
        The cage's nearest points.
    outside : (m,) bool
        Beyond the surface, be it by rounding.
    tolerance : float
        How far outside is rounding, file units.
    """

    nearest: NearestOnSurface
    outside: NDArray[np.bool_]
    tolerance: float

    @property
    def far(self) -> Integers:
        """The vertices that are outside by more than rounding."""
        return np.flatnonzero(self.outside & (self.nearest.distance > self.tolerance))


def check_enclosure(cage: TriMesh, rest: TriMesh, outside: str = "refuse") -> Enclosure:
    """Check the cage, turn it outward, and check that it holds every vertex of the rest pose.

    Raises
    ------
    InputError
        With what is wrong, where, and whether cage and model look swapped.
    """
    try:
        outward, notes = checked_cage(cage)
        return _held(outward, rest, notes, outside)
    except InputError as error:
        if len(cage.vertices) <= len(rest.vertices):
            raise
        raise InputError(
            f"{error}; the cage has {len(cage.vertices)} vertices and the model "
            f"{len(rest.vertices)}: are they swapped?"
        ) from error


def checked_cage(cage: TriMesh) -> tuple[TriMesh, tuple[str, ...]]:
    """The cage with its faces turned outward, and notes on what was changed.

    Raises
    ------
    InputError
        Unless the cage is a closed, manifold, consistently oriented surface of one component that
        does not cross itself, without degenerate or repeated faces and unreferenced vertices.
    """
    findings = cage_findings(cage)
    for finding in findings:
        if finding.severity == "unfit":
            raise InputError(finding.sentence)
    if findings:
        return cage.flipped(), tuple(finding.message for finding in findings)
    return cage, ()


def cage_findings(cage: TriMesh) -> tuple[Finding, ...]:
    """Everything that is wrong with a cage itself, causes before what may follow from them.

    Faces that are to be deleted (a vertex twice, a repetition) are left out of what is looked at
    after them.
    """
    corners = np.sort(cage.faces, axis=1)
    pointed = (corners[:, 1:] == corners[:, :-1]).any(axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    again = ~pointed & ~np.isin(np.arange(len(corners)), first)
    flat = is_flat(cage) & ~pointed & ~again
    lone = np.setdiff1d(np.arange(len(cage.vertices)), cage.faces)
    found = [
        _fault("repeated-vertex", "has a vertex twice in a face:", "face", pointed),
        _fault("degenerate-face", "is degenerate, corners on a line, at", "face", flat),
        _fault("duplicate-face", "has faces that repeat others:", "face", again),
        _fault(
            "unreferenced-vertex",
            "has vertices in no face, which can move nothing:",
            "vertex",
            lone,
        ),
    ]
    kept = np.flatnonzero(~(pointed | again))
    if len(kept):
        surface = TriMesh(cage.vertices, cage.faces[kept])
        # An open cage may have yet to be merged: vertices at one place are then taken as one.
        joined = surface if surface.is_closed else _merged(surface)
        found += [*_edge_findings(surface, joined), _pinch_finding(surface)]
        found += [*_part_findings(joined), *_volume_findings(surface)]
        found += [_crossing_finding(joined, kept, flat[kept])]
    return tuple(finding for finding in found if finding is not None)


def place(cage: TriMesh, rest: TriMesh) -> Placement:
    """Find where the vertices of the rest pose are, against a cage that is turned outward."""
    largest = max(np.abs(mesh.vertices).max() for mesh in (cage, rest))
    return Placement(
        nearest=nearest_on_surface(cage, rest.vertices),
        outside=winding_numbers(cage, rest.vertices) < 0.5,
        tolerance=float(max(TOUCHING * rest.diagonal, ROUNDING * largest)),
    )


def outside_finding(placement: Placement, rest: TriMesh) -> Finding | None:
    """Say which vertices of the rest pose are outside, if any are."""
    far = placement.far
    if len(far) == 0:
        return None
    worst = far[placement.nearest.distance[far].argmax()]
    percent = 100 * placement.nearest.distance[worst] / rest.diagonal
    return Finding(
        kind="outside",
        severity="unfit",
        message=(
            f"{len(far)} of {len(rest.vertices)} vertices of the rest pose are outside the cage, "
            f"the worst, {worst}, by {percent:.3g} % of the diagonal: numbers {first_few(far)} "
            "(from 0)"
        ),
        remedy=_misfit(placement.nearest.mesh, rest)
        if _is_misplaced(placement)
        else "enlarge the cage there, give the rest pose it was made for with --rest, or take the "
        "nearest points of the cage with --outside project",
        elements="vertices",
        numbers=far,
        value=float(percent),
    )


def _is_misplaced(placement: Placement) -> bool:
    """Whether so much is outside that the cage cannot have been made for this rest pose."""
    return len(placement.far) > MISPLACED * len(placement.outside)


def _misfit(cage: TriMesh, rest: TriMesh) -> str:
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
        return "their boxes do not meet: move the cage to the model, or give its --rest"
    return (
        "most of the model is outside: give the rest pose the cage was made for with --rest, or "
        "export both with the same axes and scale"
    )


def point_finding(rest: TriMesh) -> Finding | None:
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


def _held(cage: TriMesh, rest: TriMesh, notes: tuple[str, ...], allowed: str) -> Enclosure:
    """Move vertices that are outside onto the cage: by rounding, or by more if `allowed`."""
    if point := point_finding(rest):
        raise InputError(point.sentence)
    placement = place(cage, rest)
    if found := outside_finding(placement, rest):
        if allowed == "refuse" or _is_misplaced(placement):
            raise InputError(found.sentence)
        notes = (
            *notes,
            f"{found.message}; they have the weights of the nearest points of the cage",
        )
    moved = placement.outside[:, None]
    points = np.where(moved, placement.nearest.position, rest.vertices)
    return Enclosure(cage, points, placement.far, notes)


def _fault(
    kind: str, what: str, noun: str, wrong: NDArray[np.bool_] | Integers, remedy: str = ""
) -> Finding | None:
    """A fault of the cage at the elements where `wrong` is true, or that it lists; or None."""
    numbers = np.flatnonzero(wrong) if wrong.dtype == np.bool_ else wrong
    if len(numbers) == 0:
        return None
    remedy = _REMEDIES[remedy or kind].format(it="it" if len(numbers) == 1 else "them")
    message = f"the cage {what} {at(noun, numbers)}"
    return Finding(
        kind, "unfit", message, remedy, plural(noun), numbers.astype(np.int64), float(len(numbers))
    )


def _edge_findings(surface: TriMesh, joined: TriMesh) -> Iterator[Finding | None]:
    edges = surface.edges
    unmerged = "" if np.array_equal(joined.faces, surface.faces) else "unmerged-edge"
    for kind, what, bad, remedy in (
        ("non-manifold-edge", "is not manifold: more than two faces meet at", edges.uses > 2, ""),
        ("open-edge", "is open: no second face at", edges.uses < 2, unmerged),
        (
            "orientation",
            "has neighbours facing opposite ways at",
            (edges.uses == 2) & ~edges.is_balanced,
            "",
        ),
    ):
        yield _fault(kind, what, "edge", edges.ends[bad], remedy)


def _pinch_finding(surface: TriMesh) -> Finding | None:
    used = np.unique(surface.faces)
    pinched = used[~np.asarray(igl.is_vertex_manifold(surface.faces))[used]]
    return _fault(
        "pinched-vertex", "is not manifold: its parts touch in a point at", "vertex", pinched
    )


def _part_findings(surface: TriMesh) -> Iterator[Finding]:
    used = np.unique(surface.faces)
    parts, of_vertex = np.unique(surface.components[used], return_inverse=True)
    if len(parts) > 1:
        sizes = np.bincount(of_vertex)
        small = used[of_vertex != sizes.argmax()]
        yield Finding(
            kind="components",
            severity="unfit",
            message=f"the cage has {len(parts)} components (of {first_few(sizes)} vertices), "
            "expected one connected surface",
            remedy="join them or delete the loose ones",
            elements="vertices",
            numbers=small,
            value=float(len(parts)),
        )


def _volume_findings(surface: TriMesh) -> Iterator[Finding]:
    if not bounds_volume(surface):
        return
    area = face_areas(surface).sum()
    none = np.empty(0, np.int64)
    if abs(surface.volume) <= FLATTEST * area * surface.diagonal:
        yield Finding(
            kind="no-volume",
            severity="unfit",
            message=f"the cage bounds no volume ({surface.volume:.3g} in an area of {area:.3g})",
            remedy="give it thickness",
            elements="",
            numbers=none,
            value=surface.volume,
        )
    elif surface.volume < 0:
        yield Finding(
            kind="inward",
            severity="usable",
            message="the cage's faces turn inward; it is used turned outward",
            remedy="recalculate its normals to be rid of this note",
            elements="",
            numbers=none,
            value=surface.volume,
        )


def _crossing_finding(surface: TriMesh, kept: Integers, flat: NDArray[np.bool_]) -> Finding | None:
    """Faces that cross or touch; none at the vertices of faces without a plane, which do that."""
    faces = surface.faces
    judged = np.flatnonzero(~np.isin(faces, faces[flat]).any(axis=1))
    if len(judged) == 0:
        return None
    pairs = self_intersections(TriMesh(surface.vertices, faces[judged]))
    what = "crosses or touches itself at"
    return _fault("self-intersection", what, "face pair", kept[judged[pairs]])


def _merged(surface: TriMesh) -> TriMesh:
    """The same vertices, and faces that name the first of those at one place."""
    _, first, place_of = np.unique(surface.vertices, axis=0, return_index=True, return_inverse=True)
    return TriMesh(surface.vertices, first[place_of.ravel()][surface.faces])
