"""Why a cage does not hold its model, as far as that can be measured, and what to do about it.

A cage may be in another unit, have other axes, be mirrored, be elsewhere, or be too small.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from cageik_cli.cages.surface_points import sample_surface, take_evenly
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats
from cageik_cli.util.messages import Said, Text, say
from cageik_cli.util.units import LONG_UNIT_NAMES, find_units_of_ratio, list_unit_ratios

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

MAX_NEAR_PERCENT = 5.0
"""A cage whose model is outside by less, percent of its diagonal, is at most too small."""

MAX_FITTED_PERCENT = 2.0
"""The same of a cage whose scale or place were fitted, which makes chance matches likelier."""

MAX_TRANSFORM_STEPS = 12
"""Steps in which a transform is fitted to the points that are left outside."""

MIN_EXTENT_RATIO, MAX_EXTENT_RATIO = 0.9, 2.0
"""A transformed cage is at least and at most so much larger than the model, along each axis."""

MAX_SIZE_RATIO = 5.0
"""A larger ratio of the diagonals of cage and model suggests different units."""

COMMON_SCALES = tuple(
    list_unit_ratios()[pair] for name in ("cm", "mm", "in") for pair in ((name, "m"), ("m", name))
)
"""Scales between metres and what else most programs count in."""

UP_CHANGES: dict[tuple[int, ...], str] = {
    (1, 0, 0, 0, 0, 1, 0, -1, 0): "with z up instead of y up",
    (1, 0, 0, 0, 0, -1, 0, 1, 0): "with y up instead of z up",
}
"""The turns between programs that count heights along y and along z; rows of the matrix."""

UP_AXES_OF_TURNS = dict(zip(UP_CHANGES.values(), (("Z", "Y"), ("Y", "Z")), strict=True))
"""The up axes before and after these turns."""

UNIT_SCALES = tuple(dict.fromkeys((*COMMON_SCALES, *list_unit_ratios().values())))
"""All scales that have a name: those, and the rare ones between the others."""

MAX_INFLATION = 20.0
"""Cages that must grow by more, percent of the model's diagonal, are not this model's."""

INFLATION_TOL = 0.01
"""The inflation is found to this share of itself."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """What brings a cage to its model: points become `matrix @ point + offset`.

    Attributes
    ----------
    rotation : (3, 3) float64
        A signed permutation: a turn by quarters, perhaps mirrored.
    offset : (3,) float64
        File units of the model.
    is_scaled, is_moved : bool
        Whether the scale and the place are fitted. A scale that is not is one between units.
    name : str
        How the cage differs, in plain words: `in centimetres instead of metres`. Empty while a
        transform is only tried.
    inflation : float
        By how much the transformed cage is too small, percent of the model's diagonal.
    """

    rotation: Floats
    scale: float
    offset: Floats
    is_scaled: bool = False
    is_moved: bool = False
    name: str = ""
    inflation: float = 0.0

    @property
    def matrix(self) -> Floats:
        """Return the turn times the scale, (3, 3)."""
        return self.scale * self.rotation

    @property
    def is_mirror(self) -> bool:
        """Whether faces must be turned, too."""
        return bool(np.linalg.det(self.rotation) < 0)

    @property
    def is_fitted(self) -> bool:
        """Whether scale or place are fitted."""
        return self.is_scaled or self.is_moved

    @property
    def complexity(self) -> int:
        """How many things are different at once: simple explanations go first."""
        turns = 0
        if (self.rotation != np.eye(3)).any():
            straight = (np.abs(self.rotation) == np.eye(3)).all()
            mirrored = 1 if straight else 2
            turns = 1 if _find_up_change(self.rotation) else 2
            turns += mirrored * int(self.is_mirror)
        scales = 0 if self.scale == 1 else 1 if self.scale in COMMON_SCALES else 3
        scales = 3 if self.is_scaled else scales
        return turns + scales + 2 * int(self.is_moved)

    def apply(self, points: Floats) -> Floats:
        """Return points, (k, 3), brought to the model."""
        return np.asarray(points @ self.matrix.T + self.offset)

    def apply_to_mesh(self, mesh: TriMesh) -> TriMesh:
        """Return a mesh brought to the model, its faces turned if it is mirrored."""
        moved = TriMesh(self.apply(mesh.vertices), mesh.faces)
        return moved.flip() if self.is_mirror else moved

    def invert(self) -> "Transform":
        """Return what brings the model to the cage."""
        rotation, scale = self.rotation.T, 1 / self.scale
        offset = -scale * rotation @ self.offset
        return Transform(rotation, scale, offset, self.is_scaled, self.is_moved)

    @property
    def up_axes(self) -> tuple[str, str] | None:
        """The up axes of the cage and of the model, if it is turned from one to the other."""
        return UP_AXES_OF_TURNS.get(_find_up_change(self.rotation))

    def describe(self, diagonal: float) -> str:
        """Say how the cage differs from what a model needs, to follow `the cage is`.

        A move by less than a thousandth of the model's diagonal is not worth a word.
        """
        parts = [_name_rotation(self.rotation)]
        if self.is_scaled:
            parts.append(f"scaled by {1 / self.scale:.3g}")
        elif self.scale != 1:
            units = find_units_of_ratio(self.scale, 1e-9)
            if units is None:
                parts.append(f"scaled by {1 / self.scale:.4g}")
            else:
                own, other = (LONG_UNIT_NAMES[name] for name in units)
                parts.append(f"in {own} instead of {other}")
        if np.linalg.norm(self.offset) > 1e-3 * diagonal:
            x, y, z = (f"{0 - value:.3g}" for value in self.offset)
            parts.append(f"moved by ({x}, {y}, {z})")
        return ", ".join(part for part in parts if part)


def _name_rotation(rotation: Floats) -> str:
    if name := _find_up_change(rotation):
        return name
    axes = np.abs(rotation).argmax(axis=1)
    signs = rotation.sum(axis=1)
    if (axes == np.arange(3)).all():
        negative = ["xyz"[k] for k in np.flatnonzero(signs < 0)]
        if len(negative) == 2:
            (kept,) = set("xyz") - set(negative)
            return f"turned by 180 degrees about {kept}"
        return f"mirrored in {' and '.join(negative)}" if negative else ""
    fixed = np.flatnonzero((axes == np.arange(3)) & (signs > 0))
    if len(fixed) == 1 and np.linalg.det(rotation) > 0:
        k = int(fixed[0])
        # The cage was turned by the inverse: R[i, j] is the sine of its angle for i, j after k.
        angle = 90 * int(rotation[(k + 1) % 3, (k + 2) % 3])
        return f"turned by {angle} degrees about {'xyz'[k]}"
    named = [("-" if signs[row] < 0 else "") + "xyz"[axes[row]] for row in range(3)]
    return f"with its {', '.join(named)} as the model's x, y, z"


def _find_up_change(rotation: Floats) -> str:
    return UP_CHANGES.get(tuple(rotation.ravel().astype(int).tolist()), "")


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
    """

    remedy: Said
    transform: Transform | None = None
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
        left = ""
        if transform.inflation >= 0.01:
            left = f", and then too small by {round_up(transform.inflation):g} % of the diagonal"
        found = f"the cage is {transform.name}{left}: export it as the model was"
        return Misfit(found, transform=transform)
    project = say("take the nearest points of the cage with `outside=project`")
    if worst < MAX_NEAR_PERCENT:
        otherwise = ", or " + project if share <= MAX_OUTSIDE_SHARE else ""
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
        return Misfit("enlarge the cage there, give the rest pose it was made for, or " + project)
    if share <= MAX_OUTSIDE_SHARE:
        remedy = OTHER_POSE_REMEDY + say(", or the frame that it was made for as `rest=`")
        return Misfit(remedy, is_repairable=False)
    return Misfit(_describe_misplaced(cage, rest), is_repairable=False)


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


