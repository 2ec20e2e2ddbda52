"""Models that a cage builder may stumble over, made from formulas; no two runs differ."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import TETRAHEDRON, ball, box, changed, concave, finer, merged, moved, octahedron


def sheet(across=12, along=12, height=lambda u, v: 0 * u, loops=(False, False)):
    """A grid of (u, v) in [0, 1]², lifted, with triangles."""
    u, v = np.meshgrid(np.linspace(0, 1, across), np.linspace(0, 1, along), indexing="ij")
    points = np.stack([u, v, height(u, v)], axis=-1).reshape(-1, 3)
    return TriMesh(points, grid_faces(across, along, loops))


def grid_faces(across, along, loops=(False, False)):
    number = np.arange(across * along).reshape(across, along)
    if loops[0]:
        number = np.concatenate([number, number[:1]])
    if loops[1]:
        number = np.concatenate([number, number[:, :1]], axis=1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])


def torus(radius=1.0, thickness=0.3, across=48, along=16):
    """A closed ring."""
    u, v = np.meshgrid(
        np.arange(across) * 2 * np.pi / across, np.arange(along) * 2 * np.pi / along, indexing="ij"
    )
    ring = radius + thickness * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), thickness * np.sin(v)], axis=-1)
    return TriMesh(points.reshape(-1, 3), grid_faces(across, along, (True, True)))


def tube(start, stop, radius=0.1, across=12, along=8):
    """An open tube between two places."""
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    axis = (stop - start) / np.linalg.norm(stop - start)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    turn = np.arange(across) * 2 * np.pi / across
    ring = radius * (np.outer(np.cos(turn), side) + np.outer(np.sin(turn), np.cross(axis, side)))
    centres = start + np.linspace(0, 1, along)[:, None] * (stop - start)
    points = (ring[:, None] + centres[None]).reshape(-1, 3)
    return TriMesh(points, grid_faces(across, along, (True, False)))


def klein():
    """A figure-eight immersion of the Klein bottle, which crosses itself and has no inside."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(0, 2 * np.pi, 24), indexing="ij")
    r = 2 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
    z = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
    points = np.stack([r * np.cos(u), r * np.sin(u), z], axis=-1).reshape(-1, 3)
    return TriMesh(points, grid_faces(60, 24))


def soup(count=1000, size=0.1, seed=0):
    """Triangles anywhere, in no order."""
    generator = np.random.default_rng(seed)
    centre = generator.uniform(-1, 1, (count, 1, 3))
    corners = centre + size * generator.normal(size=(count, 3, 3))
    return TriMesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def hand():
    """A palm with five thin fingers, open tubes that start inside it."""
    palm = changed(finer(box(1), 3), vertices=finer(box(1), 3).vertices * [0.5, 0.15, 0.6])
    fingers = [
        tube((x, 0, 0.4), (1.4 * x, 0.1 * k, 1.4), 0.07)
        for k, x in enumerate(np.linspace(-0.4, 0.4, 5))
    ]
    return merged(palm, *fingers)


