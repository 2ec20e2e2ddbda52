"""Random cages for tests: clean by construction, and nasty in every way a clean cage can be."""

import numpy as np
from scipy.spatial import ConvexHull

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points, winding_numbers
from tests.shapes import ball, prism, rotation


def random_cage(seed: int) -> TriMesh:
    """A cage of 20 to 90 faces; the kind goes round with the seed.

    Closed, outward, without self-intersection. Turned and moved at random, of any size.
    """
    generator = np.random.default_rng(seed)
    mesh = KINDS[kind_of(seed)](generator)
    size = 10.0 ** generator.uniform(-2, 2)
    offset = size * generator.choice([0, 1, 1e3]) * generator.normal(size=3)
    return TriMesh(size * mesh.vertices @ rotation(seed).T + offset, mesh.faces)


def kind_of(seed: int) -> str:
    """What sort of cage `random_cage` makes of it."""
    return list(KINDS)[seed % len(KINDS)]


def points_within(cage: TriMesh, seed: int, count: int = 24) -> np.ndarray:
    """Points inside: half of them anywhere, half nearer to the surface the later they come.

    The last are 1e-10 diagonals from faces, edges and corners in turn.
    """
    generator = np.random.default_rng(seed)
    depth = np.repeat(10.0 ** -np.linspace(0.5, 10, count // 2), 40)
    depth = np.concatenate([10.0 ** generator.uniform(-3, 0, 40 * (count // 2)), depth])
    shares = generator.dirichlet(np.ones(3), len(depth))
    shares[1::3, 0] = 0
    shares[2::3, :2] = 0
    shares /= shares.sum(axis=1, keepdims=True)
    corners = cage.vertices[generator.choice(cage.faces, len(depth))]
    away = generator.normal(size=(len(depth), 3))
    away *= (depth * cage.diagonal / np.linalg.norm(away, axis=1))[:, None]
    points = np.einsum("ik,ikx->ix", shares, corners) + away
    kept = winding_numbers(cage, points) > 0.5
    kept &= closest_points(cage, points).distance > 2e-12 * cage.diagonal
    return np.concatenate([group[:1] for group in _groups(points, kept, count) if len(group)])


def _groups(points: np.ndarray, kept: np.ndarray, count: int) -> list[np.ndarray]:
    return [
        group[inside]
        for group, inside in zip(np.split(points, count), np.split(kept, count), strict=True)
    ]


def _star(generator: np.random.Generator) -> TriMesh:
    """Seen whole from the origin."""
    mesh = _sphere(generator)
    return _pulled(mesh, generator.uniform(0.4, 1, len(mesh.vertices)))


def _hull(generator: np.random.Generator) -> TriMesh:
    return _convex(generator.normal(size=(generator.integers(40, 120), 3)))


def _thin(generator: np.random.Generator) -> TriMesh:
    mesh = _star(generator)
    return TriMesh(mesh.vertices * [1, 1, generator.uniform(0.01, 0.05)], mesh.faces)


def _elongated(generator: np.random.Generator) -> TriMesh:
    mesh = _star(generator)
    return TriMesh(mesh.vertices * [1, 1, generator.uniform(10, 40)], mesh.faces)


def _spiky(generator: np.random.Generator) -> TriMesh:
    mesh = _sphere(generator)
    radii = generator.uniform(0.8, 1, len(mesh.vertices))
    radii[generator.choice(len(radii), 4, replace=False)] *= generator.uniform(3, 5, 4)
    return _pulled(mesh, radii)


def _dented(generator: np.random.Generator) -> TriMesh:
    mesh = _sphere(generator)
    radii = generator.uniform(0.8, 1, len(mesh.vertices))
    radii[generator.choice(len(radii), 5, replace=False)] *= 10 ** generator.uniform(-2, -0.5, 5)
    return _pulled(mesh, radii)


def _slit(generator: np.random.Generator) -> TriMesh:
    """Two blocks on a bridge, all but touching."""
    return _u_shape(gap=10 ** generator.uniform(-3, -2), left=1.0, right=1.0, bridge=0.7)


def _folded(generator: np.random.Generator) -> TriMesh:
    """A thin sheet folded upon itself."""
    left, right, bridge = generator.uniform(0.01, 0.05, 3)
    return _u_shape(10 ** generator.uniform(-3, -2), left, right, bridge)


KINDS = {
    "star": _star,
    "hull": _hull,
    "thin": _thin,
    "elongated": _elongated,
    "spiky": _spiky,
    "dented": _dented,
    "slit": _slit,
    "folded": _folded,
}


def _sphere(generator: np.random.Generator) -> TriMesh:
    """An octahedron divided, or the hull of random places."""
    if generator.random() < 0.3:
        return ball(1, 1.0)
    places = generator.normal(size=(generator.integers(18, 40), 3))
    places = np.concatenate([places, np.eye(3), -np.eye(3)])  # so that the origin is inside
    return _convex(places / np.linalg.norm(places, axis=1)[:, None])


def _pulled(sphere: TriMesh, radii: np.ndarray) -> TriMesh:
    return TriMesh(sphere.vertices * radii[:, None], sphere.faces)


def _convex(places: np.ndarray) -> TriMesh:
    hull = ConvexHull(places)
    numbers = np.full(len(places), -1)
    numbers[hull.vertices] = np.arange(len(hull.vertices))
    a, b, c = places[hull.simplices].swapaxes(0, 1)
    turned = np.einsum("ix,ix->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces = np.where(turned[:, None], hull.simplices[:, ::-1], hull.simplices)
    return TriMesh(places[hull.vertices], numbers[faces])


def _u_shape(gap: float, left: float, right: float, bridge: float) -> TriMesh:
    """A U of height and depth one, its arms `gap` apart, over a bridge."""
    x = np.cumsum([0, left, gap, right])
    low, high = [[x[0], 0], [x[3], 0], [x[3], 1], [x[2], 1]], [[x[1], 1], [0, 1]]
    return prism(
        [*low, [x[2], bridge], [x[1], bridge], *high],
        [[0, 1, 4], [1, 2, 4], [2, 3, 4], [0, 4, 5], [0, 5, 7], [5, 6, 7]],
    )
