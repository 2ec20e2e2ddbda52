"""Why a cage does not hold its model, as far as that can be measured, and what to do about it."""

import math
from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.looseness import measure_inflation
from cageik_cli.cages.similarity import MAX_SIZE_RATIO, find_transform
from cageik_cli.geometry.mesh import TriMesh

MAX_UNINFLATED = 5.0
"""A cage whose worst vertex is outside by less, percent of the diagonal, was not inflated."""

MIN_NAMED_INFLATION = 0.01
"""A smaller inflation, percent of the diagonal, is not worth a word beside a transform."""

MAX_OUTSIDE_SHARE = 0.5
"""With a larger share of vertices outside, none are projected: it is another model's cage."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """Why vertices are outside a cage.

    Attributes
    ----------
    remedy : str
        What is measured, and what to do.
    transform : str, optional
        How the cage differs, as `Transform.name`, if it holds the model without that.
    inflation : float, optional
        By how much it is too small everywhere, percent of the diagonal, if it holds the model
        then.
    is_repairable : bool
        Whether `cageik cage --repair` may help.
    """

    remedy: str
    transform: str | None = None
    inflation: float | None = None
    is_repairable: bool = True


def explain_misfit(cage: TriMesh, rest: TriMesh, worst: float, share: float) -> Misfit:
    """Find what would make a cage hold its model.

    The time is bounded: only points of large models are tried.

    Parameters
    ----------
    cage : TriMesh
        Closed, turned outward.
    worst : float
        How far the worst vertex is outside, percent of the diagonal.
    share : float
        Share of the vertices that are outside.
    """
    if transform := find_transform(cage, rest):
        return Misfit(
            f"the cage is {transform.name}{_describe_rest_of(transform.inflation)}: export it as "
            "the model was",
            transform=transform.name,
        )
    if worst < MAX_UNINFLATED:
        return _explain_small_cage(cage, rest, share)
    if share <= MAX_OUTSIDE_SHARE:
        return Misfit(f"enlarge the cage there, give the rest pose it was made for, or {_PROJECT}")
    return Misfit(_describe_misplaced(cage, rest), is_repairable=False)


_PROJECT = "take the nearest points of the cage with --outside project"


def round_up(percent: float) -> float:
    """Round up to two digits, so that what is said is enough."""
    if percent <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(percent)) - 1)
    return float(f"{math.ceil(percent / step - 1e-9) * step:.2g}")


def _describe_rest_of(inflation: float) -> str:
    """Say what is missing once the transform is undone."""
    if inflation < MIN_NAMED_INFLATION:
        return ""
    return f", and then too small by {round_up(inflation):g} % of the diagonal"


def _explain_small_cage(cage: TriMesh, rest: TriMesh, share: float) -> Misfit:
    project = f", or {_PROJECT}" if share <= MAX_OUTSIDE_SHARE else ""
    inflation = measure_inflation(cage, rest)
    if not inflation:
        return Misfit(
            "the cage is too small there, and to inflate it evenly does not help: move it outward "
            f"there{project}"
        )
    percent = round_up(inflation)
    return Misfit(
        f"the cage is not inflated: inflate it by {percent:g} % of the diagonal "
        f"({percent / 100 * rest.diagonal:.3g}) along its normals{project}",
        inflation=percent,
    )


def _describe_misplaced(cage: TriMesh, rest: TriMesh) -> str:
    """Say what is known of a cage when most of the model is outside, for no cause that is found."""
    ratio = cage.diagonal / rest.diagonal
    low = np.maximum(cage.vertices.min(axis=0), rest.vertices.min(axis=0))
    high = np.minimum(cage.vertices.max(axis=0), rest.vertices.max(axis=0))
    if (low > high).any():
        what = "their bounding boxes do not overlap"
    elif not 1 / MAX_SIZE_RATIO < ratio < MAX_SIZE_RATIO:
        what = f"the cage is {ratio:.3g} times as large as the model"
    else:
        what = "most of the model is outside"
    return f"{what}, and no unit, axes or place makes it fit: give the rest pose it was made for"
