"""Weights that were fitted to clips, and the record of their fit."""

from __future__ import annotations

from dataclasses import dataclass

from cageik_cli.fit.settings import FitRecord, FitReport
from cageik_cli.method.weights.binding import Binding, Correction


@dataclass(frozen=True, slots=True, eq=False)
class FittedWeights:
    """Weights fitted to clips.

    Attributes
    ----------
    binding : Binding
        With the fitted weights.
    fit : FitRecord
        How they were fitted, and to which clips.
    low_rank : Correction, optional
        What a fit of low rank has added to the weights before.
    unfitted : Binding
        The same model with the weights before the fit.

    Examples
    --------
    >>> from cageik_cli import bind, fit_weights, load_clip, load_mesh
    >>> clip = load_clip("data_fixtures/walker/frames", selection=slice(0, 12))
    >>> binding = bind(clip.first, load_mesh("data_fixtures/walker/cage.obj"), accuracy="preview")
    >>> fitted = fit_weights(binding, [clip])
    >>> fitted.binding.weights.shape, fitted.report.fitted_frames
    ((1570, 80), 12)
    >>> errors = fitted.report.held_out_blocks
    >>> errors.fitted.rms < errors.unfitted.rms
    True
    """

    binding: Binding
    fit: FitRecord
    low_rank: Correction | None
    unfitted: Binding

    @property
    def report(self) -> FitReport:
        """What the fit gains, on which frames, and what it costs."""
        return self.fit.report

    def __repr__(self) -> str:
        count, cage_count = self.binding.weights.shape
        return (
            f"<FittedWeights: {count} vertices in a cage of {cage_count}, fitted to "
            f"{self.report.fitted_frames} of {self.report.frames} frames>"
        )
