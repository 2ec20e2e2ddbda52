"""Transforms between a cage and its model, and what to call them in plain words."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

UNITS = {
    "metres": 1.0,
    "centimetres": 0.01,
    "millimetres": 0.001,
    "inches": 0.0254,
    "feet": 0.3048,
}
"""Lengths in metres."""

UP_CHANGES: dict[tuple[int, ...], str] = {
    (1, 0, 0, 0, 0, 1, 0, -1, 0): "with z up instead of y up",
    (1, 0, 0, 0, 0, -1, 0, 1, 0): "with y up instead of z up",
}
"""The turns between programs that count heights along y and along z; rows of the matrix."""

COMMON_SCALES = (0.01, 100, 0.001, 1000, 0.0254, 1 / 0.0254)
"""Scales between metres and what else programs count in."""

RARE_SCALES = tuple(
    scale for factor in (10, 2.54, 25.4, 0.3048, 30.48, 12) for scale in (factor, 1 / factor)
)
"""Scales between the others."""

UNIT_SCALES = (*COMMON_SCALES, *RARE_SCALES)
"""All scales that have a name."""

MIN_MOVE = 1e-3
"""A move by less, in diagonals of the model, is not worth a word."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """What brings a cage to its model: points become `matrix @ point + offset`.

    Attributes
    ----------
    name : str
        How the cage differs, in plain words: `in centimetres instead of metres`.
    matrix : (3, 3) float64
        A turn by quarters, perhaps mirrored, times the scale.
    offset : (3,) float64
        File units of the model.
    inflation : float
        By how much the transformed cage is too small, percent of the model's diagonal.
    """

    name: str
    matrix: Floats
    offset: Floats
    inflation: float

    @property
    def is_mirror(self) -> bool:
        """Whether faces must be turned, too."""
        return bool(np.linalg.det(self.matrix) < 0)

    def apply(self, points: Floats) -> Floats:
        """Return points, (k, 3), brought to the model."""
        return np.asarray(points @ self.matrix.T + self.offset)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A transform that is tried.

    Attributes
    ----------
    rotation : (3, 3) float64
        A signed permutation.
    offset : (3,) float64
    is_scaled, is_moved : bool
        Whether the scale and the place are fitted. A scale that is not is one between units.
    """

    rotation: Floats
    scale: float
    offset: Floats
    is_scaled: bool = False
    is_moved: bool = False

    @property
    def is_fitted(self) -> bool:
        """Whether anything is."""
        return self.is_scaled or self.is_moved

    @property
    def complexity(self) -> int:
        """How many things are different at once: simple explanations go first."""
        turns = 0
        if (self.rotation != np.eye(3)).any():
            straight = (np.abs(self.rotation) == np.eye(3)).all()
            mirrored = 1 if straight else 2
            turns = 1 if _find_up_change(self.rotation) else 2
            turns += mirrored * int(np.linalg.det(self.rotation) < 0)
        scales = 0 if self.scale == 1 else 1 if self.scale in COMMON_SCALES else 3
        scales = 3 if self.is_scaled else scales
        return turns + scales + 2 * int(self.is_moved)

    def apply_to_mesh(self, mesh: TriMesh) -> TriMesh:
        """Return a mesh brought to the model, its faces turned if it is mirrored."""
        points = mesh.vertices @ (self.scale * self.rotation).T + self.offset
        moved = TriMesh(points, mesh.faces)
        return moved.flip() if np.linalg.det(self.rotation) < 0 else moved


def name_candidate(candidate: Candidate, diagonal: float) -> str:
    """Say how the cage differs from what the model needs, to follow `the cage is`."""
    parts = [_name_rotation(candidate.rotation)]
    if candidate.is_scaled:
        parts.append(f"scaled by {1 / candidate.scale:.3g}")
    elif candidate.scale != 1:
        parts.append(_name_unit(candidate.scale))
    if np.linalg.norm(candidate.offset) > MIN_MOVE * diagonal:
        x, y, z = (f"{0 - value:.3g}" for value in candidate.offset)
        parts.append(f"moved by ({x}, {y}, {z})")
    return ", ".join(part for part in parts if part)


def _name_unit(scale: float) -> str:
    for own, length in UNITS.items():
        for other, other_length in UNITS.items():
            if np.isclose(length / other_length, scale, rtol=1e-9):
                return f"in {own} instead of {other}"
    return f"scaled by {1 / scale:.4g}"


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
