"""The distance to the model on a grid around it: exact near the model, a lower bound far off."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cageik_cli.cages.building.unit import MAX_SAMPLES, SPACING
from cageik_cli.cages.surface_points import sample_in_blocks
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers

MOST_NODES = 1_500_000
"""Nodes of a grid, at most: cells are made larger to keep to it."""


@dataclass(frozen=True, slots=True, eq=False)
class DistanceGrid:
    """Unsigned distances at the nodes of a regular grid.

    Attributes
    ----------
    distance : (nx, ny, nz) float64
        To the surface; exact up to `reach`, beyond it at least `reach`.
    origin : (3,) float64
        Place of the first node.
    cell : float
        Side of a cell.
    """

    distance: Floats
    origin: Floats
    cell: float
    reach: float

    def positions(self, nodes: Integers) -> Floats:
        """Return places of nodes (k, 3)."""
        return np.asarray(self.origin + self.cell * nodes)


def measure_grid(surface: TriMesh, cell: float, reach: float) -> DistanceGrid:
    """Measure the distance to a surface on a grid that leaves `reach` and two cells around it."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    size = high - low + 2 * reach
    cell = max(cell, float(np.cbrt(size.prod() / MOST_NODES)))
    shape = np.ceil(size / cell).astype(np.int64) + 5
    origin = low - reach - 2 * cell
    coarse = _coarse_distance(surface, origin, cell, shape)
    # A point of the surface is in a cell, a node of it at most this far.
    slack = np.sqrt(3) * cell
    near = np.argwhere(coarse < reach + 2 * slack)
    distance = np.maximum(coarse - 2 * slack, reach)
    exact = closest_points(surface, origin + cell * near).distance
    distance[tuple(near.T)] = exact
    return DistanceGrid(distance, origin, cell, reach)


def _coarse_distance(surface: TriMesh, origin: Floats, cell: float, shape: Integers) -> Floats:
    """Return distance from every node to the nearest node beside a point of the surface."""
    free = np.ones(tuple(shape), bool)
    for samples in sample_in_blocks(surface, SPACING, MAX_SAMPLES):
        node = np.rint((samples - origin) / cell).astype(np.int64)
        free[tuple(node.T)] = False
    return np.asarray(cell * ndimage.distance_transform_edt(free))
