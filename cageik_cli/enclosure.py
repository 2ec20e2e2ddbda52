"""Is this cage fit to hold this model? Every check, with numbers that count from 0."""

from collections.abc import Sequence
from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.surface import nearest_on_surface, winding_numbers
from cageik_cli.errors import InputError, first_few
from cageik_cli.mesh import Floats, Integers, TriMesh

THINNEST = 1e-9
"""Smallest altitude of a cage face over its longest side; below it the face has no plane."""

TOUCHING = 1e-8
"""A vertex outside by no more than this, in diagonals, is on the cage but for rounding."""

OUTSIDE = ("refuse", "project")
"""What may be done with vertices further outside."""


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
        Unless the cage is a closed, manifold, consistently oriented surface of one component,
        without degenerate or repeated faces and unreferenced vertices.
    """
    _refuse_bad_faces(cage)
    _refuse_bad_vertices(cage)
    _refuse_bad_edges(cage)
    pinched = np.flatnonzero(~np.asarray(igl.is_vertex_manifold(cage.faces)))
    if len(pinched):
        raise InputError(
            "the cage is not manifold: its parts touch in a point at "
            f"{_listed('vertex', pinched)}; separate them there"
        )
    count = int(cage.components.max()) + 1
    if count > 1:
        sizes = ", ".join(map(str, np.bincount(cage.components)))
        raise InputError(
            f"the cage has {count} components (of {sizes} vertices), expected one connected "
            "surface; join them or delete the loose ones"
        )
    if cage.volume < 0:
        return cage.flipped(), ("the cage's faces turn inward; it is used turned outward",)
    return cage, ()


def _held(cage: TriMesh, rest: TriMesh, notes: tuple[str, ...], allowed: str) -> Enclosure:
    """Move vertices that are outside onto the cage: by rounding, or by more if `allowed`."""
    nearest = nearest_on_surface(cage, rest.vertices)
    outside = winding_numbers(cage, rest.vertices) < 0.5
    distance = np.where(outside, nearest.distance, 0.0)
    far = np.flatnonzero(distance > TOUCHING * rest.diagonal)
    if len(far):
        worst = 100 * distance.max() / rest.diagonal
        found = (
            f"{len(far)} of {len(rest.vertices)} vertices of the rest pose are outside the cage, "
            f"the worst by {worst:.3g} % of the diagonal: numbers {first_few(far)} (from 0)"
        )
        if allowed == "refuse":
            raise InputError(
                f"{found}; enlarge the cage there, give the rest pose it was made for with "
                "--rest, or take the nearest points of the cage with --outside project"
            )
        notes = (*notes, f"{found}; they have the weights of the nearest points of the cage")
    points = np.where(outside[:, None], nearest.position, rest.vertices)
    return Enclosure(cage, points, far, notes)


def _refuse_bad_faces(cage: TriMesh) -> None:
    faces = np.sort(cage.faces, axis=1)
    repeated = (faces[:, 1:] == faces[:, :-1]).any(axis=1)
    if repeated.any():
        raise InputError(
            "the cage has a vertex twice in a face: delete "
            f"{_listed('face', np.flatnonzero(repeated))}"
        )
    corner = cage.vertices[cage.faces]
    sides = corner - np.roll(corner, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    flat = np.flatnonzero(~(twice_area > THINNEST * longest**2))
    if len(flat):
        raise InputError(
            f"the cage is degenerate, corners on a line, at {_listed('face', flat)}; "
            "move or merge vertices there"
        )
    _, first, count = np.unique(faces, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        again = np.setdiff1d(np.arange(len(faces)), first)
        raise InputError(f"the cage has faces that repeat others: delete {_listed('face', again)}")


def _refuse_bad_vertices(cage: TriMesh) -> None:
    lone = np.setdiff1d(np.arange(len(cage.vertices)), cage.faces)
    if len(lone):
        raise InputError(
            "the cage has vertices in no face, which can move nothing: delete "
            f"{_listed('vertex', lone)}"
        )


def _refuse_bad_edges(cage: TriMesh) -> None:
    edges = cage.edges
    for bad, what, remedy in (
        (edges.uses > 2, "is not manifold: more than two faces meet", "remove the inner faces"),
        (edges.uses < 2, "is open: no second face", "close the hole"),
        (~edges.is_balanced, "has neighbours facing opposite ways", "recalculate its normals"),
    ):
        if bad.any():
            pairs = [f"{a}-{b}" for a, b in edges.ends[bad]]
            raise InputError(f"the cage {what} at {_listed('edge', pairs)}; {remedy}")


def _listed(noun: str, things: Sequence[object] | NDArray[np.int64]) -> str:
    """Such as `face 12` or `3 edges (1-3, 3-7, 1-7)`."""
    if len(things) == 1:
        return f"{noun} {things[0]}"
    plural = {"vertex": "vertices"}.get(noun, noun + "s")
    return f"{len(things)} {plural} ({first_few(things)})"