def spikes(count=24):
    """A ball with needles on it."""
    mesh = ball(4, 0.5)
    vertices = mesh.vertices.copy()
    vertices[:: len(vertices) // count] *= 2.2
    return changed(mesh, vertices=vertices)


def with_flat_faces():
    """A ball with faces without area, repeated faces, and vertices in no face."""
    mesh = ball(3)
    faces = np.concatenate([mesh.faces, mesh.faces[:5], [[0, 0, 1], [2, 3, 3], [4, 4, 4]]])
    return TriMesh(np.concatenate([mesh.vertices, [[0.1, 0.2, 0.1]]]), faces)


def helix():
    """A thin open spiral band."""
    wide, turns = 4, 200
    u, v = np.meshgrid(np.linspace(0, 6 * np.pi, turns), np.linspace(0, 1, wide), indexing="ij")
    points = np.stack([np.cos(u), np.sin(u), 0.15 * u + 0.25 * v], axis=-1).reshape(-1, 3)
    return TriMesh(points, grid_faces(turns, wide))


FAST = {
    "tetrahedron": lambda: TETRAHEDRON,
    "octahedron": octahedron,
    "box": box,
    "concave": concave,
    "ball": lambda: ball(3),
    "plane": sheet,
    "one triangle": lambda: TriMesh(np.eye(3), [[0, 1, 2]]),
    "a line": lambda: TriMesh(np.array([[0.0, 0, 0], [1, 2, 3], [2, 4, 6]]), [[0, 1, 2]]),
    "wavy sheet": lambda: sheet(30, 30, lambda u, v: 0.1 * np.sin(9 * u) * np.cos(7 * v)),
    "long strip": lambda: moved(
        changed(sheet(4, 80), vertices=sheet(4, 80).vertices * [0.02, 1, 1])
    ),
    "two sheets close together": lambda: merged(sheet(), moved(sheet(), (0, 0, 0.003))),
    "crossed sheets": lambda: merged(
        moved(sheet(), (-0.5, -0.5, 0)), moved(sheet(), (-0.5, -0.5, 0.01), turn=5)
    ),
    "nested shells": lambda: merged(*(ball(3, size) for size in (0.5, 0.4, 0.3, 0.2))),
    "inward ball": lambda: ball(3).flip(),
    "half a ball": lambda: changed(ball(4), faces=ball(4).faces[:512]),
    "two balls far apart": lambda: merged(ball(3), moved(ball(3), (20, 3, 1))),
    "three balls in a row": lambda: merged(*(moved(ball(2), (1.2 * k, 0, 0)) for k in range(3))),
    "a small ball beside a large one": lambda: merged(ball(4), moved(ball(2, 0.01), (0.8, 0, 0))),
    "balls that touch": lambda: merged(ball(3), moved(ball(3), (1, 0, 0))),
    "balls that overlap": lambda: merged(ball(3), moved(ball(3), (0.6, 0.1, 0))),
    "torus": torus,
    "torus, nearly closed": lambda: torus(0.5, 0.46),
    "Klein bottle": klein,
    "flat faces": with_flat_faces,
    "far from the origin": lambda: moved(ball(3), (1e6, -2e6, 1e6)),
    "tiny": lambda: moved(concave(), scale=1e-12),
    "huge": lambda: moved(concave(), scale=1e12),
    "turned box": lambda: moved(box(), turn=3),
    "a flat box": lambda: changed(
        finer(box(), 3), vertices=finer(box(), 3).vertices * [1, 1, 0.002]
    ),
    "a rod": lambda: changed(finer(box(), 4), vertices=finer(box(), 4).vertices * [0.01, 0.01, 1]),
    "open tube": lambda: tube((0, 0, 0), (1, 1, 1)),
    "three tubes": lambda: merged(
        tube((0, 0, 0), (1, 0, 0)), tube((0, 0, 0), (0, 1, 0)), tube((0, 0, 0), (0, 0, 1))
    ),
    "little soup": lambda: soup(30, 0.2),
}

SLOW = {
    "wire torus": lambda: torus(1.0, 0.004, 200, 6),
    "soup": soup,
    "fine soup": lambda: soup(1000, 0.01),
    "hand": hand,
    "spikes": spikes,
    "helix": helix,
    "ball of 200 000 vertices": lambda: fine_ball(),
}


def split_corners(mesh, size=0.0, seed=0):
    """The triangles of a mesh, each with corners of its own, moved by `size` as a whole."""
    shifts = size * np.random.default_rng(seed).normal(size=(len(mesh.faces), 1, 3))
    corners = (mesh.vertices[mesh.faces] + shifts).reshape(-1, 3)
    return TriMesh(corners, np.arange(len(corners)).reshape(-1, 3))


def scattered_boxes(count, seed=0):
    """Boxes that stand apart, on a grid of places that are moved a little."""
    generator = np.random.default_rng(seed)
    places = 2.4 * np.stack([np.arange(count) % 5, np.arange(count) // 5, np.zeros(count)], axis=1)
    places += generator.uniform(0, 0.6, places.shape)
    return merged(*(moved(box(), place) for place in places))


def triangle_grid(count):
    """Triangles in a plane that do not touch."""
    places = np.stack(np.meshgrid(np.arange(count), np.arange(count), [0]), axis=-1).reshape(-1, 3)
    corner = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0]])
    points = (places[:, None] + corner).reshape(-1, 3)
    return TriMesh(points, np.arange(len(points)).reshape(-1, 3))


def row_on_box(count):
    """A long box with a row of triangles that stand on it."""
    base = changed(box(), vertices=box().vertices * [10, 1, 1])
    places = np.linspace(-4.5, 4.5, count)[:, None, None] * [1, 0, 0]
    corner = np.array([[-0.2, 0, 0.5], [0.2, 0, 0.5], [0, 0, 1.1]])
    points = (places + corner).reshape(-1, 3)
    return merged(base, TriMesh(points, np.arange(len(points)).reshape(-1, 3)))


PIECES = {
    "10 boxes": lambda: scattered_boxes(10),
    "20 boxes": lambda: scattered_boxes(20),
    "10 boxes of 36 vertices": lambda: split_corners(scattered_boxes(10)),
    "cube of 36 vertices": lambda: split_corners(box()),
    "cube of 12 triangles apart": lambda: split_corners(box(), 0.05),
    "balls of triangles apart": lambda: split_corners(
        merged(ball(0), moved(ball(0), (1.5, 0, 0))), 0.05
    ),
    "soup of 72 triangles": lambda: soup(72, 0.2),
    "soup of 72 small triangles": lambda: soup(72, 0.05, 1),
    "octahedra of triangles": lambda: split_corners(
        merged(*(moved(octahedron(), (1.5 * (k % 3), 1.5 * (k // 3), 0)) for k in range(9)))
    ),
    "64 triangles": lambda: triangle_grid(8),
    "triangles on a box": lambda: row_on_box(10),
    "three sheets that cross": lambda: merged(
        *(moved(sheet(6, 6), (-0.5, -0.5, 0.01 * k), turn=k) for k in (5, 6, 7))
    ),
}
"""Models in many pieces, of which shells are full of holes or tangle."""


def fine_ball():
    """A sphere of 200 000 vertices."""
    across, along = 500, 400
    u = np.arange(across) * 2 * np.pi / across
    v = np.pi * (np.arange(along) + 0.5) / along
    u, v = np.meshgrid(u, v, indexing="ij")
    points = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1)
    return TriMesh(points.reshape(-1, 3), grid_faces(across, along, (True, False)))
