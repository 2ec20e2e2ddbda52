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

UNFELT = 1e-9
"""Free motions that all anchors feel less than this are not decided by them."""

LEAK = 1e-9
"""Of a motion of length one: the share that may be lost when it is written in what is free."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """How one coordinate of a cage answers to its anchors.

    Attributes
    ----------
    of_anchors : (n, l) float64
        To displacements of the anchors.
    of_differences : (n, n) float64
        To changes of δ, the anchors' targets staying where they are.
    condition_number : float
        Of the anchors' system, in the 2-norm.
    weakest : (l,) float64
        The anchors' part in what that system decides least; of length one.
    loose : int
        Free motions that the anchors do not decide: they are the least possible.
    """

    of_anchors: Floats
    of_differences: Floats
    condition_number: float
    weakest: Floats
    loose: int


class CageField:
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
        self._free = _free_motions(cage, basis)
        self._moves_as_one = bool(self._free.size) and bool(np.ptp(self._free[:, 0]) < LEAK)
        held, free = laplacian @ basis, basis.T @ self._free
        self._factor = scipy.linalg.cho_factor(held.T @ held + free @ free.T, check_finite=False)
        self._of_laplacian = self._moved(laplacian.T)

    def response(self, rows: Floats, slacks: Floats) -> Response:
        """How it answers to anchors with rows A (l, n) and slacks, the diagonal of E, (l,)."""
        influence, felt = self._moved(rows.T), rows @ self._free
        system = rows @ influence + np.diag(slacks)
        balanced = _left_null_space(felt)
        inner = balanced.T @ system @ balanced
        values, vectors = np.linalg.eigh(inner)
        with np.errstate(divide="ignore", invalid="ignore"):
            forces = balanced @ (vectors / values) @ vectors.T @ balanced.T
        motions = self._decided(felt) @ (np.eye(len(rows)) - system @ forces)
        of_anchors = influence @ forces + self._free @ motions
        return Response(
            of_anchors=of_anchors,
            of_differences=self._of_laplacian - of_anchors @ (rows @ self._of_laplacian),
            condition_number=_condition_number(values.tolist()),
            weakest=balanced @ vectors[:, 0] if len(values) else np.zeros(len(rows)),
            loose=len(self._free.T) - (len(rows) - len(inner)),
        )

    def _moved(self, forces: Floats) -> Floats:
        """G of forces on the cage's vertices, (n, k): displacements without a free motion."""
        inside = self._basis.T @ forces
        moved = scipy.linalg.cho_solve(self._factor, inside, check_finite=False)
        return np.asarray(self._basis @ moved - self._free @ (self._free.T @ forces))

    def _decided(self, felt: Floats) -> Floats:
        """The free motions, (p, l), that what the anchors ask for beside forces means.

        Where anchors leave a choice, parts of the cage move against each other as little as
        possible.
        """
        if not (self._moves_as_one and len(felt)):
            return _inverse_of_felt(felt)
        centring = np.eye(len(felt)) - 1 / len(felt)
        apart = _inverse_of_felt(centring @ felt[:, 1:]) @ centring
        together = (np.eye(len(felt)) - felt[:, 1:] @ apart).mean(axis=0) / self._free[0, 0]
        return np.concatenate([together[None], apart])


def _condition_number(values: list[float]) -> float:
    """Of a symmetric matrix by its eigenvalues, ascending; infinite unless all are above 0."""
    if not values:
        return 1.0
    return values[-1] / values[0] if values[0] > 0 else float("inf")


def _free_motions(cage: TriMesh, basis: Floats) -> Floats:
    """P, (n, p), orthonormal: parts of the cage moving as one, as far as the basis lets them.

    If the whole cage can, that is the first.
    """
    parts = np.eye(cage.components.max() + 1)[cage.components]
    parts /= np.linalg.norm(parts, axis=0)
    lost = parts - basis @ (basis.T @ parts)
    _, sizes, motions = np.linalg.svd(lost, full_matrices=False)
    free = parts @ motions[sizes < LEAK].T
    whole = np.full(len(parts), len(parts) ** -0.5)
    shares = free.T @ whole
    if np.linalg.norm(free @ shares - whole) > LEAK:
        return np.asarray(free)
    others = np.linalg.svd(shares[None])[2][1:]
    return np.column_stack([whole, free @ others.T])


def _left_null_space(felt: Floats) -> Floats:
    """Orthonormal columns, (l, l − rank): forces of the anchors that move no part as one."""
    left, sizes, _ = np.linalg.svd(felt)
    return np.asarray(left[:, np.count_nonzero(sizes > UNFELT) :])


def _inverse_of_felt(felt: Floats) -> Floats:
    """Pseudoinverse, (p, l), in which what is felt less than `UNFELT` is not felt at all."""
    left, sizes, right = np.linalg.svd(felt, full_matrices=False)
    is_felt = sizes > UNFELT
    return np.asarray((right[is_felt].T / sizes[is_felt]) @ left[:, is_felt].T)
