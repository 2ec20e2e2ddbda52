"""Harmonic coordinates (Joshi et al. 2007) by boundary elements on the cage.

The weight w_k of cage vertex k is the harmonic function inside the cage that on the cage equals the
piecewise linear hat φ_k. Green's representation gives it from φ_k and its outward normal derivative
q_k on the cage,

    4π w_k(x) = Σ_panels ∫ q_k / r dA + D_k(x),     D_k = Σ_faces ∫ φ_k h/r³ dA,

and, for x inside a face, 2π φ_k(x) in place of 4π w_k(x) makes an integral equation for q_k. It is
solved by collocation, with q_k linear on each panel (discontinuous between panels: at the cage's
edges it is). Boundary values and integrals are exact, so that the weights sum to one and reproduce
affine maps to rounding however coarse the panels are.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy import sparse

from cageik_cli.coordinates.panel_geometry import Panels
from cageik_cli.coordinates.panels import (
    Scratch,
    View,
    close_angles,
    double_layer,
    single_layer_moments,
    view,
)
from cageik_cli.coordinates.surface import nearest_on_surface
from cageik_cli.coordinates.weights import Weights
from cageik_cli.errors import InputError
from cageik_cli.mesh import Floats, TriMesh
from cageik_cli.threads import blas_threads, processors

TOLERANCES = {"preview": 0.03, "standard": 0.005, "fine": 0.001}
"""Mean over points of a row's L1 distance from exact weights, by the accuracy asked for."""

PANEL_GOAL = 1200
"""Faces are divided in four while the panels are not more than this."""

PANEL_LIMIT = 5000
"""Most panels: the boundary matrix has nine float64 times its square, 1.8 GB here."""

BLOCK = 128
"""Points evaluated together: few enough for the processor's cache, enough to keep threads apart."""

ON_SURFACE = 1e-12
"""A point this near the cage, in diagonals, is on it and has its barycentric weights."""

# Density nodes lie at barycentric (2/3, 1/6, 1/6); this gives a linear function's corner values
# from its values at the three nodes: the inverse of ½ I + ⅙ J.
_CORNERS_FROM_NODES = 2 * np.eye(3) - 1 / 3
_NODES = np.eye(3) / 2 + 1 / 6


class _ThreadScratch(threading.local):
    """Scratch of the running thread, dropped with it."""

    def __init__(self) -> None:
        self.own = Scratch()


_SCRATCH = _ThreadScratch()


def no_progress(done: int, total: int) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True, eq=False)
class BoundarySolution:
    """The normal derivatives of all harmonic coordinates of one cage.

    Attributes
    ----------
    cage : Panels
        The cage's faces, moved to the origin and scaled to a diagonal of one.
    panels : Panels
        The faces divided into panels.
    densities : (n, 3p) float64
        q_k of each weight on each panel as coefficients of (1, u, v), ordered [term, panel].
    origin : (3,) float64
    scale : float
        The diagonal of the cage, file units.
    """

    cage: Panels
    panels: Panels
    densities: Floats
    origin: Floats
    scale: float


def harmonic_weights(
    cage: TriMesh,
    points: Floats,
    accuracy: str = "standard",
    jobs: int | None = None,
    progress: Callable[[int, int], None] = no_progress,
) -> Weights:
    """Harmonic coordinates of points inside or on a cage.

    Parameters
    ----------
    cage : TriMesh
        Closed, manifold, outward, of one component (`enclosure.checked_cage`).
    points : (m, 3)
        Inside or on the cage, file units. A point on it gets barycentric weights.
    accuracy : str
        One of `TOLERANCES`.
    jobs : int, optional
        Threads; the number of processors by default. They change the result by rounding alone.
    progress : callable
        Told (points done, points) after every block.

    Returns
    -------
    Weights
        Whose rows sum to 1 and give the points to rounding, whatever the accuracy.

    Raises
    ------
    InputError
        When the cage has more faces than `PANEL_LIMIT`.
    """
    nearest = nearest_on_surface(cage, points)
    touching = nearest.distance <= ON_SURFACE * cage.diagonal
    within = np.flatnonzero(~touching)
    weights = np.empty((len(points), len(cage.vertices)))
    weights[touching] = nearest.weights(touching)
    jobs = jobs or processors()
    with blas_threads(1), ThreadPoolExecutor(jobs) as pool:
        boundary = solve_boundary(cage, pool, jobs)

        def fill(block: slice) -> int:
            chosen = within[block]
            weights[chosen] = _weights_inside(boundary, points[chosen])
            return int(block.stop)

        for done in pool.map(fill, _blocks(len(within))):
            progress(done, len(within))
    return Weights(weights, len(boundary.panels.corners))


