"""Harmonic coordinates (Joshi et al. 2007) by boundary elements on the cage.

The weight of a cage vertex is the harmonic function inside the cage that on the cage equals the
vertex's piecewise linear hat. Its normal derivative on the cage, the density, is a polynomial on
each panel, discontinuous between panels, as the exact one is at the cage's edges. Boundary values
and integrals are exact, and constants are among the polynomials, so that the weights sum to one and
reproduce affine maps to rounding, however coarse the panels are.

Only panels close to the model's vertices have polynomials beyond linear. Panels with too large an
estimated error are divided.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.bem.boundary_equation import (
    BoundarySolution,
    rounded_interior_weights,
    solve_boundary,
    split_points,
)
from cageik_cli.coordinates.bem.boundary_mesh import BoundaryMesh
from cageik_cli.coordinates.bem.error_estimate import estimate_error
from cageik_cli.coordinates.bem.panel_geometry import Panels
from cageik_cli.coordinates.bem.polynomials import LINEAR_TERMS, exponents
from cageik_cli.coordinates.bem.potentials import FADE_FACTOR
from cageik_cli.coordinates.binding import Weights
from cageik_cli.coordinates.settings import ACCURACIES, Accuracy
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import measure_distances, order_by_place
from cageik_cli.geometry.surface import weights_on_surface
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError, SettingError
from cageik_cli.util.progress import ignore_progress
from cageik_cli.util.threads import count_processors, limit_blas_threads

MIN_PANELS = 60
"""Faces of cages with fewer panels are divided into four, which costs little."""

MAX_FACES = 5000
"""Largest number of faces of a cage; its matrix then has (3 × 5000)² float32, 0.9 GB."""

MAX_REFINEMENTS = 4
"""Largest number of times that the panels with the largest error are divided."""

SAMPLE_SIZE = 128
"""Points at which the error is estimated."""

REFINED_SHARE = 0.6
"""Share of the estimated error that the divided panels have."""

MAX_ROUNDING_GROWTH = 1e10
"""Largest growth of rounding errors in higher terms, which need few digits."""

NEEDLE_ORDER, NEEDLE_REACH = 3, 1.5
"""Thin panels have densities of this degree where higher ones would not reach so many radii."""


def harmonic_weights(
    cage: TriMesh,
    points: Floats,
    accuracy: str = "standard",
    jobs: int | None = None,
    progress: Callable[[int, int], None] = ignore_progress,
) -> Weights:
    """Compute harmonic coordinates of points inside or on a cage.

    Parameters
    ----------
    cage : TriMesh
        Closed, manifold, outward, of one component (`cages.soundness.validate_cage`).
    points : (m, 3)
        Inside or on the cage, file units. A point on it gets barycentric weights.
    accuracy : str
        One of `ACCURACIES`.
    jobs : int, optional
        Threads; the number of processors by default. They do not change the result.
    progress : callable
        Called with (points done, points) after every block.

    Returns
    -------
    Weights
        Rows sum to 1 and reproduce the points to rounding, whatever the accuracy.

    Raises
    ------
    CageError
        When the cage has more faces than `MAX_FACES`.
    SettingError
        When the accuracy is unknown.
    NumericalError
        When the equations have no solution.
    """
    check_request(cage, accuracy)
    weights, within = weights_on_surface(cage, points)
    if len(within) == 0:
        return Weights(weights)
    origin, scale = cage.vertices.mean(axis=0), cage.diagonal
    unit = TriMesh((cage.vertices - origin) / scale, cage.faces)
    within = within[order_by_place(points[within])]
    places = (points[within] - origin) / scale
    with limit_blas_threads(1), ThreadPoolExecutor(jobs or count_processors()) as pool:
        boundary, error = solve_to_tolerance(unit, places, ACCURACIES[accuracy], pool)

        def fill(block: slice) -> int:
            weights[within[block]] = rounded_interior_weights(boundary, places[block])
            return int(block.stop)

        for done in pool.map(fill, split_points(boundary.mesh, len(within))):
            progress(done, len(within))
    return Weights(weights, len(boundary.mesh.panels.corners), error)


def check_request(cage: TriMesh, accuracy: str) -> None:
    """Refuse an unknown accuracy, and a cage with too many faces; raises as `harmonic_weights`."""
    if accuracy not in ACCURACIES:
        raise SettingError(f"accuracy is {accuracy!r}, expected one of {', '.join(ACCURACIES)}")
    if len(cage.faces) > MAX_FACES:
        raise CageError(
            f"the cage has {len(cage.faces)} faces, at most {MAX_FACES} fit in memory; "
            "use a coarser cage"
        )


def solve_to_tolerance(
    cage: TriMesh, points: Floats, accuracy: Accuracy, pool: ThreadPoolExecutor
) -> tuple[BoundarySolution, float]:
    """Divide panels until the estimated error is below the tolerance, or there are too many.

    The points, (q, 3), are ordered by place.
    """
    sample = points[:: -(-len(points) // SAMPLE_SIZE)]
    mesh = BoundaryMesh.from_cage(cage)
    while len(mesh.panels.corners) < MIN_PANELS:
        mesh = mesh.divide(np.ones(len(mesh.panels.corners), bool))
    mesh = _raise_order(mesh, points, accuracy)
    best = solve_boundary(mesh, pool)
    error, shares = estimate_error(best, sample)
    for _ in range(MAX_REFINEMENTS):
        if error <= accuracy.tolerance:
            break
        mesh = _raise_order(best.mesh.divide(_worst_panel_mask(shares)), points, accuracy)
        no_room = mesh.unknowns > accuracy.max_unknowns or len(mesh.high_panels) < len(
            best.mesh.high_panels
        )
        if no_room or mesh.order < best.mesh.order:
            break
        finer = solve_boundary(mesh, pool)
        less, shares = estimate_error(finer, sample)
        if less >= error:
            break
        best, error = finer, less
    return best, error


def _worst_panel_mask(shares: Floats) -> NDArray[np.bool_]:
    """Return a mask of the fewest panels that have `REFINED_SHARE` of the error, (p,)."""
    order = np.argsort(-shares, kind="stable")
    count = np.searchsorted(np.cumsum(shares[order]), REFINED_SHARE * shares.sum()) + 1
    chosen = np.zeros(len(shares), bool)
    chosen[order[:count]] = True
    return chosen


def _raise_order(mesh: BoundaryMesh, points: Floats, accuracy: Accuracy) -> BoundaryMesh:
    """Raise the order of panels within reach of `points`, as far as the unknowns allow."""
    panels = mesh.panels
    distance = measure_distances(points, panels.centroids)
    room = max(0, accuracy.max_unknowns - mesh.linear_unknowns)
    for order in range(accuracy.order, 1, -1):
        extra = len(exponents(order)) - LINEAR_TERMS
        degrees, reach = _choose_degrees(panels, order, accuracy.reach)
        near = np.flatnonzero((distance < FADE_FACTOR * reach) & (reach > panels.radii))
        if extra * len(near) <= room or order == 2:
            nearest = np.argsort(distance[near] / reach[near], kind="stable")
            near = np.sort(near[nearest[: room // extra]])
            return mesh.raise_order(near, degrees[near], reach[near])
    return mesh


def _choose_degrees(panels: Panels, order: int, radii: float) -> tuple[Integers, Floats]:
    """Choose the degree of the density on each panel, up to `order`, and how far its terms reach.

    The recurrences of higher terms are unstable at distances from thin panels, the sooner the
    higher their degree: where `order` does not reach `NEEDLE_REACH` radii, a lower one is used.

    Returns
    -------
    (p,) int64
    (p,) float64
        `radii` times those of the panels, or less where the terms are unstable.
    """
    degree = np.zeros(len(panels.corners), np.int64)
    reach = np.zeros(len(panels.corners))
    thickness = panels.altitudes.min(axis=0)
    for lower in range(order, min(order, NEEDLE_ORDER) - 1, -1):
        furthest = thickness * MAX_ROUNDING_GROWTH ** (0.5 / lower) / FADE_FACTOR
        is_left = reach < min(radii, NEEDLE_REACH) * panels.radii
        degree[is_left] = lower
        reach[is_left] = np.minimum(radii * panels.radii, furthest)[is_left]
    return degree, reach
