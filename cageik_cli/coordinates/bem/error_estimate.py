"""How far computed harmonic weights are from exact ones, and which panels are to blame."""

import numpy as np

from cageik_cli.coordinates.bem.boundary_equation import (
    BoundarySolution,
    compute_potentials,
    single_layer,
    split_points,
)
from cageik_cli.coordinates.bem.boundary_mesh import BoundaryMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats

LINEAR_REMAINDER = 0.1
"""Error of linear densities over what their linear terms emit: 0.08 to 0.16 on real cages."""

MIN_DECAY = 0.3
"""Degrees are not trusted to fall faster: a density's logarithms at edges do not let them."""

MAX_DECAY = 0.8
"""Nor slower, for the series' sum to mean something."""

EDGE_OFFSET = 1e-3
"""How far towards its centroid a point of a panel is moved, for edges have no tangent plane."""


def estimate_error(boundary: BoundarySolution, sample: Floats) -> tuple[float, Floats]:
    """Estimate the mean row L1 error over `sample`, (s, 3), and each panel's share in it, (p,).

    Away from the cage, the terms of each panel's highest degree, against those one lower, tell how
    fast the degrees fall; those that would follow are taken to fall alike, as a geometric series.
    Near it, the error is what the equations leave at the nearest point. The larger of both counts.
    """
    mesh = boundary.mesh
    degree, highest, panel = mesh.unknown_degrees
    terms = {
        (order, of): np.flatnonzero((degree == of) & (highest == order))
        for order in np.unique(highest)
        for of in (order - 1, order)
    }
    sizes = dict.fromkeys(terms, 0.0)
    term_sums = np.zeros(mesh.unknowns)
    for block in split_points(mesh, len(sample)):
        seen = _compute_all_potentials(mesh, sample[block])
        term_sums += np.abs(seen).sum(axis=1)
        for of, rows in terms.items():
            of_terms = boundary.densities[rows].T @ seen[rows]
            sizes[of] += np.abs(of_terms).sum() / (4 * np.pi * len(sample))
    series = 0.0
    for order in np.unique(highest):
        last, before = sizes[order, order], sizes[order, order - 1]
        if before > 0:
            fall = np.clip(last / before, MIN_DECAY, MAX_DECAY)
            series += last * (LINEAR_REMAINDER if order == 1 else fall / (1 - fall))
    error = max(series, float(_residual_near_cage(boundary, sample).mean()))
    term_sums *= np.abs(boundary.densities).sum(axis=1)
    return error, np.bincount(panel, term_sums * (degree == highest)).astype(np.float64)


def _compute_all_potentials(mesh: BoundaryMesh, points: Floats) -> Floats:
    """∫ of all terms over r, (u, q); 0 of those that have faded out."""
    potentials = compute_potentials(mesh, points, is_inside=True)
    everything = np.zeros((mesh.unknowns, len(points)))
    everything[: mesh.linear_unknowns] = potentials.linear
    higher = everything[mesh.linear_unknowns :].reshape(
        mesh.extra_terms, len(mesh.high_panels), len(points)
    )
    higher[:, potentials.near_panels] = potentials.higher
    return everything


def _residual_near_cage(boundary: BoundarySolution, sample: Floats) -> Floats:
    """Row L1 errors, (s,), that the equations leave on the cage, as felt at points in it.

    The computed weights are harmonic, and on the cage are off by (2π φ − D − ∫ q/r) / 4π. That
    changes its sign from node to node of a panel, and so dies away over the distance of nodes.
    """
    mesh = boundary.mesh
    panels = mesh.panels
    nearest = closest_points(TriMesh(panels.vertices, panels.corners), sample)
    on = nearest.position + EDGE_OFFSET * (panels.centroids[nearest.face] - nearest.position)
    hats = closest_points(nearest.mesh, on).barycentric_weights(np.ones(len(on), bool)) @ mesh.hats
    left = np.concatenate(
        [
            np.abs(2 * np.pi * hats[block] - _surface_values(boundary, on[block]).T).sum(axis=1)
            for block in split_points(mesh, len(on))
        ]
    )
    waves = (mesh.panel_degrees[nearest.face] + 1) / panels.radii[nearest.face]
    return np.asarray(left / (4 * np.pi) * np.exp(-np.pi * waves * nearest.distance))


def _surface_values(boundary: BoundarySolution, points: Floats) -> Floats:
    """D + ∫ q/r of every weight at points in faces, (n, q): 2π φ but for the error."""
    potentials = compute_potentials(boundary.mesh, points, is_inside=False)
    return single_layer(boundary.mesh, boundary.densities, potentials) + potentials.double
