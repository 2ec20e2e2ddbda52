"""A closed shell around any surface: offset, flooded from outside, narrow gaps closed."""

from dataclasses import dataclass

import igl
import numpy as np
from scipy import ndimage

from cageik_cli.cages.building.distance_grid import DistanceGrid
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats


@dataclass(frozen=True, slots=True)
class ShellRecipe:
    """How far a shell keeps off, in diagonals.

    Attributes
    ----------
    offset : float
        Distance of the shell from the model.
    closing : float
        Gaps that are narrower than twice the sum of both are closed.
    """

    offset: float
    closing: float


def make_shell(grid: DistanceGrid, recipe: ShellRecipe) -> TriMesh | None:
    """The outermost part of the shell, None if the grid cannot carry it as a closed manifold."""
    surface = _march(grid, shell_field(grid, recipe))
    return _outermost(surface) if surface is not None else None


def shell_field(grid: DistanceGrid, recipe: ShellRecipe) -> Floats:
    """A continuous function of the nodes, negative inside the shell.

    What cannot be reached from outside, at a distance of offset + closing, is filled; the filled
    body loses a layer of the closing again, wherever the offset does not need it.
    """
    wide = recipe.offset + recipe.closing
    apart = grid.distance - wide
    parts, _ = ndimage.label(apart > 0)
    outside = parts == parts[0, 0, 0]
    depth, nearest = ndimage.distance_transform_edt(~outside, return_indices=True)
    # The body begins between its last node and the first outside: by less than a cell.
    beyond = np.minimum(apart[tuple(nearest)], grid.cell)
    depth = np.where(outside, -apart, grid.cell * depth - beyond)
    return np.minimum(grid.distance - recipe.offset, recipe.closing - depth)


def _march(grid: DistanceGrid, field: Floats) -> TriMesh | None:
    """The surface where the field is zero, by marching cubes; None if it is not manifold."""
    # A node on the surface would make faces without area.
    field = np.where(np.abs(field) < 1e-3 * grid.cell, 1e-3 * grid.cell, field)
    nodes = np.indices(field.shape).reshape(3, -1).T
    order = "F"
    positions = grid.positions(np.stack([nodes[:, 0], nodes[:, 1], nodes[:, 2]], axis=1))
    positions = positions.reshape(*field.shape, 3)
    flat = np.stack([positions[..., k].ravel(order=order) for k in range(3)], axis=1)
    vertices, faces, _ = igl.marching_cubes(field.ravel(order=order), flat, *field.shape, 0.0)
    if len(faces) == 0:
        return None
    return TriMesh(vertices, faces)


def _outermost(surface: TriMesh) -> TriMesh:
    """The component with the largest box, faces turned outward."""
    part = surface.components
    size = np.zeros(part.max() + 1)
    for k in range(len(size)):
        size[k] = np.ptp(surface.vertices[part == k], axis=0).sum()
    kept = part == size.argmax()
    number = np.cumsum(kept) - 1
    faces = number[surface.faces[kept[surface.faces[:, 0]]]]
    shell = TriMesh(surface.vertices[kept], faces)
    return shell if shell.volume > 0 else shell.flipped()
