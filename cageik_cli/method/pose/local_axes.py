"""Axes that turn with the surface around a point, from the rest pose to each frame.

The turn is the rotation that fits the motion of the vertices around the point best (Kabsch 1976).
Its covariance is linear in the cage:

    S = Σ_j w_j (x_j − x̄) v_jᵀ = B c,    B = Σ_j w_j (x_j − x̄) H_j,

over vertices at rest x_j, their mean x̄ and their weights w_j: 3 by n numbers of a point.
"""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.geometry.surface_distance import SurfaceDistances
from cageik_cli.method.pose.anchors import COINCIDENT_TOL, SurfacePoint
from cageik_cli.method.pose.hold import fall_off
from cageik_cli.util.arrays import Floats

AXES_RADIUS = 0.08
"""How far around a point the surface counts, in diagonals: the end of an arm, and not its folds."""

MIN_COUNTED = 12
"""Vertices around the point that count at least, on a coarse surface."""

COUNTED_RADIUS = 0.6
"""How far out the last of them is, in radii: what is at the radius counts nothing."""


class LocalAxes:
    """The turn of the surface around a point.

    Parameters
    ----------
    rest : TriMesh
        m vertices.
    weights : (m, n) float64
        H.
    base : (m, 3) float64
        What the mesh of a cage is besides H c.
    """

    def __init__(
        self,
        point: SurfacePoint,
        rest: TriMesh,
        weights: Floats,
        base: Floats,
        distances: SurfaceDistances,
    ) -> None:
        away = distances.measure(point.corners, point.barycentric)
        around = np.sort(away[away > COINCIDENT_TOL * rest.diagonal])[:MIN_COUNTED]
        least = around[-1] / COUNTED_RADIUS if len(around) else 0.0
        counted = fall_off(away / (max(AXES_RADIUS * rest.diagonal, float(least)) or 1.0))
        counted /= counted.sum()
        arms = counted[:, None] * (rest.vertices - counted @ rest.vertices)
        self._map, self.base = arms.T @ weights, arms.T @ base

    def find_turns(self, moves: Floats, base: Floats) -> Floats:
        """Return the turns R, (k, 3, 3), as `points @ R`.

        Parameters
        ----------
        moves : (k, n, 3) float64
            Cages, less that which gives the base.
        base : (3, 3) or (k, 3, 3) float64
            `base`, turned with the frames.
        """
        covariances = self._map @ moves + base
        return nearest_rotations_by_svd(covariances)
