"""Animations that are exactly weights times cages, known from theory and exact in the text.

Inside a tetrahedron harmonic weights are the barycentric coordinates; on any cage's own surface
they are the barycentric coordinates of the triangle. Every number below is a multiple of a power
of two, so weights, frames and cages are exact in binary and in decimals.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from blocks import Blocks
from meshes import (
    Mesh,
    Points,
    exact,
    face_lines,
    lattice_noise,
    midpoint_subdivided,
    octahedron,
    triangulated,
    write_lines,
)

FRAMES = 6
GRID = 64
"""Model vertices inside the tetrahedron are multiples of ``1 / GRID``."""


def tetrahedron() -> Mesh:
    """Return the regular tetrahedron around the origin with corners at ``(+-4, +-4, +-4)``."""
    verts = 4.0 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    return Mesh(verts, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32))


def barycentric(points: Points) -> Points:
    """Return the (m, 4) barycentric coordinates of (m, 3) points in `tetrahedron`."""
    signs = tetrahedron().verts / 4
    return np.stack([(1 + (points * sign).sum(axis=1) / 4) / 4 for sign in signs], axis=1)


def ball() -> Mesh:
    """Return a rounded octahedron of 66 vertices on the grid, well inside the tetrahedron."""
    mesh = midpoint_subdivided(midpoint_subdivided(octahedron(1.0)))
    lengths = np.sqrt((mesh.verts**2).sum(axis=1, keepdims=True))
    return mesh.moved(np.round(1.5 * GRID * mesh.verts / lengths) / GRID)


def ell() -> Mesh:
    """Return an L of three cubes: 16 vertices, 28 triangles, one edge turned inward."""
    blocks = Blocks()
    corners = [(x, y) for x in (0, 1, 2) for y in (0, 1, 2) if (x, y) != (2, 2)]
    number = {
        (x, y, z): blocks.vertex((2.0 * x, 2.0 * y, 1.5 * z), {})
        for x, y in corners
        for z in (0, 1)
    }
    for x, y in ((0, 0), (1, 0), (0, 1)):
        square = ((x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1))
        a, b, c, d = (number[(*corner, 0)] for corner in square)
        blocks.cell((a, b, c, d), (a + 1, b + 1, c + 1, d + 1))
    return triangulated(blocks.skin())


def posed_cages(cage: Mesh, seed: int, bend: Points) -> Points:
    """Return (F, n, 3) cages: the rest, then ever stronger bends with some fixed noise.

    Parameters
    ----------
    cage : Mesh
        The rest cage of n vertices.
    seed : int
        Picks the noise.
    bend : (3, 3, 3) float64
        How much coordinate k moves for the product of coordinates i and j: ``bend[i, j, k]``.
    """
    rest = cage.verts
    products = rest[:, :, None, None] * rest[:, None, :, None] * bend
    curve = products.sum(axis=(1, 2))
    frames = [rest]
    for frame in range(1, FRAMES):
        noise = lattice_noise(rest.shape, seed + frame, 1 / 16, 5)
        drift = np.array([0.25 * frame, 0.0, 0.5 * frame])
        frames.append(rest + frame * curve + noise + drift)
    return np.array(frames)


def write_case(folder: Path, cage: Mesh, cages: Points, model: list[Mesh]) -> None:
    """Write one animation: the cage, the frames and the cages they were made of."""
    write_lines(folder / "cage.obj", [*exact(cage.verts), *face_lines(cage.faces)])
    for frame, mesh in enumerate(model, start=1):
        lines = [*exact(mesh.verts), *face_lines(mesh.faces)]
        write_lines(folder / "frames" / f"frame_{frame}.obj", lines)
    np.savez(folder / "cages.npz", verts=cages, tris=cage.faces)


def bends(*terms: tuple[int, int, int, float]) -> Points:
    """Return a (3, 3, 3) bend from ``(i, j, k, amount)`` terms."""
    bend = np.zeros((3, 3, 3))
    for i, j, k, amount in terms:
        bend[i, j, k] = amount
    return bend


def write_posed(folder: Path) -> None:
    """Write both animations."""
    cage, model = tetrahedron(), ball()
    cages = posed_cages(cage, 3, bends((0, 1, 2, 1 / 64), (1, 2, 0, -1 / 128)))
    weights = barycentric(model.verts)
    frames = [model.moved((weights[:, :, None] * verts).sum(axis=1)) for verts in cages]
    write_case(folder / "tetrahedron", cage, cages, frames)

    cage = ell()
    cages = posed_cages(cage, 11, bends((0, 0, 2, 1 / 32), (1, 1, 2, -1 / 32), (1, 2, 0, 1 / 16)))
    frames = [midpoint_subdivided(midpoint_subdivided(cage.moved(verts))) for verts in cages]
    write_case(folder / "surface", cage, cages, frames)
