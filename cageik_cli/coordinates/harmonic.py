"""Harmonic coordinates (Joshi et al. 2007) by boundary elements on the cage.

The weight w_k of cage vertex k is the harmonic function inside the cage that on the cage equals the
piecewise linear hat φ_k. Green's representation gives it from φ_k and its outward normal derivative
q_k on the cage,

    4π w_k(x) = Σ_panels ∫ q_k / r dA + D_k(x),     D_k = Σ_panels ∫ φ_k h/r³ dA,

and, for x inside a face, 2π φ_k(x) in place of 4π w_k(x) makes an integral equation for q_k. It is
solved by Galerkin's method, with q_k a polynomial on each panel (discontinuous between panels: at
the cage's edges it is). Boundary values and integrals are exact, and constants are among the
polynomials, so that the weights sum to one and reproduce affine maps to rounding, however coarse
the panels are.

What the polynomials beyond the linear ones emit falls off as the cube of the distance: it is faded
out at a few radii of the panel, and only panels that the model's vertices come near have them.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cageik_cli.coordinates.boundary_mesh import BoundaryMesh
from cageik_cli.coordinates.panels import (
    Scratch,
    close_angles,
    distances,
    double_layer,
    higher_moments,
    linear_moments,
    take_principal_values,
    view,
)
from cageik_cli.coordinates.polynomials import LINEAR, basis, exponents, gauss_rule, monomials
from cageik_cli.coordinates.surface import nearest_on_surface
from cageik_cli.coordinates.weights import Weights
from cageik_cli.errors import InputError
from cageik_cli.mesh import Floats, Integers, TriMesh
from cageik_cli.threads import blas_threads, processors


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What weights are computed to.

    Attributes
    ----------
    tolerance : float
        Mean over points of a row's L1 distance from exact weights.
    order : int
        Degree of the densities on panels that points come near.
    reach : float
        Radii of a panel at which what is beyond linear has half faded out.
    most : int
        Unknowns not to be passed for accuracy's sake; the matrix takes 4 bytes times their square.
    """

    tolerance: float
    order: int
    reach: float
    most: int


ACCURACIES = {
    "preview": Accuracy(0.03, 1, 0.0, 9000),
    "standard": Accuracy(0.005, 3, 1.5, 15000),
    "fine": Accuracy(0.001, 5, 4.0, 15000),
}

FADE = 1.25
"""What is beyond linear is whole to `reach` over this, and nothing from `reach` times this."""

FEWEST_PANELS = 60
"""Faces of cages that have fewer are divided in four: it costs nothing."""

PANEL_LIMIT = 5000
"""Most faces of a cage: its matrix has nine float32 times their square, 0.9 GB."""

ROUNDS = 4
"""How often the panels that are resolved worst are divided, at most."""

SAMPLE = 128
"""Points at which the error is estimated."""

SHARED = 0.6
"""The panels that are divided have this share of the estimated error."""

DIGITS = 1e10
"""How much the rounding of higher terms may grow; they need few digits, constants keep theirs."""

AFTER_LINEAR = 0.1
"""Error of linear densities over what their linear terms emit: 0.08 to 0.16 on real cages."""

FASTEST_FALL = 0.3
"""Degrees are not trusted to fall faster: a density's logarithms at edges do not let them."""

SLOWEST_FALL = 0.8
"""Nor slower, for the series' sum to mean something."""

OFF_EDGES = 1e-3
"""How far towards its centroid a point of a panel is moved, for edges have no tangent plane."""

BLOCK = 60_000
"""Panels times points looked at together: they stay in a cache, and threads stay apart."""

LU_THREADS = 2
"""A fixed number, so that weights do not depend on how many processors there are."""


