"""A closed shell around any surface: offset, flooded from outside, narrow gaps closed.

It is made on a grid of the distances from the surface.
"""

from collections.abc import Callable
from dataclasses import dataclass

import igl
import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from cageik_cli.cages.builder.collapse import euler_characteristic
from cageik_cli.cages.builder.frame import break_ties
from cageik_cli.cages.surface_points import find_spacing, sample_in_blocks
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import join_truncated

MAX_GRID_NODES = 1_500_000
"""Nodes of a grid, at most."""

MIN_NAMED_NODES = 8
"""Grid nodes of a place that is worth naming."""

MIN_NAMED_DEPTH = 0.5
"""How far beyond the offset a place that is worth naming reaches, in cells of the grid: what is
closed there otherwise is the rounding of the shell to nodes, which no gap made."""

MAX_JOINED_PARTS = 400
"""Parts that are joined, at most: joining them takes the square of their number."""


class DistanceGrid:
    """Unsigned distances from a surface at the nodes of a regular grid around it.

    Parameters
    ----------
    cell : float
        Side of a cell, at least: cells are made larger to keep to `MAX_GRID_NODES`.
    reach : float
        The grid leaves this and two cells around the surface.

    Attributes
    ----------
    distance : (nx, ny, nz) float64
        At most the true ones, and exact as far as they were measured.
    origin : (3,) float64
        Place of the first node.
    cell : float
        Side of a cell.
    """

    def __init__(self, surface: TriMesh, cell: float, reach: float) -> None:
        low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
        size = high - low + 2 * reach
        self.cell = cell = max(cell, float(np.cbrt(size.prod() / MAX_GRID_NODES)))
        self.origin = low - reach - 2 * cell
        self._surface = surface
        # What every node is from the surface at least, by the nodes nearest to its samples: these
        # are half the diagonal of a cell from a sample, at most; and samples are the corners of
        # triangles that cover the surface, with sides up to their spacing.
        free = np.ones(tuple(np.ceil(size / cell).astype(np.int64) + 5), bool)
        for samples in sample_in_blocks(surface):
            node = np.rint((samples - self.origin) / cell).astype(np.int64)
            free[tuple(node.T)] = False
        slack = np.sqrt(3) / 2 * cell + find_spacing(surface) / np.sqrt(3)
        self.distance = np.asarray(cell * ndimage.distance_transform_edt(free) - slack)
        self._is_exact = np.zeros(self.distance.shape, bool)

    def measure(self, reach: float) -> None:
        """Make the distances exact that are below the reach."""
        chosen = ~self._is_exact & (self.distance < reach)
        places = self.positions(np.argwhere(chosen))
        if len(places):
            self.distance[chosen] = closest_points(self._surface, places).distance
        self._is_exact |= chosen

    def positions(self, nodes: Integers) -> Floats:
        """Return places of nodes (k, 3)."""
        return np.asarray(self.origin + self.cell * nodes)


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


def make_shell(grid: DistanceGrid, offset: float, closing: float) -> Shell | None:
    """Make a shell, if the grid can carry it as a closed manifold.

    Parameters
    ----------
    offset : float
        Distance of the shell from the model.
    closing : float
        Gaps that are narrower than twice the sum of both are closed.
    """
    # A body ends within a cell of the nodes that decide where; marching cubes look at no others.
    grid.measure(offset + closing + 2 * grid.cell)
    field = _compute_field(grid, offset, closing)
    bridges = find_bridges(grid, field < 0)
    if bridges is None:
        return None
    radius = 1.5 * max(offset, grid.cell)
    # Marching cubes look at nodes up to the diagonal of a cell beyond the surface.
    apart = measure_segment_distance(grid, bridges, radius + 2 * grid.cell)
    field = np.minimum(field, apart - radius)
    surface = _march(grid, field)
    if surface is None:
        return None
    added = (field < 0) & _reach(grid.distance > offset)
    added &= apart > radius  # a bridge is none of the model's hollows or gaps
    is_wide = grid.distance > offset + closing
    beyond = offset + MIN_NAMED_DEPTH * grid.cell
    hollows, webs = (_find_centres(grid, added & w, beyond) for w in (is_wide, ~is_wide))
    surface = TriMesh(break_ties(surface.vertices), surface.faces)
    return Shell(surface, bridges.mean(axis=1), hollows, webs)


def describe_closings(
    shell: Shell, to_file_units: Callable[[Floats], Floats], holes: int, *, is_closed: bool
) -> tuple[str, ...]:
    """Return notes on what a shell closed, and where, around a model with so many holes."""
    notes = []
    holes = 1 - euler_characteristic(shell.surface) // 2 - holes
    is_joined = holes > 0 and joins_parts(shell, is_closed)
    for count, what, places in (
        (len(shell.bridges), "parts of the model that lie apart were joined", shell.bridges),
        (len(shell.hollows), "hollows with a narrow opening were filled", shell.hollows),
        (
            is_joined * holes,
            "the cage has holes through it, some perhaps where parts touch and move together",
            shell.webs,
        ),
    ):
        if count:
            texts = [f"({x:.4g}, {y:.4g}, {z:.4g})" for x, y, z in to_file_units(places)]
            where = f", at {join_truncated(texts)}" if texts else ""
            notes.append(f"{what} ({count}){where}")
    return tuple(notes)


def joins_parts(shell: Shell, is_closed: bool) -> bool:
    """Return whether holes of a shell that are none of the model's are between its parts.

    Those of a closed model are known; of an open one, a web tells.
    """
    return is_closed or len(shell.webs) > 0


