"""Vertices that are thrown away from the surface around them, as their neighbours tell."""

from collections.abc import Iterable

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

MIN_OUTLIER_RATIO = 8.0
"""Vertices are off by themselves that are off by more times as much as their neighbours."""

MIN_THROWN_PERCENT = 5.0
"""Percent of the diagonal; edges of thrown vertices change by more. In clean clips of a dancer, a
horse and a cartoon chicken no vertex does so by itself by more than 2.9 %. A vertex that is thrown
by 9 % of the diagonal is seen in 70 to 100 % of tries there, one thrown by 5 % or less hardly ever:
clean vertices come too near to that."""


def average_neighbours(mesh: TriMesh, values: Floats) -> Floats:
    """Return the mean of the values, (m,), of each vertex's neighbours; its own if it has none."""
    first, second = mesh.edges.ends.T
    own = np.concatenate([first, second])
    others = values[np.concatenate([second, first])]
    counts = np.bincount(own, minlength=len(values))
    sums = np.bincount(own, others, minlength=len(values))
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), values))


def has_thrown_vertices(mesh: TriMesh, frames: Iterable[Floats]) -> bool:
    """Return whether single vertices of frames, (m, 3) each, are thrown away from the others.

    The data alone tells, before any solve: all edges of such a vertex change their length by far
    more than some edge of each neighbour does. Limbs that bend, and surfaces that stretch as a
    whole, do not count. Nor do neighbours that are thrown together.

    Parameters
    ----------
    mesh : TriMesh
        A pose that the frames are compared with; its vertex may be the one that is thrown.
    """
    return any(_is_thrown(mesh, _measure_least_changes(mesh, frame)) for frame in frames)


def _measure_least_changes(mesh: TriMesh, frame: Floats) -> Floats:
    """Return by how much the edge of each vertex changes that changes least, (m,); 0 of none."""
    first, second = mesh.edges.ends.T
    before, after = (
        np.linalg.norm(points[first] - points[second], axis=1) for points in (mesh.vertices, frame)
    )
    least = np.full(len(mesh.vertices), np.inf)
    for ends in (first, second):
        np.minimum.at(least, ends, np.abs(after - before))
    least[~np.isfinite(least)] = 0.0
    return least


def _is_thrown(mesh: TriMesh, changes: Floats) -> bool:
    """Return whether a vertex changes by so much, and by far more than its neighbours."""
    is_large = 100 * changes > MIN_THROWN_PERCENT * mesh.diagonal
    if not is_large.any():
        return False
    around = average_neighbours(mesh, changes)
    return bool((is_large & (changes > MIN_OUTLIER_RATIO * around)).any())