def solve_boundary(cage: TriMesh, pool: ThreadPoolExecutor, jobs: int) -> BoundarySolution:
    """Solve the boundary integral equation of `cage` for all its hats, in `jobs` threads."""
    if len(cage.faces) > PANEL_LIMIT:
        raise InputError(
            f"the cage has {len(cage.faces)} faces, at most {PANEL_LIMIT} fit in memory; "
            "use a coarser cage"
        )
    origin, scale = cage.vertices.mean(axis=0), cage.diagonal
    mesh = TriMesh((cage.vertices - origin) / scale, cage.faces)
    faces = Panels(mesh.vertices, mesh.faces)
    fine, hats = divided(mesh, PANEL_GOAL)
    panels = Panels(fine.vertices, fine.faces) if fine is not mesh else faces
    nodes, values = _collocation(panels, hats)
    basis = _node_basis(panels)

    matrix = np.empty((len(nodes), len(nodes)))
    right = 2 * np.pi * values

    def fill(block: slice) -> None:
        moments, double = _potentials(faces, panels, nodes[block], inside=False)
        matrix[block] = (basis @ moments).T
        right[block] -= double.T

    for _ in pool.map(fill, _blocks(len(nodes))):
        pass
    with blas_threads(min(jobs, processors())):
        # LAPACK wants columns: the transpose is factored where it stands, and solved transposed.
        factor = scipy.linalg.lu_factor(matrix.T, overwrite_a=True, check_finite=False)
        at_nodes = scipy.linalg.lu_solve(
            factor, right, trans=1, overwrite_b=True, check_finite=False
        )
    return BoundarySolution(faces, panels, (basis.T @ at_nodes).T.copy(), origin, scale)


def divided(mesh: TriMesh, most: int) -> tuple[TriMesh, sparse.csr_array]:
    """Divide every face in four, again and again, to at most `most` faces.

    Returns
    -------
    TriMesh
        The divided mesh, children of a face in a row.
    (v, n) sparse
        The hat of each vertex of `mesh` at each vertex of the divided one.
    """
    hats = sparse.eye_array(len(mesh.vertices), format="csr")
    while 4 * len(mesh.faces) <= most:
        ends, count = mesh.edges.ends, len(mesh.vertices)
        a, b, c = mesh.faces.T
        opposite_a, opposite_b, opposite_c = (mesh.edges.of_side + count).T
        children = np.stack(
            [
                np.stack([a, opposite_c, opposite_b], axis=1),
                np.stack([b, opposite_a, opposite_c], axis=1),
                np.stack([c, opposite_b, opposite_a], axis=1),
                np.stack([opposite_a, opposite_b, opposite_c], axis=1),
            ],
            axis=1,
        )
        middles = mesh.vertices[ends].mean(axis=1)
        hats = sparse.vstack([hats, (hats[ends[:, 0]] + hats[ends[:, 1]]) / 2], format="csr")
        mesh = TriMesh(np.concatenate([mesh.vertices, middles]), children.reshape(-1, 3))
    return mesh, sparse.csr_array(hats)


def _collocation(panels: Panels, hats: sparse.csr_array) -> tuple[Floats, Floats]:
    """The nodes (3p, 3), ordered [node, panel] like the densities, and the hats there, (3p, n)."""
    corner = panels.vertices[panels.corners]
    nodes = np.einsum("jk,pkx->jpx", _NODES, corner).reshape(-1, 3)
    corner_hats = [hats[panels.corners[:, k]] for k in range(3)]
    at_nodes = [sum(row[k] * corner_hats[k] for k in range(3)) for row in _NODES]
    return nodes, np.concatenate([block.toarray() for block in at_nodes])


def _node_basis(panels: Panels) -> sparse.csr_array:
    """Densities that are 1 at one node and 0 at its panel's others, as coefficients of (1, u, v).

    (3p, 3p), row [node, panel], column [term, panel].
    """
    coefficients = np.einsum("ij,itp->jtp", _CORNERS_FROM_NODES, panels.hats)
    own = np.arange(3 * len(panels.corners)).reshape(3, -1)
    rows, columns = np.broadcast_arrays(own[:, None], own[None])
    return sparse.csr_array((coefficients.ravel(), (rows.ravel(), columns.ravel())))


def _weights_inside(boundary: BoundarySolution, points: Floats) -> Floats:
    local = (points - boundary.origin) / boundary.scale
    moments, double = _potentials(boundary.cage, boundary.panels, local, inside=True)
    weights = boundary.densities @ moments
    weights += double
    return weights.T / (4 * np.pi)


def _potentials(
    cage: Panels, panels: Panels, points: Floats, *, inside: bool
) -> tuple[Floats, Floats]:
    """∫ (1, u, v)/r of every panel, (3p, q), scratch, and D_k of every cage vertex, (n, q).

    From points strictly `inside`, or in the faces.
    """
    scratch = _SCRATCH.own

    def look(surface: Panels) -> View:
        seen = view(surface, points, scratch)
        if inside:
            close_angles(seen)
        return seen

    seen = look(panels)
    moments = single_layer_moments(panels, seen, scratch)
    if panels is not cage:
        seen = look(cage)
    integrals = double_layer(cage, seen, scratch)
    double = cage.corner_sums @ integrals.reshape(-1, len(points))
    return moments.reshape(-1, len(points)), np.asarray(double)


def _blocks(count: int) -> list[slice]:
    return [slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK)]
