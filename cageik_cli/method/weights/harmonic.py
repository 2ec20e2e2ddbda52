"""Harmonic coordinates (Joshi et al. 2007) by boundary elements on the cage.

The weight of a cage vertex is the harmonic function inside the cage that on the cage equals the
vertex's piecewise linear basis function. Its normal derivative on the cage, the density, is a
polynomial on each panel, discontinuous between panels, as the exact one is at the cage's edges.
Boundary values and integrals are exact, and constants are among the polynomials, so that the
weights sum to one and reproduce affine maps to rounding, however coarse the panels are.

Only panels close to the model's vertices have polynomials beyond linear. Panels with too large an
estimated error are divided.

The error is estimated at the model's vertices, and measured by what the equations leave on the
cage.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import measure_distances, order_by_place
from cageik_cli.geometry.shape import thin_face_pairs
from cageik_cli.geometry.surface import closest_points, weights_on_surface
from cageik_cli.method.weights.bem.boundary_equation import (
    BoundarySolution,
    Densities,
    count_points_per_block,
    rounded_interior_weights,
    single_layer,
    solve_boundary,
    split_points,
)
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.bem.panels import LINEAR_TERMS, Panels, exponents, gauss_rule
from cageik_cli.method.weights.bem.potentials import FADE_FACTOR, compute_potentials
from cageik_cli.method.weights.binding import Weights
from cageik_cli.method.weights.settings import ACCURACIES, Accuracy
from cageik_cli.util.arrays import Floats, Integers, spread_evenly
from cageik_cli.util.errors import CageError, SettingError
from cageik_cli.util.progress import ignore_progress
from cageik_cli.util.text import group_digits
from cageik_cli.util.threads import count_processors, limit_blas_threads

MIN_PANELS = 60
"""Faces of cages with fewer panels are divided into four, which costs little."""

MAX_HARMONIC_FACES = 5000
"""Largest number of faces of a cage; its matrix then has (3 × 5000)² float32, 0.9 GB."""

MAX_REFINEMENTS = 4
"""Largest number of times that the panels with the largest error are divided."""

MAX_ERROR_SAMPLES = 128
"""Points at which the error is estimated."""

MIN_REFINED_SHARE = 0.6
"""Panels are divided that have this share of the error, the fewest that do."""

STEADY_SHARE = 0.24
"""Share of the error on the cage that does not change its sign within a panel.

