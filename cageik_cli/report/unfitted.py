"""The error of a clip with the weights before the fit, beside that with fitted ones."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.store.result import Result
from cageik_cli.store.unfitted import read_unfitted_errors


@dataclass(frozen=True, slots=True)
class UnfittedRecord:
    """The error of some frames with the weights before the fit.

    Attributes
    ----------
    coordinates : str
        Of the weights before the fit: "harmonic" or "mean-value".
    frames : tuple of int
        Numbers of the frames that were measured.
    rms_percent : tuple of float
        The rms of each, percent of the diagonal.
    mean_rms_percent, fitted_rms_percent : float
        The rms over these frames, with the weights before and after the fit.
    """

    coordinates: str
    frames: tuple[int, ...]
    rms_percent: tuple[float, ...]
    mean_rms_percent: float
    fitted_rms_percent: float


def build_unfitted(result: Result) -> UnfittedRecord | None:
    """Build the record of a result; None if it does not hold the errors before a fit.

    Raises
    ------
    InputError
        When they are damaged.
    """
    if result.fit is None:
        return None
    errors = read_unfitted_errors(result.path, len(result.frames), result.skipped)
    if errors is None:
        return None
    percent = 100 / result.rest.diagonal
    before, after = percent * errors.rms, percent * result.metrics.rms[errors.frames]
    return UnfittedRecord(
        coordinates=str(result.settings.get("coordinates", "harmonic")),
        frames=tuple(errors.frames.tolist()),
        rms_percent=tuple(before.tolist()),
        mean_rms_percent=float(np.sqrt(np.mean(before**2))),
        fitted_rms_percent=float(np.sqrt(np.mean(after**2))),
    )
