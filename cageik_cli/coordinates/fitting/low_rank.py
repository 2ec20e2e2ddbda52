"""Changes of weights of low rank, E = U Vᵀ, fitted and not only truncated.

U and V are fitted by turns. For given V, U is the fit of a few columns. For given U, the rows of Vᵀ
separate in the eigenbasis q_i of the cage's motion, as in `problem`:

    (g_i UᵀΩU + λ UᵀU + μ UᵀΛᵀΛU) Vᵀq_i = UᵀΩ (D − H B) Bᵀ q_i / s.
"""

import numpy as np

from cageik_cli.coordinates.fitting.problem import (
    Correction,
    Motion,
    Solving,
    WeightProblem,
    diagonalize,
)
from cageik_cli.util.arrays import Floats

SINGULAR_TOL = 1e-14
"""Relative ridge that keeps systems solvable when columns of U vanish."""


def truncate(
    problem: WeightProblem, motion: Motion, correction: Correction, rank: int
) -> Correction:
    """Return the change of at most `rank` that is nearest in the motion of the vertices."""
    basis, gains = diagonalize(motion.cages, correction.basis)
    scales = np.sqrt(gains / (motion.scale or 1) + problem.regularization)
    scaled = correction.express(basis) * scales
    vectors = np.linalg.eigh(scaled.T @ scaled)[1][:, ::-1][:, :rank]
    subspace = np.linalg.qr((basis / scales) @ vectors)[0]
    back = (vectors.T / scales) @ (basis.T @ subspace)
    return Correction((scaled @ vectors) @ back, subspace)


def refit(
    problem: WeightProblem, motion: Motion, start: Correction, complement: Floats, solving: Solving
) -> Correction:
    """Fit U to the V of `start`, and V to this U.

    Parameters
    ----------
    start : Correction
        The rank of the result is at most its rank.
    complement : (n, n - 4)
        From `complement_basis`.
    """
    found = problem.fit(motion, start.basis, start, solving)
    left = found.columns
    basis, gains = diagonalize(motion.cages, complement)
    scale = motion.scale
    if not scale or not left.any():
        return found
    weighted = left if problem.vertex_weights is None else problem.vertex_weights[:, None] * left
    smooth = problem.regularization * left + problem.smoothness * problem.surface.apply(left)
    matrices = (gains / scale)[:, None, None] * (left.T @ weighted) + left.T @ smooth
    ridge = SINGULAR_TOL * np.trace(matrices, axis1=1, axis2=2)
    matrices += ridge[:, None, None] * np.eye(left.shape[1])
    residual = motion.target.multiply_left(weighted.T)
    residual -= (weighted.T @ problem.rest_weights) @ motion.cages
    right = (residual @ (motion.cages.T @ basis) / scale).T
    rows = np.linalg.solve(matrices, right[:, :, None])[:, :, 0]
    subspace, factor = np.linalg.qr(basis @ rows)
    return Correction(left @ factor.T, subspace)
