"""A closed shell around any surface: offset, flooded from outside, narrow gaps closed."""

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from cageik_cli.cages.building.bridges import find_bridges, measure_segment_distance
from cageik_cli.cages.building.distance_grid import DistanceGrid
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.util.arrays import Floats

BRIDGE_RADIUS = 1.5
"""Radius of what joins parts that lie apart, over the shell's offset,"""

BRIDGE_CELLS = 1.5
"""and in cells of the grid, at least."""

FEWEST_NODES = 8
"""Nodes of a place that is worth naming."""


@dataclass(frozen=True, slots=True)
class ShellRecipe:
    """The distances of a shell, in diagonals.

    Attributes
    ----------
    offset : float
        Distance of the shell from the model.
    closing : float
        Gaps that are narrower than twice the sum of both are closed.
    """

    offset: float
    closing: float


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """A shell, and the places that it closes.

    Attributes
    ----------
    surface : TriMesh
        Closed, of one component, outward.
    bridges : (b, 3) float64
        Places where parts that lie apart were joined.
    hollows : (h, 3) float64
        Places in hollows that were filled because their openings are narrow.
    webs : (w, 3) float64
        Places where parts that lie near each other were joined, the largest first.
    """

    surface: TriMesh
    bridges: Floats
    hollows: Floats
    webs: Floats


def make_shell(grid: DistanceGrid, recipe: ShellRecipe) -> Shell | None:
    """Return the shell by a recipe, None if the grid cannot carry it as a closed manifold."""
    field = shell_field(grid, recipe)
    bridges = find_bridges(grid, field < 0)
    if bridges is None:
        return None
    radius = max(BRIDGE_RADIUS * recipe.offset, BRIDGE_CELLS * grid.cell)
    # Marching cubes look at nodes up to the diagonal of a cell beyond the surface.
    apart = measure_segment_distance(grid, bridges, radius + 2 * grid.cell)
    field = np.minimum(field, apart - radius)
    surface = _march(grid, field)
    if surface is None:
        return None
    hollows, webs = _closed_places(grid, field, recipe)
    return Shell(_outermost(surface), bridges.mean(axis=1), hollows, webs)


def shell_field(grid: DistanceGrid, recipe: ShellRecipe) -> Floats:
    """Return a continuous function of the nodes, negative inside the shell.

    What cannot be reached from outside, at a distance of offset + closing, is filled; the filled
    body loses a layer of the closing again, wherever the offset does not need it.
    """
    apart = grid.distance - (recipe.offset + recipe.closing)
    outside = _reach(apart > 0)
    depth, nearest = ndimage.distance_transform_edt(~outside, return_indices=True)
    # The body begins between its last node and the first outside: by less than a cell.
    beyond = np.minimum(apart[tuple(nearest)], grid.cell)
    depth = np.where(outside, -apart, grid.cell * depth - beyond)
    return np.asarray(np.minimum(grid.distance - recipe.offset, recipe.closing - depth))


def _reach(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the nodes that can be reached from the grid's corner through free ones."""
    parts, _ = ndimage.label(free)
    return np.asarray(parts == parts[0, 0, 0])


def _closed_places(grid: DistanceGrid, field: Floats, recipe: ShellRecipe) -> tuple[Floats, Floats]:
    """Return where hollows were filled and parts were joined, (h, 3) and (w, 3)."""
    added = (field < 0) & _reach(grid.distance > recipe.offset)
    wide = recipe.offset + recipe.closing
    return (
        _centres(grid, added & (grid.distance > wide)),
        _centres(grid, added & (grid.distance <= wide)),
    )


def _centres(grid: DistanceGrid, chosen: NDArray[np.bool_]) -> Floats:
    """Return centres of the connected parts of more than a few nodes, the largest first, (k, 3)."""
    parts, count = ndimage.label(chosen)
    if count == 0:
        return np.empty((0, 3))
    sizes = np.bincount(parts.ravel())[1:]
    order = np.argsort(-sizes, kind="stable")
    order = order[sizes[order] >= FEWEST_NODES]
    centres = ndimage.center_of_mass(chosen, parts, order + 1)
    return grid.positions(np.array(centres).reshape(-1, 3))


def _march(grid: DistanceGrid, field: Floats) -> TriMesh | None:
    """Return the surface where the field is zero, by marching cubes; None if it is not manifold."""
    # A node on the surface would make faces without area.
    field = np.where(np.abs(field) < 1e-3 * grid.cell, 1e-3 * grid.cell, field)
    # libigl counts nodes with x first.
    nodes = np.indices(field.shape).reshape(3, -1, order="F").T
    vertices, faces, _ = igl.marching_cubes(
        field.ravel(order="F"), grid.positions(nodes), *field.shape, 0.0
    )
    surface = TriMesh(vertices, faces) if len(faces) else None
    if surface is None or not bounds_volume(surface) or not igl.is_vertex_manifold(faces).all():
        return None
    return surface


def _outermost(surface: TriMesh) -> TriMesh:
    """Return the component with the largest box, faces turned outward."""
    part = surface.components
    size = np.zeros(part.max() + 1)
    for k in range(len(size)):
        size[k] = np.ptp(surface.vertices[part == k], axis=0).sum()
    kept = part == size.argmax()
    number = np.cumsum(kept) - 1
    faces = number[surface.faces[kept[surface.faces[:, 0]]]]
    shell = TriMesh(surface.vertices[kept], faces)
    return shell if shell.volume > 0 else shell.flip()