It reaches far inside: on 16 cages, the error at half a radius of a panel is 0.07 to 0.45 of it, in
the middle 0.2. With a larger share, estimates of balls and tori are above twice their error.
"""

MAX_GAP_RATIO = 1.0
"""Panels that face another nearer than this, in roots of their area, have a higher degree."""

MAX_MEASURED_PANELS = 250
"""Panels at which the error on the cage is measured: in a tenth of the time of a bind."""


def harmonic_weights(
    cage: TriMesh,
    points: Floats,
    accuracy: str | Accuracy = "standard",
    jobs: int | None = None,
    progress: Callable[[int, int], None] = ignore_progress,
) -> Weights:
    """Compute harmonic coordinates of points inside or on a cage.

    Parameters
    ----------
    cage : TriMesh
        Closed, manifold, outward, of one component (`cages.check.faults.validate_cage`).
    points : (m, 3)
        Inside or on the cage, file units. A point on it gets barycentric weights.
    accuracy : str or Accuracy
        One of `ACCURACIES`, or limits of another.
    jobs : int, optional
        Threads; the number of processors by default. They do not change the result.
    progress : callable
        Called with (points done, points) after every block; before, where the equations take long,
        with (work done, work) of their solution, in unknowns.

    Returns
    -------
    Weights
        Rows sum to 1 and reproduce the points to rounding, whatever the accuracy.

    Raises
    ------
    CageError
        When the cage has more faces than `MAX_HARMONIC_FACES`.
    SettingError
        When the accuracy is unknown.
    NumericalError
        When the equations have no solution.
    """
    check_request(cage, accuracy)
    weights, within = weights_on_surface(cage, points)
    if len(within) == 0:
        return Weights(weights)
    solution = HarmonicSolution(cage, points[within], accuracy, jobs, progress)

    def fill(chosen: Integers, places: Floats) -> None:
        weights[chosen] = rounded_interior_weights(solution.boundary, places)

    solution.visit_blocks(points, within, fill, jobs, progress)
    panels = len(solution.boundary.mesh.panels.corners)
    return Weights(weights, panels, solution.error, solution.surface_error)


class HarmonicSolution:
    """The boundary equation of a cage, solved to a tolerance at points inside.

    It is solved in the cage's own units: centred, with a diagonal of one.

    Parameters
    ----------
    cage, points, accuracy, jobs, progress
        As of `harmonic_weights`; the points are inside.

    Attributes
    ----------
    boundary : BoundarySolution
    error : float
        Estimate of the mean row L1 error at the points.
    surface_error : float
        Mean row L1 error of the weights just inside the cage, over its area.
    scale : float
        A unit of the solution, file units.
    """

    def __init__(
        self,
        cage: TriMesh,
        points: Floats,
        accuracy: str | Accuracy,
        jobs: int | None,
        progress: Callable[[int, int], None] = ignore_progress,
    ) -> None:
        limits = ACCURACIES[accuracy] if isinstance(accuracy, str) else accuracy
        self._origin, self.scale = cage.vertices.mean(axis=0), cage.diagonal
        unit = TriMesh(self.to_units(cage.vertices), cage.faces)
        places = self.to_units(points[order_by_place(points)])
        with limit_blas_threads(1), ThreadPoolExecutor(jobs or count_processors()) as pool:
            self.boundary, error = _solve_to_tolerance(unit, places, limits, pool, progress)
            is_measured = np.isfinite(limits.tolerance)  # else no error is asked for
            self.surface_error = measure_surface_error(self.boundary, pool) if is_measured else 0.0
        self.error = max(error, STEADY_SHARE * self.surface_error)

    def to_units(self, points: Floats) -> Floats:
        """Return places in file units, (m, 3), in those of the solution."""
        return np.asarray((points - self._origin) / self.scale)

    def visit_blocks(
        self,
        points: Floats,
        chosen: Integers,
        visit: Callable[[Integers, Floats], None],
        jobs: int | None,
        progress: Callable[[int, int], None],
    ) -> None:
        """Call `visit` with blocks of the chosen points, neighbours together, in threads.

        Parameters
        ----------
        points : (m, 3)
            File units.
        chosen : (k,) int64
            Numbers of points inside.
        visit : callable
            Of numbers of points, and their places in the units of the solution.
        """
        if len(chosen) == 0:
            return
        chosen = chosen[order_by_place(points[chosen])]
        places = self.to_units(points[chosen])

        def visit_block(block: slice) -> int:
            visit(chosen[block], places[block])
            return int(block.stop)

        with limit_blas_threads(1), ThreadPoolExecutor(jobs or count_processors()) as pool:
            for done in pool.map(visit_block, split_points(self.boundary.mesh, len(chosen))):
                progress(done, len(chosen))


def check_request(cage: TriMesh, accuracy: str | Accuracy) -> None:
    """Refuse an unknown accuracy, and a cage with too many faces; raises as `harmonic_weights`."""
    if isinstance(accuracy, str) and accuracy not in ACCURACIES:
        raise SettingError(f"accuracy is {accuracy!r}, expected one of {', '.join(ACCURACIES)}")
    if len(cage.faces) > MAX_HARMONIC_FACES:
        raise CageError(
            f"the cage has {group_digits(len(cage.faces))} faces, at most "
            f"{group_digits(MAX_HARMONIC_FACES)} "
            "fit in memory; "
            "use a coarser cage"
        )


def _solve_to_tolerance(
    cage: TriMesh,
    points: Floats,
    accuracy: Accuracy,
    pool: ThreadPoolExecutor,
    progress: Callable[[int, int], None],
) -> tuple[BoundarySolution, float]:
    """Divide panels until the estimated error is below the tolerance, or there are too many.

    The points, (q, 3), are ordered by place.
    """
    sample = points[:: -(-len(points) // MAX_ERROR_SAMPLES)]
    mesh = BoundaryMesh.from_cage(cage)
    while len(mesh.panels.corners) < MIN_PANELS:
        mesh = mesh.divide(np.ones(len(mesh.panels.corners), bool))
    mesh = _raise_order(mesh, points, accuracy)
    best = solve_boundary(mesh, pool, progress)
    error, shares = estimate_error(best, sample)
    for _ in range(MAX_REFINEMENTS):
        if error <= accuracy.tolerance:
            break
        # Divided are the fewest panels that have `MIN_REFINED_SHARE` of the error.
        order = np.argsort(-shares, kind="stable")
        count = np.searchsorted(np.cumsum(shares[order]), MIN_REFINED_SHARE * shares.sum()) + 1
        chosen = np.zeros(len(shares), bool)
        chosen[order[:count]] = True
        mesh = _raise_order(best.mesh.divide(chosen), points, accuracy)
        no_room = mesh.unknowns > accuracy.max_unknowns or len(mesh.high_panels) < len(
            best.mesh.high_panels
        )
        if no_room or mesh.order < best.mesh.order:
            break
        finer = solve_boundary(mesh, pool, progress)
        less, shares = estimate_error(finer, sample)
        if less >= error:
            break
        best, error = finer, less
    return best, error


def _raise_order(mesh: BoundaryMesh, points: Floats, accuracy: Accuracy) -> BoundaryMesh:
    """Raise the order of panels within reach of `points` or of a panel that they face.

    As far as the unknowns allow, the nearest first.
    """
    if accuracy.order == 1:
        return mesh
    panels = mesh.panels
    distance = measure_distances(points, panels.centroids)
    # The densities of panels that face each other near by vary over the distance between them, also
    # where no point is near.
    pairs, ratios = thin_face_pairs(TriMesh(panels.vertices, panels.corners), MAX_GAP_RATIO)
    np.minimum.at(distance, pairs[:, 0], ratios * np.sqrt(panels.areas[pairs[:, 0]]))
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
    higher their degree: where `order` does not reach 1.5 radii, a lower one down to 3 is used.
    Rounding errors grow by 1e10 at most, as higher terms need few digits.

    Returns
    -------
    (p,) int64
    (p,) float64
        `radii` times those of the panels, or less where the terms are unstable.
    """
    degree = np.zeros(len(panels.corners), np.int64)
    reach = np.zeros(len(panels.corners))
    thickness = panels.altitudes.min(axis=0)
    for lower in range(order, min(order, 3) - 1, -1):
        furthest = thickness * 1e10 ** (0.5 / lower) / FADE_FACTOR
        is_left = reach < min(radii, 1.5) * panels.radii
        degree[is_left] = lower
        reach[is_left] = np.minimum(radii * panels.radii, furthest)[is_left]
    return degree, reach


