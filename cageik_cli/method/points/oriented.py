"""What turns with points that are moved: their normals, and the shapes and colours of splats.

An ellipsoid with the rotation R and the semi-axes s is the image of the unit ball under R diag(s).
A map J takes it to J R diag(s) = M, whose left singular vectors and singular values are the new
rotation and axes. They come from one-sided Jacobi rotations of the columns of M (Hestenes 1958),
which keep small axes to full relative precision, where the eigenvalues of M Mᵀ would lose them.
Columns of M that are orthogonal stay as they are: after a rigid motion every axis keeps its place,
and without shear nothing is exchanged between frames.

Colours are real spherical harmonics of bands 1 to 3. Signs and factors are those of Gaussian splats
(Kerbl et al. 2023, 3D Gaussian splatting). A rotation R takes a function f of directions to
f(Rᵀ d). A band of degree l stays in itself, and so the coefficients of the turned function follow
from its values in 2l + 1 fixed directions.

Arrays have one ellipsoid or function per column, so that each operation runs over all of them.
"""

from collections import Counter
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.rotations import nearest_rotations_by_entry
from cageik_cli.util.arrays import Floats

MIN_AXIS = float(np.exp(-80.0))
"""Shortest semi-axis: the logarithm of each is a number that files of splats may hold."""

REST_COUNTS = {(degree + 1) ** 2 - 1: degree for degree in range(4)}
"""The degree by the number of coefficients beyond the constant one."""

_DIRECTIONS = (
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 0, 0), (0, 1, 0), (1, -1, -1), (1, -1, 1), (1, 1, -1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1), (1, 0, 1), (1, -1, 0), (1, 1, -1)),
)
"""Where bands 1, 2 and 3 are sampled; the condition numbers of their values are below 2.4."""


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
        Coefficients of the colours beyond the constant ones, see `evaluate_band`.
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


def move_ellipsoids(axes: Floats, quaternions: Floats, maps: Floats) -> tuple[Floats, Floats]:
    """Return semi-axes and quaternions of the images of ellipsoids under linear maps J, (3, 3, m).

    The semi-axes are (3, m), the unit quaternions w, x, y, z of their rotation (4, m).
    An ellipsoid is the same when its axes are reversed, so that reflections give rotations, too. Of
    the two quaternions of a rotation, that closer to the one at rest is taken. An axis that a map
    takes to nothing, or that is shorter, becomes `MIN_AXIS`.
    """
    frames = quaternions_to_rotations(quaternions)
    frames *= axes
    columns = np.empty_like(frames)
    for i in range(3):
        for k in range(3):
            np.multiply(maps[i, 0], frames[0, k], out=columns[i, k])
            columns[i, k] += maps[i, 1] * frames[1, k]
            columns[i, k] += maps[i, 2] * frames[2, k]
    _orthogonalize(columns)
    lengths = np.sqrt(np.einsum("ikm,ikm->km", columns, columns))
    with np.errstate(all="ignore"):  # those without a length are replaced
        columns /= lengths
    # An axis that is shorter has no direction of its own.
    is_flat = ~(lengths.min(axis=0) > 1e-13 * lengths.max(axis=0))
    if is_flat.any():
        # Those get a whole frame by singular value decomposition.
        with np.errstate(all="ignore"):
            images = np.nan_to_num(columns[:, :, is_flat]) * lengths[:, is_flat]
        left, values, _ = np.linalg.svd(images.transpose(2, 0, 1))
        columns[:, :, is_flat], lengths[:, is_flat] = left.transpose(1, 2, 0), values.T
    columns[:, 2] *= np.where(determinants(columns) < 0, -1.0, 1.0)
    moved = rotations_to_quaternions(columns)
    moved *= np.where((moved * quaternions).sum(axis=0) < 0, -1.0, 1.0)
    return np.maximum(lengths, MIN_AXIS), moved


def _orthogonalize(columns: Floats) -> None:
    """Rotate the columns k of matrices, (3, 3, m) indexed [entry, k], until they are orthogonal."""
    for _ in range(12):  # four or five sweeps suffice
        largest = 0.0
        for first, second in ((0, 1), (0, 2), (1, 2)):
            p, q = columns[:, first], columns[:, second]
            product, square, other = _dot(p, q), _dot(p, p), _dot(q, q)
            bound = np.sqrt(square) * np.sqrt(other)
            is_skew = np.abs(product) > 1e-15 * bound
            if not is_skew.any():
                continue
            with np.errstate(all="ignore"):  # a quotient by zero is not used
                largest = max(largest, float(np.max(np.abs(product[is_skew]) / bound[is_skew])))
                ratio = (other - square) / (2 * product)
                tangent = np.copysign(1 / (np.abs(ratio) + np.sqrt(1 + ratio * ratio)), ratio)
            tangent = np.where(is_skew, tangent, 0.0)
            cosine = 1 / np.sqrt(1 + tangent * tangent)
            sine = cosine * tangent
            turned = cosine * p - sine * q
            columns[:, second] = sine * p + cosine * q
            columns[:, first] = turned
        # Convergence is quadratic: what is left is of the order of the square.
        if largest < 1e-8:
            return


