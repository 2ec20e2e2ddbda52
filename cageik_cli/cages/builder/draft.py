"""A cage under edit: every edit is tested, and only those are taken that leave it sound.

The tests are exact, and quick for the handful of faces that an edit changes.
"""

from dataclasses import dataclass

import igl
import igl.predicates
import numpy as np

from cageik_cli.cages.builder.frame import MIN_PLANE_DISTANCE, find_partners, reflect
from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import cross, measure_angles
from cageik_cli.geometry.surface import measure_closest, measure_winding
from cageik_cli.util.arrays import Floats, Integers, Mask

MIN_FOLD_COSINE = -0.94
"""Between the normals of two faces at a side, at least: they are 20 degrees apart, and no fin."""

Edge = tuple[int, int]
"""Two vertices, the lower first."""

MIN_KEPT_ANGLE = 10.0
"""Degrees that new faces keep where vertices are taken away, unless the old ones had less."""


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
    kept : set of Edge
        Edges that no edit takes away, and no split divides.

    Attributes
    ----------
    vertices : (n, 3) float64
    faces : (f, 3) int64
    volume : float
        Of the cage as it was given.
    """

    def __init__(
        self, cage: TriMesh, samples: Floats, clearance: float, kept: frozenset[Edge] = frozenset()
    ) -> None:
        self.volume = cage.volume
        self.vertices = cage.vertices.copy()
        self.faces = cage.faces.copy()
        self.clearance = clearance
        self.samples = samples
        self._kept, self._held = kept, {vertex for edge in kept for vertex in edge}
        self._order = np.argsort(samples[:, 0], kind="stable")
        self._columns = np.ascontiguousarray(samples[self._order].T)

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

    def faces_at_edge(self, start: int, stop: int) -> Integers:
        """Return numbers of the faces at an edge, or at a pair of vertices."""
        at = self.faces_at(start)
        return np.asarray(at[(self.faces[at] == stop).any(axis=1)])

    def count_faces(self) -> Integers:
        """Return how many faces each vertex has, (n,), which are as many as its edges."""
        return np.bincount(self.faces.ravel(), minlength=len(self.vertices))

    def neighbours(self, vertex: int) -> Integers:
        """Return the vertices that share an edge with one."""
        around = np.unique(self.faces[self.faces_at(vertex)])
        return np.asarray(around[around != vertex])

    def angles(self, edit: Edit) -> Floats:
        """Return corner angles of the faces that an edit adds, (a, 3), degrees."""
        return measure_angles(self._place_corners(edit))

    def angles_before(self, edit: Edit) -> Floats:
        """Return corner angles of the faces that an edit removes, (r, 3), degrees."""
        return measure_angles(self.vertices[self.faces[edit.removed]])

    def growth(self, edit: Edit) -> float:
        """Return the volume that an edit adds, negative where it takes some away."""
        # Seen from the vertex, the tetrahedra are as small as the edit.
        here = self.vertices[edit.vertex]
        before, after = self.vertices[self.faces[edit.removed]], self._place_corners(edit)
        volumes = [np.linalg.det(corners - here).sum() / 6 for corners in (before, after)]
        return float(volumes[1] - volumes[0])

    def take(self, edit: Edit) -> bool:
        """Make the edit if the cage stays sound; return whether it was made."""
        if not self.allows(edit):
            return False
        self.apply(edit)
        return True

    def allows(self, edit: Edit) -> bool:
        """Return whether the cage stays sound by an edit.

        No edge that is kept is taken away, no two faces at a side are folded onto each other more
        than before, and new faces meet others only at the vertices and edges that they share.
        """
        if self._kept:
            before, after = (
                {name_edge(face[k - 1], face[k]) for face in faces.tolist() for k in range(3)}
                for faces in (self.faces[edit.removed], edit.added)
            )
            if (before & self._kept) - after:
                return False
        vertices = self.vertices.copy()
        vertices[edit.vertex] = edit.position
        rest = np.delete(self.faces, edit.removed, axis=0)
        beside = rest[np.isin(rest, edit.added).sum(axis=1) >= 2]
        fold = _find_sharpest_fold(vertices, edit.added, beside)
        is_open = fold >= MIN_FOLD_COSINE or fold >= _find_sharpest_fold(
            self.vertices, self.faces[edit.removed], beside
        )
        return (
            is_open and self.keeps_clear(edit) and are_intersection_free(vertices, edit.added, rest)
        )

    def is_divisible(self, start: int, stop: int) -> bool:
        """Return whether an edge may be split: not between vertices of kept edges."""
        return not {start, stop} <= self._held

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
        beside = self.faces_at_edge(start, stop)
        one, other = self.faces[beside].copy(), self.faces[beside].copy()
        one[one == stop] = middle
        other[other == start] = middle
        self.faces = np.concatenate([np.delete(self.faces, beside, axis=0), one, other])
        return middle

    def count_split(self, start: int, stop: int) -> int:
        """Return how many vertices a split of an edge adds."""
        return 1

    def near_samples(self, edit: Edit) -> Floats:
        """Return the samples that an edit may come near to, or leave outside, (k, 3)."""
        around = np.concatenate([edit.added.ravel(), self.faces[edit.removed].ravel()])
        corners = np.concatenate([self.vertices[around], edit.position[None]])
        low, high = corners.min(axis=0) - self.clearance, corners.max(axis=0) + self.clearance
        start = int(self._columns[0].searchsorted(low[0], "right"))
        stop = int(self._columns[0].searchsorted(high[0], "left"))
        y, z = self._columns[1:, start:stop]
        is_near = (y > low[1]) & (y < high[1]) & (z > low[2]) & (z < high[2])
        return np.asarray(self.samples[np.sort(self._order[start:stop][is_near])])

    def keeps_clear(self, edit: Edit) -> bool:
        """Return whether new faces keep off the samples, and none changes sides."""
        samples = self.near_samples(edit)
        if len(samples) == 0:
            return True
        if self.measure_distances(edit, samples).min() < self.clearance:
            return False
        return not self._find_swept(edit, samples).any()

    def offsets(self, edit: Edit, samples: Floats) -> tuple[Floats, Floats]:
        """Return how the moved vertex moves the faces at it against samples, and what they lack.

        Returns
        -------
        (k, 3)
            The outward direction at the nearest point, times the vertex's share in that point.
        (k,)
            The clearance less the distance, which is negative outside.
        """
        if len(samples) == 0:
            return np.empty((0, 3)), np.empty(0)
        distance, face, position = self._find_closest(edit, samples)
        # A sample that the edit sweeps over is outside now, and the face must come back to it.
        sign = np.where(self._find_swept(edit, samples), 1.0, -1.0)
        towards = (sign / np.maximum(distance, 1e-300))[:, None]
        direction = towards * (samples - position)
        share = self._measure_shares(edit, face, position)
        return share[:, None] * direction, sign * distance + self.clearance

    def measure_distances(self, edit: Edit, samples: Floats) -> Floats:
        """Return how far samples are from the faces that an edit adds, (k,)."""
        return self._find_closest(edit, samples)[0]

    def _find_closest(self, edit: Edit, samples: Floats) -> tuple[Floats, Integers, Floats]:
        """Return the distances, faces and positions on the faces that an edit adds."""
        corners = self._place_corners(edit).reshape(-1, 3)
        return measure_closest(corners, np.arange(len(corners)).reshape(-1, 3), samples)

    def _measure_shares(self, edit: Edit, face: Integers, at: Floats) -> Floats:
        """Return the barycentric share of the moved vertex in points of the added faces, (k,)."""
        is_moved = edit.added == edit.vertex
        turned = np.take_along_axis(
            edit.added, (is_moved.argmax(axis=1)[:, None] + np.arange(3)) % 3, axis=1
        )
        b, c = (self.vertices.take(turned[:, k], axis=0) for k in (1, 2))
        normal = cross(b - edit.position, c - edit.position)
        square = (normal * normal).sum(axis=1)
        # A face without area, or without the vertex, says nothing about where to move.
        known = is_moved.any(axis=1) & (square > 1e-300)
        normal = np.where(known[:, None], normal, 0) / np.where(known, square, 1)[:, None]
        b, c = (corner.take(face, axis=0) for corner in (b, c))
        return np.asarray((normal[face] * cross(b - at, c - at)).sum(axis=1))

    def _find_swept(self, edit: Edit, samples: Floats) -> Mask:
        """Return the samples that an edit sweeps over: old and new faces together bound that."""
        vertices = np.concatenate([self.vertices, edit.position[None]])
        added = np.where(edit.added == edit.vertex, len(self.vertices), edit.added)
        faces = np.concatenate([added, self.faces[edit.removed][:, ::-1]])
        return np.abs(measure_winding(vertices, faces, samples)) >= 0.5

    def _place_corners(self, edit: Edit) -> Floats:
        """Return the corners of the faces that an edit adds, (a, 3, 3)."""
        corners = self.vertices.take(edit.added, axis=0)
        corners[edit.added == edit.vertex] = edit.position
        return corners


class PairedDraft(Draft):
    """A draft that makes every edit on both sides of the plane, or on none.

    Parameters are those of `Draft`; the cage and the samples are their own mirror images.
    """

    def __init__(self, cage: TriMesh, samples: Floats, clearance: float, axis: int) -> None:
        super().__init__(cage, samples, clearance)
        self._axis = axis
        self._partner = find_partners(cage.vertices, axis)

    def take(self, edit: Edit) -> bool:
        """Make the edit and its mirror image if the cage stays sound; return whether it did."""
        before = self.vertices, self.faces
        self.vertices = self.vertices.copy()
        if self._take_both(edit):
            return True
        self.vertices, self.faces = before
        return False

    def split(self, start: int, stop: int) -> int:
        """Put vertices on the middles of an edge and of its mirror image."""
        first, second = self._partner[[start, stop]].tolist()
        middle = super().split(start, stop)
        self._partner = np.append(self._partner, middle)
        if self.count_split(start, stop) == 2:
            image = super().split(first, second)
            self._partner[middle] = image
            self._partner = np.append(self._partner, middle)
        return middle

    def count_split(self, start: int, stop: int) -> int:
        """Return 1 for an edge on the plane, else 2: its mirror image is split, too."""
        return 1 if {*self._partner[[start, stop]].tolist()} == {start, stop} else 2

    def _take_both(self, edit: Edit) -> bool:
        """Make the edit and then its image; what was made stays if the other is not sound."""
        vertex, partner = edit.vertex, int(self._partner[edit.vertex])
        gone = np.setdiff1d(self.faces[edit.removed], edit.added)
        if partner == vertex:
            position = np.where(np.arange(3) == self._axis, 0.0, edit.position)
            edit = Edit(edit.removed, edit.added, vertex, position)
            if self.angles(edit).min() < min(MIN_KEPT_ANGLE, self.angles_before(edit).min()):
                return False
        else:
            side = np.sign(self.vertices[vertex, self._axis])
            leaves_side = side * edit.position[self._axis] < MIN_PLANE_DISTANCE
            if leaves_side or (self._partner[gone] == gone).any():
                return False
        images = self._partner[self.faces[edit.removed]]
        is_own_image = set(_find_rows(self.faces, images)) == set(edit.removed.tolist())
        if is_own_image and len(edit.removed) == 2:
            return False  # an edge on the plane that is flipped crosses it
        is_move = np.array_equal(edit.added, self.faces[edit.removed])
        if not super().take(edit):
            return False
        if is_own_image:
            return True
        position = reflect(edit.position, self._axis)
        if is_move:
            return super().take(move_vertex(self, partner, position))
        if len(gone):
            image = collapse_edge(self, partner, int(self._partner[gone[0]]), position)
        else:
            added = self._partner[edit.added][:, ::-1]
            removed = np.array(_find_rows(self.faces, images))
            image = Edit(removed, added, partner, position)
        if image is None or not super().take(image):
            return False
        edges = TriMesh(self.vertices, self.faces).edges
        return bool((edges.face_counts == 2).all() and edges.is_balanced.all())


def _find_rows(faces: Integers, wanted: Integers) -> list[int]:
    """Return numbers of the faces that have the vertices of those wanted, in any order."""
    known = {tuple(face): number for number, face in enumerate(np.sort(faces, axis=1).tolist())}
    return [known[tuple(face)] for face in np.sort(wanted, axis=1).tolist()]


def move_vertex(draft: Draft, vertex: int, position: Floats) -> Edit:
    """Move a vertex."""
    around = draft.faces_at(vertex)
    return Edit(around, draft.faces[around], vertex, position)


def flip_edge(draft: Draft, start: int, stop: int) -> Edit | None:
    """Put the other diagonal in the place of an edge; None if that is an edge already."""
    beside = draft.faces_at_edge(start, stop)
    if len(beside) != 2:
        return None
    corners = draft.faces[beside]
    across = corners[(corners != start) & (corners != stop)].tolist()
    if across[0] == across[1] or across[1] in draft.neighbours(across[0]):
        return None
    # The first face has the edge forward or backward; its orientation is handed on.
    face = draft.faces[beside[0]].tolist()
    forward = face[(face.index(start) + 1) % 3] == stop
    a, b = (start, stop) if forward else (stop, start)
    added = np.array([[across[0], a, across[1]], [across[1], b, across[0]]])
    return Edit(beside, added, start, draft.vertices[start])


def collapse_edge(draft: Draft, start: int, stop: int, position: Floats) -> Edit | None:
    """Merge the end of an edge into its start; None if the surface would not stay manifold."""
    common = np.intersect1d(draft.neighbours(start), draft.neighbours(stop))
    if len(common) != 2 or len(draft.faces) <= 4:
        return None
    if min(len(draft.faces_at(vertex)) for vertex in common) <= 3:
        return None
    removed = np.union1d(draft.faces_at(start), draft.faces_at(stop))
    added = np.where(draft.faces[removed] == stop, start, draft.faces[removed])
    added = added[(added == start).sum(axis=1) == 1]
    return Edit(removed, added, start, position)


def name_edge(start: int, stop: int) -> Edge:
    """Return an edge, whichever of its ends is given first."""
    return (start, stop) if start < stop else (stop, start)


def _find_sharpest_fold(vertices: Floats, faces: Integers, beside: Integers) -> float:
    """Return the least cosine between normals of `faces`, and of these and others at a side."""
    others = np.concatenate([faces, beside])
    corners = vertices[others]
    normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    shared = (faces[:, None, :, None] == others[None, :, None]).any(axis=3).sum(axis=2)
    cosines = normals[: len(faces)] @ normals.T
    return float(cosines[shared == 2].min(initial=1.0))


def are_intersection_free(vertices: Floats, added: Integers, others: Integers) -> bool:
    """Return whether `added` faces meet each other and `others` at shared vertices alone.

    It is exact, and quick for a handful of faces. What is left to `geometry/intersections.py`,
    which has the full answer, is faces that share a plane.
    """
    faces = np.concatenate([added, others])
    corners = vertices[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    count = len(added)
    near = (low[:count, None] <= high).all(axis=2) & (low <= high[:count, None]).all(axis=2)
    near &= np.arange(count)[:, None] < np.arange(len(faces))
    first, second = np.nonzero(near)
    shared = _shares_corner(faces[first], faces[second]).sum(axis=1)
    if (shared == 3).any():
        return False
    # Faces that share a side may not lie in a plane, on one side of it.
    beside, others = faces[first[shared == 2]], faces[second[shared == 2]]
    a, tip = vertices[beside], vertices[others[~_shares_corner(others, beside)]]
    flat = _orient(a[:, 0], a[:, 1], a[:, 2], tip) == 0
    if flat.any():
        pair = a[flat], vertices[others[flat]]
        one, other = (np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in pair)
        if ((one * other).sum(axis=1) <= 0).any():
            return False
    return not _any_pierces(vertices, faces, first[shared < 2], second[shared < 2])


def _shares_corner(faces: Integers, others: Integers) -> Mask:
    """Return which corners of faces, (k, c), are vertices of others, (k, 3), row by row."""
    return np.asarray((faces[:, :, None] == others[:, None]).any(axis=2))


def _any_pierces(vertices: Floats, faces: Integers, first: Integers, second: Integers) -> bool:
    """Return whether a side of one face meets the other, away from vertices that both have."""
    sides, triangles = [], []
    for one, other in ((faces[first], faces[second]), (faces[second], faces[first])):
        for k in range(3):
            side = one[:, [k, k - 1]]
            free = ~_shares_corner(side, other).any(axis=1)
            sides.append(side[free])
            triangles.append(other[free])
    p, q = (vertices[np.concatenate(sides)[:, k]] for k in range(2))
    a, b, c = (vertices[np.concatenate(triangles)[:, k]] for k in range(3))
    before, behind = _orient(a, b, c, p), _orient(a, b, c, q)
    doubtful = before * behind <= 0
    if not doubtful.any():
        return False
    if ((before == 0) & (behind == 0)).any():
        # Some share a plane.
        both = np.concatenate([faces[first], faces[second]])
        both, number = np.unique(both, axis=0, return_inverse=True)
        used, local = np.unique(both, return_inverse=True)
        pairs = self_intersections(TriMesh(vertices[used], local.reshape(-1, 3)))
        asked = np.sort(number.reshape(2, -1).T)
        return bool((pairs[:, None] == asked).all(axis=2).any())
    p, q, a, b, c = (points[doubtful] for points in (p, q, a, b, c))
    turns = np.stack([_orient(p, q, *pair) for pair in ((a, b), (b, c), (c, a))])
    return bool(((turns.min(axis=0) >= 0) | (turns.max(axis=0) <= 0)).any())


def _orient(a: Floats, b: Floats, c: Floats, d: Floats) -> Integers:
    """Return the sign of the volume of tetrahedra, (k,); exact (Shewchuk 1997)."""
    if len(a) == 0:
        return np.empty(0, np.int64)
    rows = (np.ascontiguousarray(points) for points in (a, b, c, d))
    return np.asarray(igl.predicates.orient3d(*rows), np.int64)
