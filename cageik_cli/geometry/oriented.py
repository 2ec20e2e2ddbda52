"""What turns with points that are moved: their normals, and the shapes and colours of splats."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.ellipsoids import determinants, move_ellipsoids
from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.geometry.spherical_harmonics import rotate_harmonics
from cageik_cli.util.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """m Gaussians, one per column, without their places.

    Attributes
    ----------
    axes : (3, m) float64
        Standard deviations along their axes.
    quaternions : (4, m) float64
        The rotation of the axes: w, x, y, z, of length one.
    harmonics : (3, c, m) float32
        Coefficients of the colours beyond the constant ones, see `spherical_harmonics`.
    """

    axes: Floats
    quaternions: Floats
    harmonics: NDArray[np.float32]

    def __getitem__(self, chosen: slice) -> "Splats":
        """Return some of them."""
        return Splats(
            self.axes[:, chosen], self.quaternions[:, chosen], self.harmonics[:, :, chosen]
        )


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
    return Splats(*move_ellipsoids(rest.axes, rest.quaternions, maps), harmonics)


def count_map_faults(maps: Floats) -> Counter[str]:
    """Count the maps, (3, 3, m), that turn space inside out ("mirrored") or make it "flat".

    The determinant of a flat map is below 1e-9 times its norm cubed.
    """
    volume = determinants(maps)
    squares = np.einsum("ikm,ikm->m", maps, maps)
    limit = 1e-9 * squares * np.sqrt(squares)
    is_flat = np.abs(volume) <= limit
    mirrored = np.count_nonzero((volume < 0) & ~is_flat)
    return Counter(mirrored=int(mirrored), flat=int(np.count_nonzero(is_flat)))


@dataclass(frozen=True, slots=True, eq=False)
class Oriented:
    """What a linear map changes of m points, one per column, besides their places.

    Attributes
    ----------
    normals : (3, m) float64, optional
    """

    normals: Floats | None = None
    splats: Splats | None = None

    def __getitem__(self, chosen: slice) -> "Oriented":
        """Return that of some points."""
        return Oriented(
            None if self.normals is None else self.normals[:, chosen],
            None if self.splats is None else self.splats[chosen],
        )

    def move(self, maps: Floats) -> "Oriented":
        """Return it under linear maps J, (3, 3, m)."""
        return Oriented(
            None if self.normals is None else move_normals(self.normals, maps),
            None if self.splats is None else move_splats(self.splats, maps),
        )


def move_normals(normals: Floats, maps: Floats) -> Floats:
    """Return normals (3, m) under linear maps J, (3, 3, m): J⁻ᵀ n, of length 1.

    They stay across surfaces that the maps move. The cofactors of J are det J · J⁻ᵀ: only the sign
    is lost, and a map that flattens space has them, too. A normal that is zero or not finite stays
    as it is, and so does one that a map leaves no direction.
    """
    with np.errstate(all="ignore"):  # what fails is replaced
        sizes = np.abs(maps).max(axis=(0, 1))
        unit = maps / sizes  # squares of tiny maps vanish
        scaled = normals / np.abs(normals).max(axis=0)
        moved = np.empty_like(normals)
        for i in range(3):
            rows = unit[i - 2], unit[i - 1]
            cofactors = [
                rows[0][k - 2] * rows[1][k - 1] - rows[0][k - 1] * rows[1][k - 2] for k in range(3)
            ]
            moved[i] = sum(cofactors[k] * scaled[k] for k in range(3))
        moved *= np.where(determinants(unit) < 0, -1.0, 1.0)
        largest = np.abs(moved).max(axis=0)
        moved /= largest
        moved /= np.sqrt((moved * moved).sum(axis=0))
    return np.where(np.isfinite(moved).all(axis=0), moved, normals)
