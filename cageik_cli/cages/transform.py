"""How two meshes relate: by which unit, axes and place the one would fit the other.

A cage and its model are asked whether the cage holds the model with another unit or other axes,
mirrored, elsewhere or larger. Poses of one mesh may differ in the unit, which changes the length of
every edge by one factor, as no pose does; and in the up axis, which is certain only if the same
pose is there with both, or every frame of a clip is turned so.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, permutations, product

import numpy as np

from cageik_cli.cages.surface_points import sample_surface, take_evenly
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.rotations import UP_TURNS
from cageik_cli.geometry.shape import corner_angles
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.method.solve.alignment import best_motions
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.units import LONG_UNIT_NAMES, find_units_of_ratio, list_unit_ratios

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

UNIT_SCALES = tuple(dict.fromkeys((*COMMON_SCALES, *list_unit_ratios().values())))
"""All scales that have a name: those, and the rare ones between the others."""

MAX_INFLATION = 20.0
"""Cages that must grow by more, percent of the model's diagonal, are not this model's."""

INFLATION_TOL = 0.01
"""The inflation is found to this share of itself."""

MAX_BOX_SLACK = 0.1
"""A mesh that is where a model is leaves its bounding box by at most this, in diagonals."""

MAX_POSE_STRETCH = 1.5
"""The median edge of a pose is at most so many times longer than that of another; the smallest
ratio of two units is 2.54."""

UNIT_RATIO_TOL = 0.05
"""A ratio of edges is that of two units if it differs by less, relative to itself."""

MAX_EDGE_SPREAD = 1.6
"""A pose in another unit has edges whose ratios differ by less, from the lowest tenth to the
highest: those of dancers do by up to 1.4, those of a shape that is stretched by more."""

MIN_CLEAR_RATIO = 9.0
"""A larger ratio of two units explains edges that differ more: no edit makes a shape so much
larger."""

SAME_POSE_TOL = 5e-3
"""Poses are the same if they differ by less, rms in diagonals, and their place does not count."""

MIN_POSE_DIFFERENCE = 0.05
"""Poses differ clearly by more, rms in diagonals."""

MAX_TILT = 20.0
"""The up axis of a clip may lean by so much against that of its rest pose, degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """What brings one mesh to another: points become `scale * rotation @ point + offset`.

    Attributes
    ----------
    rotation : (3, 3) float64
        A signed permutation: a turn by quarters, perhaps mirrored.
    offset : (3,) float64
        File units of the other mesh.
    is_scaled, is_moved : bool
        Whether the scale and the place are fitted. A scale that is not is one between units.
    is_certain : bool
        Whether nothing else explains how the two differ.
    name : str
        How a cage differs, in plain words: `in centimetres instead of metres`. Empty while a
        transform is only tried.
    inflation : float
        By how much a transformed cage is too small, percent of the model's diagonal.
    """

    rotation: Floats
    scale: float
    offset: Floats = field(default_factory=lambda: np.zeros(3))
    is_scaled: bool = False
    is_moved: bool = False
    is_certain: bool = True
    name: str = ""
    inflation: float = 0.0

    @property
    def matrix(self) -> Floats:
        """Return the turn times the scale, (3, 3)."""
        return self.scale * self.rotation

    @property
    def is_turned(self) -> bool:
        """Whether axes change places or signs."""
        return bool((self.rotation != np.eye(3)).any())

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
        if self.is_turned:
            straight = (np.abs(self.rotation) == np.eye(3)).all()
            mirrored = 1 if straight else 2
            turns = 1 if self.up_axes else 2
            turns += mirrored * int(self.is_mirror)
        scales = 0 if self.scale == 1 else 1 if self.scale in COMMON_SCALES else 3
        scales = 3 if self.is_scaled else scales
        return turns + scales + 2 * int(self.is_moved)

    def apply(self, points: Floats) -> Floats:
        """Return points, (k, 3), brought to the other mesh."""
        return np.asarray(points @ self.matrix.T + self.offset)

    def apply_to_mesh(self, mesh: TriMesh) -> TriMesh:
        """Return a mesh brought to the other one, its faces turned if it is mirrored."""
        moved = TriMesh(self.apply(mesh.vertices), mesh.faces)
        return moved.flip() if self.is_mirror else moved

    def invert(self) -> "Transform":
        """Return what brings the other mesh to this one."""
        rotation, scale = self.rotation.T, 1 / self.scale
        offset = -scale * rotation @ self.offset
        return Transform(rotation, scale, offset, self.is_scaled, self.is_moved)

    @property
    def up_axes(self) -> tuple[str, str] | None:
        """The up axes of both, if it is turned from one to the other."""
        turns = UP_TURNS.items()
        return next((axes for axes, turn in turns if (self.rotation == turn.T).all()), None)

    @property
    def scene_name(self) -> str:
        """The unit and the up axis, `in metres instead of centimetres`; empty if both are right."""
        return ", ".join(filter(None, (self._unit_name, self._up_name)))

    @property
    def _unit_name(self) -> str:
        units = None if self.is_scaled else find_units_of_ratio(self.scale, 1e-9)
        if units is None:
            return ""
        own, other = (LONG_UNIT_NAMES[name] for name in units)
        return f"in {own} instead of {other}"

    @property
    def _up_name(self) -> str:
        if self.up_axes is None:
            return ""
        own, other = (axis.lower() for axis in self.up_axes)
        return f"with {own} up instead of {other} up"

    def describe(self, diagonal: float) -> str:
        """Say how a cage differs from what a model needs, to follow `the cage is`.

        A move by less than a thousandth of the model's diagonal is not worth a word.
        """
        parts = [self._up_name or _name_turn(self.rotation)]
        if self.scale != 1 or self.is_scaled:
            scaled = f"scaled by {1 / self.scale:{'.3g' if self.is_scaled else '.4g'}}"
            parts.append(self._unit_name or scaled)
        if np.linalg.norm(self.offset) > 1e-3 * diagonal:
            x, y, z = (f"{0 - value:.3g}" for value in self.offset)
            parts.append(f"moved by ({x}, {y}, {z})")
        return ", ".join(part for part in parts if part)

    def describe_poses(self, beside: str) -> str:
        """Say what was measured of poses, beside the edges that a message calls `beside`."""
        seen = []
        if self.scale != 1:
            size = f"{max(self.scale, 1 / self.scale):.4g} times as "
            size += "short" if self.scale > 1 else "long"
            seen.append(f"its edges are {size} as {beside}")
        if self.is_turned:
            seen.append("its poses are turned so")
        return ", and ".join(seen)


