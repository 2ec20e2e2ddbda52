"""The forms of fitted weights: dense, of low rank, and with few influences."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cageik_cli.coordinates.fitting.displacements import Displacements
from cageik_cli.coordinates.fitting.low_rank import refit, truncate
from cageik_cli.coordinates.fitting.problem import Correction, Motion
from cageik_cli.solver.fitting.alternate import Alternation, Alternator
from cageik_cli.solver.fitting.influences import fit_influences, loosen, to_sparse
from cageik_cli.solver.settings import FitSettings
from cageik_cli.util.arrays import Floats

if TYPE_CHECKING:
    from scipy import sparse


@dataclass(frozen=True, slots=True, eq=False)
class FittedModel:
    """Fitted weights, and the form in which they are stored.

    Attributes
    ----------
    weights : (m, n) float64
    fixed_floats : int
        Numbers that must be stored; of sparse weights, the numbers without their places.
    low_rank : Correction or None
        U, (m, R), as `columns` and V, (n, R), as `basis`, for weights H + U Vᵀ.
    sparse_weights : (m, n) csr_array or None
        Weights with few influences. They are not affine-exact: vertices are X + W (c - C), in the
        alignment of the frame.
    """

    weights: Floats
    fixed_floats: int
    low_rank: Correction | None = None
    sparse_weights: "sparse.csr_array | None" = None


ModelFit = Callable[[Displacements], FittedModel]
"""A fit of a model to frames."""


def choose_model(alternator: Alternator, complement: Floats, settings: FitSettings) -> ModelFit:
    """Return the fit of the model that `settings` ask for; `complement` is the affine one."""

    def fit(target: Displacements) -> FittedModel:
        compressed = target.compress(alternator.problem.vertex_weights)
        if settings.rank is not None:
            return fit_low_rank(alternator, complement, compressed, settings.rank)
        if settings.influences is not None:
            return fit_few(alternator, complement, compressed, settings.influences)
        return fit_dense(alternator, complement, compressed)

    return fit


def fit_dense(alternator: Alternator, complement: Floats, target: Displacements) -> FittedModel:
    """Fit all weights to `target`."""
    change = _alternate_dense(alternator, complement, target).form
    weights = alternator.problem.add_change(change)
    return FittedModel(weights, weights.size)


def _alternate_dense(
    alternator: Alternator, complement: Floats, target: Displacements
) -> Alternation[Correction]:
    problem, solving = alternator.problem, alternator.effort.solving

    def step(motion: Motion, last: Correction) -> Correction:
        return problem.fit(motion, complement, last, solving)

    start = Correction.none(*problem.rest_weights.shape)
    return alternator.run(target, start, step, problem.add_change)


def fit_low_rank(
    alternator: Alternator, complement: Floats, target: Displacements, rank: int
) -> FittedModel:
    """Fit weights whose change has at most `rank`, from the change that has any rank."""
    problem, solving = alternator.problem, alternator.effort.solving
    whole = _alternate_dense(alternator, complement, target)
    start = truncate(problem, whole.motion, whole.form, rank)

    def step(motion: Motion, last: Correction) -> Correction:
        return refit(problem, motion, last, complement, solving)

    change = alternator.run(target, start, step, problem.add_change).form
    return FittedModel(problem.add_change(change), change.columns.size + change.basis.size, change)


def fit_few(
    alternator: Alternator, complement: Floats, target: Displacements, count: int
) -> FittedModel:
    """Fit weights with at most `count` influences, not negative, from weights that have all."""
    whole = fit_dense(loosen(alternator), complement, target).weights
    return limit_influences(alternator, target, whole, count)


def limit_influences(
    alternator: Alternator, target: Displacements, whole: Floats, count: int
) -> FittedModel:
    """Fit weights with at most `count` influences, from weights (m, n) that fit `target` well."""
    n = whole.shape[1]
    matrix = to_sparse(fit_influences(alternator, target, whole, count), n)
    return FittedModel(matrix.toarray(), matrix.nnz, sparse_weights=matrix)
