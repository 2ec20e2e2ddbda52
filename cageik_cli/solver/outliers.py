"""Vertices that are thrown away from the surface around them, as their neighbours tell.

`has_thrown_vertices` asks frames before any solve, `find_torn_vertices` the residuals of one.
"""

from collections.abc import Iterable

import numpy as np

from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.util.arrays import Floats, Mask

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


def find_torn_vertices(mesh: TriMesh, residuals: Floats, limits: Floats, is_data: Mask) -> Mask:
    """Return which vertices, (m,), are torn from the surface in a frame.

    The cage is smooth, so that residuals jump only where the data do. Where it cannot follow a
    quick motion, they are large, but grow from vertex to vertex. So an edge is torn if residuals
    differ by more than the mean of its limits along it, and vertices are if all ways to the
    largest part of their component have a torn edge. A lone vertex has no edge that tells: it is.

    Parameters
    ----------
    residuals : (m, 3) float64
        v − H c.
    limits : (m,) float64
        Lengths of residuals above which a vertex may be an outlier.
    is_data : (m,) bool
        The surface ends at vertices that are not; they are not torn.
    """
    count, ends, components = len(limits), mesh.edges.ends, mesh.components
    if not is_data.all():
        ends = ends[is_data[ends].all(axis=1)]
        components = find_groups(ends, count)
    jumps = np.diff(residuals[ends], axis=1)[:, 0]
    is_joined = np.einsum("ex,ex->e", jumps, jumps) <= limits[ends].mean(axis=1) ** 2
    parts = components if is_joined.all() else find_groups(ends[is_joined], count)
    sizes, largest = np.bincount(parts)[parts], np.zeros(count, np.int64)
    np.maximum.at(largest, components, sizes)
    largest = largest[components]
    return np.asarray(is_data & ((sizes < largest) | (largest == 1)))
