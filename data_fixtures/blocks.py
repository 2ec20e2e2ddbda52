"""Figures built from blocks: rings of four vertices, joined to cells, skinned and subdivided."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from meshes import Faces, Mesh, Points
from numpy.typing import NDArray

Corners = tuple[int, int, int, int]
Vector = tuple[float, float, float]
Shares = dict[str, float]

CELL_SIDES = ((3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


@dataclass(frozen=True)
class Ring:
    """A cross section of a limb.

    Attributes
    ----------
    center : Vector
        Its middle.
    u, v : Vector
        The two half axes; the corners are ``center -u-v, +u-v, +u+v, -u+v``.
    shares : Shares
        How much of every bone moves it; sums to 1.
    """

    center: Vector
    u: Vector
    v: Vector
    shares: Shares


@dataclass
class Blocks:
    """Vertices and cells of eight vertices; the figure's skin is every side no two cells share."""

    verts: list[Vector] = field(default_factory=list)
    shares: list[Shares] = field(default_factory=list)
    cells: list[tuple[int, ...]] = field(default_factory=list)

    def vertex(self, position: Vector, shares: Shares) -> int:
        """Add a vertex and return its number."""
        self.verts.append(position)
        self.shares.append(shares)
        return len(self.verts) - 1

    def ring(self, ring: Ring, mirror: float = 1.0) -> Corners:
        """Add the four vertices of a ring, mirrored in x when `mirror` is -1."""
        center, u, v = (np.array(axis) for axis in (ring.center, ring.u, ring.v))
        corners = []
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            x, y, z = (float(number) for number in center + a * u + b * v)
            corners.append(self.vertex((mirror * x, y, z), ring.shares))
        return (corners[0], corners[1], corners[2], corners[3])

    def cell(self, start: Corners, end: Corners) -> None:
        """Join two rings to a cell, turned so that its sides face outward."""
        points = np.array([self.verts[number] for number in start + end])
        along = points[4:].mean(axis=0) - points[:4].mean(axis=0)
        normal = np.cross(points[2] - points[0], points[3] - points[1])
        if float((along * normal).sum()) < 0:
            start, end = end, start
        self.cells.append(start + end)

    def chain(self, start: Corners, rings: list[Ring], mirror: float = 1.0) -> list[Corners]:
        """Grow a limb from four vertices through the given rings; return the rings' corners."""
        corners = [start]
        for ring in rings:
            corners.append(self.ring(ring, mirror))
            self.cell(corners[-2], corners[-1])
        return corners

    def skin(self) -> Mesh:
        """Return the outward quads of the cells' boundary, over the vertices they use."""
        sides = [tuple(cell[i] for i in side) for cell in self.cells for side in CELL_SIDES]
        count = Counter(tuple(sorted(side)) for side in sides)
        quads = [side for side in sides if count[tuple(sorted(side))] == 1]
        return Mesh(np.array(self.verts, np.float64), np.array(quads, np.int32))

    def weights(self, bones: list[str]) -> NDArray[np.float64]:
        """Return the (n, b) shares of every bone in every vertex."""
        return np.array([[shares.get(bone, 0.0) for bone in bones] for shares in self.shares])


def _sums(values: Points, rows: NDArray[np.integer], number: int) -> Points:
    """Return (number, c): for every row number in `rows` the sum of the values it comes with."""
    total = np.zeros((number, values.shape[1]))
    np.add.at(total, rows, values)
    return total


def catmull_clark(values: Points, quads: Faces) -> tuple[Points, Faces]:
    """Subdivide a closed quad mesh once.

    Parameters
    ----------
    values : (n, c) float64
        What the vertices carry: positions, and anything to be smoothed along with them.
    quads : (f, 4) int32
        Vertex numbers.

    Returns
    -------
    values : (n + e + f, c) float64
        Vertex points, then edge points, then face points.
    quads : (4 f, 4) int32
        The new quads.
    """
    count = len(values)
    sides = np.stack([quads, np.roll(quads, -1, axis=1)], axis=2)
    edges, number = np.unique(np.sort(sides.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    number = number.reshape(-1).astype(np.int32)
    centers = values[quads].sum(axis=1) / 4
    middles = values[edges].sum(axis=1) / 2
    beside = _sums(np.repeat(centers, 4, axis=0), number, len(edges)) / 2
    valence = np.bincount(quads.reshape(-1), minlength=count)[:, None].astype(np.float64)
    around = _sums(np.repeat(centers, 4, axis=0), quads.reshape(-1), count) / valence
    spokes = _sums(np.repeat(middles, 2, axis=0), edges.reshape(-1), count) / valence
    smooth = (around + 2 * spokes + (valence - 3) * values) / valence
    after = (count + number).reshape(-1, 4)
    center = np.broadcast_to((count + len(edges) + np.arange(len(quads)))[:, None], quads.shape)
    split = np.stack([quads, after, center, np.roll(after, 1, axis=1)], axis=2)
    points = np.concatenate([smooth, (middles + beside) / 2, centers])
    return points, split.reshape(-1, 4).astype(np.int32)
