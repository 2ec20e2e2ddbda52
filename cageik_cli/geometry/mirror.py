"""Mirror planes, and the pairs of vertices that are each other's mirror images."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError

PAIR_TOL = 1e-6
"""How far partners may be from mirror images, in diagonals: ten times the rounding of single
precision."""

MAX_TRIED_PLANES = 2000
"""Planes that are tried for one cage; more arise where many vertices are
as far from the centre, within the tolerance."""

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
        distance, partner = _find_nearest(vertices, self.reflect(vertices))
        diagonal = np.linalg.norm(np.ptp(vertices, axis=0))
        is_pair = partner[partner] == np.arange(len(partner))
        if distance.max() > tolerance * diagonal or not is_pair.all():
            return None
        return np.asarray(partner, np.int64)

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
    several planes, those across the axes come first.
    """
    few = vertices[:: -(-len(vertices) // 8)]
    reach = tolerance * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    for mirror in islice(_list_planes(vertices, reach), MAX_TRIED_PLANES):
        if _find_nearest(vertices, mirror.reflect(few))[0].max() > reach:
            continue
        if mirror.find_pairs(vertices, tolerance) is not None:
            return mirror
    return None


def _find_nearest(points: Floats, queries: Floats) -> tuple[Floats, Integers]:
    """Return the distances of queries (q, 3) from the nearest of points (n, 3), and which it is.

    Without scipy: every result is looked through for pairs, and a warm run shall not import it.
    """
    distances, nearest = np.empty(len(queries)), np.empty(len(queries), np.int64)
    size = max(1, MAX_COMPARED // len(points))
    for start in range(0, len(queries), size):
        rows = slice(start, start + size)
        squares = np.square(queries[rows, None] - points).sum(axis=2)
        nearest[rows] = squares.argmin(axis=1)
        distances[rows] = np.sqrt(squares.min(axis=1))
    return distances, nearest


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
        for second in order[low[first] : high[first]].tolist():
            line = vertices[second] - vertices[first]
            if second > first and np.linalg.norm(line) > reach:
                yield Mirror(line, centre)
