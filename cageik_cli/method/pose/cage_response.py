"""The response of one coordinate of a cage to its anchors.

With the forces λ by which anchors cause displacements t, the minimum in `poser.py` is where

    LᵀL d = Aᵀ λ,        A d + E λ = t.

LᵀL does not depend on the anchors: it is factored once per cage. G is its inverse outside the free
modes P (components of the cage that move as one). Then d = G Aᵀ λ + P u, and

    (A G Aᵀ + E) λ + A P u = t,        (A P)ᵀ λ = 0

is a system of the size of the anchors. It gives the same minimum as the normal matrix of both
terms, and stays well conditioned however small E is: hard anchors are the limit E = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dgemv

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.method.solve.dual_laplacian import MAX_CONDITION, MIN_REFINED_CONDITION
from cageik_cli.util.arrays import Floats

FREE_MODE_TOL = 1e-9
"""Free modes that couple to all anchors more weakly than this are not decided by them."""

BASIS_TOL = 1e-9
"""A motion of length one may lose this much when it is projected on the free coordinates."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """The linear response of one coordinate of a cage to its anchors.

    Attributes
    ----------
    anchor_response : (n, l) float64
        Displacements of the cage per displacement of an anchor.
    differential_response : (n, n) float64
        Displacements of the cage per change of δ, with the anchors' targets fixed.
    condition_number : float
        Condition number of the anchors' system, in the 2-norm.
    weakest_mode : (l,) float64
        Eigenvector of the smallest eigenvalue, in anchors; of length one.
    free_modes : int
        Number of free modes that the anchors do not decide; those motions are minimal.
    """

    anchor_response: Floats
    differential_response: Floats
    condition_number: float
    weakest_mode: Floats
    free_modes: int


class CageResponseSolver:
    """Solver for one coordinate of all cage vertices, factored once per cage.

    Parameters
    ----------
    laplacian : (n, n) float64
    basis : (n, r) float64
        Orthonormal columns: what may move, from `constraints.free_basis`.
    """

    def __init__(self, cage: TriMesh, laplacian: Floats, basis: Floats) -> None:
        self._basis, self._laplacian = basis, laplacian
        self._free_modes = _find_free_modes(cage, basis)
        self._can_move_as_one = bool(self._free_modes.size) and bool(
            np.ptp(self._free_modes[:, 0]) < BASIS_TOL
        )
        differences, free = laplacian @ basis, basis.T @ self._free_modes
        self._factor = scipy.linalg.cho_factor(
            differences.T @ differences + free @ free.T, check_finite=False
        )
        self._laplacian_response = self._solve_forces(laplacian.T)

    def solve_response(self, rows: Floats, compliance: Floats) -> Response:
        """Return the response to anchors with rows A, (l, n), and compliance E, a diagonal (l,)."""
        influence, rigid_coupling = self._solve_forces(rows.T), rows @ self._free_modes
        system = rows @ influence + np.diag(compliance)
        balanced = _left_null_space(rigid_coupling)
        inner = balanced.T @ system @ balanced
        values, vectors = np.linalg.eigh(inner)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = balanced @ (vectors / values) @ vectors.T @ balanced.T
        free_motions = self._resolve_free_modes(rigid_coupling)

        def respond(displacements: Floats) -> tuple[Floats, Floats]:
            forces = inverse @ displacements
            motions = free_motions @ (displacements - system @ forces)
            return influence @ forces + self._free_modes @ motions, forces

        anchor_response, forces = respond(np.eye(len(rows)))
        condition = _condition_number(values.tolist())
        if MIN_REFINED_CONDITION < condition <= MAX_CONDITION:
            # What the anchors miss, from the motion itself: the system has lost these digits.
            missed = np.eye(len(rows)) - rows @ anchor_response - compliance[:, None] * forces
            anchor_response += respond(missed)[0]
        return Response(
            anchor_response=anchor_response,
            differential_response=self._laplacian_response
            - anchor_response @ (rows @ self._laplacian_response),
            condition_number=condition,
            weakest_mode=balanced @ vectors[:, 0] if len(values) else np.zeros(len(rows)),
            free_modes=len(self._free_modes.T) - (len(rows) - len(inner)),
        )

    def _solve_forces(self, forces: Floats) -> Floats:
        """Return G f, (n, k), for forces f on cage vertices: displacements without free modes."""
        inside = self._basis.T @ forces
        moved = scipy.linalg.cho_solve(self._factor, inside, check_finite=False)
        return np.asarray(self._basis @ moved - self._free_modes @ (self._free_modes.T @ forces))

    def _resolve_free_modes(self, rigid_coupling: Floats) -> Floats:
        """Return the free modes u, (p, l), per displacement of an anchor that forces do not cause.

        Where the anchors leave a choice, components of the cage move relative to each other as
        little as possible.
        """
        if not (self._can_move_as_one and len(rigid_coupling)):
            return _invert_rigid_coupling(rigid_coupling)
        centring = np.eye(len(rigid_coupling)) - 1 / len(rigid_coupling)
        apart = _invert_rigid_coupling(centring @ rigid_coupling[:, 1:]) @ centring
        together = (np.eye(len(rigid_coupling)) - rigid_coupling[:, 1:] @ apart).mean(
            axis=0
        ) / self._free_modes[0, 0]
        return np.concatenate([together[None], apart])


class MirroredMap:
    """A linear map of points, which may differ for the coordinate across a mirror.

    Parameters
    ----------
    maps : one or two (p, q) float64
        For all coordinates; or for those along the mirror, and for the one across it.
    """

    def __init__(self, maps: Sequence[Floats], mirror: Mirror | None) -> None:
        self._mirror, self._along = mirror, maps[0]
        self._across_difference = maps[0] if mirror is None else maps[1] - maps[0]

    def __call__(self, points: Floats) -> Floats:
        """Map points (…, q, 3) to (…, p, 3)."""
        if self._mirror is None:
            return np.asarray(self._along @ points)
        normal = self._mirror.normal
        heights = (self._across_difference @ (points @ normal)[..., None])[..., 0]
        return np.asarray(self._along @ points + heights[..., None] * normal)

    def add_to(self, columns: Floats, points: Floats) -> None:
        """Add the mapped points (q, 3) to `columns`, (3, p) float64, in place.

        Each row of `columns` must be contiguous in memory.
        """
        if not len(points):
            return
        for column, coordinate in zip(columns, points.T, strict=True):
            # y + A x in one pass is faster than a product of so few columns.
            dgemv(1.0, self._along, coordinate, beta=1.0, y=column, overwrite_y=True)
        if self._mirror is not None:
            normal = self._mirror.normal
            columns += normal[:, None] * (self._across_difference @ (points @ normal))

    def compose(self, matrix: Floats) -> "MirroredMap":
        """Return the map followed by a matrix that is the same for all coordinates."""
        across = [] if self._mirror is None else [self._along + self._across_difference]
        maps = [np.asfortranarray(matrix @ values) for values in (self._along, *across)]
        return MirroredMap(maps, self._mirror)


def _condition_number(eigenvalues: list[float]) -> float:
    """Return the condition number for ascending eigenvalues; infinite unless all are above 0."""
    if not eigenvalues:
        return 1.0
    return eigenvalues[-1] / eigenvalues[0] if eigenvalues[0] > 0 else float("inf")


def _find_free_modes(cage: TriMesh, basis: Floats) -> Floats:
    """Return P, (n, p), orthonormal: components of the cage moving as one within the basis.

    If the whole cage can move as one, that is the first column.
    """
    components = np.eye(cage.components.max() + 1)[cage.components]
    components /= np.linalg.norm(components, axis=0)
    lost = components - basis @ (basis.T @ components)
    _, sizes, motions = np.linalg.svd(lost, full_matrices=False)
    free = components @ motions[sizes < BASIS_TOL].T
    whole = np.full(len(components), len(components) ** -0.5)
    shares = free.T @ whole
    if np.linalg.norm(free @ shares - whole) > BASIS_TOL:
        return np.asarray(free)
    others = np.linalg.svd(shares[None])[2][1:]
    return np.column_stack([whole, free @ others.T])


def _left_null_space(rigid_coupling: Floats) -> Floats:
    """Return orthonormal columns, (l, l − rank): anchor forces that move no component as one."""
    left, sizes, _ = np.linalg.svd(rigid_coupling)
    return np.asarray(left[:, np.count_nonzero(sizes > FREE_MODE_TOL) :])


def _invert_rigid_coupling(rigid_coupling: Floats) -> Floats:
    """Return the pseudoinverse, (p, l), with singular values below `FREE_MODE_TOL` taken as 0."""
    left, sizes, right = np.linalg.svd(rigid_coupling, full_matrices=False)
    is_coupled = sizes > FREE_MODE_TOL
    return np.asarray((right[is_coupled].T / sizes[is_coupled]) @ left[:, is_coupled].T)