def estimate_error(boundary: BoundarySolution, sample: Floats) -> tuple[float, Floats]:
    """Estimate the mean row L1 error over `sample`, (s, 3), and each panel's share in it, (p,).

    Away from the cage, the terms of the highest degree relative to those one lower give a ratio;
    the missing degrees are estimated by a geometric series with this ratio. Near the cage, the
    error is the residual of the equations at the closest point. The larger estimate counts.
    """
    mesh = boundary.mesh
    degree, highest, panel = mesh.unknown_degrees
    terms = {
        (order, power): np.flatnonzero((degree == power) & (highest == order))
        for order in np.unique(highest)
        for power in (order - 1, order)
    }
    sizes = dict.fromkeys(terms, 0.0)
    term_sums = np.zeros(mesh.unknowns)
    for block in split_points(mesh, len(sample)):
        # ∫ ψ/r of all terms, (u, q); 0 for those that have faded out.
        found = compute_potentials(mesh, sample[block], is_inside=True)
        potentials = np.zeros((mesh.unknowns, found.linear.shape[1]))
        potentials[: mesh.linear_unknowns] = found.linear
        higher = potentials[mesh.linear_unknowns :]
        higher = higher.reshape(mesh.extra_terms, len(mesh.high_panels), found.linear.shape[1])
        higher[:, found.near_panels] = found.higher
        term_sums += np.abs(potentials).sum(axis=1)
        for key, rows in terms.items():
            contributions = boundary.densities[rows].T @ potentials[rows]
            sizes[key] += np.abs(contributions).sum() / (4 * np.pi * len(sample))
    series = 0.0
    for order in np.unique(highest):
        last, before = sizes[order, order], sizes[order, order - 1]
        if before > 0:
            # Densities have logarithms at edges, and the series must have a useful sum.
            ratio = np.clip(last / before, 0.3, 0.8)
            # The error of linear densities is 0.08 to 0.16 of their linear terms on real cages.
            series += last * (0.1 if order == 1 else ratio / (1 - ratio))
    error = max(series, float(_residual_near_cage(boundary, sample).mean()))
    term_sums *= np.abs(boundary.densities).sum(axis=1)
    return error, np.bincount(panel, term_sums * (degree == highest)).astype(np.float64)


