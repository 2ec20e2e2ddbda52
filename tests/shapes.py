"""Meshes for tests: made from formulas, small, clean."""

import numpy as np

from cageik_cli.geometry.attributes import SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh

TETRAHEDRON = TriMesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


def box(size: float = 1.0) -> TriMesh:
    """A cube around the origin, 8 vertices and 12 triangles."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
    faces = [f for a, b, c, d in QUADS for f in ([a, b, c], [a, c, d])]
    return TriMesh(corners, np.array(faces))


QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""The faces of a box before they are cut."""


def quad_box(size: float = 1.0) -> TriMesh:
    """A box that knows its six quads."""
    polygons = SurfaceAttributes(np.full(6, 4), np.ravel(QUADS))
    return TriMesh(box(size).vertices, box().faces, polygons)


def quad_text(size: float, inward: bool = False) -> str:
    """A box as programs write it: quads, texture coordinates, normals, groups, a material."""
    lines = ["# 100 %", "mtllib skins/box.mtl", "o box"]
    lines += ["v {} {} {}".format(*vertex) for vertex in box(size).vertices]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "vn 0 0 1"]
    for k, quad in enumerate(QUADS):
        corners = [f"{v + 1}/{t}/1" for t, v in enumerate(quad, start=1)]
        lines += [
            f"g side{k}",
            "usemtl red",
            "s 1",
            "f " + " ".join(corners[:: -1 if inward else 1]),
        ]
    return "\n".join(lines) + "\n"


def octahedron(size: float = 0.5) -> TriMesh:
    """6 vertices and 8 faces, outward."""
    vertices = size * np.array(
        [[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    )
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    return TriMesh(vertices, np.array(faces))


def ball(levels: int = 2, size: float = 0.5) -> TriMesh:
    """An octahedron divided and blown up to a sphere."""
    mesh = finer(octahedron(1.0), levels)
    return TriMesh(
        size * mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None], mesh.faces
    )


def changed(mesh, faces=None, vertices=None) -> TriMesh:
    """The mesh with other faces, or other vertices."""
    return TriMesh(
        mesh.vertices if vertices is None else vertices, mesh.faces if faces is None else faces
    )


def merged(*meshes: TriMesh) -> TriMesh:
    """One mesh of several."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return TriMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
    )


def moved(mesh: TriMesh, shift=(0, 0, 0), scale=1.0, turn: int | None = None) -> TriMesh:
    """The mesh somewhere else, of another size along all axes or each, turned before."""
    vertices = mesh.vertices if turn is None else mesh.vertices @ rotation(turn).T
    return changed(mesh, vertices=scale * vertices + np.asarray(shift, float))


def finer(mesh: TriMesh, levels: int) -> TriMesh:
    """Every face divided in four, `levels` times."""
    for _ in range(levels):
        panels = BoundaryMesh.from_cage(mesh).divide(np.ones(len(mesh.faces), bool)).panels
        mesh = TriMesh(panels.vertices, panels.corners)
    return mesh


def concave() -> TriMesh:
    """An L of three cubes (16 vertices), with an edge that points inward."""
    outline = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
    return prism(outline, [[0, 1, 3], [1, 2, 3], [0, 3, 5], [3, 4, 5]])


def letter_c(gap: float) -> TriMesh:
    """A rod of four sides that is bent into a ring; its ends are `gap` diagonals apart."""
    rod = finer(box(), 4)
    x, y, z = rod.vertices.T
    turn = np.pi + x * (np.pi - gap * 3.72 / 2)
    bent = np.stack([(1 + 0.3 * y) * np.cos(turn), 0.3 * z, (1 + 0.3 * y) * np.sin(turn)], axis=1)
    ring = changed(rod, vertices=bent)
    return ring if ring.volume > 0 else ring.flip()


def prism(outline, cap) -> TriMesh:
    """A body from z = 0 to 1 over a polygon that goes around to the left, cut into `cap`."""
    count, outline, cap = len(outline), np.array(outline, float), np.array(cap)
    vertices = np.concatenate([np.insert(outline, 2, z, axis=1) for z in (0, 1)])
    walls = [
        face
        for k, after in zip(range(count), np.roll(range(count), -1), strict=True)
        for face in ([k, after, after + count], [k, after + count, k + count])
    ]
    return TriMesh(vertices, np.concatenate([cap[:, ::-1], cap + count, walls]))


def two_chambers(thickness: float) -> TriMesh:
    """An H of two rooms that a web joins, with 90 vertices."""
    low, high = (1 - thickness) / 2, (1 + thickness) / 2
    left, right = 0.4, 0.6
    outline = [[0, 0], [left, 0], [left, low], [right, low], [right, 0], [1, 0]]
    outline += [[1, 1], [right, 1], [right, high], [left, high], [left, 1], [0, 1]]
    cap = [[0, 1, 2], [0, 2, 9], [0, 9, 11], [9, 10, 11], [2, 3, 8], [2, 8, 9]]
    cap += [[3, 4, 5], [3, 5, 8], [8, 5, 6], [8, 6, 7]]
    return finer(prism(outline, cap), 1)


def inside(mesh: TriMesh, count: int, seed: int = 0, margin: float = 0.02) -> np.ndarray:
    """Random points inside `mesh`, at least `margin` diagonals from it."""
    from cageik_cli.geometry.surface import closest_points, winding_numbers

    generator = np.random.default_rng(seed)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    points = generator.uniform(low, high, (40 * count, 3))
    kept = winding_numbers(mesh, points) > 0.5
    kept &= closest_points(mesh, points).distance > margin * mesh.diagonal
    return points[kept][:count]


def rotation(seed: int) -> np.ndarray:
    """A random proper rotation, (3, 3)."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)