def _name_turn(rotation: Floats) -> str:
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
                yield Transform(rotation, scale)
                yield Transform(rotation, scale, is_moved=True)
        scale = float(np.max(inner / np.maximum(outer, np.finfo(float).tiny)))
        if (scale * outer <= most).all():
            yield Transform(rotation, scale, is_scaled=True)
            yield Transform(rotation, scale, is_scaled=True, is_moved=True)


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


def find_small_unit(mesh: TriMesh, model: TriMesh) -> Transform | None:
    """Return the unit in which a mesh that is much smaller than a model is where the model is."""
    if mesh.diagonal > model.diagonal / MAX_SIZE_RATIO:
        return None
    slack = MAX_BOX_SLACK * model.diagonal
    low, high = model.vertices.min(axis=0) - slack, model.vertices.max(axis=0) + slack
    for scale in UNIT_SCALES:
        points = scale * mesh.vertices
        is_within = (points >= low).all() and (points <= high).all()
        if scale >= MIN_CLEAR_RATIO and is_within and scale * mesh.diagonal > model.diagonal / 2:
            return Transform(np.eye(3), scale)
    return None


def find_pose_transform(
    pairs: Iterable[tuple[Floats, Floats]], ends: Integers, *, is_paired: bool = False
) -> Transform | None:
    """Find by which unit and up axis the first poses of pairs differ from the second ones.

    Parameters
    ----------
    pairs : iterable of ((n, 3), (n, 3))
        A given pose and a reference; positions may be nan. The others are taken only if the first
        pair differs.
    ends : (e, 2) int64
        The vertices of the edges.
    is_paired : bool
        Whether the pairs are of one moment each, so that all differ by the same turn if one does.

    Returns
    -------
    Transform, optional
        None if they fit. The scale is fitted if the edges differ by no ratio of two units.
    """
    rest = iter(pairs)
    first = next(rest)
    if _is_alike(first, ends):
        return None
    every = list(chain([first], rest))
    factor, is_unit = _find_factor(every, ends)
    scaled = [(factor * given, reference) for given, reference in every]
    axes, is_exact = _find_axes(scaled, is_paired)
    if factor == 1 and axes is None:
        return None
    is_certain = (factor == 1 or is_unit) and (axes is None or is_exact)
    if is_unit and axes is not None and not is_exact:
        axes, is_certain = None, True  # the unit alone is
    turn = np.eye(3) if axes is None else UP_TURNS[axes].T
    is_scaled = factor != 1 and not is_unit
    return Transform(turn, factor, is_scaled=is_scaled, is_certain=is_certain)


