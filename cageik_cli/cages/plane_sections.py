"""Plane sections of a mesh: the loops in which a plane across an axis cuts it."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.util.arrays import Floats, Integers

CLOSED_TOL = 1e-9
"""Ends of a loop nearer than this, in its size, are one: a loop with more is open."""


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """The loops in which a plane across an axis cuts a mesh.

    Attributes
    ----------
    segments : (s, 2, 3) float64
        Ends of the segment in each face that is cut; the inside is on the same side of all.
    faces : (s,) int64
        The faces.
    loops : (s,) int64
        The number of each segment's loop.
    """

    segments: Floats
    faces: Integers
    loops: Integers


@dataclass(frozen=True, slots=True, eq=False)
class Slicer:
    """A mesh that is cut often across one axis.

    Attributes
    ----------
    axis : int
        0, 1, 2 for x, y, z.
    low, high : (f,) float64
        Where each face begins and ends along the axis.
    """

    mesh: TriMesh
    axis: int
    low: Floats
    high: Floats

    @classmethod
    def prepare(cls, mesh: TriMesh, axis: int) -> Self:
        """Find where the faces are."""
        a, b, c = (mesh.vertices[mesh.faces[:, k], axis] for k in range(3))
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        return cls(mesh, axis, low, high)

    def find_cut_faces(self, position: float) -> Integers:
        """Find the faces with vertices on both sides; vertices in the plane count as above it."""
        return np.flatnonzero((self.low < position) & (self.high >= position))

    def cut(self, position: float) -> Section:
        """Cut the mesh."""
        return cut_faces(self.mesh, self.axis, position, self.find_cut_faces(position))


def cut_faces(mesh: TriMesh, axis: int, position: float, faces: Integers) -> Section:
    """Cut the faces that have vertices on both sides of a plane."""
    side = mesh.vertices[mesh.faces[faces], axis] >= position
    # The corner that is alone on its side first: its two edges are the ones that are cut.
    lone = np.where(side.sum(axis=1) == 1, side.argmax(axis=1), (~side).argmax(axis=1))
    turns = (lone[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(mesh.faces[faces], turns, axis=1)
    ends = np.stack([corners[:, [0, 1]], corners[:, [0, 2]]], axis=1)
    # Faces whose lone corner is below pass the plane the other way.
    flipped = ~np.take_along_axis(side, lone[:, None], axis=1)[:, 0]
    ends[flipped] = ends[flipped][:, ::-1]
    one, two = mesh.vertices[ends[:, :, 0]], mesh.vertices[ends[:, :, 1]]
    height, other = one[..., axis] - position, two[..., axis] - position
    segments = one + (height / (height - other))[..., None] * (two - one)
    return Section(segments, faces, _label_loops(ends))


def winds_around(segments: Floats, point: Floats, axis: int) -> bool:
    """Return whether a loop goes around a point of its plane."""
    kept = [k for k in range(3) if k != axis]
    one, two = ((segments[:, end] - point)[:, kept] for end in range(2))
    turn = np.arctan2(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0], (one * two).sum(axis=1))
    return bool(abs(turn.sum()) > np.pi)


def is_closed(segments: Floats) -> bool:
    """Return whether a loop ends where it begins; it is cut off where the mesh is open."""
    ends = segments.sum(axis=0)
    allowed = CLOSED_TOL * len(segments) * measure_box(segments[:, 0])
    return bool(np.linalg.norm(ends[1] - ends[0]) <= allowed)


def measure_box(points: Floats) -> float:
    """Return the diagonal of the box around points, (k, 3)."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _label_loops(ends: Integers) -> Integers:
    """Number the loop of each segment, (s,), by the edges (s, 2, 2) on which they end."""
    flat = np.sort(ends.reshape(-1, 2), axis=1)
    keys: Integers = flat[:, 0] * (int(flat.max(initial=0)) + 1) + flat[:, 1]
    _, edge = np.unique(keys, return_inverse=True)
    joined: Integers = edge.reshape(-1, 2)
    return find_groups(joined, int(edge.max(initial=-1)) + 1)[joined[:, 0]]
