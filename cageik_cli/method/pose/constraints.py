"""Constraints on cage vertices: locked ones, and mirror symmetry."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror, find_mirror
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError, join_truncated
from cageik_cli.util.messages import say
from cageik_cli.util.text import group_digits

MAX_ASYMMETRY = 1e-3
"""Largest distance of a vertex from its partner's mirror image, in diagonals of the cage."""


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


def require_mirror(cage: TriMesh) -> Mirror:
    """Return the plane across which a cage is its own mirror image.

    Raises
    ------
    HandlesError
        When there is none.
    """
    mirror = find_mirror(cage.vertices, MAX_ASYMMETRY)
    if mirror is None:
        raise HandlesError(
            say(
                "the cage is not its own mirror image, which `mirror=True` needs; leave "
                "that out, or build a cage that is, with `symmetric=auto`"
            )
        )
    return mirror


def mirror_pairs(cage: TriMesh, mirror: Mirror) -> Integers:
    """Return the partner of each cage vertex, (n,); a vertex on the plane is its own partner.

    Raises
    ------
    HandlesError
        When the cage is not symmetric; the message lists vertices.
    """
    distances, nearest = mirror.find_nearest(cage.vertices, MAX_ASYMMETRY)
    is_off = ~np.isfinite(distances)
    wrong = np.flatnonzero(is_off | (nearest[nearest] != np.arange(len(nearest))))
    if len(wrong):
        raise HandlesError(
            f"mirror: the cage is not symmetric, {group_digits(len(wrong))} of "
            f"{group_digits(len(nearest))} cage vertices have "
            f"no partner within {100 * MAX_ASYMMETRY:g} % of its diagonal "
            f"({join_truncated(wrong.tolist())}); move the plane, or remove the mirror"
        )
    return nearest


def free_basis(cage: TriMesh, constraints: CageConstraints, sign: int) -> Floats:
    """Return a basis of the free motions of one coordinate of a cage, (n, r), orthonormal.

    The sign is 1 for coordinates along the mirror plane, which partners share, and −1 for that
    across it, which is opposite. Without a mirror it is 1.
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
