"""Options of the solve for the cages."""

from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.options.common import usage_errors
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.solver.settings import AREA, SolveSettings


def make_solve_settings(alpha: float, beta: float, align: bool) -> SolveSettings:
    """Make the settings of the solver; impossible values are wrong usage."""
    with usage_errors():
        return SolveSettings(alpha, beta, align)


class VertexWeightsType(click.Path):
    """A file of weights, or a word for weights that are computed."""

    words = (AREA,)

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the word as it is, and other text as a path."""
        return value if value in self.words else super().convert(value, param, ctx)


vertex_weights_option = click.option(
    "--vertex-weights",
    type=VertexWeightsType(),
    metavar=f"FILE|{AREA}",
    help="Weights of the vertices: a file with one per vertex (text or .npy), or in extract one "
    f"per frame and vertex (.npy), where 0 marks missing data; or {AREA}: each vertex counts by "
    "its area.",
)

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
