"""The residuals that each vertex of a clip may have: what a cage cannot follow is no outlier."""

from collections.abc import Iterable

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.solver.captured import CapturedFrames
from cageik_cli.solver.robust import RobustSolver
from cageik_cli.util.arrays import Floats


def measure_tolerances(
    robust: RobustSolver,
    frames: Iterable[CapturedFrames],
    *,
    ratio: float = 5.0,
    least: float = 1e-5,
) -> Floats:
    """Measure the tolerances of all vertices on some frames.

    The residual of a vertex is the median over the frames, and then over its neighbours in the
    mesh, so that a vertex that is off in all frames is found too.

    Parameters
    ----------
    robust : RobustSolver
        With the tolerances that are known so far, if any are.
    frames : iterable of CapturedFrames
        One frame each, so that the result does not depend on the size of blocks.
    ratio : float
        Tolerance, in the sum of the median residuals of a vertex and of all vertices.
    least : float
        Smallest tolerance, in diagonals: rounding of single precision is far below.

    Returns
    -------
    (m,) float64, file units
    """
    rest = robust.solver.binding.rest
    rows = []
    for one in frames:
        found = robust.solve(one.positions, one.weights)
        if found.faults:
            continue
        errors = one.positions[0] - found.solution.reconstructions[0]
        residuals = np.sqrt(np.einsum("jx,jx->j", errors, errors))
        is_data = robust.solver.vertex_weights > 0
        if one.weights is not None:
            is_data = is_data & (one.weights[0] > 0)
        rows.append(np.where(is_data, residuals, np.nan))
    smallest = least * rest.diagonal
    # The rest pose is met exactly, and says nothing of the others.
    rows = [row for row in rows if np.nanmax(row, initial=0) > smallest] or rows
    if not rows:
        return np.full(len(rest.vertices), smallest)
    typical = take_ring_medians(rest, take_medians(np.stack(rows)))
    middle = float(np.median(typical[np.isfinite(typical)]))
    typical = np.where(np.isfinite(typical), typical, middle)
    return np.asarray(np.maximum(ratio * (typical + middle), smallest))


def take_medians(rows: Floats) -> Floats:
    """Return the medians of the columns of (k, m), without nan; nan where all are."""
    ordered = np.sort(rows, axis=0)  # nan is last
    counts = np.isfinite(rows).sum(axis=0)
    places = np.stack([np.maximum(counts - 1, 0) // 2, np.maximum(counts, 1) // 2])
    places = np.minimum(places, len(rows) - 1)
    return np.asarray(np.take_along_axis(ordered, places, axis=0).mean(axis=0))


def take_ring_medians(mesh: TriMesh, values: Floats) -> Floats:
    """Return the (lower) median of each vertex and its neighbours, (m,), without nan."""
    ends, own = mesh.edges.ends, np.arange(len(values))
    centres = np.concatenate([own, ends[:, 0], ends[:, 1]])
    found = np.concatenate([values, values[ends[:, 1]], values[ends[:, 0]]])
    centres, found = centres[np.isfinite(found)], found[np.isfinite(found)]
    order = np.lexsort((found, centres))
    counts = np.bincount(centres, minlength=len(values))
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    medians = np.full(len(values), np.nan)
    known = np.flatnonzero(counts)
    medians[known] = found[order][starts[known] + (counts[known] - 1) // 2]
    return medians
