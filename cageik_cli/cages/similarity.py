"""Recognise a cage that is in another unit, has other axes, is mirrored or was moved."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations, product

import numpy as np

from cageik_cli.cages.looseness import measure_inflation
from cageik_cli.cages.repairing.samples import sample_surface
from cageik_cli.cages.transform_names import (
    COMMON_SCALES,
    UNIT_SCALES,
    Candidate,
    Transform,
    name_candidate,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats

__all__ = ["Transform", "find_transform"]

MAX_INFLATION = 5.0
"""A transformed cage may have to be inflated by so much, percent of the model's diagonal."""

MAX_FITTED_INFLATION = 2.0
"""The same where scale or place were fitted, too, which makes chance matches likelier."""

MIN_OUTSIDE_SHARE = 0.05
"""With a smaller share of the model outside, parts of the cage are dented, not all misplaced."""

MIN_FITTED_OUTSIDE_SHARE = 0.25
"""The same where scale or place are to be fitted."""

EXTENT_RATIOS = (0.9, 2.0)
"""A transformed cage is at least and at most so much larger than the model, along each axis."""

MAX_FITTED_RATIO = 1.4
"""The same where the scale was fitted: any cage holds any model when it is large enough."""

MAX_RARE_RATIO = 1.25
"""The same for rare units: their factors are small, and a cage that is only too small must not be
taken for one in another unit."""

EXTENT_SLACK = 0.1
"""Along axes in which the model is thin, the cage may be larger by this, in diagonals."""

MAX_SIZE_RATIO = 5.0
"""A larger ratio of the diagonals of cage and model suggests different units."""

MAX_POINTS = 400
"""Vertices of the model by which candidates are compared."""

MAX_FIT_POINTS = 4000
"""Points of the model's surface to which the best candidates are fitted."""

FIT_ROUNDS = 12
"""Steps in which the place, and the scale, of a candidate are fitted."""

RIDGE = 1e-3
"""Weight of the change of place and scale in a step, against one point's distance."""


