"""Options of weights that are fitted to clips."""

from collections.abc import Iterable
from typing import Any

import click

from cageik_cli.cli.options.common import is_given, usage_errors
from cageik_cli.solver.fitting.record import DEFAULT_REGULARIZATION, FitSettings

AUTO = "auto"


class RegularizationType(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """A number above 0, or "auto"."""

    name = "number|auto"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float | str:
        """Parse the text; the settings check the number."""
        if value == AUTO:
            return AUTO
        try:
            return float(value)
        except (TypeError, ValueError):
            self.fail(f"{value!r} is not a number, such as 0.1, or {AUTO}", param, ctx)


FIT_STRENGTH_OPTIONS = (
    click.option(
        "--fit-regularization",
        type=RegularizationType(),
        default=str(DEFAULT_REGULARIZATION),
        show_default=True,
        help="Pull of fitted weights to the others: higher is smoother and less exact; auto "
        "chooses it by frames held out.",
    ),
    click.option(
        "--fit-smoothness",
        type=float,
        default=FitSettings().smoothness,
        show_default=True,
        help="Smoothness over the surface of what the fit changes.",
    ),
    click.option(
        "--fit-rank",
        type=int,
        help="Rank of what the fit changes: few numbers to store beside weights that can be "
        "computed.  [default: any]",
    ),
    click.option(
        "--influences",
        type=int,
        help="Cage vertices that move each vertex, with weights that are not negative, as "
        "skeletons need.  [default: all]",
    ),
)
"""The options that say how weights are fitted."""

_NAMES = ("fit_regularization", "fit_smoothness", "fit_rank", "influences")


def refuse_without_fit(names: Iterable[str]) -> None:
    """Refuse options that are given, though they are for a fit and there is none."""
    for name in filter(is_given, names):
        option = f"--{name.replace('_', '-')}"
        raise click.UsageError(
            f"{option} is for weights that are fitted; add --fit, or leave out {option}"
        )


def make_fit_settings(
    is_fitted: bool,
    fit_regularization: float | str,
    fit_smoothness: float,
    fit_rank: int | None,
    influences: int | None,
) -> FitSettings | None:
    """Make the settings of a fit; None without one, and options without one are wrong usage."""
    if not is_fitted:
        refuse_without_fit(_NAMES)
        return None
    strength = None if isinstance(fit_regularization, str) else fit_regularization
    with usage_errors():
        return FitSettings(strength, fit_smoothness, fit_rank, influences)
