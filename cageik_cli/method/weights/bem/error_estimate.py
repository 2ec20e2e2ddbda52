"""What is wrong with computed weights: an estimate at points, and what they leave on the cage."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.method.weights.bem.boundary_equation import (
    BoundarySolution,
    Densities,
    count_points_per_block,
    single_layer,
    split_points,
)
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.bem.panel_geometry import gauss_rule
from cageik_cli.method.weights.bem.potentials import compute_potentials
from cageik_cli.util.arrays import Floats, spread_evenly

MAX_MEASURED_PANELS = 250
"""Panels at which the error on the cage is measured: in a tenth of the time of a bind."""


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
        potentials = _compute_all_potentials(mesh, sample[block])
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


def _compute_all_potentials(mesh: BoundaryMesh, points: Floats) -> Floats:
    """Return ∫ ψ/r of all terms, (u, q); 0 for those that have faded out."""
    potentials = compute_potentials(mesh, points, is_inside=True)
    all_terms = np.zeros((mesh.unknowns, len(points)))
    all_terms[: mesh.linear_unknowns] = potentials.linear
    higher = all_terms[mesh.linear_unknowns :].reshape(
        mesh.extra_terms, len(mesh.high_panels), len(points)
    )
    higher[:, potentials.near_panels] = potentials.higher
    return all_terms


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
