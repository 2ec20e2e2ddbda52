"""Points: clouds of them, their order by place, distances, spheres, frames as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cageik_cli.geometry.mesh import TriMesh, make_read_only, validate_positions
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError


@dataclass(frozen=True, eq=False)
class PointCloud(TriMesh):
    """A mesh that has no faces: it can be bound, moved and posed, but has no surface.

    Make one of positions, (m, 3), with `PointCloud.from_points`.

    Examples
    --------
    >>> from cageik_cli import PointCloud, bind, load_mesh
    >>> cloud = PointCloud.from_points([[0.0, 1.0, 0.0], [0.1, 1.0, 0.0]])
    >>> cloud
    <PointCloud: 2 points>
    >>> binding = bind(cloud, load_mesh("data_fixtures/walker/cage.obj"))
    >>> binding.weights.shape
    (2, 80)
    """

    def __post_init__(self) -> None:
        vertices = make_read_only(validate_positions(self.vertices))
        if np.size(self.faces):
            raise FormatError("a cloud of points has no faces; make a mesh of them")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", make_read_only(np.empty((0, 3), np.int64)))

    def __repr__(self) -> str:
        return f"<PointCloud: {len(self.vertices)} points>"

    @staticmethod
    def from_points(positions: ArrayLike) -> PointCloud:
        """Return the cloud of positions, (m, 3); raises as `TriMesh` does."""
        return PointCloud(np.asarray(positions), np.empty((0, 3), np.int64))

    def move(self, positions: ArrayLike) -> PointCloud:
        """Return the points at other positions, (n, 3)."""
        return self.from_points(positions)

    @cached_property
    def is_used(self) -> NDArray[np.bool_]:
        """Whether each point is part of the model, (n,): all are."""
        return np.ones(len(self.vertices), bool)

    @property
    def is_closed(self) -> bool:
        """Whether it bounds a volume: never."""
        return False


def order_by_place(points: Floats) -> Integers:
    """Return an order, (m,), of points, (m, 3), in which neighbours are close to each other.

    It follows the cells of a grid along a curve that visits each cube of cells before the next
    (Morton 1966). There are 2**10 cells along the longest axis: blocks of points are larger.
    """
    if len(points) == 0:
        return np.empty(0, np.int64)
    low, size = points.min(axis=0), np.ptp(points, axis=0).max()
    cells = ((points - low) * ((2**10 - 1) / size if size > 0 else 0.0)).astype(np.int32)
    x, y, z = (_spread_bits(cells[:, k]) << k for k in range(3))
    return np.argsort(x | y | z, kind="stable")


def _spread_bits(numbers: NDArray[np.int32]) -> NDArray[np.int32]:
    """Move the bits of numbers below 2**10 to every third place."""
    spread = numbers
    for shift, kept in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        spread = (spread | spread << shift) & kept
    return spread


def measure_distances(
    places: Floats, points: Floats, max_pairs: int = 10_000_000, block_pairs: int = 50_000
) -> Floats:
    """Return the distance of each of `points`, (m, 3), from the nearest of `places`, (n, 3).

    Up to `max_pairs` are all compared, since a tree takes longer to import; `block_pairs` at once,
    which fit in the processor's cache.
    """
    if len(points) * len(places) > max_pairs:
        from scipy.spatial import cKDTree

        return np.asarray(cKDTree(places).query(points)[0])
    squares = np.full(len(points), np.inf)
    columns = np.ascontiguousarray(places.T)
    size = max(1, block_pairs // max(1, len(points)))
    for start in range(0, len(places), size):
        block = columns[:, start : start + size]
        offsets = (points[:, k, None] - block[k] for k in range(3))
        x, y, z = (offset * offset for offset in offsets)
        np.minimum(squares, (x + y + z).min(axis=1), out=squares)
    return np.asarray(np.sqrt(squares))


def choose_farthest(count: int, distances: Floats, measure: Callable[[int], Floats]) -> list[int]:
    """Choose up to `count` of p items, each the farthest from all before it (Gonzalez 1985).

    Of equal ones it is the first. Those that are where others are chosen already are left out.

    Parameters
    ----------
    distances : (p,) float64
        Of every item from what was chosen before.
    measure : callable
        Returns the distances, (p,), of every item from one, by its number.
    """
    chosen: list[int] = []
    while len(chosen) < count and distances.max() > 0:
        chosen.append(int(distances.argmax()))
        distances = np.minimum(distances, measure(chosen[-1]))
    return chosen


def smallest_enclosing_sphere(points: Floats) -> tuple[Floats, float]:
    """Return the centre, (3,), and the radius of the smallest sphere that holds points, (m, 3).

    At most four points determine it. The one furthest outside joins them, and those that determine
    the sphere of these five stay, until none is outside: the radius grows each time, so the exact
    sphere is found after few rounds (Welzl 1991; Gärtner 1999).
    """
    origin = points[0]
    size = float(np.abs(points - origin).max()) or 1.0  # squares of any units must not overflow
    local = (points - origin) / size
    support, centre, radius = local[:1], local[0], 0.0
    while True:
        distances = np.linalg.norm(local - centre, axis=1)
        furthest = int(distances.argmax())
        if distances[furthest] <= radius * (1 + 1e-12):  # on the sphere, up to rounding
            break
        chosen, next_centre, next_radius = _determine_sphere(np.vstack([support, local[furthest]]))
        if next_radius <= radius:  # rounding is all that is left
            radius = float(distances[furthest])
            break
        support, centre, radius = chosen, next_centre, next_radius
    return origin + size * centre, size * radius


def _determine_sphere(points: Floats) -> tuple[Floats, Floats, float]:
    """Return those of at most five points that determine their sphere, its centre and radius.

    Its centre has the smallest distance from the furthest point of all centres.
    """
    best = (points, points[0], np.inf)
    for count in range(2, min(len(points), 4) + 1):
        for numbers in combinations(range(len(points)), count):
            chosen = points[list(numbers)]
            centre = _find_circumcentre(chosen)
            radius = float(np.linalg.norm(points - centre, axis=1).max())
            if radius < best[2]:
                best = (chosen, centre, radius)
    return best


def _find_circumcentre(points: Floats) -> Floats:
    """Return the point in the plane of 2 to 4 points that is equally far from all, (3,).

    Of points that have none, such as three in a row, it is one nearby.
    """
    sides = points[1:] - points[0]
    return np.asarray(points[0] + np.linalg.lstsq(2 * sides, (sides**2).sum(axis=1), rcond=None)[0])


def frames_to_columns(points: Floats) -> Floats:
    """Return the points of k frames, (k, p, 3), as columns (p, 3k)."""
    k, p, _ = points.shape
    return points.transpose(1, 0, 2).reshape(p, 3 * k)


def columns_to_frames(columns: Floats) -> Floats:
    """Return columns (p, 3k) as points of k frames, (k, p, 3); a view."""
    return columns.reshape(len(columns), -1, 3).transpose(1, 0, 2)


def place_columns(columns: Floats, centres: Floats, frames: Floats, first: int = 0) -> None:
    """Fill p points of frames, (k, m, 3), from number `first` on.

    They are the columns, (p, 3k), plus the centres of the frames, (k, 3).
    """
    if compiled.kernel is not None:
        compiled.kernel.place_columns(columns, np.ascontiguousarray(centres), frames, first)
    else:
        points = frames[:, first : first + len(columns)]
        np.add(columns_to_frames(columns), centres[:, None], out=points)