Singles = NDArray[np.float32]


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
    mesh : BoundaryMesh
    densities : (u, n) float64
        q_k as coefficients of the mesh's unknowns.
    """

    mesh: BoundaryMesh
    densities: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Potentials:
    """What panels emit, seen from q points.

    Attributes
    ----------
    linear : (3p, q)
        ∫ (1, x, y)/r of every panel; scratch.
    near : (c,) int64
        Places among `mesh.high` of the panels whose higher terms have not faded out.
    higher : (d − 3, c, q)
        ∫ ψ/r of their higher terms.
    double : (n, q)
        D_k of every cage vertex.
    """

    linear: Floats
    near: Integers
    higher: Floats
    double: Floats


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
        One of `ACCURACIES`.
    jobs : int, optional
        Threads; the number of processors by default. They do not change the result.
    progress : callable
        Told (points done, points) after every block.

    Returns
    -------
    Weights
        Whose rows sum to 1 and give the points to rounding, whatever the accuracy.

    Raises
    ------
    InputError
        When the cage has more faces than `PANEL_LIMIT`, or the accuracy is none we know.
    """
    if accuracy not in ACCURACIES:
        raise InputError(f"accuracy is {accuracy!r}, expected one of {', '.join(ACCURACIES)}")
    if len(cage.faces) > PANEL_LIMIT:
        raise InputError(
            f"the cage has {len(cage.faces)} faces, at most {PANEL_LIMIT} fit in memory; "
            "use a coarser cage"
        )
    nearest = nearest_on_surface(cage, points)
    touching = nearest.touching
    weights = np.empty((len(points), len(cage.vertices)))
    weights[touching] = nearest.weights(touching)
    within = np.flatnonzero(~touching)
    if len(within) == 0:
        return Weights(weights)
    origin, scale = cage.vertices.mean(axis=0), cage.diagonal
    unit = TriMesh((cage.vertices - origin) / scale, cage.faces)
    tree = cKDTree((points[within] - origin) / scale)
    with blas_threads(1), ThreadPoolExecutor(jobs or processors()) as pool:
        boundary, error = _resolved(unit, tree, ACCURACIES[accuracy], pool)

        def fill(block: slice) -> int:
            chosen = tree.indices[block]
            weights[within[chosen]] = weights_inside(boundary, tree.data[chosen])
            return int(block.stop)

        for done in pool.map(fill, _blocks(boundary.mesh, len(within))):
            progress(done, len(within))
    return Weights(weights, len(boundary.mesh.panels.corners), error)