def _compute_field(grid: DistanceGrid, offset: float, closing: float) -> Floats:
    """Return a continuous function of the nodes, negative inside the shell.

    What cannot be reached from outside, at a distance of offset + closing, is filled; the filled
    body loses a layer of the closing again, wherever the offset does not need it.
    """
    apart = grid.distance - (offset + closing)
    outside = _reach(apart > 0)
    depth, nearest = ndimage.distance_transform_edt(~outside, return_indices=True)
    # The body begins between its last node and the first outside: by less than a cell.
    beyond = np.minimum(apart[tuple(nearest)], grid.cell)
    depth = np.where(outside, -apart, grid.cell * depth - beyond)
    return np.asarray(np.minimum(grid.distance - offset, closing - depth))


def _reach(free: Mask) -> Mask:
    """Return the nodes that can be reached from the grid's corner through free ones."""
    parts, _ = ndimage.label(free)
    return np.asarray(parts == parts[0, 0, 0])


def _find_centres(grid: DistanceGrid, chosen: Mask, beyond: float) -> Floats:
    """Return centres of connected parts, (k, 3), the largest first, that are worth naming.

    They have `MIN_NAMED_NODES`, one of which is `beyond` that distance from the surface.
    """
    parts, count = ndimage.label(chosen)
    if count == 0:
        return np.empty((0, 3))
    sizes = np.bincount(parts.ravel())[1:]
    deepest = ndimage.maximum(grid.distance, parts, np.arange(count) + 1)
    order = np.argsort(-sizes, kind="stable")
    order = order[(sizes[order] >= MIN_NAMED_NODES) & (np.asarray(deepest)[order] > beyond)]
    centres = ndimage.center_of_mass(chosen, parts, order + 1)
    return grid.positions(np.array(centres).reshape(-1, 3))


def _march(grid: DistanceGrid, field: Floats) -> TriMesh | None:
    """Return the outermost surface where the field is zero, by marching cubes, outward.

    It is the component with the largest box. None if the surface is not manifold.
    """
    # A node on the surface would make faces without area.
    field = np.where(np.abs(field) < 1e-3 * grid.cell, 1e-3 * grid.cell, field)
    # libigl counts nodes with x first.
    x, y, z = (o + grid.cell * np.arange(n) for o, n in zip(grid.origin, field.shape, strict=True))
    places = np.empty((*field.shape[::-1], 3))
    places[..., 0], places[..., 1], places[..., 2] = x, y[:, None], z[:, None, None]
    vertices, faces, _ = igl.marching_cubes(
        field.ravel(order="F"), places.reshape(-1, 3), *field.shape, 0.0
    )
    surface = TriMesh(vertices, faces) if len(faces) else None
    if surface is None or not bounds_volume(surface) or not igl.is_vertex_manifold(faces).all():
        return None
    part = surface.components
    size = np.array(
        [np.ptp(surface.vertices[part == k], axis=0).sum() for k in range(part.max() + 1)]
    )
    kept = part == size.argmax()
    number = np.cumsum(kept) - 1
    faces = number[surface.faces[kept[surface.faces[:, 0]]]]
    shell = TriMesh(surface.vertices[kept], faces)
    return shell if shell.volume > 0 else shell.flip()


def find_bridges(grid: DistanceGrid, body: Mask) -> Floats | None:
    """Return segments (b, 2, 3) that make one part of a body's parts, of the least total length.

    They are the tree of shortest segments (Prim 1957). None when there is nothing to join, or more
    than `MAX_JOINED_PARTS`: the time is their square.
    """
    labels, count = ndimage.label(body)
    if not 1 <= count <= MAX_JOINED_PARTS:
        return None
    nodes = np.argwhere(body & ~ndimage.binary_erosion(body))
    of_node = labels[tuple(nodes.T)]
    parts = [grid.positions(nodes[of_node == part]) for part in range(1, count + 1)]
    nearest, segments = np.full(count, np.inf), np.zeros((count, 2, 3))
    left = np.arange(count) > 0
    last, found = 0, []
    while left.any():
        tree = cKDTree(parts[last])
        for k in np.flatnonzero(left):
            distance, at = tree.query(parts[k], distance_upper_bound=nearest[k])
            best = int(distance.argmin())
            if distance[best] < nearest[k]:
                nearest[k] = distance[best]
                segments[k] = parts[last][at[best]], parts[k][best]
        last = int(np.where(left, nearest, np.inf).argmin())
        left[last] = False
        found.append(segments[last])
    return np.array(found).reshape(-1, 2, 3)


def measure_segment_distance(grid: DistanceGrid, segments: Floats, reach: float) -> Floats:
    """Return the distance of every node from the nearest segment.

    It is exact up to `reach`; nodes further from all segments may have infinity.
    """
    nearest = np.full(grid.distance.shape, np.inf)
    for start, stop in segments:
        low, high = np.minimum(start, stop) - reach, np.maximum(start, stop) + reach
        first = np.maximum(np.ceil((low - grid.origin) / grid.cell), 0).astype(np.int64)
        last = np.floor((high - grid.origin) / grid.cell).astype(np.int64)
        box = nearest[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))]
        nodes = grid.positions(np.indices(box.shape).reshape(3, -1).T + first)
        along = stop - start
        share = np.clip((nodes - start) @ along / max(float(along @ along), 1e-300), 0, 1)
        apart = np.linalg.norm(nodes - start - share[:, None] * along, axis=1)
        np.minimum(box, apart.reshape(box.shape), out=box)
    return nearest
