"""Potentials of the panels of a cage at points, compiled where that is possible.

The potentials of terms beyond linear decay with the cube of the distance, and are faded out.
"""

import threading
from dataclasses import dataclass

import numpy as np

from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.bem.higher_terms import higher_moments
from cageik_cli.method.weights.bem.panels import (
    CLOSED_ANGLE_TOL,
    EDGE_ON_TOL,
    INSIDE_ANGLE_TOL,
    MIN_GAP_RATIO,
    NEAR_EDGE_RATIO,
    PanelView,
    distances,
)
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats, Integers, Workspace

FADE_FACTOR = 1.25
"""Terms beyond linear are full up to `reach` over this, and zero from `reach` times this."""

_THREAD_LOCAL = threading.local()

_LIMITS = np.array(
    [EDGE_ON_TOL, MIN_GAP_RATIO, NEAR_EDGE_RATIO, CLOSED_ANGLE_TOL, INSIDE_ANGLE_TOL, FADE_FACTOR]
)


def thread_workspace() -> Workspace:
    """Return the workspace of the current thread."""
    found: Workspace = _THREAD_LOCAL.__dict__.setdefault("workspace", Workspace())
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Potentials:
    """Potentials of panels at q points; in workspace memory, valid until the next in this thread.

    Attributes
    ----------
    linear : (3p, q)
        ∫ (1, x, y)/r of every panel.
    near_panels : (c,) int64
        Indices into `mesh.high_panels` of the panels whose higher terms may not have faded out.
    higher : (d − 3, c, q)
        ∫ ψ/r of their higher terms.
    double : (n, q)
        D_k of every cage vertex.
    """

    linear: Floats
    near_panels: Integers
    higher: Floats
    double: Floats


def compute_potentials(mesh: BoundaryMesh, points: Floats, *, is_inside: bool) -> Potentials:
    """Compute the potentials at points, (q, 3), that are strictly inside, or else in faces."""
    near = find_near_panels(mesh, points)
    workspace = thread_workspace()
    if compiled.kernel is None:
        view = PanelView(mesh.panels, points, workspace)
        if is_inside:
            view.close_solid_angles()
        else:
            view.set_principal_values()
        linear = view.linear_moments()
        higher = np.empty((mesh.extra_terms, 0, len(points)))
        if len(near):
            higher = higher_moments(mesh.higher_terms, near, view, linear)
            higher *= compute_strength(mesh, near, points, workspace)
        double = mesh.double_layer_to_basis @ view.double_layer().reshape(-1, len(points))
        return Potentials(linear.reshape(-1, len(points)), near, higher, np.asarray(double))
    p, q = len(mesh.panels.corners), len(points)
    potentials = Potentials(
        workspace.array("moments", 3 * p, q),
        near,
        workspace.array("higher", mesh.extra_terms, len(near), q),
        workspace.array("double", mesh.basis_functions.count, q),
    )
    compiled.kernel.compute_potentials(
        _LIMITS,
        mesh.panels.kernel_arrays,
        mesh.double_layer_columns,
        (mesh.order, near, *mesh.higher_arrays) if mesh.order > 1 else None,
        np.ascontiguousarray(points),
        is_inside,
        (potentials.linear, potentials.higher, potentials.double),
    )
    return potentials


def find_near_panels(mesh: BoundaryMesh, points: Floats) -> Integers:
    """Return indices into `mesh.high_panels` within reach of the box around the points."""
    centroids = mesh.panels.centroids[mesh.high_panels]
    low, high = points.min(axis=0), points.max(axis=0)
    outside = np.maximum(np.maximum(low - centroids, centroids - high), 0)
    return np.flatnonzero(np.linalg.norm(outside, axis=1) < FADE_FACTOR * mesh.reach)


def compute_strength(
    mesh: BoundaryMesh, near: Integers, points: Floats, workspace: Workspace
) -> Floats:
    """Return the strength of the higher terms of panels at points, (c, q).

    It is 1 up to a distance of reach / FADE_FACTOR, 0 from reach · FADE_FACTOR, with a continuous
    slope.
    """
    centroids = mesh.panels.centroids[mesh.high_panels[near]]
    share = distances(centroids, points, workspace, "centroid")
    share /= mesh.reach[near, None]
    np.subtract(FADE_FACTOR, share, out=share)
    share /= FADE_FACTOR - 1 / FADE_FACTOR
    np.clip(share, 0, 1, out=share)
    return np.asarray(share * share * (3 - 2 * share))
