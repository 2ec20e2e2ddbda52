"""A small binding, and a fit of each form, with a record that no run made."""

from dataclasses import replace

import numpy as np

from cageik_cli.fit.settings import (
    Comparison,
    Distances,
    EditRoughness,
    FitRecord,
    FitReport,
    FitSettings,
    FittedClip,
    StrengthLimit,
    TriedStrength,
)
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding, Correction
from cageik_cli.store.binding_file import StoredBinding
from tests.shapes import TETRAHEDRON, ball

COMPARISON = Comparison(Distances(0.1, 0.3, 0.9), Distances(0.9, 4.0, 9.0), 24)
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
    limit=StrengthLimit.EDITS,
    ladder=(
        TriedStrength(1.0, 1.0, 0.3, 0.4, EditRoughness(1.0, 1.01)),
        TriedStrength(0.1, 1.0, 0.2, None, EditRoughness(1.2, 1.1)),
    ),
    edits=EditRoughness(1.02, 1.01),
    distinct_frames=24,
)
CLIPS = (FittedClip("walk_1.obj ... walk_48.obj", "ab", 48),)


def barycentric_binding(**details: object) -> Binding:
    """Barycentric weights in a tetrahedron, whose affine precision is rounding."""
    shares = np.abs(ball(1).vertices) + 0.1
    weights = np.column_stack([shares, np.ones(len(shares))])
    weights /= weights.sum(axis=1, keepdims=True)
    rest = type(TETRAHEDRON)(weights @ TETRAHEDRON.vertices, ball(1).faces)
    return Binding(rest, TETRAHEDRON, weights, **details)


def record(**settings: object) -> FitRecord:
    return FitRecord(FitSettings(**settings), SolveSettings(0.01), CLIPS, REPORT)


def few_weights(binding: Binding, count: int = 2) -> np.ndarray:
    """The largest weights of each row, scaled to a sum of one."""
    weights = binding.weights.copy()
    np.put_along_axis(weights, np.argsort(weights, axis=1)[:, :-count], 0, axis=1)
    return weights / weights.sum(axis=1, keepdims=True)


def as_fitted(binding: Binding, form: str, sources: dict | None = None) -> StoredBinding:
    """The binding as if its weights were fitted, of the form "dense", "low rank" or "few"."""
    stored = StoredBinding(binding, sources or {})
    if form == "low rank":
        m, n = binding.weights.shape
        generator = np.random.default_rng(2)
        change = Correction(generator.normal(size=(m, 2)), generator.normal(size=(n, 2)))
        return replace(stored, fit=record(rank=2), low_rank=change)
    if form == "few":
        few = replace(binding, weights=few_weights(binding), has_offsets=True)
        return replace(stored, binding=few, fit=record(influences=2))
    return replace(stored, fit=record())
