"""Options of the solve for the cages: its weights, captured clips, and weights that are fitted."""

from collections.abc import Iterable
from dataclasses import Field, fields
from typing import Any

import click

from cageik_cli.captured.settings import AUTO_SMOOTHING, CaptureSettings
from cageik_cli.cli.command import HelpGroup, option
from cageik_cli.cli.options import PATH_TYPE, Decorator, OptionGroup, is_given, refuse_options
from cageik_cli.cli.options.types import OrWord
from cageik_cli.fit.settings import FitSettings, find_kind
from cageik_cli.method.solve.settings import AREA, SolveSettings

vertex_weights_option = option(
    "--vertex-weights",
    type=OrWord(PATH_TYPE, AREA),
    metavar=f"FILE|{AREA}",
    help="Weights of the vertices: a file with one per vertex (text or .npy), or in extract one "
    f"per frame and vertex (.npy), where 0 marks missing data; or {AREA}: each vertex counts by "
    "its area.",
    group=HelpGroup.SOLVE,
)

SOLVE_OPTIONS = OptionGroup(
    "solve",
    SolveSettings,
    option(
        "--alpha",
        type=float,
        default=SolveSettings().alpha,
        show_default=True,
        help="Weight of the cage's Laplacian: higher is smoother and less exact.",
    ),
    option(
        "--beta",
        type=float,
        default=SolveSettings().beta,
        show_default=True,
        help="Weight of the vertices.",
    ),
    option(
        "--align/--no-align",
        default=SolveSettings().align,
        show_default=True,
        help="Align each frame rigidly with the rest pose before the solve.",
    ),
    group=HelpGroup.SOLVE,
)

CAPTURE_OPTIONS = OptionGroup(
    "capture",
    CaptureSettings,
    option("--robust", is_flag=True, help="Reject vertices that are thrown away in some frames."),
    option(
        "--smooth",
        type=OrWord(click.FLOAT, AUTO_SMOOTHING, "a number of seconds"),
        metavar=f"SECONDS|{AUTO_SMOOTHING}",
        help="Smooth the cages over time: halve motions of this period, or find it from the noise.",
    ),
    option("--fill-gaps", is_flag=True, help="Fill frames without data from those around them."),
    group=HelpGroup.CAPTURED,
)


def make_setting_option(setting: "Field[Any]") -> Decorator:
    """Make the option of a setting of a fit, of what the setting says of itself."""
    word, text = setting.metadata["name"].replace("_", "-"), setting.metadata["help"]
    kind, unset, default = find_kind(setting), setting.metadata["unset"], setting.default
    if kind is bool:
        words = f"--{word}/--no-{word}"
        return option(
            words, setting.name, default=default, show_default=True, help=text, group=HelpGroup.FIT
        )
    if default is None:
        text = f"{text}  [default: {unset}]"
        return option(f"--{word}", setting.name, type=kind, help=text, group=HelpGroup.FIT)
    is_found, known = unset == "auto", click.types.convert_type(kind)
    return option(
        f"--{word}",
        setting.name,
        type=OrWord(known, "auto", "a number, such as 0.1") if is_found else known,
        metavar="NUMBER|AUTO" if is_found else None,
        default=str(default),
        show_default=True,
        help=text,
        group=HelpGroup.FIT,
    )


FIT_STRENGTH_OPTIONS = tuple(map(make_setting_option, fields(FitSettings)))
"""The options that say how weights are fitted, one for each of the settings of a fit."""


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
