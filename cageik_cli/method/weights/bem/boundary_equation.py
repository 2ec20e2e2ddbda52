"""The boundary integral equation of a cage: assembly, solution for all basis functions, evaluation.

With q_k the outward normal derivative of the weight w_k on the cage, and φ_k its basis function
there,

    4π w_k(x) = Σ_panels ∫ q_k / r dA + D_k(x),     D_k = Σ_panels ∫ φ_k h/r³ dA,

(Green's representation). For x inside a face, 2π φ_k(x) replaces 4π w_k(x), which gives an equation
for q_k. It is tested with the polynomials of the densities (Galerkin's method), and solved by
elimination of blocks in single precision.

Threads of the linear algebra wait for each other at every step, which takes long where other
programs run. So it has one, and the blocks of a step are shared out over threads of our own. The
blocks are fixed: the number of threads does not change the result.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.points import order_by_place
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.bem.panels import (
    LINEAR_TERMS,
    gauss_rule,
    monomials,
    orthogonal_basis,
)
from cageik_cli.method.weights.bem.potentials import Potentials, compute_potentials
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import NumericalError
from cageik_cli.util.messages import say
from cageik_cli.util.progress import ignore_progress

MAX_EVALUATED_ENTRIES = 240_000
"""Panels times points evaluated together: products with fewer columns are slow for large cages."""

Float32s = NDArray[np.float32]

Densities = TypeVar("Densities", Floats, Float32s)

Part = TypeVar("Part")
"""What one thread works on."""

BLOCK_SIZE = 256
"""Unknowns that are eliminated together; the inverses of their blocks take little time."""

MIN_SHOWN_UNKNOWNS = 6000
"""More unknowns take seconds to eliminate, and the work grows with their cube."""

SUBSTITUTED_COLUMNS = 64
"""Right hand sides in which the unknowns are substituted together."""


@dataclass(frozen=True, eq=False)
class BoundarySolution:
    """The normal derivatives of all harmonic coordinates of one cage.

    Attributes
    ----------
    densities : (u, n) float64
        q_k, as coefficients of the mesh's unknowns.
    """

    mesh: BoundaryMesh
    densities: Floats

    @cached_property
    def rounded_densities(self) -> Float32s:
        """Return the densities in single precision, (u, n)."""
        return self.densities.astype(np.float32)

    @cached_property
    def affine_correction(self) -> Floats:
        """Return the least change of n weights per unit of their errors for 1 and x, (4, n)."""
        return np.asarray(np.linalg.pinv(affine_values(self.mesh)), np.float64)


def solve_boundary(
    mesh: BoundaryMesh,
    pool: ThreadPoolExecutor,
    progress: Callable[[int, int], None] = ignore_progress,
) -> BoundarySolution:
    """Solve the boundary integral equation for all basis functions of the cage; threads of `pool`
    do the work.

    `progress` is called as by `solve_in_place`, where that takes long.

    Single precision halves memory and time. It changes the weights of sound cages in the sixth
    digit at most; the densities of affine functions are known, and are corrected exactly.

    Raises
    ------
    NumericalError
        When the equations have no solution, as for faces without area.
    """
    count = len(mesh.solved_unknowns)
    matrix = np.zeros((count, count), np.float32)
    rhs = np.empty((count, mesh.basis_functions.count), np.float32)
    _run_all(pool, partial(_fill_rows, mesh, matrix=matrix, rhs=rhs), _split_test_panels(mesh))
    try:
        is_long = count > MIN_SHOWN_UNKNOWNS
        solve_in_place(matrix, rhs, pool, progress=progress if is_long else ignore_progress)
    except np.linalg.LinAlgError as error:
        raise NumericalError(
            say(
                "the equations of harmonic weights have no solution for this cage; check it "
                "with cageik check `cage=`"
            )
        ) from error
    del matrix
    densities = np.zeros((mesh.unknowns, rhs.shape[1]), order="F")
    densities[mesh.solved_unknowns] = rhs
    # The normal derivatives of 1 and x are 0 and n: Σ_k q_k = 0, and Σ_k q_k c_k = n with the cage
    # vertices c_k.
    affine = affine_values(mesh)
    excess = densities @ affine
    excess[: len(mesh.panels.corners), 1:] -= mesh.panels.normals
    densities -= excess @ np.linalg.pinv(affine)
    return BoundarySolution(mesh, densities)


def affine_values(mesh: BoundaryMesh) -> Floats:
    """Return 1 and x at the vertices of the cage, (n, 4)."""
    vertices = mesh.panels.vertices[: mesh.basis_functions.count]
    return np.column_stack([np.ones(len(vertices)), vertices])


def interior_weights(boundary: BoundarySolution, points: Floats) -> Floats:
    """Return the weights of points strictly inside, (q, 3), as (q, n)."""
    potentials = compute_potentials(boundary.mesh, points, is_inside=True)
    total = single_layer(boundary.mesh, boundary.densities, potentials)
    return (total + potentials.double).T / (4 * np.pi)


def rounded_interior_weights(boundary: BoundarySolution, points: Floats) -> Floats:
    """Return the weights of points strictly inside, (q, 3), as (q, n), in less time.

    The product with the densities, which takes most of the time of large cages, is in single
    precision. It changes the weights in the seventh digit. Sums and affine maps are then corrected,
    and exact to the rounding of double precision.
    """
    potentials = compute_potentials(boundary.mesh, points, is_inside=True)
    total = single_layer(boundary.mesh, boundary.rounded_densities, potentials)
    weights = (total + potentials.double).T / (4 * np.pi)
    excess = weights @ affine_values(boundary.mesh)
    excess[:, 0] -= 1
    excess[:, 1:] -= points
    weights -= excess @ boundary.affine_correction
    return weights


def single_layer(mesh: BoundaryMesh, densities: Densities, potentials: Potentials) -> Densities:
    """Return Σ_panels ∫ q_k / r, (n, q), of densities (u, n), in their precision."""
    split = mesh.linear_unknowns
    total = densities[:split].T @ potentials.linear.astype(densities.dtype, copy=False)
    if len(potentials.near_panels):
        higher = densities[split:].reshape(mesh.extra_terms, len(mesh.high_panels), -1)[
            :, potentials.near_panels
        ]
        terms = potentials.higher.reshape(-1, total.shape[1]).astype(densities.dtype, copy=False)
        total += higher.reshape(-1, len(total)).T @ terms
    return np.asarray(total)


def _fill_rows(mesh: BoundaryMesh, chosen: Integers, matrix: Float32s, rhs: Float32s) -> None:
    """Fill the rows of the panels `chosen`, tested with the polynomials of their densities."""
    rows = mesh.panel_unknowns(chosen)
    order = 1 if rows.shape[1] == LINEAR_TERMS else mesh.order
    barycentric, shares = gauss_rule(order + 1)
    tests = (orthogonal_basis(order) @ monomials(order, barycentric) * shares).T
    corner = mesh.panels.vertices[mesh.panels.corners[chosen]]
    nodes = np.einsum("jk,ckx->cjx", barycentric, corner)
    potentials = compute_potentials(mesh, nodes.reshape(-1, 3), is_inside=False)

    into = mesh.equation_places[rows.ravel()]
    is_solved = into >= 0
    into = into[is_solved]

    def integrate_against_tests(values: Floats) -> Floats:
        integrals = (values.reshape(-1, len(shares)) @ tests).reshape(len(values), -1).T
        return integrals if is_solved.all() else integrals[is_solved]

    matrix[into, : mesh.linear_unknowns] = integrate_against_tests(potentials.linear)
    if len(potentials.near_panels):
        columns = (
            np.arange(mesh.extra_terms)[:, None] * len(mesh.high_panels) + potentials.near_panels
        )
        columns = mesh.equation_places[columns.ravel() + mesh.linear_unknowns]
        higher = potentials.higher.reshape(-1, nodes.shape[0] * nodes.shape[1])[columns >= 0]
        columns = columns[columns >= 0]
        matrix[into[:, None], columns] = integrate_against_tests(higher)
    on_nodes = (
        2 * np.pi * mesh.evaluate_basis_functions(chosen, barycentric).reshape(-1, rhs.shape[1])
    )
    rhs[into] = integrate_against_tests(on_nodes.T - potentials.double)


def _split_test_panels(mesh: BoundaryMesh) -> list[Integers]:
    """Split the panels into blocks of neighbours of the same order."""
    panels = np.arange(len(mesh.panels.corners))
    is_high = mesh.panel_degrees > 1
    blocks: list[Integers] = []
    for chosen, order in ((panels[is_high], mesh.order), (panels[~is_high], 1)):
        if len(chosen):
            size = max(1, count_points_per_block(mesh) // (order + 1) ** 2)
            ordered = chosen[order_by_place(mesh.panels.centroids[chosen])]
            blocks += np.split(ordered, range(size, len(ordered), size))
    return blocks


def split_points(mesh: BoundaryMesh, count: int) -> list[slice]:
    """Split `count` points into blocks that are evaluated together."""
    size = count_points_per_block(mesh)
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def count_points_per_block(mesh: BoundaryMesh) -> int:
    """Return the number of points per block; with too few, the overhead of calls dominates."""
    return int(np.clip(MAX_EVALUATED_ENTRIES // len(mesh.panels.corners), 16, 512))


def solve_in_place(
    matrix: Float32s,
    rhs: Float32s,
    pool: ThreadPoolExecutor,
    block_size: int = BLOCK_SIZE,
    progress: Callable[[int, int], None] = ignore_progress,
) -> None:
    """Replace `rhs`, (u, n), by the solution of matrix (u, u) · x = rhs; the matrix is lost.

    Rows are not exchanged. This needs leading blocks that are well conditioned. Those of Galerkin's
    method are: they are the equations of fewer polynomials, and the single layer is positive
    definite. Rows are divided by their blocks in double precision: in cages whose sides nearly
    touch, blocks have condition numbers of 1e6 and more. So the error is about that of LAPACK's
    routine, which exchanges rows: not twice as large in a wedge of a tenth of a degree.

    `progress` is called after every block with the share of the work that is done, of u.

    Raises
    ------
    numpy.linalg.LinAlgError
        When a block is singular.
    """
    elimination = _Elimination(matrix, rhs)
    blocks = _split(len(matrix), block_size)
    elimination.invert(blocks[0])
    for place, block in enumerate(blocks, 1):
        rhs[block] = elimination.inverses[block.start] @ rhs[block]
        for work in (elimination.divide, elimination.eliminate):
            _run_all(pool, partial(work, block), blocks[place:])
        left = 1 - block.stop / len(matrix)
        progress(round(len(matrix) * (1 - left**3)), len(matrix))
    columns = _split(rhs.shape[1], SUBSTITUTED_COLUMNS)
    _run_all(pool, partial(elimination.substitute, blocks), columns)


def _split(count: int, size: int) -> list[slice]:
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def _run_all(pool: ThreadPoolExecutor, work: Callable[[Part], None], parts: Iterable[Part]) -> None:
    for _ in pool.map(work, parts):
        pass


class _Elimination:
    """Equations matrix (u, u) · x = rhs (u, n), changed in place.

    Attributes
    ----------
    inverses : dict
        The inverses of blocks on the diagonal, by their first unknown.
    """

    def __init__(self, matrix: Float32s, rhs: Float32s) -> None:
        self.matrix, self.rhs = matrix, rhs
        self.inverses: dict[int, Floats] = {}

    def invert(self, block: slice) -> None:
        """Invert a block of the diagonal."""
        self.inverses[block.start] = np.linalg.inv(self.matrix[block, block].astype(np.float64))

    def divide(self, block: slice, columns: slice) -> None:
        """Divide some columns of the rows of a block by the block."""
        self.matrix[block, columns] = self.inverses[block.start] @ self.matrix[block, columns]

    def eliminate(self, block: slice, rows: slice) -> None:
        """Eliminate the unknowns of a block from some rows; invert the block that is next."""
        after = slice(block.stop, len(self.matrix))
        self.matrix[rows, after] -= self.matrix[rows, block] @ self.matrix[block, after]
        self.rhs[rows] -= self.matrix[rows, block] @ self.rhs[block]
        if rows.start == block.stop:
            self.invert(rows)  # beside the other rows

    def substitute(self, blocks: list[slice], columns: slice) -> None:
        """Substitute the unknowns in some columns of `rhs`, the last first."""
        for block in reversed(blocks):
            later = slice(block.stop, len(self.matrix))
            self.rhs[block, columns] -= self.matrix[block, later] @ self.rhs[later, columns]