def _residual_near_cage(boundary: BoundarySolution, sample: Floats) -> Floats:
    """Return the row L1 errors, (s,), at points inside due to the residual on the cage.

    The computed weights are harmonic, and their error on the cage is (2π φ − D − ∫ q/r) / 4π. It
    changes its sign from node to node of a panel, and so decays over the distance of nodes.
    """
    mesh = boundary.mesh
    panels = mesh.panels
    nearest = closest_points(TriMesh(panels.vertices, panels.corners), sample)
    # Off the edges, by a thousandth of the way to the centroid.
    on_cage = nearest.position + 1e-3 * (panels.centroids[nearest.face] - nearest.position)
    on_panels = closest_points(nearest.mesh, on_cage)
    barycentric = on_panels.barycentric_coordinates(np.ones(len(on_cage), bool))
    basis_functions = mesh.basis_functions.evaluate(panels.corners[on_panels.face], barycentric)
    residual = np.concatenate(
        [
            _measure_residual(boundary, boundary.densities, on_cage[block], basis_functions[block])
            for block in split_points(mesh, len(on_cage))
        ]
    )
    waves = (mesh.panel_degrees[nearest.face] + 1) / panels.radii[nearest.face]
    return np.asarray(residual * np.exp(-np.pi * waves * nearest.distance))


def _measure_residual(
    boundary: BoundarySolution, densities: Densities, points: Floats, basis_functions: Floats
) -> Floats:
    """Return the row L1 norms, (q,), of (2π φ − D − ∫ q/r) / 4π at points in faces, (q, 3).

    It is the error of the weights there, just inside. `basis_functions`, (q, n), are φ at the
    points.
    """
    potentials = compute_potentials(boundary.mesh, points, is_inside=False)
    values = single_layer(boundary.mesh, densities, potentials) + potentials.double
    return np.asarray(np.abs(2 * np.pi * basis_functions - values.T).sum(axis=1) / (4 * np.pi))


def measure_surface_error(boundary: BoundarySolution, pool: ThreadPoolExecutor) -> float:
    """Measure the mean row L1 error of the weights just inside the cage, over the area of panels.

    They are those of a degree above 1: near vertices, or facing one another; 0 if there are none.
    Unlike the estimate at points, it sees those that no point is near. Of many panels, evenly
    spread ones are measured; single precision suffices. The nodes are those of the equations, where
    residuals are smaller than between them: it is up to a third too small.
    """
    mesh, panels = boundary.mesh, boundary.mesh.panels
    barycentric, shares = gauss_rule(3)
    if len(mesh.high_panels) == 0:
        return 0.0
    chosen = mesh.high_panels[spread_evenly(len(mesh.high_panels), MAX_MEASURED_PANELS)]
    nodes = np.einsum("jk,ckx->cjx", barycentric, panels.vertices[panels.corners[chosen]])

    def measure(block: slice) -> Floats:
        basis_functions = mesh.evaluate_basis_functions(chosen[block], barycentric).reshape(
            -1, mesh.basis_functions.count
        )
        points = nodes[block].reshape(-1, 3)
        errors = _measure_residual(boundary, boundary.rounded_densities, points, basis_functions)
        return np.asarray(errors.reshape(-1, len(shares)) @ shares)

    size = max(1, count_points_per_block(mesh) // len(shares))
    blocks = [slice(start, start + size) for start in range(0, len(chosen), size)]
    errors = np.concatenate(list(pool.map(measure, blocks)))
    return float(np.average(errors, weights=panels.areas[chosen]))
