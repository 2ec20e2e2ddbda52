"""Distances over a surface, along its edges; components that lie close are linked.

A model of several components, such as a body and its clothes, is one thing to a person: what lies
beside the hand belongs to the hand. So vertices of different components that are close are linked,
and each component at least at the place where it is nearest to the others.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.util.arrays import Floats, Integers

MAX_LINK = 0.02
"""Vertices of different components that are this close are linked, in diagonals of the model."""

MAX_SEARCHED_GROUP = 256
"""Groups of at most this size are searched together, for the nearest vertices that are not
theirs; a larger one is searched by itself, in a tree without it."""

MAX_SEARCHED_ROWS = 4096
"""Vertices that are searched together, so that memory does not grow with the model."""


class SurfaceDistances:
    """Distances from a point of a surface to all its vertices.

    They are lengths of ways along edges, which are longer than the shortest way over the faces: by
    up to a tenth on usual meshes. Points without faces have straight distances.

    Parameters
    ----------
    mesh : TriMesh
        m vertices. Those in no face are linked as components of one vertex.

    Attributes
    ----------
    links : (q, 2) int64
        Vertices of different components that are linked.
    """

    def __init__(self, mesh: TriMesh) -> None:
        self._vertices = mesh.vertices
        self._has_faces = len(mesh.faces) > 0
        self.links = np.empty((0, 2), np.int64)
        if not self._has_faces:
            return
        ends = mesh.edges.ends
        self.links = link_components(mesh.vertices, ends, MAX_LINK * mesh.diagonal)
        self._ends = np.concatenate([ends, self.links])

    @cached_property
    def _graph(self) -> sparse.csr_array:
        first, second = self._ends.T
        lengths = np.linalg.norm(self._vertices[first] - self._vertices[second], axis=1)
        # An edge of no length would be none in a sparse graph.
        lengths = np.maximum(lengths, np.finfo(float).tiny)
        count = len(self._vertices)
        return sparse.csr_array((lengths, (first, second)), (count, count))

    def measure(self, corners: Integers, barycentric: Floats) -> Floats:
        """Return the distances, (m,), from a point of a face: its corners (3,), and shares (3,)."""
        position = barycentric @ self._vertices[corners]
        if not self._has_faces:
            return np.asarray(np.linalg.norm(self._vertices - position, axis=1))
        used = np.unique(corners[barycentric > 0])
        first = np.linalg.norm(self._vertices[used] - position, axis=1)
        ways = dijkstra(self._graph, directed=False, indices=used)
        return np.asarray((ways + first[:, None]).min(axis=0))


def link_components(vertices: Floats, ends: Integers, close: float) -> Integers:
    """Find links, (q, 2), that make one component of the vertices (m, 3) with edges (e, 2).

    In rounds, each group but the largest is linked to what is nearest to it, and wherever one of
    its vertices is closer than `close` to one that is not its own.
    """
    links = np.empty((0, 2), np.int64)
    while True:
        groups = find_groups(np.concatenate([ends, links]), len(vertices))
        sizes = np.bincount(groups)
        if len(sizes) <= 1:
            return links
        linked = ~(groups == sizes.argmax())
        distances, nearest = _find_nearest_others(vertices, groups, sizes, linked)
        least = np.full(len(sizes), np.inf)
        np.minimum.at(least, groups, distances)
        chosen = linked & (distances <= np.maximum(close, least[groups]))
        rows = np.flatnonzero(chosen)
        links = np.concatenate([links, np.stack([rows, nearest[rows]], axis=1)])


def _find_nearest_others(
    vertices: Floats, groups: Integers, sizes: Integers, searched: NDArray[np.bool_]
) -> tuple[Floats, Integers]:
    """Find the nearest vertex of another group, for each vertex that is searched.

    Returns
    -------
    distances : (m,) float64
        inf for those that are not searched.
    nearest : (m,) int64
    """
    distances, nearest = np.full(len(vertices), np.inf), np.zeros(len(vertices), np.int64)
    tree, is_small = cKDTree(vertices), sizes <= MAX_SEARCHED_GROUP
    small = np.flatnonzero(searched & is_small[groups])
    # By size, so that one query serves groups that need about as many neighbours.
    small = small[np.argsort(sizes[groups[small]], kind="stable")]
    for start in range(0, len(small), MAX_SEARCHED_ROWS):
        rows = small[start : start + MAX_SEARCHED_ROWS]
        # One more than the group has: one of them is of another.
        count = int(sizes[groups[rows]].max()) + 1
        away, found = tree.query(vertices[rows], np.arange(1, count + 1))
        away[groups[found] == groups[rows][:, None]] = np.inf
        first = away.argmin(axis=1)
        distances[rows] = away[np.arange(len(rows)), first]
        nearest[rows] = found[np.arange(len(rows)), first]
    for group in np.flatnonzero(~is_small):
        rows = np.flatnonzero(searched & (groups == group))
        others = np.flatnonzero(groups != group)
        if len(rows):
            away, found = cKDTree(vertices[others]).query(vertices[rows])
            distances[rows], nearest[rows] = away, others[found]
    return distances, nearest
