"""How a cage may differ from the one that its model needs: unit, axes, place, and inflation."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.surface_points import sample_surface, take_evenly
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats
from cageik_cli.util.units import LONG_UNIT_NAMES, find_units_of_ratio, list_unit_ratios

COMMON_SCALES = tuple(
    list_unit_ratios()[pair] for name in ("cm", "mm", "in") for pair in ((name, "m"), ("m", name))
)
"""Scales between metres and what else most programs count in."""

UNIT_SCALES = tuple(dict.fromkeys((*COMMON_SCALES, *list_unit_ratios().values())))
"""All scales that have a name: those, and the rare ones between the others."""

UP_CHANGES: dict[tuple[int, ...], str] = {
    (1, 0, 0, 0, 0, 1, 0, -1, 0): "with z up instead of y up",
    (1, 0, 0, 0, 0, -1, 0, 1, 0): "with y up instead of z up",
}
"""The turns between programs that count heights along y and along z; rows of the matrix."""

MAX_INFLATION = 20.0
"""Cages that must grow by more, percent of the model's diagonal, are not this model's."""

INFLATION_TOL = 0.01
"""The inflation is found to this share of itself."""


UP_AXES_OF_TURNS = dict(zip(UP_CHANGES.values(), (("Z", "Y"), ("Y", "Z")), strict=True))
"""The up axes before and after these turns."""


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
            parts.append(_name_unit(self.scale))
        if np.linalg.norm(self.offset) > 1e-3 * diagonal:
            x, y, z = (f"{0 - value:.3g}" for value in self.offset)
            parts.append(f"moved by ({x}, {y}, {z})")
        return ", ".join(part for part in parts if part)


def _name_unit(scale: float) -> str:
    units = find_units_of_ratio(scale, 1e-9)
    if units is None:
        return f"scaled by {1 / scale:.4g}"
    own, other = (LONG_UNIT_NAMES[name] for name in units)
    return f"in {own} instead of {other}"


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
