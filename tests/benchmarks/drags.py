"""Bindings of any size to drag at, and the median time of a move.

Cages are wavy spheres; weights are smooth and convex, but not harmonic: of the ten cage vertices
nearest in direction. Nothing that is timed depends on their values.
"""

import time

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.pose.anchors import Anchor, point_at_vertex
from cageik_cli.method.weights.binding import Binding
from tests.benchmarks.growth import spread_directions, wavy_sphere

NEAREST = 10


def synthetic(vertices: int, points: int, is_meshed: bool = False) -> Binding:
    """A cage of `vertices` around a model of `points`; meshed, the model is a closed surface."""
    cage, directions = wavy_sphere(vertices), spread_directions(points)
    corners = cage.vertices / np.linalg.norm(cage.vertices, axis=1)[:, None]
    distances, nearest = cKDTree(corners).query(directions, NEAREST)
    shares = np.exp(-((2 * distances / distances[:, -1:]) ** 2))
    weights = np.zeros((points, vertices))
    np.put_along_axis(weights, nearest, shares / shares.sum(axis=1, keepdims=True), axis=1)
    faces = ConvexHull(directions).simplices if is_meshed else [[0, 1, 2]]
    return Binding(TriMesh(weights @ cage.vertices, np.asarray(faces, np.int64)), cage, weights)


def spread_anchors(binding: Binding, count: int) -> list[Anchor]:
    """Vertices from all over the model."""
    chosen = np.linspace(0, len(binding.rest.vertices) - 1, count).astype(int)
    return [Anchor(f"a{vertex}", point_at_vertex(binding.rest, vertex)) for vertex in chosen]


def moves_of(count: int, anchors: int) -> np.ndarray:
    """Displacements (count, anchors, 3), of about a tenth of the model's size."""
    return 0.1 * np.random.default_rng(0).normal(size=(count, anchors, 3))


def median_seconds(moves: np.ndarray, work) -> float:
    """Median time of `work` over moves, each another one."""
    seconds = []
    for move in moves:
        start = time.perf_counter()
        work(move)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))
