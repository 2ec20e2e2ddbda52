"""Options of the solve for the cages."""

import click

from cageik_cli.cli.options.common import usage_errors
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.solver.settings import SolveSettings


def make_solve_settings(alpha: float, beta: float, align: bool) -> SolveSettings:
    """Make the settings of the solver; impossible values are wrong usage."""
    with usage_errors():
        return SolveSettings(alpha, beta, align)


SOLVE_DEFAULTS = SolveSettings()

SOLVE_OPTIONS = OptionGroup(
    "solve",
    make_solve_settings,
    click.option(
        "--alpha",
        type=float,
        default=SOLVE_DEFAULTS.alpha,
        show_default=True,
        help="Weight of the cage's Laplacian: higher is smoother and less exact.",
    ),
    click.option(
        "--beta",
        type=float,
        default=SOLVE_DEFAULTS.beta,
        show_default=True,
        help="Weight of the vertices.",
    ),
    click.option(
        "--align/--no-align",
        default=SOLVE_DEFAULTS.align,
        show_default=True,
        help="Align each frame rigidly with the rest pose before the solve.",
    ),
)
