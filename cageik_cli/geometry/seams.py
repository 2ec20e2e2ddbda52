"""Seams: vertices that are at one place at rest and in frames, split for texture or normals.

They are one vertex for whatever neighbours and motion decide, such as fitted weights. What is found
for one of them is that of all, so that a surface does not crack along its seams.
"""

from collections.abc import Iterable

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.text import format_count

REST_SEAM_TOL = 1e-7
"""Vertices this near at rest may be one, in diagonals: they are equal but for rounding."""

MAX_NEAR_PAIRS = 10
"""Pairs of places that may be one by rounding, per place; where there are more, points are denser
than the tolerance, and only equal ones are one."""

FRAME_SEAM_TOL = 1e-6
"""Vertices farther apart in a frame are not one, in diagonals at rest: single precision is finer
unless a clip is far from the origin."""


class Seams:
    """Which vertices of a mesh are one.

    Attributes
    ----------
    firsts : (k,) int64
        The first vertex at each place, ascending.
    places : (m,) int64
        Which of these each vertex is.
    """

    def __init__(self, mesh: TriMesh, owners: Integers) -> None:
        """Take the first of the vertices that are one with each vertex, `owners` (m,)."""
        self._mesh = mesh
        self.firsts, self.places = np.unique(owners, return_inverse=True)

    @staticmethod
    def find(mesh: TriMesh, frames: Iterable[Floats]) -> "Seams | None":
        """Find the vertices that are at one place at rest and in all frames, (m, 3) each.

        None without any. No frame is read where no vertices meet at rest. A vertex that is missing
        (nan) in a frame says nothing of it.
        """
        from scipy import sparse
        from scipy.spatial import cKDTree

        m, diagonal = len(mesh.vertices), mesh.diagonal
        # Equal ones first: a thousand that are collapsed to a point make a million pairs.
        points, labels = np.unique(mesh.vertices, axis=0, return_inverse=True)
        labels = labels.reshape(-1)
        tree, near = cKDTree(points), REST_SEAM_TOL * diagonal
        if len(points) < tree.count_neighbors(tree, near) <= MAX_NEAR_PAIRS * len(points):
            pairs = tree.query_pairs(near, output_type="ndarray")
            links = np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])
            graph = sparse.coo_array(links, shape=(len(points), len(points)))
            labels = sparse.csgraph.connected_components(graph, directed=False)[1][labels]
        owners = _find_firsts(labels)
        if (owners == np.arange(m)).all():
            return None
        for frame in frames:
            owners = _split_apart(owners, frame, FRAME_SEAM_TOL * diagonal)
            if (owners == np.arange(m)).all():
                return None
        return Seams(mesh, owners)

    @property
    def note(self) -> str:
        """A sentence that counts the vertices."""
        copies = np.bincount(self.places)
        found = format_count(int(copies[copies > 1].sum()), "vertex")
        places = format_count(int((copies > 1).sum()), "place")
        return (
            f"{found} at {places} never come apart, as along seams of texture: those of a place "
            "have the same weights"
        )

    def weld(self) -> TriMesh:
        """Return the mesh with one vertex for those that are one, and without the surface's layers.

        Triangles that have two corners at one place are left out.
        """
        faces = self.places[self._mesh.faces]
        is_whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        return TriMesh(self._mesh.vertices[self.firsts], faces[is_whole])

    def sum_weights(self, weights: Floats) -> Floats:
        """Return weights of vertices, (m,), as those of the welded mesh, (k,), of mean one."""
        sums = np.bincount(self.places, weights)
        return np.asarray(sums / sums.mean())


def _find_firsts(labels: Integers) -> Integers:
    """Return the first vertex with the label of each vertex, (m,)."""
    _, firsts, places = np.unique(labels, return_index=True, return_inverse=True)
    return np.asarray(firsts[places])


def _split_apart(owners: Integers, frame: Floats, distance: float) -> Integers:
    """Return the first of the vertices that each is one with, also in a frame."""
    owners, number = owners.copy(), np.arange(len(owners))
    waiting = np.flatnonzero(owners != number)
    while len(waiting):
        apart = np.square(frame[waiting] - frame[owners[waiting]]).sum(axis=1)
        leaving = waiting[apart > distance**2]
        # Those that leave a place together may still be one: they are compared with their first.
        before = owners[leaving]
        _, firsts, groups = np.unique(before, return_index=True, return_inverse=True)
        owners[leaving] = leaving[firsts[groups]]
        waiting = leaving[owners[leaving] != leaving]
    return owners
