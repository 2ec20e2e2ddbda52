"""Decimation and edits of a cage that is its own mirror image, and stays so: pairs act together.

The plane is where the coordinate of `axis` is 0. Partners are mirror images to the last bit, and no
edge crosses the plane: it is cut along edges on it.
"""

import numpy as np

from cageik_cli.cages.builder.collapse import (
    COLLAPSE_LIMITS,
    CollapseLimits,
    Collapser,
    collapse_costs,
)
from cageik_cli.cages.builder.draft import Draft, Edit
from cageik_cli.cages.builder.polish import MIN_KEPT_ANGLE, collapse_edge, move_vertex
from cageik_cli.cages.builder.symmetry import (
    MIN_PLANE_DISTANCE,
    add_image,
    find_partners,
    reflect,
    take_half,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers


def collapse_pairs(cage: TriMesh, count: int, axis: int, evenness: float) -> TriMesh:
    """Collapse edges until there are `count` vertices, or one less, as `collapse_edges` does."""
    for limits in COLLAPSE_LIMITS:
        if len(cage.vertices) > count:
            cage = add_image(_HalfCollapser(cage, axis, evenness, limits).run(count), axis)
    return cage


class _HalfCollapser(Collapser):
    """The part of a cage above the plane, whose border stays on it.

    Parameters are those of `Collapser`; vertices and edges are counted in the whole cage.
    """

    def __init__(self, cage: TriMesh, axis: int, evenness: float, limits: CollapseLimits) -> None:
        half = take_half(cage, axis)
        self._axis, self._on_plane = axis, half.vertices[:, axis] == 0
        super().__init__(half, None, evenness, limits)
        self._left = 2 * len(half.vertices) - int(self._on_plane.sum())

    def _weigh(self, ends: Integers) -> tuple[Floats, Floats]:
        costs, targets = super()._weigh(ends)
        count = self._on_plane[ends].sum(axis=1)
        at = count > 0
        if at.any():
            costs[at], targets[at] = self._weigh_on_plane(ends[at])
        # What a pair of vertices costs is that of one, twice: on the plane only one is saved.
        return np.where(count == 2, 2 * costs, costs), targets

    def _weigh_on_plane(self, ends: Integers) -> tuple[Floats, Floats]:
        """Weigh collapses onto the plane, by quadrics that have no terms mixed with its axis.

        Those are the mean of a quadric and its mirror image.
        """
        quadrics = self._quadrics[:, ends]
        others = np.arange(4) != self._axis
        quadrics[..., self._axis, others] = quadrics[..., others, self._axis] = 0
        places = self._places[:, ends]
        height = places[..., self._axis].max(axis=2)
        places[..., self._axis] = 0
        numbers = np.arange(2 * len(ends)).reshape(-1, 2)
        flat = (quadrics.reshape(1, -1, 4, 4), places.reshape(1, -1, 3))
        costs, targets = collapse_costs(*flat, numbers, self._evenness)
        size = np.trace(quadrics.sum(axis=2)[..., :3, :3], axis1=2, axis2=3)
        targets[..., self._axis] = 0
        return costs + (self._evenness * size * height**2).sum(axis=0), targets

    def _collapse(self, a: int, b: int, places: Floats) -> None:
        if self._on_plane[b]:
            a, b = b, a
        if self._on_plane[a] or places[0, self._axis] > MIN_PLANE_DISTANCE:
            super()._collapse(a, b, places)

    def _stays_manifold(self, a: int, b: int) -> bool:
        """Return whether a merge leaves a manifold, seen in the whole cage."""
        common = self._around[a] & self._around[b]
        is_border = self._on_plane[b]
        if len(common) != (1 if is_border else 2):
            return False
        ring = (self._around[a] | self._around[b]) - {a, b}
        if self._on_plane[a] and self._count_on_plane(ring) != 2:
            return False  # an edge that crosses the plane, or lies on it twice
        if min(self._count_edges(c, self._around[c]) for c in common) <= 3:
            return False
        return self._count_edges(a, ring) <= self._limits.valence

    def _count_on_plane(self, vertices: set[int]) -> int:
        return int(self._on_plane[list(vertices)].sum())

    def _count_edges(self, vertex: int, ring: set[int]) -> int:
        """Return edges of the whole cage at a vertex, by the ring of its neighbours in the half."""
        on_plane = self._count_on_plane(ring)
        return 2 * len(ring) - on_plane if self._on_plane[vertex] else len(ring)

    def _merge(self, a: int, b: int, places: Floats) -> None:
        self._left -= 0 if self._on_plane[b] else 1
        super()._merge(a, b, places)


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
