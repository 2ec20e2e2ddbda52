"""Constraints on cage vertices: locked ones, mirror symmetry, and how far handles reach.

Where handles have a radius, the part of the cage that moves what is beyond it is locked. A vertex j
moves by Σ_k H_jk d_k, where d_k are the displacements of cage vertices. If those that are free move
by at most D, it moves by at most D Σ_free |H_jk|. So cage vertices are freed, those with the least
influence beyond first, as long as this sum stays small for every vertex beyond.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror, find_mirror
from cageik_cli.method.pose.anchors import Anchor, anchor_matrix, anchor_positions
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError, join_truncated
from cageik_cli.util.messages import say
from cageik_cli.util.text import format_decimals, group_digits

MAX_ASYMMETRY = 1e-3
"""Largest distance of a vertex from its partner's mirror image, in diagonals of the cage."""

MAX_LEAK = 1e-3
"""Largest motion of a vertex beyond, in motions of the cage vertex that moves farthest."""

MIN_FREE_SHARE = 0.5
"""Smallest share of a handle's weights that free cage vertices must have to move it."""

MAX_REACH_ROWS = 4096
"""Vertices that are looked at together, so that memory does not grow with the model."""


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


def find_reach(
    binding: Binding, anchors: Sequence[Anchor], radii: Floats, mirror: Mirror | None = None
) -> tuple[NDArray[np.bool_], Integers, NDArray[np.bool_]]:
    """Find the cage vertices to lock, so that nothing moves beyond the radii of l anchors.

    Parameters
    ----------
    radii : (l,) float64
        In the units of the rest pose; nan for an anchor without one, which has to be one that
        stays. They hold around the mirror images of anchors, too.

    Returns
    -------
    is_beyond : (m,) bool
        Vertices that are farther from all handles than their radius, in the rest pose.
    locked : (p,) int64
        Cage vertices that stay, so that vertices beyond do: each moves by at most `MAX_LEAK` times
        the largest motion of a cage vertex.
    held : (l,) bool
        Anchors beyond, which stay because of that, and not by forces of their own.

    Raises
    ------
    HandlesError
        When too little of the cage is left to move an anchor; the message names it, and the
        smallest radius that works.
    """
    search = _ReachSearch(binding, anchors, mirror)
    is_beyond = search.find_beyond(radii, binding.rest.vertices)
    is_free = search.find_free(is_beyond)
    for k in np.flatnonzero(np.isfinite(radii)).tolist():
        share = search.shares(is_free)[k]
        if share < MIN_FREE_SHARE:
            raise HandlesError(
                f"handle {anchors[k].name!r}: radius: {radii[k]:g} is too small for "
                f"this cage: what is free to move has {format_decimals(100 * share, 0)} % of the "
                f"weights there (at least {100 * MIN_FREE_SHARE:.0f} %); give it a radius of at "
                "least "
                f"{search.find_radius(radii, k):.3g}, or use a finer cage"
            )
    return is_beyond, np.flatnonzero(~is_free), search.find_beyond(radii, search.centres)


class _ReachSearch:
    """What is beyond radii around anchors, and what of the cage may move then."""

    def __init__(self, binding: Binding, anchors: Sequence[Anchor], mirror: Mirror | None) -> None:
        self.centres = anchor_positions(anchors, binding.rest.vertices)
        images = [] if mirror is None else [mirror.reflect(self.centres)]
        self._places = [self.centres, *images]
        self._partners = None if mirror is None else mirror_pairs(binding.cage, mirror)
        self._binding = binding
        self._sizes = np.abs(anchor_matrix(anchors, binding.weights))

    def find_beyond(self, radii: Floats, points: Floats) -> NDArray[np.bool_]:
        """Return which points, (p, 3), are farther from all anchors than their radii."""
        is_beyond = np.ones(len(points), bool)
        for places in self._places:
            for centre, radius in zip(places, radii, strict=True):
                is_beyond &= ~(np.linalg.norm(points - centre, axis=1) <= radius)
        return is_beyond

    def find_free(self, is_beyond: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the cage vertices, (n,), that together move what is beyond by `MAX_LEAK`."""
        weights = self._binding.weights
        influence = np.zeros(weights.shape[1])
        for sizes in _iterate_blocks(weights, is_beyond):
            influence = np.maximum(influence, sizes.max(axis=0))
        order = np.argsort(influence, kind="stable")
        leak = np.zeros(len(order))
        for sizes in _iterate_blocks(weights, is_beyond):
            leak = np.maximum(leak, np.cumsum(sizes[:, order], axis=1).max(axis=0))
        is_free = np.zeros(len(order), bool)
        is_free[order[leak <= MAX_LEAK]] = True
        return is_free if self._partners is None else is_free & is_free[self._partners]

    def shares(self, is_free: NDArray[np.bool_]) -> Floats:
        """Return the share of the weights of each anchor on free cage vertices, (l,)."""
        return np.asarray(self._sizes[:, is_free].sum(axis=1) / self._sizes.sum(axis=1))

    def find_radius(self, radii: Floats, k: int) -> float:
        """Search for a small radius of anchor k that works, of three digits; others keep theirs.

        At the largest distance of a vertex everything is free.
        """
        rest, radii = self._binding.rest.vertices, radii.copy()
        distances = np.linalg.norm(rest - self.centres[k], axis=1)
        low, high = radii[k], _round_up(float(distances.max()))
        while (middle := _round_up((low + high) / 2)) < high:
            radii[k] = middle
            if self.shares(self.find_free(self.find_beyond(radii, rest)))[k] < MIN_FREE_SHARE:
                low = middle
            else:
                high = middle
        return high


def _iterate_blocks(weights: Floats, chosen: NDArray[np.bool_]) -> Iterator[Floats]:
    """Yield the sizes of the weights of chosen rows, in blocks."""
    rows = np.flatnonzero(chosen)
    for start in range(0, len(rows), MAX_REACH_ROWS):
        yield np.abs(weights[rows[start : start + MAX_REACH_ROWS]])


def _round_up(length: float) -> float:
    """Return the next larger length of three digits."""
    return float(f"{length + 0.5 * 10.0 ** (np.floor(np.log10(length)) - 2):.3g}")
