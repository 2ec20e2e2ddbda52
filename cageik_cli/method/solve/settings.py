"""Settings of the solver and their defaults. This module imports no numerics."""

from dataclasses import dataclass

from cageik_cli.util.errors import SettingError
from cageik_cli.util.settings import HelpGroup, check_settings, declare_setting

LEAST_SQUARES = 2.0
"""The norm of least squares."""

FITTED_NORM = 6.0
"""The norm where weights are fitted to clean clips, if none is stated."""

AREA = "area"
"""Says, in place of a file of vertex weights, that each vertex counts by its area."""


@dataclass(frozen=True, slots=True)
class SolveSettings:
    """Settings of the minimisation; alpha and beta are not both zero.

    Without a norm, it is that of least squares; a run states one where weights are fitted.
    """

    alpha: float = declare_setting(
        1e-3,
        "Weight of the cage's Laplacian: higher is smoother and less exact.",
        name="alpha",
        meaning="weight of the cage's Laplacian",
        minimum=0,
        group=HelpGroup.SOLVE,
    )
    beta: float = declare_setting(
        1.0,
        "Weight of the vertices.",
        name="beta",
        meaning="weight of the mesh vertices",
        minimum=0,
        group=HelpGroup.SOLVE,
    )
    align: bool = declare_setting(
        True,
        "Align each frame rigidly with the rest pose before the solve.",
        name="align",
        meaning="move each frame rigidly onto the rest pose before it is solved",
        group=HelpGroup.SOLVE,
    )
    norm: float | None = declare_setting(
        None,
        "Power by which deviations far above the others of a frame count: 2 is least squares, a "
        "higher one lowers the largest deviation.",
        name="norm",
        meaning="power by which deviations far above the others of a frame count; 2 is least "
        "squares",
        is_recorded_unset=False,
        unset=f"{FITTED_NORM:g} where weights are fitted to clean clips, else {LEAST_SQUARES:g}",
        metavar="P",
        minimum=2,
        maximum=8,
        group=HelpGroup.SOLVE,
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.alpha == self.beta == 0:
            raise SettingError("alpha and beta are both 0, expected at least one above 0")

    @property
    def lowers_deviations(self) -> bool:
        """Whether the norm is above that of least squares."""
        return self.norm is not None and self.norm > LEAST_SQUARES
