"""Cage vertices that do not move, or move as mirror images of each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dgemv

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError, join_truncated

MAX_ASYMMETRY = 1e-3
"""Diagonals of the cage by which a vertex may be off the mirror image of its partner."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """A plane.

    Attributes
    ----------
    normal : (3,) float64
        Of any length above zero; taken as of length one.
    point : (3,) float64
        On the plane.

    Raises
    ------
    InputError
        When the normal has no direction.
    """

    normal: Floats
    point: Floats

    def __post_init__(self) -> None:
        normal, point = (np.asarray(v, np.float64) for v in (self.normal, self.point))
        size = np.linalg.norm(normal)
        if not (size > 0 and np.isfinite(normal).all() and np.isfinite(point).all()):
            raise InputError(
                f"the mirror's normal is {normal.tolist()} and its point {point.tolist()}, "
                "expected finite numbers and a normal that is not zero"
            )
        object.__setattr__(self, "normal", normal / size)
        object.__setattr__(self, "point", point)

    def reflect(self, points: Floats) -> Floats:
        """The mirror images of points, (…, 3)."""
        heights = (points - self.point) @ self.normal
        return np.asarray(points - 2 * heights[..., None] * self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class CageConstraints:
    """What binds the vertices of a cage beside its Laplacian.

    Attributes
    ----------
    locked : tuple of int
        Cage vertices that stay where they are.
    mirror : Mirror, optional
        Every displacement of a vertex is the mirror image of its partner's, the vertex that is
        nearest to its mirror image in the rest cage.
    """

    locked: tuple[int, ...] = ()
    mirror: Mirror | None = None


def mirror_pairs(cage: TriMesh, mirror: Mirror) -> Integers:
    """The mirror image's number of each cage vertex, (n,); its own for one on the plane.

    Raises
    ------
    InputError
        When the cage is not its own mirror image, naming vertices.
    """
    images = mirror.reflect(cage.vertices)
    distances = np.linalg.norm(images[:, None] - cage.vertices, axis=2)
    nearest = distances.argmin(axis=1)
    off = distances.min(axis=1) > MAX_ASYMMETRY * cage.diagonal
    wrong = np.flatnonzero(off | (nearest[nearest] != np.arange(len(nearest))))
    if len(wrong):
        raise InputError(
            f"the cage is not symmetric about the mirror: {len(wrong)} of {len(nearest)} cage "
            f"vertices have no partner within {MAX_ASYMMETRY:g} of its diagonal "
            f"({join_truncated(wrong.tolist(), 5)}); move the plane, or leave the mirror out"
        )
    return np.asarray(nearest, np.int64)


def free_basis(cage: TriMesh, constraints: CageConstraints, sign: int) -> Floats:
    """What is free of one coordinate of all cage vertices: (n, r), columns of length one.

    Parameters
    ----------
    sign : int
        1 for coordinates along the mirror plane, which partners share; −1 for the one across it,
        which is opposite. Without a mirror, 1.

    Raises
    ------
    InputError
        When a vertex that is locked does not exist, or the mirror does not fit.
    """
    n = len(cage.vertices)
    wrong = [vertex for vertex in constraints.locked if not 0 <= vertex < n]
    if wrong:
        raise InputError(
            f"there is no cage vertex {wrong[0]} to lock; the cage has {n}, numbered from 0 to "
            f"{n - 1}"
        )
    partner = np.arange(n) if constraints.mirror is None else mirror_pairs(cage, constraints.mirror)
    tied = np.eye(n) + sign * np.eye(n)[partner]
    locked = np.array(constraints.locked, np.int64)
    is_free = np.ones(n, bool)
    is_free[locked] = is_free[partner[locked]] = False
    kept = is_free & (np.arange(n) <= partner) & tied.any(axis=0)
    basis = tied[:, kept]
    return np.asarray(basis / np.linalg.norm(basis, axis=0))


class MirroredMap:
    """A linear map of points; of their coordinate across a mirror, another one.

    Parameters
    ----------
    maps : one or two (p, q) float64
        Of all coordinates; or of those along the mirror, and of the one across it.
    mirror : Mirror, optional
    """

    def __init__(self, maps: Sequence[Floats], mirror: Mirror | None) -> None:
        self._mirror, self._along = mirror, maps[0]
        self._across_difference = maps[0] if mirror is None else maps[1] - maps[0]

    def __call__(self, points: Floats) -> Floats:
        """Points (…, q, 3) mapped, (…, p, 3)."""
        if self._mirror is None:
            return np.asarray(self._along @ points)
        normal = self._mirror.normal
        heights = (self._across_difference @ (points @ normal)[..., None])[..., 0]
        return np.asarray(self._along @ points + heights[..., None] * normal)

    def add_to(self, columns: Floats, points: Floats) -> None:
        """Add points (q, 3) mapped to others, coordinate by coordinate: (3, p) float64 rows.

        Each row is to lie in memory without gaps, since it is written where it is.
        """
        if not len(points):
            return
        for column, coordinate in zip(columns, points.T, strict=True):
            # y + A x in one pass, where the product of a few columns by itself is slower.
            dgemv(1.0, self._along, coordinate, beta=1.0, y=column, overwrite_y=True)
        if self._mirror is not None:
            normal = self._mirror.normal
            columns += normal[:, None] * (self._across_difference @ (points @ normal))

    def compose(self, matrix: Floats) -> "MirroredMap":
        """The map, then a matrix that is the same for all coordinates."""
        more = [] if self._mirror is None else [self._along + self._across_difference]
        maps = [np.asfortranarray(matrix @ values) for values in (self._along, *more)]
        return MirroredMap(maps, self._mirror)
