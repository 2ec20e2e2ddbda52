"""Why a cage does not hold its model, as far as that can be measured, and what to do about it."""

import math
from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.transform import (
    MAX_NEAR_PERCENT,
    MAX_SIZE_RATIO,
    Transform,
    find_transform,
    measure_inflation,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.messages import Said, Text, say

MAX_OUTSIDE_SHARE = 0.5
"""With a larger share of vertices outside, none are projected: it is another model's cage."""

MAX_DENTED_SHARE = 0.1
"""With a larger share of vertices far outside, a cage is of another pose."""

BUILD_REMEDY = say("cageik extract builds one if `cage=` is left out")
"""What always helps where a cage is not that of the model."""

OTHER_POSE_REMEDY = (
    "it looks like the cage of another pose, or of another model: "
    + BUILD_REMEDY
    + "; or give the "
    "cage at rest"
)
"""What to do about a cage that is not of the rest pose."""


MAX_DENT_VERTICES = 6
"""Cage vertices at which a model comes out, at most: with more, the cage is too small all over."""

MIN_VERTICES_PER_DENT = 12
"""The same for small cages: at most one of so many of their vertices."""


@dataclass(frozen=True, slots=True)
class Dent:
    """A cage vertex at which the model comes out of the cage.

    Attributes
    ----------
    vertex : int
        Of the cage.
    depth : float
        How far it is inside the model, or how far the model comes out there, file units.
    is_inside : bool
        Whether the vertex itself is inside the model.
    """

    vertex: int
    depth: float
    is_inside: bool

    def describe(self, length: str) -> str:
        """Say what is wrong at the vertex; `length` is the depth in words."""
        if self.is_inside:
            return f"vertex {self.vertex} of the cage is {length} inside the model"
        return f"the model comes {length} out of the cage at its vertex {self.vertex}"


@dataclass(frozen=True, slots=True)
class Misfit:
    """Why vertices are outside a cage.

    Attributes
    ----------
    remedy : str or Text
        What is measured, and what to do.
    transform : Transform, optional
        How the cage differs, if it holds the model without that.
    inflation : float, optional
        By how much it is too small everywhere, percent of the diagonal, if it holds the model
        then.
    is_repairable : bool
        Whether a repair may help.
    dents : tuple of Dent
        The few cage vertices that are the cause, the deepest first; none if they are not few.
    """

    remedy: Said
    transform: Transform | None = None
    inflation: float | None = None
    is_repairable: bool = True
    dents: tuple[Dent, ...] = ()


def explain_misfit(
    cage: TriMesh, rest: TriMesh, worst: float, share: float, dents: tuple[Dent, ...] = ()
) -> Misfit:
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
    dents : tuple of Dent
        As of `find_dents`.
    """
    if transform := find_transform(cage, rest):
        left = ""
        if transform.inflation >= 0.01:
            left = f", and then too small by {round_up(transform.inflation):g} % of the diagonal"
        found = f"the cage is {transform.name}{left}: export it as the model was"
        return Misfit(found, transform=transform)
    project = say("take the nearest points of the cage with `outside=project`")
    if worst < MAX_NEAR_PERCENT:
        otherwise = ", or " + project if share <= MAX_OUTSIDE_SHARE else ""
        if dents:
            return Misfit(_describe_dents(dents, rest.diagonal) + otherwise, dents=dents)
        if not (inflation := measure_inflation(cage, rest)):
            return Misfit(
                "the cage is too small there, and to inflate it evenly does not help: move it "
                "outward there" + otherwise
            )
        percent = round_up(inflation)
        return Misfit(
            f"the cage is not inflated: inflate it by {percent:g} % of the diagonal "
            f"({percent / 100 * rest.diagonal:.3g}) along its normals" + otherwise,
            inflation=percent,
        )
    is_dented = share <= MAX_DENTED_SHARE or worst < 2 * MAX_NEAR_PERCENT
    if is_dented and share <= MAX_OUTSIDE_SHARE:
        if dents:
            described = _describe_dents(dents, rest.diagonal)
            described += ", give the rest pose it was made for, or "
            return Misfit(described + project, dents=dents)
        return Misfit("enlarge the cage there, give the rest pose it was made for, or " + project)
    if share <= MAX_OUTSIDE_SHARE:
        remedy = OTHER_POSE_REMEDY + say(", or the frame that it was made for as `rest=`")
        return Misfit(remedy, is_repairable=False)
    return Misfit(_describe_misplaced(cage, rest), is_repairable=False)


def find_dents(
    cage: TriMesh, rest: TriMesh, faces: Integers, distances: Floats
) -> tuple[Dent, ...]:
    """Find the few cage vertices at which the model comes out.

    Parameters
    ----------
    faces : (k,) int64
        The cage face that is nearest to each vertex of the model that is outside.
    distances : (k,) float64
        How far these are outside, file units.

    Returns
    -------
    tuple of Dent
        The deepest first; none if more vertices than `MAX_DENT_VERTICES` have faces there, or more
        than one of `MIN_VERTICES_PER_DENT`.
    """
    most = min(MAX_DENT_VERTICES, max(1, len(cage.vertices) // MIN_VERTICES_PER_DENT))
    corners, left = cage.faces[faces], np.ones(len(faces), bool)
    found: list[tuple[int, float]] = []
    while left.any():
        if len(found) == most:
            return ()
        # The vertex whose faces the model comes out of most: each of the rest adds its depth.
        depths = np.repeat(distances[left], 3)
        sums = np.bincount(corners[left].ravel(), depths, len(cage.vertices))
        vertex = int(sums.argmax())
        is_here = left & (corners == vertex).any(axis=1)
        left &= ~is_here
        found.append((vertex, float(distances[is_here].max())))
    dents = [Dent(vertex, depth, is_inside=False) for vertex, depth in found]
    if len(rest.faces):  # points have no inside
        places = cage.vertices[[vertex for vertex, _ in found]]
        is_inside, inner = winding_numbers(rest, places) > 0.5, closest_points(rest, places)
        for k in np.flatnonzero(is_inside).tolist():
            dents[k] = Dent(dents[k].vertex, float(inner.distance[k]), is_inside=True)
    return tuple(sorted(dents, key=lambda dent: -dent.depth))


def _describe_dents(dents: tuple[Dent, ...], diagonal: float) -> str:
    """Say which vertices of the cage have to be moved, and how far the deepest is."""
    first, *others = dents
    percent = round_up(100 * first.depth / diagonal)
    text = first.describe(f"{percent:g} % of the diagonal ({percent / 100 * diagonal:.3g})")
    if not others:
        return f"{text}: move it outward"
    numbers = ", ".join(str(dent.vertex) for dent in others)
    noun = "vertex" if len(others) == 1 else "vertices"
    return f"{text}, and {noun} {numbers} less: move them outward"


def round_up(percent: float) -> float:
    """Round up to two digits, so that what is said is enough."""
    if percent <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(percent)) - 1)
    return float(f"{math.ceil(percent / step - 1e-9) * step:.2g}")


def _describe_misplaced(cage: TriMesh, rest: TriMesh) -> Text:
    """Say what is known of a cage when most of the model is outside, for no cause that is found."""
    ratio = cage.diagonal / rest.diagonal
    low = np.maximum(cage.vertices.min(axis=0), rest.vertices.min(axis=0))
    high = np.minimum(cage.vertices.max(axis=0), rest.vertices.max(axis=0))
    if (low > high).any():
        what = "their bounding boxes do not overlap, and "
    elif not 1 / MAX_SIZE_RATIO < ratio < MAX_SIZE_RATIO:
        what = f"the cage is {ratio:.3g} times as large as the model, and "
    else:
        what = ""
    return (
        f"{what}no unit, axes or place makes it fit, so it looks like the cage of another "
        "model, or of another frame: "
        + BUILD_REMEDY
        + say("; or give the frame that it was made for as `rest=`")
    )
