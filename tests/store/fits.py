"""A fit of each form, with a record that no run made."""

import numpy as np
from scipy import sparse

from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.fitting.problem import Correction
from cageik_cli.solver.fitting.held_out import Comparison, FitError
from cageik_cli.solver.fitting.record import FitRecord, FitReport, FittedClip
from cageik_cli.solver.settings import FitSettings, SolveSettings
from cageik_cli.store.fit_fields import StoredFit

COMPARISON = Comparison(FitError(0.1, 0.3, 0.9), FitError(0.9, 4.0, 9.0), 24)
REPORT = FitReport(
    regularization=0.1,
    smoothness=1.0,
    frames=48,
    fitted_frames=24,
    needed_memory=None,
    fitted=COMPARISON,
    held_out_blocks=COMPARISON,
    copied_frames=3,
    unseen_third=None,
    negative_per_row=0.1,
    min_weight=-0.05,
    roughness=1.02,
    fixed_floats=100,
    curve=((1.0, 0.3), (0.3, 0.2)),
)
CLIPS = (FittedClip("walk_1.obj ... walk_48.obj", "ab", 48),)


def record(**settings: object) -> FitRecord:
    return FitRecord(FitSettings(None, **settings), SolveSettings(0.01), CLIPS, REPORT)


def few_weights(binding: Binding, count: int = 2) -> sparse.csr_array:
    """The largest weights of each row, scaled to a sum of one."""
    weights = binding.weights.copy()
    np.put_along_axis(weights, np.argsort(weights, axis=1)[:, :-count], 0, axis=1)
    return sparse.csr_array(weights / weights.sum(axis=1, keepdims=True))


def stored_fit(binding: Binding, form: str) -> StoredFit:
    """A fit of the form "dense", "low rank" or "few"."""
    if form == "low rank":
        m, n = binding.weights.shape
        generator = np.random.default_rng(2)
        change = Correction(generator.normal(size=(m, 2)), generator.normal(size=(n, 2)))
        return StoredFit(record(rank=2), low_rank=change)
    if form == "few":
        return StoredFit(record(influences=2), sparse_weights=few_weights(binding))
    return StoredFit(record())
