"""Options of a fit of weights: whether there is one, and options that are refused without."""

from collections.abc import Iterable
from typing import Any

from cageik_cli.cli.options.group import is_given, refuse_options
from cageik_cli.fit.settings import FitSettings


def refuse_without_fit(names: Iterable[str]) -> None:
    """Refuse options that are given, though they are for a fit and there is none."""
    refuse_options(names, "{} is for weights that are fitted; add --fit, or leave out {}")


def choose_fit_settings(is_fitted: bool | None, **options: Any) -> FitSettings | bool | None:
    """Make the settings of a fit that is asked for, False of one that is refused, None by default.

    How a fit is made may be said without asking for it where a cage is built, as it is fitted then.
    """
    if is_fitted is None:
        if not any(map(is_given, options)):
            return None
        is_fitted = not (is_given("cage") or is_given("binding"))
    return make_fit_settings(is_fitted, **options) or False


def make_fit_settings(is_fitted: bool, **options: Any) -> FitSettings | None:
    """Make the settings of a fit; None without one, and options without one are wrong usage."""
    if not is_fitted:
        refuse_without_fit(options)
        return None
    given: dict[str, Any] = {k: None if value == "auto" else value for k, value in options.items()}
    return FitSettings(**given)
