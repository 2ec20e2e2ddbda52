"""How much too small or too large a cage is for its model."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.repairing.samples import sample_surface
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import bounds_volume, corner_angles
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats

MAX_INFLATION = 20.0
"""Cages that must grow by more, percent of the model's diagonal, are not this model's."""

INFLATION_TOL = 0.01
"""The inflation is found to this share of itself."""

GROWTH = 1.4
"""Factor between the inflations that are tried first."""

MAX_HELD_SAMPLES = 50_000
"""Points of a model's surface by which an inflation is judged, about as many at most."""

MIN_VOLUME = 1e-9
"""Closed models with less, in cubed diagonals, are flat: what they hold is rounding."""

MAX_GAP_SAMPLES = 1500
"""Points of a cage from which the distance to the model is measured, about as many at most."""


@dataclass(frozen=True, slots=True)
class Looseness:
    """How a cage's room compares with its model.

    Attributes
    ----------
    volume_ratio : float, optional
        The cage's volume over the model's; None for an open or a flat model.
    mean_gap : float
        Mean distance of the cage's surface from the model's, percent of the model's diagonal.
    """

    volume_ratio: float | None
    mean_gap: float


def measure_looseness(cage: TriMesh, model: TriMesh) -> Looseness:
    """Compare the room in a cage, closed and turned outward, with its model."""
    closed = bounds_volume(model) and abs(model.volume) > MIN_VOLUME * model.diagonal**3
    samples = sample_surface(cage)
    samples = samples[:: -(-len(samples) // MAX_GAP_SAMPLES)]
    gaps = closest_points(model, samples).distance
    return Looseness(
        volume_ratio=abs(cage.volume / model.volume) if closed else None,
        mean_gap=float(100 * gaps.mean() / model.diagonal),
    )


def measure_inflation(cage: TriMesh, model: TriMesh) -> float | None:
    """Find the smallest offset of the cage along its normals that takes the model inside.

    Parameters
    ----------
    cage : TriMesh
        Closed and turned outward.

    Returns
    -------
    float, optional
        Percent of the model's diagonal, found to hold points all over the model; 0 if the cage
        holds them as it is, None if `MAX_INFLATION` does not, or the cage then crosses itself.
    """
    samples = sample_surface(model)
    samples = samples[:: -(-len(samples) // MAX_HELD_SAMPLES)]
    outside = samples[winding_numbers(cage, samples) < 0.5]
    if len(outside) == 0:
        return 0.0
    normals = vertex_normals(cage) * (model.diagonal / 100)
    depth = 100 * float(closest_points(cage, outside).distance.max()) / model.diagonal
    left, low, high = outside, 0.0, max(depth, INFLATION_TOL)
    while len(found := _find_outside(cage, high * normals, left, outside)):
        left, low, high = found, high, high * GROWTH
        if low > MAX_INFLATION:
            return None
    while high - low > INFLATION_TOL * high:
        middle = (low + high) / 2
        if len(found := _find_outside(cage, middle * normals, left, outside)):
            left, low = found, middle
        else:
            high = middle
    # Where the cage is thin, it may cross itself as it grows, and lose what it held.
    held = high <= MAX_INFLATION and not len(_find_outside(cage, high * normals, samples))
    return high if held else None


def inflate(cage: TriMesh, distance: float) -> TriMesh:
    """Move every vertex of a cage along its normal, file units."""
    return TriMesh(cage.vertices + distance * vertex_normals(cage), cage.faces)


def vertex_normals(mesh: TriMesh) -> Floats:
    """Return unit normals of vertices, (n, 3): those of their faces, weighted by their angles."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    total = np.zeros_like(mesh.vertices)
    np.add.at(total, mesh.faces, corner_angles(mesh)[:, :, None] * normals[:, None])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0, length, 1.0))


def _find_outside(cage: TriMesh, moves: Floats, *samples: Floats) -> Floats:
    """Return the samples, (k, 3), that a cage with moved vertices does not hold.

    Of several sets the first with such samples counts: the likeliest, to save the others.
    """
    grown = TriMesh(cage.vertices + moves, cage.faces)
    left = np.empty((0, 3))
    for points in samples:
        left = points[winding_numbers(grown, points) < 0.5]
        if len(left):
            break
    return left
