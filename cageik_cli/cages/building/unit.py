"""The model in units of its diagonal, around the origin, and points all over its surface."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.surface_points import sample_in_blocks
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import degenerate_face_mask
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError

SPACING = 0.01
"""Distance of surface points, in diagonals."""

MAX_SAMPLES = 150_000
"""Surface points are spaced further apart when there would be more."""

SLIVER = 1e-7
"""How wide faces without area are made, in diagonals: a distance to a face needs its plane."""


@dataclass(frozen=True, slots=True, eq=False)
class UnitModel:
    """A model that was moved to the origin and scaled to a diagonal of one.

    Attributes
    ----------
    surface : TriMesh
        Its faces, those without area made `SLIVER` wide, and no other vertices.
    samples : (s, 3) float64
        Points of it, about `SPACING` apart.
    centre : (3,) float64
        Where the origin was, file units.
    scale : float
        The diagonal, file units.
    """

    surface: TriMesh
    samples: Floats
    centre: Floats
    scale: float

    def to_units(self, points: Floats) -> Floats:
        """Return places in file units, (..., 3), in units of the model."""
        return np.asarray((points - self.centre) / self.scale)

    def to_file_units(self, points: Floats) -> Floats:
        """Undo the move and the scale of (k, 3) points."""
        return np.asarray(points * self.scale + self.centre)


def normalize_model(model: TriMesh) -> UnitModel:
    """Move and scale the model, and put points on its surface.

    Vertices that are in no face are left out: they may be anywhere.

    Raises
    ------
    FormatError
        When all its vertices are at one place.
    """
    if not model.diagonal > 0:
        raise FormatError("the model is one point, expected a surface; give another mesh")
    model = model.drop_unused_vertices()
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    centre = low + (high - low) / 2
    surface = _widen_slivers(TriMesh((model.vertices - centre) / model.diagonal, model.faces))
    samples = np.empty((0, 3))
    for block in sample_in_blocks(surface, SPACING, MAX_SAMPLES):
        samples = thin_points(np.concatenate([samples, block]), SPACING)
    return UnitModel(surface, samples, centre, model.diagonal)


def thin_points(points: Floats, cell: float) -> Floats:
    """Return the first of the points in each cell of a grid, in their order."""
    cells = np.floor(points / cell).astype(np.int64)
    first = np.unique(cells, axis=0, return_index=True)[1]
    return np.asarray(points[np.sort(first)])


def _widen_slivers(mesh: TriMesh) -> TriMesh:
    """Give every face without area a little triangle."""
    flat = np.flatnonzero(degenerate_face_mask(mesh))
    if len(flat) == 0:
        return mesh
    return add_segments(
        TriMesh(mesh.vertices, np.delete(mesh.faces, flat, axis=0))
        if len(flat) < len(mesh.faces)
        else None,
        mesh.vertices,
        mesh.vertices[_longest_sides(mesh, flat)],
    )


def add_segments(mesh: TriMesh | None, vertices: Floats, ends: Floats) -> TriMesh:
    """Return the mesh (or the vertices alone) with a thin triangle for every segment (k, 2, 3)."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.where(length > SLIVER, along / np.where(length > 0, length, 1), [[1.0, 0, 0]])
    across = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    far = np.where(length > SLIVER, ends[:, 1], ends[:, 0] + SLIVER * along)
    points = np.stack([ends[:, 0], far, ends[:, 0] + SLIVER * across], axis=1).reshape(-1, 3)
    faces = len(vertices) + np.arange(len(points)).reshape(-1, 3)
    if mesh is not None:
        faces = np.concatenate([mesh.faces, faces])
    return TriMesh(np.concatenate([vertices, points]), faces)


def _longest_sides(mesh: TriMesh, faces: Integers) -> Integers:
    """Return the ends of the longest side of each of these faces, (k, 2)."""
    corners = mesh.faces[faces]
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    lengths = np.linalg.norm(mesh.vertices[ends[:, :, 0]] - mesh.vertices[ends[:, :, 1]], axis=2)
    return np.asarray(ends[np.arange(len(faces)), lengths.argmax(axis=1)])
