"""The boundary integral equation of a cage: assembled, solved for all its hats, and evaluated.

With q_k the outward normal derivative of the weight w_k on the cage, and φ_k its hat there,

    4π w_k(x) = Σ_panels ∫ q_k / r dA + D_k(x),     D_k = Σ_panels ∫ φ_k h/r³ dA,

and, for x inside a face, 2π φ_k(x) in place of 4π w_k(x) makes an equation for q_k (Green's
representation). It is tested with the polynomials of the densities themselves (Galerkin's method).
What those beyond the linear ones emit falls off as the cube of the distance, and is faded out.
"""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cageik_cli.coordinates.bem.boundary_mesh import BoundaryMesh
from cageik_cli.coordinates.bem.higher_terms import higher_moments
from cageik_cli.coordinates.bem.panels import (
    close_angles,
    distances,
    double_layer,
    linear_moments,
    take_principal_values,
    view,
)
from cageik_cli.coordinates.bem.polynomials import LINEAR, basis, gauss_rule, monomials
from cageik_cli.util.arrays import Floats, Integers, Scratch
from cageik_cli.util.threads import blas_threads

FADE = 1.25
"""What is beyond linear is whole to `reach` over this, and nothing from `reach` times this."""

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
    seen = potentials(boundary.mesh, points, inside=True)
    weights = emitted(boundary.mesh, boundary.densities, seen)
    weights += seen.double
    return weights.T / (4 * np.pi)


def emitted(mesh: BoundaryMesh, densities: Floats, seen: Potentials) -> Floats:
    """Σ_panels ∫ q_k / r of densities (u, n), (n, q)."""
    split = mesh.linear_unknowns
    total = densities[:split].T @ seen.linear
    if len(seen.near):
        higher = densities[split:].reshape(mesh.extra, len(mesh.high), -1)[:, seen.near]
        total += higher.reshape(-1, len(total)).T @ seen.higher.reshape(-1, total.shape[1])
    return np.asarray(total)


def _fill_rows(mesh: BoundaryMesh, chosen: Integers, matrix: Singles, right: Singles) -> None:
    """The equations of the panels `chosen`, tested with the polynomials of their densities."""
    rows = mesh.rows(chosen)
    order = 1 if rows.shape[1] == LINEAR else mesh.order
    barycentric, shares = gauss_rule(order + 1)
    tests = (basis(order) @ monomials(order, barycentric) * shares).T
    corner = mesh.panels.vertices[mesh.panels.corners[chosen]]
    nodes = np.einsum("jk,ckx->cjx", barycentric, corner)
    seen = potentials(mesh, nodes.reshape(-1, 3), inside=False)

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


def potentials(mesh: BoundaryMesh, points: Floats, *, inside: bool) -> Potentials:
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
    is_high = mesh.highest > 1
    blocks: list[Integers] = []
    for chosen, order in ((panels[is_high], mesh.order), (panels[~is_high], 1)):
        if len(chosen):
            size = max(1, _block_size(mesh) // (order + 1) ** 2)
            ordered = chosen[cKDTree(mesh.panels.centroids[chosen], leafsize=size).indices]
            blocks += np.split(ordered, range(size, len(ordered), size))
    return blocks


def blocks(mesh: BoundaryMesh, count: int) -> list[slice]:
    """Runs of `count` points that are looked at together."""
    size = _block_size(mesh)
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def _block_size(mesh: BoundaryMesh) -> int:
    """Points to a block; not so few that a call costs more than its work."""
    return int(np.clip(BLOCK // len(mesh.panels.corners), 16, 512))
