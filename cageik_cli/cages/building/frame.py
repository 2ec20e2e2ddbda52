"""The frame in which a cage is built: the same one however a file states the surface."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.util.arrays import Floats

MOMENT_DECIMALS = 5
"""Digits of the moments that order and direct the axes, in units of the frame: what differs by less
is a tie, and the axes stay as they are."""

PLACE_DECIMALS = 6
"""Digits of a position that decide which vertex comes first: single precision has seven."""

MAX_UNEVENNESS = 1e-5
"""How far points are moved so that no two edges of a symmetric shape are equally long, in units of
the frame: rounding is a hundred times less, and it would decide otherwise."""

WAVES = np.array([[13.7, 17.3, 9.1], [8.9, 14.9, 19.7], [16.1, 7.3, 12.7]])
"""Wave vectors of these moves, per unit of the frame: no two are alike along any axis."""


class Frame:
    """A model's own frame: its box at the origin, of a diagonal of one, its longest axis first.

    Axes are permuted and turned over, as the surface is spread along them and leans to one side,
    and stay right-handed. A model that is moved, scaled or turned by 90 degrees has the same
    coordinates in it, unless it is symmetric.

    Parameters
    ----------
    unit : float, optional
        In place of the diagonal, file units.
    """

    def __init__(self, model: TriMesh, unit: float | None = None) -> None:
        low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
        self._centre, self._scale = low + (high - low) / 2, unit or model.diagonal
        self._order, self._signs = np.arange(3), np.ones(3)
        points = self.to_units(model.vertices)
        # By area: the same for vertices that are split where normals or UVs differ.
        areas = lumped_areas(model)
        shares = areas / areas.sum() if areas.sum() > 0 else np.full(len(areas), 1 / len(areas))
        spread, lean = (shares @ points**power for power in (2, 3))
        order = np.argsort(-spread.round(MOMENT_DECIMALS), kind="stable")
        lean = lean.round(MOMENT_DECIMALS)[order]
        signs = np.where(lean < 0, -1.0, 1.0)
        if np.linalg.det(np.eye(3)[order] * signs[:, None]) < 0:
            signs[np.abs(lean).argmin()] *= -1
        self._order, self._signs = order, signs

    def to_units(self, points: Floats) -> Floats:
        """Return places in file units, (..., 3), in units of the frame."""
        units = (points - self._centre) / self._scale
        return np.asarray(units[..., self._order] * self._signs)

    def to_file_units(self, points: Floats) -> Floats:
        """Undo the turn, the move and the scale of (k, 3) points."""
        turned = np.empty_like(points)
        turned[:, self._order] = points * self._signs
        return np.asarray(turned * self._scale + self._centre)


def sort_mesh(mesh: TriMesh) -> TriMesh:
    """Return a mesh with its vertices ordered by their places, and its faces by their vertices."""
    order = np.lexsort(mesh.vertices.round(PLACE_DECIMALS).T[::-1])
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    faces = number[mesh.faces]
    first = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    faces = np.take_along_axis(faces, first, axis=1)
    return TriMesh(mesh.vertices[order], faces[np.lexsort(faces.T[::-1])])


def break_ties(points: Floats) -> Floats:
    """Move points, (k, 3), by smooth waves that have no symmetry, `MAX_UNEVENNESS` at most."""
    return np.asarray(points + MAX_UNEVENNESS * np.sin(points @ WAVES.T + [0.3, 1.1, 2.3]))
