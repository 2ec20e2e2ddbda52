"""Cages for `walks`, with models in them: kinds that the estimate of the error was not made for."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import ball, box, concave, finer, inside, moved, prism, two_chambers


def make_cages() -> dict[str, tuple[TriMesh, TriMesh]]:
    """Make cages and models, by names."""
    webs = {f"two chambers, a web of {t}": two_chambers(t) for t in (0.1, 0.02, 0.01, 0.003)}
    cages = {
        **webs,
        "ball": ball(3),
        "wavy ball": wavy(ball(3, 1.0)),
        "torus": torus(12, 8, 0.4),
        "torus, n = 640": torus(32, 20, 0.4),
        "thin torus": torus(24, 6, 0.08),
        "fat torus": torus(16, 10, 0.8),
        "L": concave(),
        "L, finer": finer(concave(), 2),
        "box": box(),
        "long box": moved(box(), scale=(1, 1, 30)),
        "flat box": moved(finer(box(), 2), scale=(1, 1, 0.05)),
        "spike": spike(0.02),
        "needle faces": needles(),
        "star": star(),
        "slot of 0.02": slot(0.02),
        "slot of 0.003": slot(0.003),
        "twisted prism": twisted(),
    }
    return {name: (cage, fill(cage)) for name, cage in cages.items()}


def fill(cage: TriMesh) -> TriMesh:
    """A model in a cage: points at least a hundredth of its diagonal inside, in no order."""
    points = inside(cage, 800, margin=0.01)
    return TriMesh(points, np.arange(len(points) // 3 * 3).reshape(-1, 3))


def slot(width: float) -> TriMesh:
    """A U: two arms with a narrow slot between them."""
    left, right = (1 - width) / 2, (1 + width) / 2
    outline = [[0, 0], [1, 0], [1, 1], [right, 1], [right, 0.4], [left, 0.4], [left, 1], [0, 1]]
    cap = [[0, 1, 4], [0, 4, 5], [1, 2, 4], [2, 3, 4], [0, 5, 7], [5, 6, 7]]
    return finer(prism(outline, cap), 1)


def torus(around: int, across: int, radius: float) -> TriMesh:
    """A torus of radius 1 about its axis."""
    u, v = (part.ravel() for part in np.indices((around, across)))
    ring = 1 + radius * np.cos(2 * np.pi * v / across)
    turn = 2 * np.pi * u / around
    height = radius * np.sin(2 * np.pi * v / across)
    points = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    a = np.arange(around * across).reshape(around, across)
    b, d = np.roll(a, -1, axis=0), np.roll(a, -1, axis=1)
    c = np.roll(b, -1, axis=1)
    faces = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    return TriMesh(points, np.concatenate(faces).reshape(-1, 3))


def wavy(mesh: TriMesh) -> TriMesh:
    """A ball whose radius varies by a quarter."""
    x, y, z = 5 * mesh.vertices.T
    return TriMesh(mesh.vertices * (1 + 0.25 * np.sin(x) * np.sin(y + z))[:, None], mesh.faces)


def star() -> TriMesh:
    """A ball with every third vertex pulled out."""
    mesh = ball(2, 1.0)
    return TriMesh(mesh.vertices * np.where(np.arange(66) % 3 == 0, 1.6, 0.8)[:, None], mesh.faces)


def spike(width: float) -> TriMesh:
    """A ball with one vertex pulled out far, to a needle."""
    vertices = ball(3, 1.0).vertices.copy()
    vertices[0] = [3, 0, 0]
    return TriMesh(vertices * [1, 0.3 + width, 0.3 + width], ball(3).faces)


def needles() -> TriMesh:
    """A box whose sides are cut into long thin triangles."""
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    outline = np.stack([np.cos(angles), np.sin(angles)], axis=1) * 0.3
    return prism(outline, [[0, k, k + 1] for k in range(1, 47)])


def twisted() -> TriMesh:
    """A square prism whose upper end is turned by 80 degrees."""
    mesh = finer(box(), 2)
    turn = np.radians(40) * mesh.vertices[:, 2]
    x, y, z = mesh.vertices.T
    turned = [x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), 3 * z]
    return TriMesh(np.stack(turned, axis=1), mesh.faces)