def find_transform(cage: TriMesh, model: TriMesh) -> Transform | None:
    """Find the simplest transform after which a cage holds a model that it does not hold now.

    Parameters
    ----------
    cage : TriMesh
        Closed, turned outward.

    Returns
    -------
    Transform, optional
        None if the cage holds the model, or nearly, as it is, or if no transform makes it so.
    """
    points = model.vertices[:: -(-len(model.vertices) // MAX_POINTS)]
    depth = _measure_depth(cage, points)
    if depth < MAX_INFLATION / 100 * model.diagonal and not _is_oversized(cage, model):
        return None
    share = float(np.mean(winding_numbers(cage, points) < 0.5))
    if 0 < share < MIN_OUTSIDE_SHARE:
        return None
    # A loose cage that holds its model can only be in another unit.
    may_fit = share >= MIN_FITTED_OUTSIDE_SHARE
    candidates = [c for c in _list_candidates(cage, model) if may_fit or not c.is_fitted]
    limit = depth / 2 if depth > 0 else np.inf
    found: list[tuple[float, Candidate]] = []
    for candidate in sorted(candidates, key=lambda c: c.complexity):
        if found and candidate.complexity > min(cost for cost, _ in found):
            break
        fitted = _fit_candidate(candidate, cage, points, model)
        moved = fitted.apply_to_mesh(cage)
        left = _measure_depth(moved, points)
        if left < min(limit, _max_share(fitted) * model.diagonal) and _is_of_size(
            fitted, moved, model
        ):
            found.append((_measure_cost(fitted, 100 * left / model.diagonal), fitted))
    return _take_best(found, cage, model)


def _take_best(
    found: list[tuple[float, Candidate]], cage: TriMesh, model: TriMesh
) -> Transform | None:
    """Take the candidate of least cost, of those that then need little inflation."""
    best, least = None, np.inf
    samples = sample_surface(model)
    samples = samples[:: -(-len(samples) // MAX_FIT_POINTS)]
    for cost, candidate in sorted(found, key=lambda entry: entry[0]):
        if cost >= least:
            break
        candidate = _fit_to_points(candidate, cage, samples)
        inflation = measure_inflation(candidate.apply_to_mesh(cage), model)
        if inflation is None or inflation > 100 * _max_share(candidate):
            continue
        cost = _measure_cost(candidate, inflation)
        if cost < least:
            name = name_candidate(candidate, model.diagonal)
            matrix = candidate.scale * candidate.rotation
            best, least = Transform(name, matrix, candidate.offset, inflation), cost
    return best


def _max_share(candidate: Candidate) -> float:
    return (MAX_FITTED_INFLATION if candidate.is_fitted else MAX_INFLATION) / 100


def _measure_cost(candidate: Candidate, percent: float) -> float:
    """Return what speaks against an explanation: a difference costs what a percent does."""
    return candidate.complexity + percent


def _list_candidates(cage: TriMesh, model: TriMesh) -> Iterator[Candidate]:
    """List all turns by quarters, mirrored or not, with scales that fit the extents."""
    low, high = EXTENT_RATIOS
    inner = np.ptp(model.vertices, axis=0)
    slack = 1e-3 * model.diagonal  # flat models
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        rotation = np.eye(3)[list(order)] * np.array(signs)[:, None]
        outer = np.abs(rotation) @ np.ptp(cage.vertices, axis=0)
        for scale in (1.0, *UNIT_SCALES):
            if (scale * outer >= low * inner).all() and (
                scale * outer <= high * inner + slack
            ).all():
                yield Candidate(rotation, scale, np.zeros(3))
                yield Candidate(rotation, scale, np.zeros(3), is_moved=True)
        scale = float(np.max(inner / np.maximum(outer, np.finfo(float).tiny)))
        if (scale * outer <= high * inner + slack).all():
            yield Candidate(rotation, scale, np.zeros(3), is_scaled=True)
            yield Candidate(rotation, scale, np.zeros(3), is_scaled=True, is_moved=True)


def _fit_candidate(
    candidate: Candidate, cage: TriMesh, points: Floats, model: TriMesh
) -> Candidate:
    """Centre a candidate that may move on the model, and fit what it leaves open."""
    if candidate.is_moved:
        centres = [(m.vertices.min(axis=0) + m.vertices.max(axis=0)) / 2 for m in (model, cage)]
        offset = centres[0] - candidate.scale * candidate.rotation @ centres[1]
        candidate = replace(candidate, offset=offset)
    return _fit_to_points(candidate, cage, points)


def _fit_to_points(candidate: Candidate, cage: TriMesh, points: Floats) -> Candidate:
    """Move, and grow, what a candidate leaves open until the points are inside."""
    for _ in range(FIT_ROUNDS if candidate.is_fitted else 0):
        moved = candidate.apply_to_mesh(cage)
        outside = points[winding_numbers(moved, points) < 0.5]
        if len(outside) == 0:
            break
        candidate = _take_step(candidate, moved, outside)
    return candidate


def _take_step(candidate: Candidate, moved: TriMesh, outside: Floats) -> Candidate:
    """Scale and move so that the nearest points of the cage meet the points that are outside.

    Unknowns are a relative growth about the cage's centre, in its diagonals, and a move.
    """
    nearest = closest_points(moved, outside)
    keep = nearest.distance > 0
    if not keep.any():
        return candidate
    centre = moved.vertices.mean(axis=0)
    direction = (outside - nearest.position)[keep] / nearest.distance[keep, None]
    arm = nearest.position[keep] if not candidate.is_moved else nearest.position[keep] - centre
    growth = np.einsum("kx,kx->k", direction, arm) / moved.diagonal
    columns = np.column_stack([growth * candidate.is_scaled, direction * candidate.is_moved])
    normal = columns.T @ columns + RIDGE * len(columns) * np.eye(4)
    growth_step, *move = np.linalg.solve(normal, columns.T @ nearest.distance[keep])
    factor = 1 + growth_step / moved.diagonal
    offset = factor * candidate.offset + np.array(move)
    if candidate.is_moved:
        offset += (1 - factor) * centre
    return replace(candidate, scale=candidate.scale * factor, offset=offset)


def _measure_depth(cage: TriMesh, points: Floats) -> float:
    """Return how far the point that is furthest outside is."""
    outside = points[winding_numbers(cage, points) < 0.5]
    if len(outside) == 0:
        return 0.0
    return float(closest_points(cage, outside).distance.max())


def _is_oversized(cage: TriMesh, model: TriMesh) -> bool:
    return cage.diagonal > MAX_SIZE_RATIO * model.diagonal


def _is_of_size(candidate: Candidate, cage: TriMesh, model: TriMesh) -> bool:
    """Return whether a cage is about as large as the model along every axis."""
    outer, inner = np.ptp(cage.vertices, axis=0), np.ptp(model.vertices, axis=0)
    low, high = EXTENT_RATIOS
    if candidate.is_scaled:
        high = MAX_FITTED_RATIO
    elif candidate.scale not in (1.0, *COMMON_SCALES):
        high = MAX_RARE_RATIO
    slack = EXTENT_SLACK * (high - 1) * model.diagonal
    return bool((outer >= low * inner).all() and (outer <= high * inner + slack).all())
