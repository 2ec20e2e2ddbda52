"""Small meshes and the text they are written as; everything here is deterministic."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Faces = NDArray[np.int32]

NUDGE = 1e-9
"""Added before rounding, so that the text of a number at a tie never hangs on its last bit."""


@dataclass(frozen=True)
class Mesh:
    """A polygon mesh.

    Attributes
    ----------
    verts : (n, 3) float64
        Vertex positions.
    faces : (f, k) int32
        Vertex numbers of every face from 0, counter-clockwise seen from outside.
    """

    verts: Points
    faces: Faces

    def moved(self, verts: Points) -> Mesh:
        """Return the same faces over other positions."""
        return Mesh(verts, self.faces)

    def with_faces(self, faces: object) -> Mesh:
        """Return the same positions under other faces."""
        return Mesh(self.verts, np.asarray(faces, np.int32))


def fixed(verts: Points, decimals: int) -> list[str]:
    """Return one ``v`` line per vertex with a fixed number of decimals and no negative zero."""
    rounded = np.round(verts + NUDGE, decimals) + 0.0
    return [f"v {x:.{decimals}f} {y:.{decimals}f} {z:.{decimals}f}" for x, y, z in rounded]


def exact(verts: Points) -> list[str]:
    """Return one ``v`` line per vertex with every digit of its numbers."""
    return [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in verts + 0.0]


def face_lines(faces: Faces) -> list[str]:
    """Return one ``f`` line per face, vertex numbers from 1."""
    return ["f " + " ".join(map(str, face)) for face in (faces + 1).tolist()]


def write_lines(path: Path, lines: list[str]) -> None:
    """Write lines with plain line feeds, making the folder when it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(("\n".join(lines) + "\n").encode())


def lattice_noise(shape: tuple[int, ...], seed: int, step: float, reach: int) -> Points:
    """Return multiples of `step` between ``-reach * step`` and ``reach * step``.

    The numbers come from a linear congruential generator in integers: the same everywhere.
    """
    state, out = seed, []
    for _ in range(int(np.prod(shape))):
        state = (1103515245 * state + 12345) % 2**31
        out.append((state >> 16) % (2 * reach + 1) - reach)
    return np.array(out, np.float64).reshape(shape) * step


def midpoint_subdivided(mesh: Mesh) -> Mesh:
    """Split every triangle into four at the middles of its edges.

    The old vertices come first and keep their numbers; the new ones follow in edge order.
    """
    corners = mesh.faces
    pairs = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, number = np.unique(pairs, axis=0, return_inverse=True)
    middle = (len(mesh.verts) + number.reshape(-1, 3)).astype(np.int32)
    a, b, c = corners.T
    ab, bc, ca = middle.T
    faces = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    verts = np.concatenate([mesh.verts, mesh.verts[edges].sum(axis=1) / 2])
    return Mesh(verts, faces.transpose(2, 0, 1).reshape(-1, 3))


def octahedron(radius: float) -> Mesh:
    """Return the octahedron with its corners on the axes."""
    verts = radius * np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64
    )
    faces = [
        (x, y, z) if (x + y + z) % 2 == 0 else (x, z, y)
        for x, y, z in itertools.product((0, 1), (2, 3), (4, 5))
    ]
    return Mesh(verts, np.array(faces, np.int32))


def box_quads(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """Return a box of eight vertices and six quads; vertex ``4x + 2y + z`` is a corner."""
    verts = np.array(list(itertools.product(*zip(low, high, strict=True))), np.float64)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return Mesh(verts, np.array(quads, np.int32))


def triangulated(mesh: Mesh) -> Mesh:
    """Cut every quad along its first diagonal."""
    return mesh.with_faces(mesh.faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3))


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """Return a box of eight vertices and twelve triangles."""
    return triangulated(box_quads(low, high))
