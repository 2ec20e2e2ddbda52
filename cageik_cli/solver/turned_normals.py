"""Normals that joints turn, and how far they are from those of the meshes that they follow.

A normal n of a vertex with weights w is turned into the direction of Σ_j w_j n R_j.
"""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.normals import compute_vertex_normals
from cageik_cli.geometry.points import columns_to_frames
from cageik_cli.util.arrays import Floats

ANGLES_PER_DEGREE = 20
"""Angles of normals are counted in so many steps per degree."""


def turn_normals(normals: Floats, weights: Floats, turns: Floats) -> Floats:
    """Return normals (m, 3) as skins of weights (m, n) turn them by (k, n, 3, 3); of length 1.

    They are (k, m, 3).
    """
    count, n = turns.shape[:2]
    found = np.zeros((len(normals), 3 * count))
    for axis in range(3):
        along = turns[:, :, axis].transpose(1, 0, 2).reshape(n, 3 * count)
        found += normals[:, axis, None] * (weights @ along)
    frames = columns_to_frames(found)
    lengths = np.linalg.norm(frames, axis=2, keepdims=True)
    return np.asarray(np.divide(frames, lengths, out=np.zeros_like(frames), where=lengths > 0))


class NormalAngles:
    """Counts angles between the normals of a skin, (m, n) weights, and those of meshes.

    A vertex whose faces cancel has no normal, and is left out.
    """

    def __init__(self, rest: TriMesh, weights: Floats) -> None:
        self._rest, self._weights = rest, weights
        self._normals = compute_vertex_normals(rest.polygons, rest.vertices)
        self._counts = np.zeros(180 * ANGLES_PER_DEGREE + 1, np.int64)
        self._squares = 0.0

    def add(self, turns: Floats, meshes: Floats) -> None:
        """Add the angles of frames, (k, m, 3), whose joints turn by (k, n, 3, 3)."""
        found = turn_normals(self._normals, self._weights, turns)
        for mesh, shaded in zip(meshes, found, strict=True):
            expected = compute_vertex_normals(self._rest.polygons, mesh)
            is_known = self._normals.any(axis=1) & expected.any(axis=1)
            cosines = np.einsum("mx,mx->m", shaded, expected)[is_known]
            angles = np.degrees(np.arccos(cosines.clip(-1, 1)))
            self._squares += float(np.square(angles).sum())
            steps = (angles * ANGLES_PER_DEGREE).astype(np.int64)
            self._counts += np.bincount(steps, minlength=len(self._counts))

    def summarize(self) -> tuple[float, float] | None:
        """Return the root mean square and the 99th percentile, degrees; None of no angles."""
        done = np.cumsum(self._counts)
        if not done[-1]:
            return None
        step = np.searchsorted(done, 0.99 * done[-1])
        return float(np.sqrt(self._squares / done[-1])), float(step / ANGLES_PER_DEGREE)
