"""Constraints on cage vertices: locked vertices, and mirror symmetry."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dgemv

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError, join_truncated

MAX_ASYMMETRY = 1e-3
"""Largest distance of a vertex from its partner's mirror image, in diagonals of the cage."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """A mirror plane.

    Attributes
    ----------
    normal : (3,) float64
        Of any length above zero; normalised.
    point : (3,) float64
        A point on the plane.

    Raises
    ------
    HandlesError
        When the normal has no direction.
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

    def reflect(self, points: Floats) -> Floats:
        """Return the mirror images of points, (…, 3)."""
        heights = (points - self.point) @ self.normal
        return np.asarray(points - 2 * heights[..., None] * self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class CageConstraints:
    """Constraints on the vertices of a cage.

    Attributes
    ----------
    locked : tuple of int
        Cage vertices that do not move.
    mirror : Mirror, optional
        Each vertex moves as the mirror image of its partner, which is the vertex closest to its
        mirror image in the rest cage.
    """

    locked: tuple[int, ...] = ()
    mirror: Mirror | None = None


def mirror_pairs(cage: TriMesh, mirror: Mirror) -> Integers:
    """Return the partner of each cage vertex, (n,); a vertex on the plane is its own partner.

    Raises
    ------
    HandlesError
        When the cage is not symmetric; the message lists vertices.
    """
    images = mirror.reflect(cage.vertices)
    distances = np.linalg.norm(images[:, None] - cage.vertices, axis=2)
    nearest = distances.argmin(axis=1)
    off = distances.min(axis=1) > MAX_ASYMMETRY * cage.diagonal
    wrong = np.flatnonzero(off | (nearest[nearest] != np.arange(len(nearest))))
    if len(wrong):
        raise HandlesError(
            f"mirror: the cage is not symmetric, {len(wrong)} of {len(nearest)} cage vertices have "
            f"no partner within {100 * MAX_ASYMMETRY:g} % of its diagonal "
            f"({join_truncated(wrong.tolist(), 5)}); move the plane, or remove the mirror"
        )
    return np.asarray(nearest, np.int64)


def free_basis(cage: TriMesh, constraints: CageConstraints, sign: int) -> Floats:
    """Return a basis of the free motions of one coordinate of a cage, (n, r), orthonormal.

    Parameters
    ----------
    sign : int
        1 for coordinates along the mirror plane, which partners share; −1 for the coordinate
        across it, which is opposite. Without a mirror, 1.

    Raises
    ------
    HandlesError
        When a locked vertex does not exist, or the cage is not symmetric.
    """
    n = len(cage.vertices)
    wrong = [vertex for vertex in constraints.locked if not 0 <= vertex < n]
    if wrong:
        raise HandlesError(
            f"locked: there is no cage vertex {wrong[0]}; the cage has {n}, numbered from 0 to "
            f"{n - 1}"
        )
    partner = np.arange(n) if constraints.mirror is None else mirror_pairs(cage, constraints.mirror)
    paired = np.eye(n) + sign * np.eye(n)[partner]
    locked = np.array(constraints.locked, np.int64)
    is_free = np.ones(n, bool)
    is_free[locked] = is_free[partner[locked]] = False
    kept = is_free & (np.arange(n) <= partner) & paired.any(axis=0)
    basis = paired[:, kept]
    return np.asarray(basis / np.linalg.norm(basis, axis=0))


class MirroredMap:
    """A linear map of points, which may differ for the coordinate across a mirror.

    Parameters
    ----------
    maps : one or two (p, q) float64
        For all coordinates; or for those along the mirror, and for the one across it.
    """

    def __init__(self, maps: Sequence[Floats], mirror: Mirror | None) -> None:
        self._mirror, self._along = mirror, maps[0]
        self._across_difference = maps[0] if mirror is None else maps[1] - maps[0]

    def __call__(self, points: Floats) -> Floats:
        """Map points (…, q, 3) to (…, p, 3)."""
        if self._mirror is None:
            return np.asarray(self._along @ points)
        normal = self._mirror.normal
        heights = (self._across_difference @ (points @ normal)[..., None])[..., 0]
        return np.asarray(self._along @ points + heights[..., None] * normal)

    def add_to(self, columns: Floats, points: Floats) -> None:
        """Add the mapped points (q, 3) to `columns`, (3, p) float64, in place.

        Each row of `columns` must be contiguous in memory.
        """
        if not len(points):
            return
        for column, coordinate in zip(columns, points.T, strict=True):
            # y + A x in one pass is faster than a product of so few columns.
            dgemv(1.0, self._along, coordinate, beta=1.0, y=column, overwrite_y=True)
        if self._mirror is not None:
            normal = self._mirror.normal
            columns += normal[:, None] * (self._across_difference @ (points @ normal))

    def compose(self, matrix: Floats) -> "MirroredMap":
        """Return the map followed by a matrix that is the same for all coordinates."""
        across = [] if self._mirror is None else [self._along + self._across_difference]
        maps = [np.asfortranarray(matrix @ values) for values in (self._along, *across)]
        return MirroredMap(maps, self._mirror)
