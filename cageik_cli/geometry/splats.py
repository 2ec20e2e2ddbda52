"""Gaussian splats moved by linear maps: covariances J Σ Jᵀ, and colours that turn with them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.ellipsoids import Ellipsoids, determinants, move_ellipsoids
from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.geometry.spherical_harmonics import rotate_harmonics
from cageik_cli.util.arrays import Floats

FLAT_TOL = 1e-9
"""A map whose determinant is below this share of its norm cubed makes splats flat."""


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """m Gaussians, one per column, without their places.

    Attributes
    ----------
    ellipsoids : Ellipsoids
        Standard deviations along their axes, and the rotation of these.
    harmonics : (3, c, m) float32
        Coefficients of the colours beyond the constant ones, see `spherical_harmonics`.
    """

    ellipsoids: Ellipsoids
    harmonics: NDArray[np.float32]

    def __getitem__(self, chosen: slice) -> "Splats":
        """Return some of them."""
        axes, quaternions = self.ellipsoids.axes, self.ellipsoids.quaternions
        held = Ellipsoids(axes[:, chosen], quaternions[:, chosen])
        return Splats(held, self.harmonics[:, :, chosen])


@dataclass(frozen=True, slots=True)
class MapFaults:
    """How many maps turn space inside out, and how many make it flat."""

    mirrored: int = 0
    flat: int = 0

    def __add__(self, other: "MapFaults") -> "MapFaults":
        return MapFaults(self.mirrored + other.mirrored, self.flat + other.flat)


def move_splats(rest: Splats, maps: Floats) -> Splats:
    """Return the splats under linear maps J, (3, 3, m).

    The colours turn with the rotation nearest to J: a splat that is stretched keeps what each of
    its sides looks like.
    """
    harmonics = rest.harmonics
    if harmonics.shape[1]:
        entries = np.ascontiguousarray(maps).reshape(9, -1)
        rotations = nearest_rotations_by_entry(entries).reshape(maps.shape)
        harmonics = rotate_harmonics(harmonics, rotations.astype(np.float32))
    return Splats(move_ellipsoids(rest.ellipsoids, maps), harmonics)


def count_map_faults(maps: Floats) -> MapFaults:
    """Count the maps, (3, 3, m), that turn space inside out or make it flat."""
    volume = determinants(maps)
    squares = np.einsum("ikm,ikm->m", maps, maps)
    limit = FLAT_TOL * squares * np.sqrt(squares)
    is_flat = np.abs(volume) <= limit
    mirrored = np.count_nonzero((volume < 0) & ~is_flat)
    return MapFaults(int(mirrored), int(np.count_nonzero(is_flat)))
