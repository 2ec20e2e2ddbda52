"""Mirror planes, and the pairs of vertices that are each other's mirror images."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError

PAIR_TOL = 1e-6
"""How far partners may be from mirror images, in diagonals: ten times the rounding of single
precision."""

SAMPLE_SIZE = 64
"""Vertices whose partners are looked for first, spread over all; most planes fail there."""

MAX_WORK = 30_000_000
"""Distances that are computed for all planes together: seconds, and all of 5000 vertices once."""

PLANE_WORK, QUERY_WORK = 15_000, 10
"""What takes as long as so many distances: to try a plane, and to look for one vertex in cells."""

PLANE_STEPS_PER_REACH = 8
"""Planes are taken as one if they mirror within a part of what is allowed, of about this size."""

CELL_SIZE_PER_REACH = 8
"""Few balls of the reach then touch several cells, and few points share one."""

MAX_CELLS = 1e6
"""Along an axis, so that three numbers of cells fit into one of 64 bits."""

MAX_COMPARED = 1 << 18
"""Distances that are computed at once."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """A mirror plane.

    Attributes
    ----------
    normal : (3,) float64
        Of any length above zero; normalised.
    point : (3,) float64
        A point on the plane.
    """

    normal: Floats
    point: Floats

    def __post_init__(self) -> None:
        normal, point = (np.asarray(v, np.float64) for v in (self.normal, self.point))
        size = np.linalg.norm(normal)
        if not (size > 0 and np.isfinite(normal).all() and np.isfinite(point).all()):
            raise HandlesError(
                f"normal is {normal.tolist()} and point {point.tolist()}, expected finite "
                "numbers and a normal that is not zero"
            )
        object.__setattr__(self, "normal", normal / size)
        object.__setattr__(self, "point", point)

    def __str__(self) -> str:
        if np.count_nonzero(self.normal) == 1:
            axis = int(np.abs(self.normal).argmax())
            return f"the plane {'xyz'[axis]} = {self.point[axis] + 0.0:.4g}"
        # The same words for the same plane: its point nearest to the origin, and one of its sides.
        normal = self.normal * np.sign(self.normal[np.abs(self.normal).argmax()])
        foot = normal * (normal @ self.point)
        words = [", ".join(f"{x + 0.0:.4g}" for x in v) for v in (foot, normal)]
        return f"the plane through ({words[0]}) across ({words[1]})"

    def to_record(self) -> dict[str, list[float]]:
        """Return the plane as a handles file has it."""
        return {"normal": self.normal.tolist(), "point": self.point.tolist()}

    def reflect(self, points: Floats) -> Floats:
        """Return the mirror images of points, (…, 3)."""
        heights = (points - self.point) @ self.normal
        return np.asarray(points - 2 * heights[..., None] * self.normal)

    def find_pairs(self, vertices: Floats, tolerance: float = PAIR_TOL) -> Integers | None:
        """Return the partner of each vertex, (n,); None if one has none.

        A vertex on the plane is its own partner.

        Parameters
        ----------
        tolerance : float
            How far partners may be from mirror images, in diagonals of the box around all.
        """
        reach = tolerance * float(np.linalg.norm(np.ptp(vertices, axis=0)))
        return _Cells(vertices, reach).find_pairs(self)

    def find_nearest(self, vertices: Floats, tolerance: float) -> tuple[Floats, Integers]:
        """Return how far the mirror image of each vertex is from the nearest vertex, and which.

        They are infinite, and 0, where none is within the tolerance, in diagonals.
        """
        reach = tolerance * float(np.linalg.norm(np.ptp(vertices, axis=0)))
        return _Cells(vertices, reach).find_nearest(self.reflect(vertices))

    def mirrors_polygons(self, cage: TriMesh) -> bool:
        """Return whether a cage with such pairs has the mirror image of each of its edges, too."""
        partner = self.find_pairs(cage.vertices)
        if partner is None:
            return False
        images = np.sort(partner[cage.polygon_sides], axis=1)
        return np.array_equal(np.unique(images, axis=0), cage.polygon_sides)


def find_mirror(vertices: Floats, tolerance: float = PAIR_TOL) -> Mirror | None:
    """Return the plane across which vertices, (n, 3), have partners; None if there is none.

    The plane halves the line between a vertex and its partner, and contains the centre of all. So
    the partner of a vertex off the plane is one that is as far from the centre, and few are. Of
    several planes, those across the axes come first. The search ends after `MAX_WORK`.

    Parameters
    ----------
    tolerance : float
        Above 0; as of `Mirror.find_pairs`.
    """
    if len(vertices) < 2 or len(np.unique(vertices, axis=0)) < len(vertices):
        return None  # two at one place have the same partner
    centre, diagonal = vertices.mean(axis=0), float(np.linalg.norm(np.ptp(vertices, axis=0)))
    reach = tolerance * diagonal
    cells, few = _Cells(vertices, reach, MAX_WORK), vertices[:: -(-len(vertices) // SAMPLE_SIZE)]
    compared: set[tuple[int, ...]] = set()
    for mirror in _list_planes(vertices, reach):
        cells.work += PLANE_WORK
        if cells.work > MAX_WORK:
            break
        if not np.isfinite(cells.find_nearest(mirror.reflect(few))[0]).all():
            continue
        offset = mirror.normal @ (mirror.point - centre) / diagonal
        steps = PLANE_STEPS_PER_REACH / tolerance * np.append(mirror.normal, offset)
        key = tuple(np.rint(steps).tolist())
        if key in compared:
            continue
        if cells.find_pairs(mirror) is not None:
            return mirror
        compared |= {key, tuple(-k for k in key)}
    return None


class _Cells:
    """Points in cubes, to find those within `reach` of others: the nearest of few, not of all.

    Without scipy: every result is looked through for pairs, and a warm run shall not import it.

    Attributes
    ----------
    work : float
        What was done, in distances that are computed; beyond `max_work` nothing is near.
    """

    def __init__(self, points: Floats, reach: float, max_work: float = np.inf) -> None:
        self._points, self._reach = points, reach
        self.work, self._max_work = 0.0, max_work
        extent = np.ptp(points, axis=0)
        self._size = max(CELL_SIZE_PER_REACH * reach, float(extent.max()) / MAX_CELLS) or 1.0
        self._low = points.min(axis=0)
        self._counts = np.floor(extent / self._size).astype(np.int64) + 3  # empty ones around
        keys = self._number(self._place(points))
        self._order = np.argsort(keys, kind="stable")
        self._keys = keys[self._order]

    def find_pairs(self, mirror: Mirror) -> Integers | None:
        """Return the partner of each point, (n,), as `Mirror.find_pairs`."""
        distances, partners = self.find_nearest(mirror.reflect(self._points))
        if not np.isfinite(distances).all():
            return None
        is_pair = partners[partners] == np.arange(len(partners))
        return partners if is_pair.all() else None

    def find_nearest(self, queries: Floats) -> tuple[Floats, Integers]:
        """Return the distances of queries (q, 3) from the nearest points, and which these are.

        They are infinite, and 0, where no point is within reach. Of equally near ones, it is the
        first.
        """
        low, high = (self._place(queries + side * self._reach) for side in (-1, 1))
        rows, firsts, lasts = [], [], []
        for corner in np.ndindex(2, 2, 2):
            is_other = np.flatnonzero(((low < high) >= corner).all(axis=1))
            keys = self._number(low[is_other] + corner)
            rows.append(is_other)
            firsts.append(np.searchsorted(self._keys, keys, "left"))
            lasts.append(np.searchsorted(self._keys, keys, "right"))
        row, first, last = (np.concatenate(each) for each in (rows, firsts, lasts))
        held = np.flatnonzero(last > first)
        row, first, counts = row[held], first[held], (last - first)[held]
        self.work += QUERY_WORK * len(queries) + float(counts.sum())
        distances, nearest = np.full(len(queries), np.inf), np.zeros(len(queries), np.int64)
        if not len(row) or self.work > self._max_work:
            return distances, nearest
        squares, points = self._find_nearest_in_cells(queries[row], first, counts)
        order = np.lexsort((points, squares, row))
        best = order[np.flatnonzero(np.diff(row[order], prepend=-1))]
        best = best[np.sqrt(squares[best]) <= self._reach]
        distances[row[best]], nearest[row[best]] = np.sqrt(squares[best]), points[best]
        return distances, nearest

    def _find_nearest_in_cells(
        self, queries: Floats, first: Integers, counts: Integers
    ) -> tuple[Floats, Integers]:
        """Return the squared distances, and the nearest points, of one cell for each query.

        Points of a cell are `counts` from `first` on, which ascend.
        """
        squares, nearest = np.empty(len(queries)), np.empty(len(queries), np.int64)
        ends, start = np.cumsum(counts), 0
        while start < len(queries):
            done = ends[start] - counts[start]
            stop = max(start + 1, int(np.searchsorted(ends, done + MAX_COMPARED)))
            rows = slice(start, stop)
            begins = ends[rows] - counts[rows] - done
            places = np.repeat(first[rows] - begins, counts[rows])
            points = self._order[places + np.arange(len(places))]
            lines = np.repeat(queries[rows], counts[rows], axis=0) - self._points[points]
            found = np.square(lines).sum(axis=1)
            squares[rows] = np.minimum.reduceat(found, begins)
            is_least = np.flatnonzero(found == np.repeat(squares[rows], counts[rows]))
            nearest[rows] = points[is_least[np.searchsorted(is_least, begins)]]
            start = stop
        return squares, nearest

    def _place(self, points: Floats) -> Integers:
        """Return the cells of points, (k, 3); those around all are 0, and the last."""
        cells = np.floor((points - self._low) / self._size) + 1
        return np.asarray(cells.clip(0, self._counts - 1), np.int64)

    def _number(self, cells: Integers) -> Integers:
        """Return one number for each cell."""
        return np.asarray(np.ravel_multi_index(tuple(cells.T), tuple(self._counts)), np.int64)


def are_pairs(vertices: Floats, partners: NDArray[np.integer]) -> bool:
    """Return whether partners, (n,), are each other's mirror images across one plane."""
    numbers = np.arange(len(vertices))
    if not np.isin(partners, numbers).all() or (partners[partners] != numbers).any():
        return False
    lines = vertices[partners] - vertices
    if not lines.any():
        return False
    centre = vertices.mean(axis=0)
    middles = (vertices[partners] + vertices) / 2 - centre
    # Images about the plane of normal n are off by nᵀ (4 MᵀM − LᵀL) n and a constant, squared.
    normal = np.linalg.eigh(4 * middles.T @ middles - lines.T @ lines)[1][:, 0]
    images = Mirror(normal, centre).reflect(vertices)
    away = np.linalg.norm(images - vertices[partners], axis=1).max()
    return bool(away <= 2 * PAIR_TOL * np.linalg.norm(np.ptp(vertices, axis=0)))


def _list_planes(vertices: Floats, reach: float) -> Iterator[Mirror]:
    """Yield planes that may mirror vertices: across the axes, and between vertices."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    for axis in range(3):
        # The box is mirrored exactly, where the mean is rounded.
        yield Mirror(np.eye(3)[axis], np.where(np.arange(3) == axis, middle, 0.0))
    centre = vertices.mean(axis=0)
    away = np.linalg.norm(vertices - centre, axis=1)
    order = np.argsort(away, kind="stable")
    low, high = (np.searchsorted(away[order], away + side * reach) for side in (-1, 1))
    # Vertices on the plane are their own partners, and show no plane: all may have to be tried.
    for first in np.argsort(high - low, kind="stable").tolist():
        others = order[low[first] : high[first]]
        lines = vertices[others[others > first]] - vertices[first]
        for line in lines[np.linalg.norm(lines, axis=1) > reach]:
            yield Mirror(line, centre)
