"""Options of weights that are fitted to clips: one for each of the settings of a fit."""

from collections.abc import Iterable
from dataclasses import Field, fields
from typing import Any, get_args

import click

from cageik_cli.cli.options.common import is_given, usage_errors
from cageik_cli.cli.options.group import Decorator
from cageik_cli.solver.fitting.record import FitSettings


class NumberOrAuto(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """A number, or "auto", which becomes None."""

    name = "number|auto"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float | None:
        """Parse the text; the settings check the number."""
        if value == "auto":
            return None
        try:
            return float(value)
        except (TypeError, ValueError):
            self.fail(f"{value!r} is not a number, such as 0.1, or auto", param, ctx)


def _make_option(setting: "Field[Any]") -> Decorator:
    """Make the option of a setting, of what the setting says of itself."""
    kind = int if int in get_args(setting.type) else float
    flag, text = f"--{setting.metadata['name'].replace('_', '-')}", setting.metadata["help"]
    unset = setting.metadata.get("unset")
    if setting.default is None:
        return click.option(flag, type=kind, help=f"{text}  [default: {unset}]")
    number = NumberOrAuto() if unset == "auto" else kind
    return click.option(
        flag, type=number, default=str(setting.default), show_default=True, help=text
    )


FIT_NAMES = tuple(setting.metadata["name"] for setting in fields(FitSettings))
FIT_STRENGTH_OPTIONS = tuple(map(_make_option, fields(FitSettings)))
"""The options that say how weights are fitted, and their names."""


def refuse_without_fit(names: Iterable[str]) -> None:
    """Refuse options that are given, though they are for a fit and there is none."""
    for name in filter(is_given, names):
        option = f"--{name.replace('_', '-')}"
        raise click.UsageError(
            f"{option} is for weights that are fitted; add --fit, or leave out {option}"
        )


def make_fit_settings(is_fitted: bool, **options: Any) -> FitSettings | None:
    """Make the settings of a fit; None without one, and options without one are wrong usage."""
    if not is_fitted:
        refuse_without_fit(FIT_NAMES)
        return None
    with usage_errors():
        return FitSettings(*(options[name] for name in FIT_NAMES))