def measure_edge_ratios(given: Floats, reference: Floats, ends: Integers) -> Floats:
    """Return how many times as long the edges of a reference (n, 3) are.

    Returns
    -------
    (3,)
        The ratio that a tenth, a half and nine tenths of the edges are below.
    """
    lengths = [
        np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)
        for points in (given, reference)
    ]
    known = np.isfinite(lengths).all(axis=0) & (np.minimum(*lengths) > 0)
    if not known.any():
        return np.ones(3)
    return np.asarray(np.percentile(lengths[1][known] / lengths[0][known], [10, 50, 90]))


def _find_factor(pairs: list[tuple[Floats, Floats]], ends: Integers) -> tuple[float, bool]:
    """Return the factor between edges of the poses that differ least, and if units explain it."""
    ratios = np.array([measure_edge_ratios(given, other, ends) for given, other in pairs])
    low, nearest, high = ratios[np.abs(np.log(ratios[:, 1])).argmin()].tolist()
    if 1 / MAX_POSE_STRETCH <= nearest <= MAX_POSE_STRETCH:
        return 1.0, False
    units = find_units_of_ratio(nearest, UNIT_RATIO_TOL)
    is_clear = high <= MAX_EDGE_SPREAD * low or max(nearest, 1 / nearest) >= MIN_CLEAR_RATIO
    return (nearest, False) if units is None or not is_clear else (list_unit_ratios()[units], True)


def _is_alike(pair: tuple[Floats, Floats], ends: Integers) -> bool:
    """Return whether the edges have about one length, and neither pose lies on its side."""
    _, ratio, _ = measure_edge_ratios(*pair, ends).tolist()
    if not 1 / MAX_POSE_STRETCH <= ratio <= MAX_POSE_STRETCH:
        return False
    return not any(_measure_tilt(_find_rotation(*pair), axes) <= MAX_TILT for axes in UP_TURNS)


def _find_axes(
    pairs: list[tuple[Floats, Floats]], is_paired: bool
) -> tuple[tuple[str, str] | None, bool]:
    """Return the up axes by which all poses differ, and whether that is certain."""
    if any(_measure_distance(*pair) <= SAME_POSE_TOL for pair in pairs):
        return None, False
    rotations = [_find_rotation(*pair) for pair in pairs]
    for axes, turn in UP_TURNS.items():
        is_same = any(
            _measure_distance(given @ turn, reference) <= SAME_POSE_TOL
            and _measure_distance(given, reference) >= MIN_POSE_DIFFERENCE
            for given, reference in pairs
        )
        if all(_measure_tilt(rotation, axes) <= MAX_TILT for rotation in rotations):
            are_turned = all(_measure_angle(rotation, turn) <= MAX_TILT for rotation in rotations)
            return axes, is_same or (is_paired and are_turned)
        if is_same:
            return axes, True
    return None, False


def _find_rotation(given: Floats, reference: Floats) -> Floats:
    """Return the rotation (3, 3) of rows that brings a pose nearest to a reference."""
    known = np.isfinite(given).all(axis=1) & np.isfinite(reference).all(axis=1)
    given, reference = given[known], reference[known]
    if len(given) < 3:
        return np.eye(3)
    centred = np.ascontiguousarray(reference - reference.mean(axis=0))
    _, rotations = best_motions(np.ascontiguousarray(given)[None], centred, np.ones(len(given)))
    return np.asarray(rotations[0].T)


def _measure_tilt(rotation: Floats, axes: tuple[str, str]) -> float:
    """Return the angle between the first axis, turned, and the second one, degrees."""
    before, after = ("XYZ".index(axis) for axis in axes)
    return float(np.degrees(np.arccos(np.clip(rotation[before, after], -1, 1))))


def _measure_angle(rotation: Floats, turn: Floats) -> float:
    """Return the angle between two rotations, degrees."""
    cosine = (np.trace(rotation.T @ turn) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _measure_distance(given: Floats, reference: Floats) -> float:
    """Return the rms distance of two poses about their centroids, in diagonals."""
    known = np.isfinite(given).all(axis=1) & np.isfinite(reference).all(axis=1)
    given, reference = given[known], reference[known]
    if not len(reference):
        return 0.0
    apart = (given - given.mean(axis=0)) - (reference - reference.mean(axis=0))
    diagonal = float(np.linalg.norm(np.ptp(reference, axis=0)))
    return float(np.sqrt((apart**2).sum(axis=1).mean()) / diagonal) if diagonal > 0 else 0.0


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
