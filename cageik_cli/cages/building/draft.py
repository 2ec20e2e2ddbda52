"""A cage under edit: every edit is tested, and only those are taken that leave it sound."""

from dataclasses import dataclass

import igl
import numpy as np
from scipy.spatial import cKDTree

from cageik_cli.cages.building.apart import keep_apart
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class Edit:
    """Faces of a cage that others replace, and a vertex that moves.

    Attributes
    ----------
    removed : (r,) int64
        Numbers of faces.
    added : (a, 3) int64
        Their vertices. With the removed faces they bound a volume: both have the same border.
    vertex : int
        Which moves,
    position : (3,) float64
        and where to.
    """

    removed: Integers
    added: Integers
    vertex: int
    position: Floats


class Draft:
    """A cage that keeps its clearance to points while it is edited.

    Parameters
    ----------
    cage : TriMesh
        Closed and manifold. What is wrong with it elsewhere does not stop an edit.
    samples : (s, 3) float64
        Points it holds.
    clearance : float
        How near to them new faces may come.

    Attributes
    ----------
    vertices : (n, 3) float64
    faces : (f, 3) int64
    """

    def __init__(self, cage: TriMesh, samples: Floats, clearance: float) -> None:
        self.vertices = cage.vertices.copy()
        self.faces = cage.faces.copy()
        self.clearance = clearance
        self.samples = samples
        self._tree = cKDTree(samples)

    @property
    def count(self) -> int:
        """Return vertices that are in a face."""
        return len(np.unique(self.faces))

    def to_mesh(self) -> TriMesh:
        """Return the cage as it is, without the vertices that are in no face."""
        used, faces = np.unique(self.faces, return_inverse=True)
        return TriMesh(self.vertices[used], faces.reshape(-1, 3))

    def faces_at(self, vertex: int) -> Integers:
        """Return numbers of the faces at a vertex."""
        return np.flatnonzero((self.faces == vertex).any(axis=1))

    def neighbours(self, vertex: int) -> Integers:
        """Return the vertices that share an edge with one."""
        around = np.unique(self.faces[self.faces_at(vertex)])
        return np.asarray(around[around != vertex])

    def angles(self, edit: Edit) -> Floats:
        """Return corner angles of the faces that an edit adds, (a, 3), degrees."""
        return corner_angles(self.patch(edit))

    def angles_before(self, edit: Edit) -> Floats:
        """Return corner angles of the faces that an edit removes, (r, 3), degrees."""
        return corner_angles(TriMesh(self.vertices, self.faces[edit.removed]))

    def take(self, edit: Edit) -> bool:
        """Make the edit if the cage stays sound; return whether it was made."""
        if not (self.keeps_clear(edit) and self._stays_apart(edit)):
            return False
        self.apply(edit)
        return True

    def apply(self, edit: Edit) -> None:
        """Make the edit, untested."""
        self.vertices[edit.vertex] = edit.position
        kept = np.delete(self.faces, edit.removed, axis=0)
        self.faces = np.concatenate([kept, edit.added])

    def split(self, start: int, stop: int) -> int:
        """Put a vertex on the middle of an edge: nothing moves, nothing is to be tested."""
        middle = len(self.vertices)
        self.vertices = np.concatenate(
            [self.vertices, (self.vertices[[start]] + self.vertices[[stop]]) / 2]
        )
        at = self.faces_at(start)
        beside = at[(self.faces[at] == stop).any(axis=1)]
        one, other = self.faces[beside].copy(), self.faces[beside].copy()
        one[one == stop] = middle
        other[other == start] = middle
        self.faces = np.concatenate([np.delete(self.faces, beside, axis=0), one, other])
        return middle

    def near_samples(self, edit: Edit) -> Floats:
        """Return the samples that an edit may come near to, or leave outside, (k, 3)."""
        corners = self._corners(edit)
        low, high = corners.min(axis=0), corners.max(axis=0)
        middle, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
        near = self.samples[self._tree.query_ball_point(middle, radius + self.clearance)]
        inside = ((near > low - self.clearance) & (near < high + self.clearance)).all(axis=1)
        return np.asarray(near[inside])

    def keeps_clear(self, edit: Edit) -> bool:
        """Return whether new faces keep off the samples, and none changes sides."""
        samples = self.near_samples(edit)
        if len(samples) == 0:
            return True
        patch = self.patch(edit)
        if closest_points(patch, samples).distance.min() < self.clearance:
            return False
        # Old and new faces together bound what an edit sweeps over.
        before = TriMesh(self.vertices, self.faces[edit.removed])
        change = winding_numbers(patch, samples) - winding_numbers(before, samples)
        return bool((np.abs(change) < 0.5).all())

    def offsets(self, edit: Edit, samples: Floats) -> tuple[Floats, Floats]:
        """Return how the moved vertex moves the faces at it against samples, and what they lack.

        Returns
        -------
        (k, 3)
            The outward normal of the nearest face times the vertex's share in the nearest point.
        (k,)
            The clearance less the distance, which is negative outside.
        """
        if len(samples) == 0:
            return np.empty((0, 3)), np.empty(0)
        patch = self.patch(edit)
        signed, face, nearest, normal = igl.signed_distance(
            samples, patch.vertices, patch.faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
        )
        triangles = patch.faces[face]
        a, b, c = (np.ascontiguousarray(patch.vertices[triangles[:, k]]) for k in range(3))
        weights = igl.barycentric_coordinates(np.ascontiguousarray(nearest), a, b, c)
        # A face without area has neither: it says nothing about where to move.
        weights, normal = (np.where(np.isfinite(part), part, 0.0) for part in (weights, normal))
        moved = np.searchsorted(np.unique(edit.added), edit.vertex)
        share = (weights.reshape(-1, 3) * (triangles == moved)).sum(axis=1)
        return share[:, None] * normal, signed + self.clearance

    def patch(self, edit: Edit) -> TriMesh:
        """Return the faces that an edit adds."""
        used, faces = np.unique(edit.added, return_inverse=True)
        vertices = self.vertices[used]
        vertices[used == edit.vertex] = edit.position
        return TriMesh(vertices, faces.reshape(-1, 3))

    def _corners(self, edit: Edit) -> Floats:
        """Return all places where the edit changes something, (k, 3)."""
        around = np.unique(np.concatenate([edit.added, self.faces[edit.removed]]))
        return np.concatenate([self.vertices[around], edit.position[None]])

    def _stays_apart(self, edit: Edit) -> bool:
        """Return whether new faces meet no face but at the vertices and edges that they share."""
        vertices = self.vertices.copy()
        vertices[edit.vertex] = edit.position
        rest = np.delete(self.faces, edit.removed, axis=0)
        return keep_apart(vertices, edit.added, rest)
