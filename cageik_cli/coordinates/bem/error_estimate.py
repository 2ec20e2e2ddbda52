"""Estimate of the error of harmonic weights, and the share of each panel in it."""

import numpy as np

from cageik_cli.coordinates.bem.boundary_equation import (
    BoundarySolution,
    single_layer,
    split_points,
)
from cageik_cli.coordinates.bem.boundary_mesh import BoundaryMesh
from cageik_cli.coordinates.bem.potentials import compute_potentials
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats

LINEAR_REMAINDER = 0.1
"""Error of linear densities relative to their linear terms: 0.08 to 0.16 on real cages."""

MIN_DECAY = 0.3
"""Smallest assumed ratio of successive degrees; densities have logarithms at edges."""

MAX_DECAY = 0.8
"""Largest assumed ratio of successive degrees, so that the series has a useful sum."""

EDGE_OFFSET = 1e-3
"""Share of the way to the centroid by which points are moved off edges."""


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
            ratio = np.clip(last / before, MIN_DECAY, MAX_DECAY)
            series += last * (LINEAR_REMAINDER if order == 1 else ratio / (1 - ratio))
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
    on_cage = nearest.position + EDGE_OFFSET * (panels.centroids[nearest.face] - nearest.position)
    on_panels = closest_points(nearest.mesh, on_cage)
    barycentric = on_panels.barycentric_coordinates(np.ones(len(on_cage), bool))
    hats = mesh.hats.evaluate(panels.corners[on_panels.face], barycentric)
    residual = np.concatenate(
        [
            np.abs(2 * np.pi * hats[block] - _surface_values(boundary, on_cage[block]).T).sum(
                axis=1
            )
            for block in split_points(mesh, len(on_cage))
        ]
    )
    waves = (mesh.panel_degrees[nearest.face] + 1) / panels.radii[nearest.face]
    return np.asarray(residual / (4 * np.pi) * np.exp(-np.pi * waves * nearest.distance))


def _surface_values(boundary: BoundarySolution, points: Floats) -> Floats:
    """Return D + ∫ q/r of every weight at points in faces, (n, q): 2π φ plus the error."""
    potentials = compute_potentials(boundary.mesh, points, is_inside=False)
    return single_layer(boundary.mesh, boundary.densities, potentials) + potentials.double
