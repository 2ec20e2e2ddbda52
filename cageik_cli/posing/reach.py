"""How far handles reach: the part of a cage that moves what is beyond their radius is locked.

A vertex j moves by Σ_k H_jk d_k, where d_k are the displacements of cage vertices. If those that
are free move by at most D, it moves by at most D Σ_free |H_jk|. So cage vertices are freed, those
with the least influence beyond first, as long as this sum stays small for every vertex beyond.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.binding import Binding
from cageik_cli.posing.anchors import Anchor, anchor_matrix, anchor_positions
from cageik_cli.posing.constraints import Mirror, mirror_pairs
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError

MAX_LEAK = 1e-3
"""Largest motion of a vertex beyond, in motions of the cage vertex that moves farthest."""

MIN_SHARE = 0.5
"""Smallest share of a handle's weights that free cage vertices must have to move it."""

ROWS_PER_BLOCK = 4096
"""Vertices that are looked at together, so that memory does not grow with the model."""


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Where an edit acts.

    Attributes
    ----------
    is_beyond : (m,) bool
        Vertices that are farther from all handles than their radius, in the rest pose.
    locked : (p,) int64
        Cage vertices that stay, so that vertices beyond do: each moves by at most `MAX_LEAK` times
        the largest motion of a cage vertex.
    held : (l,) bool
        Anchors beyond, which stay because of that, and not by forces of their own.
    """

    is_beyond: NDArray[np.bool_]
    locked: Integers
    held: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class ReachLimit:
    """The radii of anchors.

    Attributes
    ----------
    anchors : sequence of Anchor
        l of them.
    radii : (l,) float64
        In the units of the rest pose; nan for an anchor without one, which has to be one that
        stays.
    mirror : Mirror, optional
        The radii hold around the mirror images of anchors, too.
    """

    anchors: Sequence[Anchor]
    radii: Floats
    mirror: Mirror | None = None


def find_reach(binding: Binding, limit: ReachLimit) -> Reach:
    """Find the cage vertices to lock, so that nothing moves beyond the radii.

    Raises
    ------
    HandlesError
        When too little of the cage is left to move an anchor; the message names it, and the
        smallest radius that works.
    """
    is_beyond = _find_points_beyond(limit, limit.radii, binding, binding.rest.vertices)
    is_free = _find_free(binding, is_beyond, limit.mirror)
    limited = np.flatnonzero(np.isfinite(limit.radii)).tolist()
    for k, share in zip(limited, _measure_shares(binding, limit, is_free), strict=True):
        if share < MIN_SHARE:
            raise HandlesError(
                f"handle {limit.anchors[k].name!r}: radius: {limit.radii[k]:g} is too small for "
                f"this cage: what is free to move has {100 * share:.0f} % of the weights there "
                f"(at least {100 * MIN_SHARE:.0f} %); give it a radius of at least "
                f"{_search_radius(binding, limit, k):.3g}, or use a finer cage"
            )
    positions = anchor_positions(limit.anchors, binding.rest.vertices)
    return Reach(
        is_beyond=is_beyond,
        locked=np.flatnonzero(~is_free),
        held=_find_points_beyond(limit, limit.radii, binding, positions),
    )


def _find_points_beyond(
    limit: ReachLimit, radii: Floats, binding: Binding, points: Floats
) -> NDArray[np.bool_]:
    """Return which points, (p, 3), are farther from all anchors than their radii."""
    is_beyond = np.ones(len(points), bool)
    centres = anchor_positions(limit.anchors, binding.rest.vertices)
    images = [centres] if limit.mirror is None else [centres, limit.mirror.reflect(centres)]
    for places in images:
        for centre, radius in zip(places, radii, strict=True):
            is_beyond &= ~(np.linalg.norm(points - centre, axis=1) <= radius)
    return is_beyond


def _find_free(
    binding: Binding, is_beyond: NDArray[np.bool_], mirror: Mirror | None
) -> NDArray[np.bool_]:
    """Return the cage vertices, (n,), that together move vertices beyond by at most `MAX_LEAK`."""
    influence = np.zeros(binding.weights.shape[1])
    for weights in _iterate_blocks(binding.weights, is_beyond):
        influence = np.maximum(influence, weights.max(axis=0))
    order = np.argsort(influence, kind="stable")
    leak = np.zeros(len(order))
    for weights in _iterate_blocks(binding.weights, is_beyond):
        leak = np.maximum(leak, np.cumsum(weights[:, order], axis=1).max(axis=0))
    is_free = np.zeros(len(order), bool)
    is_free[order[leak <= MAX_LEAK]] = True
    if mirror is not None:
        is_free &= is_free[mirror_pairs(binding.cage, mirror)]
    return is_free


def _iterate_blocks(weights: Floats, chosen: NDArray[np.bool_]) -> Iterator[Floats]:
    """Yield the sizes of the weights of chosen rows, in blocks."""
    rows = np.flatnonzero(chosen)
    for start in range(0, len(rows), ROWS_PER_BLOCK):
        yield np.abs(weights[rows[start : start + ROWS_PER_BLOCK]])


def _measure_shares(binding: Binding, limit: ReachLimit, is_free: NDArray[np.bool_]) -> Floats:
    """Return the share of the weights of each anchor that has a radius on free cage vertices."""
    limited = [limit.anchors[k] for k in np.flatnonzero(np.isfinite(limit.radii)).tolist()]
    sizes = np.abs(anchor_matrix(limited, binding.weights))
    return np.asarray(sizes[:, is_free].sum(axis=1) / sizes.sum(axis=1))


def _search_radius(binding: Binding, limit: ReachLimit, k: int) -> float:
    """Search for a small radius of anchor k that works, of three digits; others keep theirs.

    At the largest distance of a vertex everything is free.
    """
    number = np.count_nonzero(np.isfinite(limit.radii[:k]))
    centre = limit.anchors[k].point.position(binding.rest.vertices)
    distances = np.linalg.norm(binding.rest.vertices - centre, axis=1)
    low, high = limit.radii[k], _round_up(float(distances.max()))
    while (middle := _round_up((low + high) / 2)) < high:
        radii = limit.radii.copy()
        radii[k] = middle
        is_beyond = _find_points_beyond(limit, radii, binding, binding.rest.vertices)
        is_free = _find_free(binding, is_beyond, limit.mirror)
        if _measure_shares(binding, limit, is_free)[number] < MIN_SHARE:
            low = middle
        else:
            high = middle
    return high


def _round_up(length: float) -> float:
    """Return the next larger length of three digits."""
    return float(f"{length + 0.5 * 10.0 ** (np.floor(np.log10(length)) - 2):.3g}")
