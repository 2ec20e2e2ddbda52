"""Faces and vertices that are one too many or missing, and faces that are turned.

A cage is polygons here, for its faces may be quads. Each function takes polygons and gives new
ones, with vertices where they were.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from cageik_cli.geometry.attributes import fan_triangulate, find_folded_triangles
from cageik_cli.geometry.mesh import TriMesh, find_groups, signed_volumes
from cageik_cli.geometry.shape import find_next_corners
from cageik_cli.util.arrays import Floats, Integers, Mask


def find_coincident(vertices: Floats, candidates: Integers) -> Integers:
    """Return the first vertex at the place of each, (n,); others than candidates stay.

    Vertices within 1e-7 diagonals of each other are at one place.
    """
    reach = 1e-7 * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    pairs = cKDTree(vertices[candidates]).query_pairs(reach, output_type="ndarray")
    group = find_groups(candidates[pairs].reshape(-1, 2), len(vertices))
    _, first = np.unique(group, return_index=True)
    return np.asarray(first[group], np.int64)


@dataclass(frozen=True, eq=False)
class PolygonMesh:
    """Polygons whose corners follow one another, and their fans.

    Attributes
    ----------
    vertices : (n, 3) float64
        File units.
    corners : (c,) int64
        The rings of all polygons, one after the other.
    corner_counts : (p,) int64
        How many corners each polygon has, 3 or more.
    """

    vertices: Floats
    corners: Integers
    corner_counts: Integers

    @staticmethod
    def from_fans(mesh: TriMesh, corner_counts: Integers | None = None) -> "PolygonMesh":
        """Find the rings of polygons that were cut into fans at their first corners.

        Parameters
        ----------
        mesh : TriMesh
            The fans follow one another, as `formats` gives them before it mends folded ones.
        corner_counts : (p,) int64, optional
            Of the polygons; all are triangles by default.

        Raises
        ------
        ValueError
            When the triangles are not such fans.
        """
        if corner_counts is None:
            return PolygonMesh(mesh.vertices, mesh.faces.ravel(), np.full(len(mesh.faces), 3))
        if corner_counts.min() < 3 or (corner_counts - 2).sum() != len(mesh.faces):
            raise ValueError("the numbers of corners are not those of the mesh")
        parts = np.split(mesh.faces, np.cumsum(corner_counts - 2)[:-1])
        rings = [np.concatenate([fan[0, :2], fan[:, 2]]) for fan in parts]
        found = PolygonMesh.from_rings(mesh.vertices, rings)
        if not np.array_equal(found.triangles.faces, mesh.faces):
            raise ValueError("the triangles are not fans of polygons")
        return found

    @staticmethod
    def from_rings(vertices: Floats, rings: list[Integers]) -> "PolygonMesh":
        """Put the rings of polygons one after the other."""
        counts = np.array([len(ring) for ring in rings], np.int64)
        corners = np.concatenate([np.empty(0, np.int64), *rings]).astype(np.int64)
        return PolygonMesh(vertices, corners, counts)

    @cached_property
    def rings(self) -> list[Integers]:
        """Return the corners of each polygon."""
        return np.split(self.corners, np.cumsum(self.corner_counts)[:-1])

    @cached_property
    def polygon_numbers(self) -> Integers:
        """Return the polygon of each corner, (c,)."""
        return np.repeat(np.arange(len(self.corner_counts)), self.corner_counts)

    @cached_property
    def triangle_polygons(self) -> Integers:
        """Return the polygon of each triangle, (f,)."""
        return np.repeat(np.arange(len(self.corner_counts)), self.corner_counts - 2)

    @cached_property
    def next_places(self) -> Integers:
        """Return where the corner that follows each in its ring stands, (c,)."""
        return find_next_corners(self.corner_counts)

    @property
    def next_corners(self) -> Integers:
        """Return the corner that follows each in its ring, (c,)."""
        return self.corners[self.next_places]

    @cached_property
    def edge_numbers(self) -> Integers:
        """Return the number of the edge that begins at each corner, (c,)."""
        ends = np.sort(np.stack([self.corners, self.next_corners], axis=1), axis=1)
        return np.unique(ends, axis=0, return_inverse=True)[1].ravel()

    @cached_property
    def edge_uses(self) -> Integers:
        """Return how many polygons the edge that begins at each corner has, (c,)."""
        return np.bincount(self.edge_numbers)[self.edge_numbers]

    @cached_property
    def triangles(self) -> TriMesh:
        """Return the fans of the polygons at their first corners."""
        return TriMesh(self.vertices, fan_triangulate(self.corners, self.corner_counts))

    @cached_property
    def is_folded(self) -> Mask:
        """Return which polygons have a fan that folds over, (p,)."""
        counts = self.corner_counts - 2
        folded, _ = find_folded_triangles(self.vertices, self.triangles.faces, counts)
        return np.asarray(np.logical_or.reduceat(folded, np.cumsum(counts) - counts))

    def move(self, vertices: Floats) -> "PolygonMesh":
        """Return the same polygons with their vertices elsewhere."""
        return PolygonMesh(vertices, self.corners, self.corner_counts)

    def keep(self, chosen: Mask) -> "PolygonMesh":
        """Return only the chosen polygons, all vertices."""
        corners = self.corners[chosen[self.polygon_numbers]]
        return PolygonMesh(self.vertices, corners, self.corner_counts[chosen])

    def turn(self, chosen: Mask) -> "PolygonMesh":
        """Turn the chosen polygons over; first corners and diagonals stay."""
        rings = [
            np.concatenate([ring[:1], ring[:0:-1]]) if turned else ring
            for ring, turned in zip(self.rings, chosen, strict=True)
        ]
        return PolygonMesh.from_rings(self.vertices, rings)

    def unfold(self) -> "PolygonMesh":
        """Start folded fans at another corner; cut those that fold from every corner.

        A reader of the file then cuts the polygons into the very triangles that were tested.
        """
        if not self.is_folded.any():
            return self
        rings: list[Integers] = []
        for ring, folded in zip(self.rings, self.is_folded, strict=True):
            if not folded:
                rings.append(ring)
                continue
            turned = (np.roll(ring, -k) for k in range(1, len(ring)))
            meshes = (PolygonMesh.from_rings(self.vertices, [other]) for other in turned)
            whole = next((mesh.corners for mesh in meshes if not mesh.is_folded.any()), None)
            fan = PolygonMesh.from_rings(self.vertices, [ring]).triangles.faces
            rings += list(fan) if whole is None else [whole]
        return PolygonMesh.from_rings(self.vertices, rings)


def replace_corners(mesh: PolygonMesh, target: Integers) -> PolygonMesh:
    """Name other vertices; a corner that then repeats the one before it goes.

    Polygons that are left with fewer than three corners go, and so do those that touch themselves.
    """
    rings = []
    for ring in mesh.rings:
        named = target[ring]
        named = named[named != np.roll(named, 1)]
        if len(named) >= 3 and len(np.unique(named)) == len(named):
            rings.append(named)
    return PolygonMesh.from_rings(mesh.vertices, rings)


def find_repeated(mesh: PolygonMesh) -> Mask:
    """Return which polygons have the vertices of one before them, (p,)."""
    keys = [tuple(sorted(ring.tolist())) for ring in mesh.rings]
    first = dict(zip(reversed(keys), reversed(range(len(keys))), strict=True))
    return np.array([first[key] != number for number, key in enumerate(keys)], bool)


def drop_unreferenced(mesh: PolygonMesh) -> tuple[PolygonMesh, Integers]:
    """Drop the vertices in no face; return the new number of each old vertex, −1 if dropped."""
    used = np.unique(mesh.corners)
    numbers = np.full(len(mesh.vertices), -1)
    numbers[used] = np.arange(len(used))
    return PolygonMesh(mesh.vertices[used], numbers[mesh.corners], mesh.corner_counts), numbers


def count_topology_faults(mesh: PolygonMesh) -> int:
    """Return edges that have not two polygons, and parts of vertices that touch in a point."""
    edge = mesh.edge_numbers
    _, first = np.unique(edge, return_index=True)
    # Corners of one vertex on one edge are joined; a vertex has one such group for each fan.
    size, after = len(mesh.corners), mesh.next_places
    ends = np.concatenate([mesh.corners, mesh.next_corners])
    key = np.concatenate([edge, edge]) * len(mesh.vertices) + ends
    place = np.concatenate([np.arange(size), after])
    order = np.argsort(key, kind="stable")
    same = np.diff(key[order]) == 0
    joined = np.stack([place[order][:-1][same], place[order][1:][same]], axis=1)
    fans = len(np.unique(find_groups(joined, size)))
    return int(np.count_nonzero(mesh.edge_uses[first] != 2)) + fans - len(np.unique(mesh.corners))


def find_boundary_vertices(mesh: PolygonMesh) -> Integers:
    """Return vertices on edges that have not two polygons."""
    is_border = mesh.edge_uses != 2
    return np.unique(np.concatenate([mesh.corners[is_border], mesh.next_corners[is_border]]))


def find_fins(mesh: PolygonMesh) -> Mask:
    """Find polygons on an edge which two others share, that are open elsewhere, (p,)."""
    fins = np.zeros(len(mesh.corner_counts), bool)
    while True:
        rest = mesh.keep(~fins)
        numbers, count = rest.polygon_numbers, len(rest.corner_counts)
        crowded = np.bincount(numbers[rest.edge_uses > 2], minlength=count) > 0
        open_sides = np.bincount(numbers[rest.edge_uses == 1], minlength=count)
        is_fin = crowded & (open_sides > 0)
        if fins.any():
            is_fin |= open_sides == rest.corner_counts
        if not is_fin.any():
            return fins
        fins[np.flatnonzero(~fins)[is_fin]] = True


def label_patches(mesh: PolygonMesh) -> Integers:
    """Number the patch of each polygon, (p,): two polygons that alone share an edge share it."""
    pairs, _ = _find_neighbours(mesh)
    return find_groups(pairs, len(mesh.corner_counts))


def find_misoriented(mesh: PolygonMesh) -> Mask:
    """Return which polygons to turn so that neighbours face alike, (p,); the fewest of each patch.

    Each polygon is two nodes, as it is and turned; neighbours that agree tie like to like. A
    patch that has no sides, such as a Möbius strip, stays as it is.
    """
    pairs, agree = _find_neighbours(mesh)
    size = len(mesh.corner_counts)
    cross = np.where(agree, 0, size)
    straight = pairs + np.stack([np.zeros_like(cross), cross], axis=1)
    reverse = pairs + np.stack([np.full_like(cross, size), size - cross], axis=1)
    label = find_groups(np.concatenate([straight, reverse]), 2 * size)
    as_is, turned = label[:size], label[size:]
    votes = np.bincount(as_is, minlength=label.max() + 1)
    # Of a patch that ties with its counterpart, the one of the larger label is turned.
    is_tie_turned = (votes[turned] == votes[as_is]) & (as_is > turned)
    return np.asarray((votes[turned] > votes[as_is]) | is_tie_turned, np.bool_)


def find_inward_facing(mesh: PolygonMesh) -> Mask:
    """Return which polygons belong to closed components of negative volume, (p,)."""
    label = label_patches(mesh)
    inward = np.zeros(len(label), bool)
    for patch in range(label.max() + 1):
        chosen = label == patch
        faces = mesh.triangles.faces[chosen[mesh.triangle_polygons]]
        if (mesh.edge_uses[chosen[mesh.polygon_numbers]] == 2).all():
            inward |= chosen & (signed_volumes(mesh.vertices[None], faces)[0] < 0)
    return inward


def _find_neighbours(mesh: PolygonMesh) -> tuple[Integers, Mask]:
    """Find pairs of polygons, (p, 2), that alone share an edge; and which pass it oppositely."""
    chosen = np.flatnonzero(mesh.edge_uses == 2)
    sides = chosen[np.argsort(mesh.edge_numbers[chosen], kind="stable")].reshape(-1, 2)
    starts = mesh.corners[sides]
    return mesh.polygon_numbers[sides], starts[:, 0] != starts[:, 1]


def find_holes(mesh: PolygonMesh) -> list[Integers]:
    """Return the loops of open edges, each turned as the face that would close it.

    Loops that pass a vertex twice are left out.
    """
    is_open = mesh.edge_uses == 1
    starts, stops = mesh.next_corners[is_open], mesh.corners[is_open]
    departures, arrivals = (np.bincount(v, minlength=len(mesh.vertices)) for v in (starts, stops))
    follow = dict(zip(starts.tolist(), stops.tolist(), strict=True))
    simple = (departures == 1) & (arrivals == 1)
    loops = []
    for start in np.flatnonzero(simple).tolist():
        loop = [start]
        while (after := follow.get(loop[-1])) is not None and simple[after] and after != start:
            loop.append(after)
        for vertex in loop:
            simple[vertex] = False
        if follow.get(loop[-1]) == start:
            loops.append(np.array(loop, np.int64))
    return loops


def close_hole(mesh: PolygonMesh, loop: Integers) -> PolygonMesh:
    """Add the faces of least area over a loop: a quad as one face in cages that have quads."""
    if len(loop) == 4 and (mesh.corner_counts == 4).any():
        return PolygonMesh.from_rings(mesh.vertices, [*mesh.rings, loop]).unfold()
    # Which vertices of the loop an edge joins already.
    place = np.full(len(mesh.vertices), -1)
    place[loop] = np.arange(len(loop))
    sides = place[np.stack([mesh.corners, mesh.next_corners], axis=1)]
    start, stop = sides[(sides >= 0).all(axis=1)].T
    joined = np.zeros((len(loop), len(loop)), bool)
    joined[start, stop] = joined[stop, start] = True
    added = loop[_fill_polygon(mesh.vertices[loop], joined)]
    closed = PolygonMesh.from_rings(mesh.vertices, [*mesh.rings, *added])
    return closed.unfold() if len(loop) == 4 else closed


def _fill_polygon(points: Floats, joined: Mask) -> Integers:
    """Return the triangles of least area over a polygon (k, 3): numbers of corners, (k − 2, 3).

    Dynamic programming over its chords, Barequet and Sharir 1995. A chord between corners that an
    edge has `joined` already, (k, k), would have four faces.
    """
    count = len(points)
    cost = np.zeros((count, count))
    middle = np.zeros((count, count), np.int64)
    for width in range(2, count):
        for i in range(count - width):
            k = i + width
            j = np.arange(i + 1, k)
            area = np.linalg.norm(np.cross(points[j] - points[i], points[k] - points[i]), axis=1)
            total = cost[i, j] + cost[j, k] + area
            is_side = width == count - 1
            cost[i, k] = np.inf if joined[i, k] and not is_side else total.min()
            middle[i, k] = j[total.argmin()]
    return np.array(_list_triangles(middle, 0, count - 1), np.int64)


def _list_triangles(middle: Integers, i: int, k: int) -> list[list[int]]:
    if k - i < 2:
        return []
    j = int(middle[i, k])
    below = [t for low, high in pairwise((i, j, k)) for t in _list_triangles(middle, low, high)]
    return [[i, j, k], *below]