def _dot(left: Floats, right: Floats) -> Floats:
    return np.asarray(left[0] * right[0] + left[1] * right[1] + left[2] * right[2])


def determinants(matrices: Floats) -> Floats:
    """Return the determinants of matrices (3, 3, m), (m,)."""
    a, b, c = matrices
    return _dot(a, np.stack([b[k - 2] * c[k - 1] - b[k - 1] * c[k - 2] for k in range(3)]))


def quaternions_to_rotations(quaternions: Floats) -> Floats:
    """Return the rotations, (3, 3, m), of unit quaternions w, x, y, z, (4, m)."""
    w, x, y, z = quaternions
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.asarray(rows)


def rotations_to_quaternions(rotations: Floats) -> Floats:
    """Return unit quaternions w, x, y, z, (4, m), of rotations (3, 3, m).

    4 q qᵀ is linear in the rotation; its column with the largest diagonal entry is well conditioned
    (Shepperd 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = rotations
    outer = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, d + b, c + g],
            [c - g, d + b, 1 - a + e - i, h + f],
            [d - b, c + g, h + f, 1 - a - e + i],
        ]
    )
    diagonal = np.stack([outer[k, k] for k in range(4)])
    chosen = diagonal.argmax(axis=0)
    found = np.take_along_axis(outer, chosen[None, None], axis=1)[:, 0]
    return np.asarray(found / np.sqrt((found * found).sum(axis=0)))


def evaluate_band(degree: int, directions: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the 2 `degree` + 1 harmonics of one band at unit directions, (3, ...), each (...)."""
    x, y, z = directions
    if degree == 1:
        factor = 0.4886025119029199
        return [-factor * y, factor * z, -factor * x]
    xx, yy, zz = x * x, y * y, z * z
    total = xx + yy
    if degree == 2:
        a, b, c = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
        return [a * x * y, -a * y * z, b * (2 * z * z - total), -a * x * z, c * (xx - yy)]
    a, b, c = 0.5900435899266435, 2.890611442640554, 0.4570457994644658
    d, e = 0.3731763325901154, 1.445305721320277
    middle = c * (4 * zz - total)
    return [
        -a * y * (3 * xx - yy),
        b * x * y * z,
        -y * middle,
        d * z * (2 * zz - 3 * total),
        -x * middle,
        e * z * (xx - yy),
        -a * x * (xx - 3 * yy),
    ]


@cache
def _samples(degree: int) -> tuple[Floats, Floats]:
    """Return unit directions, (2l + 1, 3), and the map from values there to coefficients."""
    directions = np.array(_DIRECTIONS[degree - 1], np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    values = np.stack(evaluate_band(degree, directions.T), axis=1)
    return directions, np.linalg.inv(values)


def rotate_harmonics(
    coefficients: NDArray[np.float32], rotations: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the coefficients of turned functions.

    Parameters
    ----------
    coefficients : (3, c, m) float32
        Of three colours; c is one of `REST_COUNTS`: whole bands from the first on.
    rotations : (3, 3, m) float32
    """
    turned = np.empty_like(coefficients)
    start = 0
    for degree in range(1, REST_COUNTS[coefficients.shape[1]] + 1):
        band = slice(start, start + 2 * degree + 1)
        directions, to_coefficients = _samples(degree)
        turned_back = np.tensordot(directions.astype(np.float32), rotations, 1).swapaxes(0, 1)
        values = np.zeros((2 * degree + 1, 3, coefficients.shape[2]), np.float32)
        product = np.empty_like(values)
        for i, basis in enumerate(evaluate_band(degree, turned_back)):
            values += np.multiply(basis[:, None], coefficients[:, start + i], out=product)
        found = to_coefficients.astype(np.float32) @ values.reshape(2 * degree + 1, -1)
        turned[:, band] = found.reshape(values.shape).swapaxes(0, 1)
        start = band.stop
    return turned
