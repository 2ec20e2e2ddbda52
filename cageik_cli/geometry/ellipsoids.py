"""Ellipsoids moved by linear maps: new axes and a new rotation, for many at once.

An ellipsoid with the rotation R and the semi-axes s is the image of the unit ball under R diag(s).
A map J takes it to J R diag(s) = M, whose left singular vectors and singular values are the new
rotation and axes. They come from one-sided Jacobi rotations of the columns of M (Hestenes 1958),
which keep small axes to full relative precision, where the eigenvalues of M Mᵀ would lose them.
Columns of M that are orthogonal stay as they are: after a rigid motion every axis keeps its place,
and without shear nothing is exchanged between frames.

Arrays hold one ellipsoid per column, entry by entry.
"""

import numpy as np

from cageik_cli.util.arrays import Floats, Mask

MIN_AXIS = float(np.exp(-80.0))
"""Shortest semi-axis: the logarithm of each is a number that files of splats may hold."""


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
        _replace_flat(columns, lengths, is_flat)
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


def _replace_flat(columns: Floats, axes: Floats, is_flat: Mask) -> None:
    """Give ellipsoids with an axis of no length a whole frame, by singular value decomposition."""
    lengths = axes[:, is_flat]
    with np.errstate(all="ignore"):
        moved = np.nan_to_num(columns[:, :, is_flat]) * lengths
    left, values, _ = np.linalg.svd(moved.transpose(2, 0, 1))
    columns[:, :, is_flat], axes[:, is_flat] = left.transpose(1, 2, 0), values.T


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