def _resolved(
    cage: TriMesh, points: cKDTree, asked: Accuracy, pool: ThreadPoolExecutor
) -> tuple[BoundarySolution, float]:
    """Divide panels until the estimated error is what was asked, or they are too many."""
    sample = points.data[points.indices[:: -(-points.n // SAMPLE)]]
    mesh = BoundaryMesh.of(cage)
    while len(mesh.panels.corners) < FEWEST_PANELS:
        mesh = mesh.divided(np.ones(len(mesh.panels.corners), bool))
    mesh = _raised(mesh, points, asked)
    best = solve_boundary(mesh, pool)
    error, shares = estimated(best, sample)
    for _ in range(ROUNDS):
        if error <= asked.tolerance:
            break
        mesh = _raised(best.mesh.divided(_worst(shares)), points, asked)
        no_room = mesh.unknowns > asked.most or len(mesh.high) < len(best.mesh.high)
        if no_room or mesh.order < best.mesh.order:
            break
        finer = solve_boundary(mesh, pool)
        less, shares = estimated(finer, sample)
        if less >= error:
            break
        best, error = finer, less
    return best, error


def _worst(shares: Floats) -> NDArray[np.bool_]:
    """The fewest panels that have `SHARED` of the error."""
    order = np.argsort(-shares, kind="stable")
    count = np.searchsorted(np.cumsum(shares[order]), SHARED * shares.sum()) + 1
    chosen = np.zeros(len(shares), bool)
    chosen[order[:count]] = True
    return chosen


def _raised(mesh: BoundaryMesh, points: cKDTree, asked: Accuracy) -> BoundaryMesh:
    """Higher order where one of `points` is within reach, as high as there is room for.

    Needles stay linear: the recurrences of higher terms do not reach as far as their length.
    """
    panels = mesh.panels
    distance = np.asarray(points.query(panels.centroids)[0])
    room = max(0, asked.most - mesh.linear_unknowns)
    for order in range(asked.order, 1, -1):
        extra = len(exponents(order)) - LINEAR
        furthest = panels.altitudes.min(axis=0) * DIGITS ** (0.5 / order) / FADE
        reach = np.minimum(asked.reach * panels.radii, furthest)
        near = np.flatnonzero((distance < FADE * reach) & (reach > panels.radii))
        if extra * len(near) <= room or order == 2:
            nearest = np.argsort(distance[near] / reach[near], kind="stable")
            near = np.sort(near[nearest[: room // extra]])
            return mesh.raised(order, near, reach[near])
    return mesh


def solve_boundary(mesh: BoundaryMesh, pool: ThreadPoolExecutor) -> BoundarySolution:
    """Solve the boundary integral equation for all the cage's hats, assembled by `pool`.

    In single precision, which halves memory and time: weights of sound cages feel it in the sixth
    digit at most, and what affine functions need of the densities is known and set to rounding.
    """
    matrix = np.zeros((mesh.unknowns, mesh.unknowns), np.float32)
    right = np.empty((mesh.unknowns, mesh.hats.shape[1]), np.float32)

    def fill(chosen: Integers) -> None:
        _fill_rows(mesh, chosen, matrix, right)

    for _ in pool.map(fill, _test_blocks(mesh)):
        pass
    with blas_threads(LU_THREADS):
        # LAPACK wants columns: the transpose is factored where it stands, and solved transposed.
        factor = scipy.linalg.lu_factor(matrix.T, overwrite_a=True, check_finite=False)
        densities = scipy.linalg.lu_solve(
            factor, right, trans=1, overwrite_b=True, check_finite=False
        )
    del factor
    return BoundarySolution(mesh, _affine(mesh, densities.astype(np.float64)))


def _affine(mesh: BoundaryMesh, densities: Floats) -> Floats:
    """Take from the densities what rounding added to those of affine functions.

    Σ_k q_k = 0 and Σ_k q_k c_k = n, c_k the cage's vertices, as 1 and x have the normal derivatives
    0 and n.
    """
    count = densities.shape[1]
    affine = np.column_stack([np.ones(count), mesh.panels.vertices[:count]])
    excess = densities @ affine
    excess[: len(mesh.panels.corners), 1:] -= mesh.panels.normals
    densities -= excess @ np.linalg.pinv(affine)
    return densities


def weights_inside(boundary: BoundarySolution, points: Floats) -> Floats:
    """Weights of points strictly inside, (q, n)."""
    seen = _potentials(boundary.mesh, points, inside=True)
    weights = _emitted(boundary.mesh, boundary.densities, seen)
    weights += seen.double
    return weights.T / (4 * np.pi)


def estimated(boundary: BoundarySolution, sample: Floats) -> tuple[float, Floats]:
    """Estimate the mean row L1 error over `sample`, (s, 3), and each panel's share in it, (p,).

    Away from the cage, the terms of each panel's highest degree, against those one lower, tell how
    fast the degrees fall; those that would follow are taken to fall alike, as a geometric series.
    Near it, the error is what the equations leave at the nearest point. The larger of both counts.
    """
    mesh = boundary.mesh
    degree, highest, panel = mesh.degrees
    terms = {
        (order, of): np.flatnonzero((degree == of) & (highest == order))
        for order in np.unique(highest)
        for of in (order - 1, order)
    }
    sizes = dict.fromkeys(terms, 0.0)
    seen_of = np.zeros(mesh.unknowns)
    for block in _blocks(mesh, len(sample)):
        seen = _all_potentials(mesh, sample[block])
        seen_of += np.abs(seen).sum(axis=1)
        for of, rows in terms.items():
            emitted = boundary.densities[rows].T @ seen[rows]
            sizes[of] += np.abs(emitted).sum() / (4 * np.pi * len(sample))
    series = 0.0
    for order in np.unique(highest):
        last, before = sizes[order, order], sizes[order, order - 1]
        if before > 0:
            fall = np.clip(last / before, FASTEST_FALL, SLOWEST_FALL)
            series += last * (AFTER_LINEAR if order == 1 else fall / (1 - fall))
    error = max(series, float(_left_near_the_cage(boundary, sample).mean()))
    seen_of *= np.abs(boundary.densities).sum(axis=1)
    return error, np.bincount(panel, seen_of * (degree == highest)).astype(np.float64)


def _all_potentials(mesh: BoundaryMesh, points: Floats) -> Floats:
    """∫ of all terms over r, also of those that have faded out, (u, q)."""
    seen = _potentials(mesh, points, inside=True)
    everything = np.zeros((mesh.unknowns, len(points)))
    everything[: mesh.linear_unknowns] = seen.linear
    higher = everything[mesh.linear_unknowns :].reshape(mesh.extra, len(mesh.high), len(points))
    higher[:, seen.near] = seen.higher
    return everything


def _left_near_the_cage(boundary: BoundarySolution, sample: Floats) -> Floats:
    """Row L1 errors, (s,), that the equations leave on the cage, as felt at points in it.

    The computed weights are harmonic, and on the cage are off by (2π φ − D − ∫ q/r) / 4π. That
    changes its sign from node to node of a panel, and so dies away over the distance of nodes.
    """
    mesh = boundary.mesh
    panels = mesh.panels
    nearest = nearest_on_surface(TriMesh(panels.vertices, panels.corners), sample)
    on = nearest.position + OFF_EDGES * (panels.centroids[nearest.face] - nearest.position)
    hats = nearest_on_surface(nearest.mesh, on).weights(np.ones(len(on), bool)) @ mesh.hats
    left = np.concatenate(
        [
            np.abs(2 * np.pi * hats[block] - _on_surface(boundary, on[block]).T).sum(axis=1)
            for block in _blocks(mesh, len(on))
        ]
    )
    highest = np.ones(len(panels.corners))
    highest[mesh.high] = mesh.order
    waves = (highest[nearest.face] + 1) / panels.radii[nearest.face]
    return np.asarray(left / (4 * np.pi) * np.exp(-np.pi * waves * nearest.distance))


def _on_surface(boundary: BoundarySolution, points: Floats) -> Floats:
    """D + ∫ q/r of every weight at points in faces, (n, q): 2π φ but for the error."""
    seen = _potentials(boundary.mesh, points, inside=False)
    return _emitted(boundary.mesh, boundary.densities, seen) + seen.double


def _emitted(mesh: BoundaryMesh, densities: Floats, seen: Potentials) -> Floats:
    """Σ_panels ∫ q_k / r of densities (u, n), (n, q)."""
    split = mesh.linear_unknowns
    emitted = densities[:split].T @ seen.linear
    if len(seen.near):
        higher = densities[split:].reshape(mesh.extra, len(mesh.high), -1)[:, seen.near]
        emitted += higher.reshape(-1, len(emitted)).T @ seen.higher.reshape(-1, emitted.shape[1])
    return np.asarray(emitted)


def _fill_rows(mesh: BoundaryMesh, chosen: Integers, matrix: Singles, right: Singles) -> None:
    """The equations of the panels `chosen`, tested with the polynomials of their densities."""
    rows = mesh.rows(chosen)
    order = 1 if rows.shape[1] == LINEAR else mesh.order
    barycentric, shares = gauss_rule(order + 1)
    tests = (basis(order) @ monomials(order, barycentric) * shares).T
    corner = mesh.panels.vertices[mesh.panels.corners[chosen]]
    nodes = np.einsum("jk,ckx->cjx", barycentric, corner)
    seen = _potentials(mesh, nodes.reshape(-1, 3), inside=False)

    def tested(values: Floats) -> Floats:
        return (values.reshape(-1, len(shares)) @ tests).reshape(len(values), -1).T

    into = rows.ravel()
    matrix[into, : mesh.linear_unknowns] = tested(seen.linear)
    if len(seen.near):
        columns = np.arange(mesh.extra)[:, None] * len(mesh.high) + seen.near
        columns += mesh.linear_unknowns
        higher = seen.higher.reshape(-1, nodes.shape[0] * nodes.shape[1])
        matrix[into[:, None], columns.ravel()] = tested(higher)
    on_nodes = 2 * np.pi * mesh.values(chosen, barycentric).reshape(-1, right.shape[1])
    right[into] = tested(on_nodes.T - seen.double)


def _potentials(mesh: BoundaryMesh, points: Floats, *, inside: bool) -> Potentials:
    """What is seen from points strictly `inside`, or in the faces."""
    scratch = _SCRATCH.own
    panels = mesh.panels
    seen = view(panels, points, scratch)
    if inside:
        close_angles(seen)
    else:
        take_principal_values(seen)
    linear = linear_moments(panels, seen, scratch)
    near, faded = _near(mesh, points)
    higher = np.empty((mesh.extra, 0, len(points)))
    if len(near):
        higher = higher_moments(mesh.higher_terms, near, seen, linear, scratch)
        higher *= faded
    integrals = double_layer(panels, seen, scratch)
    double = mesh.double_hats @ integrals.reshape(-1, len(points))
    return Potentials(linear.reshape(-1, len(points)), near, higher, np.asarray(double))


def _near(mesh: BoundaryMesh, points: Floats) -> tuple[Integers, Floats]:
    """Places among `mesh.high` of panels within reach of any point, and what is left there, (c, q).

    That is 1 to a distance of reach/FADE, 0 from reach · FADE, with a continuous slope between.
    """
    centroids = mesh.panels.centroids[mesh.high]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    spread = np.linalg.norm(points - middle, axis=1).max()
    distance = np.linalg.norm(centroids - middle, axis=1)
    near = np.flatnonzero(distance < FADE * mesh.reach + spread)
    share = distances(centroids[near], points, _SCRATCH.own, "centroid")
    share /= mesh.reach[near, None]
    np.subtract(FADE, share, out=share)
    share /= FADE - 1 / FADE
    np.clip(share, 0, 1, out=share)
    return near, share * share * (3 - 2 * share)


def _test_blocks(mesh: BoundaryMesh) -> list[Integers]:
    """Panels of one kind, neighbours together, with a block of nodes."""
    panels = np.arange(len(mesh.panels.corners))
    is_high: NDArray[np.bool_] = np.isin(panels, mesh.high)
    blocks: list[Integers] = []
    for chosen, order in ((panels[is_high], mesh.order), (panels[~is_high], 1)):
        if len(chosen):
            size = max(1, _block_size(mesh) // (order + 1) ** 2)
            ordered = chosen[cKDTree(mesh.panels.centroids[chosen], leafsize=size).indices]
            blocks += np.split(ordered, range(size, len(ordered), size))
    return blocks


def _blocks(mesh: BoundaryMesh, count: int) -> list[slice]:
    size = _block_size(mesh)
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def _block_size(mesh: BoundaryMesh) -> int:
    """Points to a block; not so few that a call costs more than its work."""
    return int(np.clip(BLOCK // len(mesh.panels.corners), 16, 512))
