"""A cage with quads under edit: it stays sound whichever diagonals cut them."""

import numpy as np

from cageik_cli.cages.building.draft import Draft, Edit
from cageik_cli.cages.building.paired import PairedDraft
from cageik_cli.cages.building.pairing import HALVES
from cageik_cli.cages.building.polish import move_vertex, settle
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers, Mask

WALKS = 3
"""How often each vertex is moved towards its place: others may have been in its way."""


class QuadDraft(Draft):
    """A draft of a cage whose faces are triangles, and halves of quads by both diagonals.

    Vertices move, and pairs of triangles become quads; a half of one quad may not cross that of
    another.
    """

    def __init__(self, cage: TriMesh, samples: Floats, clearance: float) -> None:
        super().__init__(cage, samples, clearance)
        self._cut = np.zeros(len(cage.faces), np.int64)  # of halves, 1 or 2: by which diagonal

    def add(self, quad: Integers) -> None:
        """Make two triangles a quad, untested; its first diagonal is the edge between them."""
        self._cut[self.faces_beside(int(quad[0]), int(quad[2]))] = 1
        self.faces = np.concatenate([self.faces, quad[list(HALVES[2:])]])
        self._cut = np.append(self._cut, [2, 2])

    def hold(self, quad: Integers, angle: float) -> bool:
        """Make two triangles a quad if its other halves are sound; return whether they are.

        Their angles must be at least this, degrees.
        """
        halves = self.faces_beside(int(quad[0]), int(quad[2]))
        edit = Edit(halves, quad[list(HALVES[2:])], int(quad[0]), self.vertices[quad[0]])
        if self.angles(edit).min() < angle or not self.allows(edit):
            return False
        self.add(quad)
        return True

    def walk(self, places: Floats, angle: float) -> None:
        """Move vertices towards places, (n, 3), as far as the cage stays sound.

        Angles do not become smaller than this, degrees, or than they are.
        """
        for _ in range(WALKS):
            for vertex in np.flatnonzero((self.vertices != places).any(axis=1)).tolist():
                self._step(vertex, places[vertex], angle)

    def apply(self, edit: Edit) -> None:
        """Move a vertex, untested; the faces stay in their order."""
        self.vertices[edit.vertex] = edit.position

    def _step(self, vertex: int, place: Floats, angle: float) -> None:
        """Move a vertex to a place, or half of the way."""
        here = self.vertices[vertex].copy()
        for share in (1.0, 0.5):
            edit = move_vertex(self, vertex, here + share * (place - here))
            if self._take_in_shape(edit, angle) or self._take_in_shape(settle(self, edit), angle):
                return

    def _take_in_shape(self, edit: Edit, angle: float) -> bool:
        needed = min(angle, float(self.angles_before(edit).min()))
        return bool(self.angles(edit).min() >= needed) and self.take(edit)

    def _find_swept(self, edit: Edit, samples: Floats) -> Mask:
        """Return the samples that an edit sweeps over, by the one diagonals or by the others."""
        if not np.array_equal(edit.added, self.faces[edit.removed]):
            return super()._find_swept(edit, samples)
        swept = np.zeros(len(samples), bool)
        for other in (1, 2):
            of_cut = self._cut[edit.removed] != other
            moved = Edit(edit.removed[of_cut], edit.added[of_cut], edit.vertex, edit.position)
            swept |= super()._find_swept(moved, samples)
        return swept


class PairedQuadDraft(PairedDraft, QuadDraft):
    """A draft of a cage with quads that is its own mirror image, and stays so."""