def find_transform(cage: TriMesh, model: TriMesh) -> Transform | None:
    """Find the simplest transform after which a cage holds a model that it does not hold now.

    Parameters
    ----------
    cage : TriMesh
        Closed, turned outward.

    Returns
    -------
    Transform, optional
        None if the cage holds the model, or nearly, as it is, or if no transform makes it so.
    """
    points = take_evenly(model.vertices, 400)
    depth = _measure_depth(cage, points)
    is_oversized = cage.diagonal > MAX_SIZE_RATIO * model.diagonal
    if depth < MAX_NEAR_PERCENT / 100 * model.diagonal and not is_oversized:
        return None
    share = float(np.mean(winding_numbers(cage, points) < 0.5))
    # With so little of the model outside, parts of the cage are dented, not all misplaced.
    if 0 < share < 0.05:
        return None
    # A loose cage that holds its model can only be in another unit.
    may_fit = share >= 0.25
    candidates = [c for c in _list_transforms(cage, model) if may_fit or not c.is_fitted]
    limit = depth / 2 if depth > 0 else np.inf
    found: list[tuple[float, Transform]] = []
    for candidate in sorted(candidates, key=lambda c: c.complexity):
        if found and candidate.complexity > min(cost for cost, _ in found):
            break
        if candidate.is_moved:  # centred on the model first
            inner, outer = (
                (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
                for mesh in (model, cage)
            )
            candidate = replace(candidate, offset=inner - candidate.matrix @ outer)
        fitted = _fit_to_points(candidate, cage, points)
        moved = fitted.apply_to_mesh(cage)
        left = _measure_depth(moved, points)
        is_near = left < min(limit, _find_max_percent(fitted) / 100 * model.diagonal)
        if is_near and _is_of_size(fitted, moved, model):
            found.append((_measure_cost(fitted, 100 * left / model.diagonal), fitted))
    return _take_best(found, cage, model)


def _take_best(
    found: list[tuple[float, Transform]], cage: TriMesh, model: TriMesh
) -> Transform | None:
    """Take the transform of least cost, of those after which the cage needs little inflation."""
    best, least = None, np.inf
    samples = take_evenly(sample_surface(model), 4000)
    for cost, transform in sorted(found, key=lambda entry: entry[0]):
        if cost >= least:
            break
        transform = _fit_to_points(transform, cage, samples)
        inflation = measure_inflation(transform.apply_to_mesh(cage), model)
        if inflation is None or inflation > _find_max_percent(transform):
            continue
        cost = _measure_cost(transform, inflation)
        if cost < least:
            name = transform.describe(model.diagonal)
            best, least = replace(transform, name=name, inflation=inflation), cost
    return best


def _find_max_percent(transform: Transform) -> float:
    """Return how much too small the transformed cage may be, percent of the model's diagonal."""
    return MAX_FITTED_PERCENT if transform.is_fitted else MAX_NEAR_PERCENT


def _measure_cost(transform: Transform, percent: float) -> float:
    """Return what speaks against an explanation: a difference costs what a percent does."""
    return transform.complexity + percent


def _list_transforms(cage: TriMesh, model: TriMesh) -> Iterator[Transform]:
    """List all turns by quarters, mirrored or not, with scales that fit the extents."""
    inner = np.ptp(model.vertices, axis=0)
    least, most = MIN_EXTENT_RATIO * inner, MAX_EXTENT_RATIO * inner
    most += 1e-3 * model.diagonal  # flat models
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        rotation = np.eye(3)[list(order)] * np.array(signs)[:, None]
        outer = np.abs(rotation) @ np.ptp(cage.vertices, axis=0)
        for scale in (1.0, *UNIT_SCALES):
            if (scale * outer >= least).all() and (scale * outer <= most).all():
                yield Transform(rotation, scale, np.zeros(3))
                yield Transform(rotation, scale, np.zeros(3), is_moved=True)
        scale = float(np.max(inner / np.maximum(outer, np.finfo(float).tiny)))
        if (scale * outer <= most).all():
            yield Transform(rotation, scale, np.zeros(3), is_scaled=True)
            yield Transform(rotation, scale, np.zeros(3), is_scaled=True, is_moved=True)


def _fit_to_points(transform: Transform, cage: TriMesh, points: Floats) -> Transform:
    """Move, and grow, what a transform leaves open until the points are inside."""
    for _ in range(MAX_TRANSFORM_STEPS if transform.is_fitted else 0):
        moved = transform.apply_to_mesh(cage)
        outside = points[winding_numbers(moved, points) < 0.5]
        if len(outside) == 0:
            break
        transform = _take_step(transform, moved, outside)
    return transform


def _take_step(transform: Transform, moved: TriMesh, outside: Floats) -> Transform:
    """Scale and move so that the nearest points of the cage meet the points that are outside.

    Unknowns are a relative growth about the cage's centre, in its diagonals, and a move; their
    squares count, too, so that a solution of few points stays small.
    """
    ridge = 1e-3  # weight of these squares against one point's distance
    nearest = closest_points(moved, outside)
    keep = nearest.distance > 0
    if not keep.any():
        return transform
    centre = moved.vertices.mean(axis=0)
    direction = (outside - nearest.position)[keep] / nearest.distance[keep, None]
    arm = nearest.position[keep] if not transform.is_moved else nearest.position[keep] - centre
    growth = np.einsum("kx,kx->k", direction, arm) / moved.diagonal
    columns = np.column_stack([growth * transform.is_scaled, direction * transform.is_moved])
    normal = columns.T @ columns + ridge * len(columns) * np.eye(4)
    growth_step, *move = np.linalg.solve(normal, columns.T @ nearest.distance[keep])
    factor = 1 + growth_step / moved.diagonal
    offset = factor * transform.offset + np.array(move)
    if transform.is_moved:
        offset += (1 - factor) * centre
    return replace(transform, scale=transform.scale * factor, offset=offset)


def _measure_depth(cage: TriMesh, points: Floats) -> float:
    """Return how far the point that is furthest outside is."""
    outside = points[winding_numbers(cage, points) < 0.5]
    if len(outside) == 0:
        return 0.0
    return float(closest_points(cage, outside).distance.max())


def _is_of_size(transform: Transform, cage: TriMesh, model: TriMesh) -> bool:
    """Return whether a transformed cage is about as large as the model along every axis."""
    outer, inner = np.ptp(cage.vertices, axis=0), np.ptp(model.vertices, axis=0)
    most = MAX_EXTENT_RATIO
    if transform.is_scaled:
        most = 1.4  # any cage holds any model when it is large enough
    elif transform.scale not in (1.0, *COMMON_SCALES):
        most = 1.25  # rare factors are small, and a cage that is only too small is in no other unit
    # Along axes in which the model is thin, the cage may be larger.
    slack = 0.1 * (most - 1) * model.diagonal
    return bool((outer >= MIN_EXTENT_RATIO * inner).all() and (outer <= most * inner + slack).all())


def measure_inflation(cage: TriMesh, model: TriMesh) -> float | None:
    """Find the smallest offset of the cage along its normals that takes the model inside.

    Parameters
    ----------
    cage : TriMesh
        Closed and turned outward.

    Returns
    -------
    float, optional
        Percent of the model's diagonal, found to hold points all over the model; 0 if the cage
        holds them as it is, None if `MAX_INFLATION` does not, or the cage then crosses itself.
    """
    samples = take_evenly(sample_surface(model), 50_000)
    outside = samples[winding_numbers(cage, samples) < 0.5]
    if len(outside) == 0:
        return 0.0
    normals = average_normals(cage) * (model.diagonal / 100)
    depth = 100 * float(closest_points(cage, outside).distance.max()) / model.diagonal
    left, low, high = outside, 0.0, max(depth, INFLATION_TOL)
    while len(found := _find_outside(cage, high * normals, left, outside)):
        left, low, high = found, high, high * 1.4
        if low > MAX_INFLATION:
            return None
    while high - low > INFLATION_TOL * high:
        middle = (low + high) / 2
        if len(found := _find_outside(cage, middle * normals, left, outside)):
            left, low = found, middle
        else:
            high = middle
    # Where the cage is thin, it may cross itself as it grows, and lose what it held.
    held = high <= MAX_INFLATION and not len(_find_outside(cage, high * normals, samples))
    return high if held else None


def average_normals(mesh: TriMesh) -> Floats:
    """Return unit normals of vertices, (n, 3): those of their faces, weighted by their angles."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    total = np.zeros_like(mesh.vertices)
    np.add.at(total, mesh.faces, corner_angles(mesh)[:, :, None] * normals[:, None])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0, length, 1.0))


def _find_outside(cage: TriMesh, moves: Floats, *samples: Floats) -> Floats:
    """Return the samples, (k, 3), that a cage with moved vertices does not hold.

    Of several sets the first with such samples counts: the likeliest, to save the others.
    """
    grown = TriMesh(cage.vertices + moves, cage.faces)
    left = np.empty((0, 3))
    for points in samples:
        left = points[winding_numbers(grown, points) < 0.5]
        if len(left):
            break
    return left
