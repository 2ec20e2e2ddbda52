"""One coordinate of a cage's displacement, and how it answers to forces and to anchors.

With the forces λ that anchors exert to bring about displacements t, the minimum in `posing.py` is
where

    LᵀL d = Aᵀ λ,        A d + E λ = t.

LᵀL does not know the anchors: it is factored once a cage. With G its inverse but for what it leaves
free, P (parts of the cage moving as one), d = G Aᵀ λ + P u, and

    (A G Aᵀ + E) λ + A P u = t,        (A P)ᵀ λ = 0

is a system of as many unknowns as there are anchors. It gives the minimum that the normal matrix of
both terms gives, and stays well conditioned however small E is: hard anchors are its limit.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

FREE_MODE_TOL = 1e-9
"""Free motions that all anchors feel less than this are not decided by them."""

BASIS_TOL = 1e-9
"""Of a motion of length one: the share that may be lost when it is written in what is free."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """How one coordinate of a cage answers to its anchors.

    Attributes
    ----------
    anchor_response : (n, l) float64
        To displacements of the anchors.
    differential_response : (n, n) float64
        To changes of δ, the anchors' targets staying where they are.
    condition_number : float
        Of the anchors' system, in the 2-norm.
    weakest_mode : (l,) float64
        The anchors' part in what that system decides least; of length one.
    free_modes : int
        Free motions that the anchors do not decide: they are the least possible.
    """

    anchor_response: Floats
    differential_response: Floats
    condition_number: float
    weakest_mode: Floats
    free_modes: int


class CageResponseSolver:
    """One coordinate of all cage vertices.

    Parameters
    ----------
    cage : TriMesh
    laplacian : (n, n) float64
    basis : (n, r) float64
        Orthonormal columns: what may move, as `ties.free_basis` gives it.
    """

    def __init__(self, cage: TriMesh, laplacian: Floats, basis: Floats) -> None:
        self._basis, self._laplacian = basis, laplacian
        self._free_modes = _find_free_modes(cage, basis)
        self._can_move_as_one = bool(self._free_modes.size) and bool(
            np.ptp(self._free_modes[:, 0]) < BASIS_TOL
        )
        held, free = laplacian @ basis, basis.T @ self._free_modes
        self._factor = scipy.linalg.cho_factor(held.T @ held + free @ free.T, check_finite=False)
        self._laplacian_response = self._solve_forces(laplacian.T)

    def solve_response(self, rows: Floats, compliance: Floats) -> Response:
        """How it answers to anchors with rows A (l, n) and slacks, the diagonal of E, (l,)."""
        influence, rigid_coupling = self._solve_forces(rows.T), rows @ self._free_modes
        system = rows @ influence + np.diag(compliance)
        balanced = _left_null_space(rigid_coupling)
        inner = balanced.T @ system @ balanced
        values, vectors = np.linalg.eigh(inner)
        with np.errstate(divide="ignore", invalid="ignore"):
            forces = balanced @ (vectors / values) @ vectors.T @ balanced.T
        motions = self._resolve_free_modes(rigid_coupling) @ (np.eye(len(rows)) - system @ forces)
        of_anchors = influence @ forces + self._free_modes @ motions
        return Response(
            anchor_response=of_anchors,
            differential_response=self._laplacian_response
            - of_anchors @ (rows @ self._laplacian_response),
            condition_number=_condition_number(values.tolist()),
            weakest_mode=balanced @ vectors[:, 0] if len(values) else np.zeros(len(rows)),
            free_modes=len(self._free_modes.T) - (len(rows) - len(inner)),
        )

    def _solve_forces(self, forces: Floats) -> Floats:
        """G of forces on the cage's vertices, (n, k): displacements without a free motion."""
        inside = self._basis.T @ forces
        moved = scipy.linalg.cho_solve(self._factor, inside, check_finite=False)
        return np.asarray(self._basis @ moved - self._free_modes @ (self._free_modes.T @ forces))

    def _resolve_free_modes(self, rigid_coupling: Floats) -> Floats:
        """The free motions, (p, l), that what the anchors ask for beside forces means.

        Where anchors leave a choice, parts of the cage move against each other as little as
        possible.
        """
        if not (self._can_move_as_one and len(rigid_coupling)):
            return _invert_rigid_coupling(rigid_coupling)
        centring = np.eye(len(rigid_coupling)) - 1 / len(rigid_coupling)
        apart = _invert_rigid_coupling(centring @ rigid_coupling[:, 1:]) @ centring
        together = (np.eye(len(rigid_coupling)) - rigid_coupling[:, 1:] @ apart).mean(
            axis=0
        ) / self._free_modes[0, 0]
        return np.concatenate([together[None], apart])


def _condition_number(eigenvalues: list[float]) -> float:
    """Of a symmetric matrix by its eigenvalues, ascending; infinite unless all are above 0."""
    if not eigenvalues:
        return 1.0
    return eigenvalues[-1] / eigenvalues[0] if eigenvalues[0] > 0 else float("inf")


def _find_free_modes(cage: TriMesh, basis: Floats) -> Floats:
    """P, (n, p), orthonormal: parts of the cage moving as one, as far as the basis lets them.

    If the whole cage can, that is the first.
    """
    parts = np.eye(cage.components.max() + 1)[cage.components]
    parts /= np.linalg.norm(parts, axis=0)
    lost = parts - basis @ (basis.T @ parts)
    _, sizes, motions = np.linalg.svd(lost, full_matrices=False)
    free = parts @ motions[sizes < BASIS_TOL].T
    whole = np.full(len(parts), len(parts) ** -0.5)
    shares = free.T @ whole
    if np.linalg.norm(free @ shares - whole) > BASIS_TOL:
        return np.asarray(free)
    others = np.linalg.svd(shares[None])[2][1:]
    return np.column_stack([whole, free @ others.T])


def _left_null_space(rigid_coupling: Floats) -> Floats:
    """Orthonormal columns, (l, l − rank): forces of the anchors that move no part as one."""
    left, sizes, _ = np.linalg.svd(rigid_coupling)
    return np.asarray(left[:, np.count_nonzero(sizes > FREE_MODE_TOL) :])


def _invert_rigid_coupling(rigid_coupling: Floats) -> Floats:
    """Pseudoinverse, (p, l), in which what is felt less than `FREE_MODE_TOL` is not felt at all."""
    left, sizes, right = np.linalg.svd(rigid_coupling, full_matrices=False)
    is_felt = sizes > FREE_MODE_TOL
    return np.asarray((right[is_felt].T / sizes[is_felt]) @ left[:, is_felt].T)
