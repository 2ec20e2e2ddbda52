"""Settings of the solver and their defaults. This module imports no numerics."""

from dataclasses import dataclass
from math import isfinite

from cageik_cli.util.errors import SettingError


@dataclass(frozen=True, slots=True)
class SolveSettings:
    """Settings of the minimisation.

    Attributes
    ----------
    alpha, beta : float
        Weights of the Laplacian and of the vertices; finite, not negative, not both zero.
    align : bool
        Align every frame rigidly with the rest pose, solve there, and move the cage back.
    """

    alpha: float = 1e-3
    beta: float = 1.0
    align: bool = True

    def __post_init__(self) -> None:
        for name, value in (("alpha", self.alpha), ("beta", self.beta)):
            if not (isfinite(value) and value >= 0):
                raise SettingError(f"{name} is {value}, expected a finite number, zero or above")
        if self.alpha == self.beta == 0:
            raise SettingError("alpha and beta are both 0, expected at least one above 0")


AREA = "area"
"""Says, in place of a file of vertex weights, that each vertex counts by its area."""
