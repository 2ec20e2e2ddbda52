"""Weights that fit displacements best for given cages, affine-exact, smooth, near to harmonic.

With displacements D (m, 3k) of the model, B (n, 3k) of its cage, and s = tr(BBᵀ)/n, the weights
W = H + E minimise

    ‖Ω^½ (D − W B)‖² + λ s ‖E‖² + μ s ‖Λ E‖²,      E·1 = 0,  E·C = 0.

Rows of E are in the complement of span(1, C). In its basis Q of the eigenvectors of P BBᵀ P, with
eigenvalues s g_i, the columns of F = E Q separate, also with vertex weights Ω:

    (μ ΛᵀΛ + g_i Ω + λ) f_i = b_i,      b_i = Ω (D − H B) Bᵀ q_i / s.

A column lowers the sum by s |b_i|² / (g_i + λ) at most. The cage hardly moves in many directions
q_i; their columns are left 0.

A change of low rank, E = U Vᵀ, is fitted and not only truncated, U and V by turns. For given V, U
is the fit of a few columns. For given U, the rows of Vᵀ separate in the same eigenbasis:

    (g_i UᵀΩU + λ UᵀU + μ UᵀΛᵀΛU) Vᵀq_i = UᵀΩ (D − H B) Bᵀ q_i / s.

The displacements are in memory once. Sums of squares over the frames do not change when the columns
of D are turned by an orthogonal matrix, and a linear solve for the cages turns with them. In the
eigenvectors of DᵀD, the last columns are nearly 0; a fit to the others is the same, and faster.

The sparse systems of the columns are solved by conjugate gradients. All columns of a block take
their steps together, each with its own step lengths. The blocks do not depend on the number of
threads, so neither does the result.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import sparse_laplacian
from cageik_cli.method.weights.binding import Correction
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError
from cageik_cli.util.text import group_digits
from cageik_cli.util.threads import OrderedMap

AFFINE_FUNCTIONS = 4
"""1 and the three coordinates: the functions that weights reproduce."""

ROUNDING_TOL = 1e-5
"""Share of the diagonal by which files of few digits round positions."""

AFFINE_TOL = 1e-13
"""Weights nearer to affine exactness than this are left as they are."""

FRAMES_PER_PART = 16
"""Frames per block; constant, because the last digits depend on it."""

COMPRESSION_TOL = 2e-3
"""What a compression leaves out, relative to D, as root mean squares."""

MAX_BLOCK_COLUMNS = 20
"""Columns that are solved together, at most: they all take the steps of the slowest of them."""


def count_columns(m: int) -> int:
    """Return how many columns of `m` entries are solved together: of a long surface, fewer."""
    max_entries = 1 << 21  # 16 MiB
    return max(1, min(MAX_BLOCK_COLUMNS, max_entries // m))


class SurfaceLaplacian:
    """The operator ΛᵀΛ of a surface, with Λ the uniform Laplacian of its edges, (m, m) sparse."""

    def __init__(self, mesh: TriMesh) -> None:
        from scipy import sparse

        self.forward = sparse_laplacian(mesh)
        self._backward = sparse.csr_array(self.forward.T)
        self._diagonal = np.asarray(self.forward.power(2).sum(axis=0), np.float64)  # of ΛᵀΛ

    def apply(self, columns: Floats) -> Floats:
        """Return ΛᵀΛ times columns (m, b)."""
        return np.asarray(self._backward @ (self.forward @ columns))

    def measure(self, weights: Floats) -> float:
        """Return the Frobenius norm of Λ times weights (m, n): their roughness."""
        width = count_columns(len(weights))
        starts = range(0, weights.shape[1], width)
        parts = [np.square(self.forward @ weights[:, s : s + width]).sum() for s in starts]
        return float(np.sqrt(np.sum(parts)))

    def solve(
        self,
        right: Floats,
        start: Floats | None,
        *,
        smoothness: float,
        shifts: Floats,
        tolerance: float,
        max_steps: int,
    ) -> Floats:
        """Return the solutions, (m, b), for right-hand sides (m, b), from a first guess.

        Preconditioned with the diagonal. Columns that have converged take further steps with the
        others of their block.

        Parameters
        ----------
        smoothness : float
            μ.
        shifts : (1, b) or (m, b) float64
            s_i, above 0.
        tolerance : float
            The steps end when the residual of each column, relative to its right-hand side and in
            the preconditioned norm, is at most this.
        """
        inverse = 1 / (shifts + smoothness * self._diagonal[:, None])
        if not smoothness:
            return right * inverse

        def multiply(columns: Floats) -> Floats:
            image = self.apply(columns)
            image *= smoothness
            image += shifts * columns
            return image

        found = np.zeros_like(right) if start is None else start.copy()
        residual = right.copy() if start is None else right - multiply(start)
        conditioned = residual * inverse
        search = conditioned.copy()
        size = _dot_columns(residual, conditioned)
        goal = tolerance**2 * _dot_columns(right, right * inverse)
        for _ in range(max_steps):
            if (size <= goal).all():
                break
            image = multiply(search)
            length = _divide(size, _dot_columns(search, image))
            found += length * search
            image *= length
            residual -= image
            np.multiply(residual, inverse, out=conditioned)
            before, size = size, _dot_columns(residual, conditioned)
            search *= _divide(size, before)
            search += conditioned
        return found


def _dot_columns(left: Floats, right: Floats) -> Floats:
    return np.asarray(np.einsum("jb,jb->b", left, right))


def _divide(above: Floats, below: Floats) -> Floats:
    """Return the quotients; 0 where a column has nothing left to solve."""
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0)


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """Displacements D of frames from the rest pose, aligned with it.

    Attributes
    ----------
    parts : tuple of (m, 3b) float32 or float64
        Of all frames in memory, frame by frame; each part has `FRAMES_PER_PART` at most.
        Scaled by the roots of their shares, so that sums of squares weigh the frames.
    frames : (k,) int64
        The frames that count, in ascending order; the others are as if they were not there.
    shares : (K,) float64
        How many frames of the clips each frame in memory stands for.
    """

    parts: tuple[NDArray[np.floating], ...]
    frames: Integers
    shares: Floats

    @staticmethod
    def of(columns: NDArray[np.floating]) -> "Displacements":
        """Return displacements (m, 3k), all frames of which count."""
        count = columns.shape[1] // 3
        return Displacements.join(np.split(columns, count, axis=1), np.ones(count))

    @staticmethod
    def join(frames: Sequence[NDArray[np.floating]], shares: Floats) -> "Displacements":
        """Return the displacements of frames, (m, 3) each, that stand for `shares` frames."""
        parts = []
        for start in range(0, len(frames), FRAMES_PER_PART):
            part = np.hstack(frames[start : start + FRAMES_PER_PART])
            scales = np.sqrt(shares[start : start + FRAMES_PER_PART])
            part *= np.repeat(scales, 3).astype(part.dtype)
            parts.append(part)
        return Displacements(tuple(parts), np.arange(len(frames)), shares)

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def weight(self) -> float:
        """Return how many frames of the clips the frames that count stand for."""
        return float(self.shares[self.frames].sum())

    @property
    def nbytes(self) -> int:
        """Return the bytes that all frames in memory take."""
        return sum(part.nbytes for part in self.parts)

    def take(self, frames: Integers) -> "Displacements":
        """Return the displacements of some of the frames in memory; shares the memory."""
        return replace(self, frames=np.sort(np.asarray(frames, np.int64)))

    def blocks(self) -> Iterator[Floats]:
        """Yield the displacements of the frames that count, (m, 3b) float64, in blocks."""
        for first, part in zip(self._starts(), self.parts, strict=True):
            chosen = self._choose_columns(first, part)
            if len(chosen):
                columns = part if len(chosen) == part.shape[1] else part[:, chosen]
                yield np.ascontiguousarray(columns, np.float64)

    def read_rows(self, rows: slice) -> Floats:
        """Return some rows of D, of all frames that count, (p, 3k) float64."""
        chosen = [
            part[rows, self._choose_columns(first, part)]
            for first, part in zip(self._starts(), self.parts, strict=True)
        ]
        return np.hstack(chosen).astype(np.float64, copy=False)

    def multiply(self, factor: Floats) -> Floats:
        """Return D times `factor`, (3k, b), as (m, b)."""
        product = np.zeros((len(self.parts[0]), factor.shape[1]))
        done = 0
        for block in self.blocks():
            product += block @ factor[done : done + block.shape[1]]
            done += block.shape[1]
        return product

    def multiply_left(self, factor: Floats) -> Floats:
        """Return `factor`, (b, m), times D, as (b, 3k)."""
        return np.hstack([factor @ block for block in self.blocks()])

    def multiply_by_transpose(
        self, row_weights: Floats | None = None, max_entries: int = 1 << 20
    ) -> Floats:
        """Return DᵀΩD, (3k, 3k), with Ω the diagonal of `row_weights`, (m,), or the identity.

        So many entries of rows of D are multiplied at once.
        """
        count = 3 * len(self)
        rows = max(1, max_entries // count)
        product = np.zeros((count, count))
        for start in range(0, len(self.parts[0]), rows):
            block = self.read_rows(slice(start, start + rows))
            if row_weights is not None:
                block *= np.sqrt(row_weights[start : start + rows, None])
            product += block.T @ block
        return product

    def compress(self, row_weights: Floats | None = None) -> "Displacements":
        """Return displacements with fewer columns, whose fit is the same but for `COMPRESSION_TOL`.

        Their frames are sums of frames; no single frame can be measured on them. Row weights are
        those of the vertices in the fit, (m,).
        """
        basis = self.find_basis(COMPRESSION_TOL, row_weights)
        return self if basis is None else self.project(basis)

    def find_basis(self, tolerance: float, row_weights: Floats | None = None) -> Floats | None:
        """Return an orthonormal basis V of few columns, (3k, 3c), so that D V Vᵀ is nearly D.

        What it leaves out is at most `tolerance`, relative to D, as root mean squares. None where
        the columns are more than 0.8 of those of D, which would hardly be faster.
        """
        values, vectors = np.linalg.eigh(self.multiply_by_transpose(row_weights))
        left_out = np.cumsum(np.maximum(values, 0)) <= tolerance**2 * values.sum()
        count = -(-int(np.count_nonzero(~left_out)) // 3)
        if not 0 < count <= 0.8 * len(self):
            return None
        return np.asarray(vectors[:, ::-1][:, : 3 * count])

    def project(self, basis: Floats) -> "Displacements":
        """Return D times a basis, (3k, 3c), as displacements of c frames, of equal shares."""
        width, count = 3 * FRAMES_PER_PART, basis.shape[1] // 3
        starts = range(0, basis.shape[1], width)
        parts = [self.multiply(basis[:, s : s + width]) for s in starts]
        parts = [part.astype(self.parts[0].dtype, copy=False) for part in parts]
        return Displacements(tuple(parts), np.arange(count), np.full(count, self.weight / count))

    def _starts(self) -> list[int]:
        """Return the number of the first frame of each part."""
        return [0, *accumulate(part.shape[1] // 3 for part in self.parts[:-1])]

    def _choose_columns(self, first: int, part: NDArray[np.floating]) -> Integers:
        """Return the columns that count in a part which begins with frame `first`."""
        last = first + part.shape[1] // 3
        local = self.frames[(self.frames >= first) & (self.frames < last)] - first
        return np.asarray((3 * local[:, None] + np.arange(3)).ravel())


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Displacements of a model and of its cage.

    Attributes
    ----------
    target : Displacements
        D, of k frames.
    cages : (n, 3k) float64
        B.
    least : float
        Displacements per coordinate and frame, as root mean squares, below which a motion may be
        rounding: s does not fall with them, so that weights are not fitted to noise.
    """

    target: Displacements
    cages: Floats
    least: float = 0.0

    @property
    def scale(self) -> float:
        """Return s, the mean of squared displacements of a cage vertex, summed over frames.

        0 if and only if nothing moves.
        """
        moved = float(np.square(self.cages).sum() / len(self.cages))
        return max(moved, 3 * self.target.weight * self.least**2) if moved else 0.0

    def diagonalize(self, subspace: Floats) -> tuple[Floats, Floats]:
        """Return a basis of `subspace`, (n, r), that diagonalises BBᵀ in it, and its eigenvalues.

        The eigenvalues, (r,), ascend and are not negative.
        """
        along = self.cages.T @ subspace
        values, vectors = np.linalg.eigh(along.T @ along)
        return subspace @ vectors, np.maximum(values, 0)


@dataclass(frozen=True, slots=True, eq=False)
class WeightProblem:
    """What does not change while cages and weights are fitted to each other.

    Attributes
    ----------
    rest_weights : (m, n) float64
        H, affine-exact.
    complement : (n, n - 4) float64
        The directions of the rows of E, from `complement_basis`.
    vertex_weights : (m,) float64 or None
        The diagonal of Ω: not negative, 0 for missing data.
    regularization : float
        λ, above 0.
    smoothness : float
        μ, 0 or above.
    jobs : int
        Threads.
    tolerance : float
        Relative residual at which conjugate gradients end.
    max_steps : int
        Of conjugate gradients. Few suffice between two cage solves, as each begins where the last
        has ended.
    negligible : float
        Columns that can change the motion of the vertices by less than this share of it, as root
        mean squares, are not solved.
    """

    rest_weights: Floats
    complement: Floats
    surface: SurfaceLaplacian
    vertex_weights: Floats | None
    regularization: float
    smoothness: float
    jobs: int = 1
    tolerance: float = 1e-3
    max_steps: int = 5
    negligible: float = 1e-3

    def add_change(self, change: Correction) -> Floats:
        """Return the weights, (m, n), with a change."""
        return change.add_to(self.rest_weights)

    def fit(
        self, motion: Motion, start: Correction | None = None, subspace: Floats | None = None
    ) -> Correction:
        """Return the best change of the weights for these cages, from `start` as a first guess.

        The rows of the change are in `subspace`, (n, r): an orthonormal part of the complement,
        which is the default.
        """
        basis, gains = motion.diagonalize(self.complement if subspace is None else subspace)
        scale = motion.scale
        if not scale:
            return Correction(np.zeros((len(self.rest_weights), basis.shape[1])), basis)

        m, width = len(self.rest_weights), count_columns(len(self.rest_weights))
        row_weights = None if self.vertex_weights is None else self.vertex_weights[:, None]

        def solve_columns(first: int) -> Correction:
            block = slice(first, first + width)
            along = motion.cages.T @ basis[:, block]
            right = motion.target.multiply(along)
            right -= self.rest_weights @ (motion.cages @ along)
            if row_weights is not None:
                right *= row_weights
            right /= scale
            reached = np.square(right).sum(axis=0) / (gains[block] / scale + self.regularization)
            kept = np.flatnonzero(reached * len(basis) > self.negligible**2 * m)
            directions, shifts = basis[:, first + kept], gains[None, first + kept] / scale
            if row_weights is not None:
                shifts = row_weights * shifts
            columns = self.surface.solve(
                np.ascontiguousarray(right[:, kept]),
                None if start is None else start.express(directions),
                smoothness=self.smoothness,
                shifts=shifts + self.regularization,
                tolerance=self.tolerance,
                max_steps=self.max_steps,
            )
            return Correction(columns, directions)

        starts = range(0, basis.shape[1], width)
        with OrderedMap(solve_columns, starts, self.jobs, self.jobs) as solved:
            return Correction.join(solved, m, basis)

    def truncate(self, motion: Motion, whole: Correction, rank: int) -> Correction:
        """Return the change of at most `rank` that is nearest in the motion of the vertices."""
        basis, gains = motion.diagonalize(whole.basis)
        scales = np.sqrt(gains / (motion.scale or 1) + self.regularization)
        scaled = whole.express(basis) * scales
        vectors = np.linalg.eigh(scaled.T @ scaled)[1][:, ::-1][:, :rank]
        subspace = np.linalg.qr((basis / scales) @ vectors)[0]
        back = (vectors.T / scales) @ (basis.T @ subspace)
        return Correction((scaled @ vectors) @ back, subspace)

    def refit(self, motion: Motion, start: Correction) -> Correction:
        """Fit U to the V of `start`, whose rank stays the largest, and V to this U."""
        found = self.fit(motion, start, subspace=start.basis)
        left = found.columns
        basis, gains = motion.diagonalize(self.complement)
        scale = motion.scale
        if not scale or not left.any():
            return found
        weighted = left if self.vertex_weights is None else self.vertex_weights[:, None] * left
        smooth = self.regularization * left + self.smoothness * self.surface.apply(left)
        matrices = (gains / scale)[:, None, None] * (left.T @ weighted) + left.T @ smooth
        # A small ridge keeps systems solvable when columns of U vanish.
        ridge = 1e-14 * np.trace(matrices, axis1=1, axis2=2)
        matrices += ridge[:, None, None] * np.eye(left.shape[1])
        residual = motion.target.multiply_left(weighted.T)
        residual -= (weighted.T @ self.rest_weights) @ motion.cages
        right = (residual @ (motion.cages.T @ basis) / scale).T
        rows = np.linalg.solve(matrices, right[:, :, None])[:, :, 0]
        subspace, factor = np.linalg.qr(basis @ rows)
        return Correction(left @ factor.T, subspace)


def estimate_memory(m: int, n: int, jobs: int) -> int:
    """Return the bytes that a fit of (m, n) weights takes beside the displacements."""
    matrices = 3  # (m, n): H, and two of the changes before and after or the weights
    per_thread = 9 * count_columns(m) + 2 * 3 * FRAMES_PER_PART  # columns of m entries
    return 8 * m * (matrices * n + jobs * per_thread)


def complement_basis(cage: TriMesh) -> Floats:
    """Return an orthonormal basis of the vectors orthogonal to 1 and to the cage's coordinates.

    It is (n, n − 4). Rows of weights may change by these vectors; their sums and `weights @ cage`
    stay the same.
    """
    whole = np.linalg.qr(_affine_functions(cage), mode="complete")[0]
    return np.asarray(whole[:, AFFINE_FUNCTIONS:])


def restore_affine(weights: Floats, rest: TriMesh, cage: TriMesh) -> Floats:
    """Return the nearest weights, (m, n), whose rows sum to one and give the rest vertices.

    Weights that do so already, to rounding, are returned as they are.
    """
    functions = _affine_functions(cage)
    target = _evaluate(rest.vertices, cage)
    inverse = np.linalg.pinv(functions)
    for _ in range(2):  # the second step removes the rounding of the first
        missing = target - weights @ functions
        if np.abs(missing).max() <= AFFINE_TOL:
            break
        weights = weights + missing @ inverse
    return weights


def _affine_functions(cage: TriMesh) -> Floats:
    """Return 1 and the scaled coordinates at the vertices of the cage, (n, 4)."""
    functions = _evaluate(cage.vertices, cage)
    smallest = np.linalg.svd(functions[:, 1:], compute_uv=False)[-1]
    if len(functions) < AFFINE_FUNCTIONS or smallest < 1e-9:
        raise CageError(
            f"the {group_digits(len(functions))} vertices of the cage lie in a plane (thickness "
            f"{smallest:.1e} "
            "of the diagonal); weights in it cannot reproduce a model; use a cage with volume"
        )
    return functions


def _evaluate(points: Floats, cage: TriMesh) -> Floats:
    """Return 1 and the coordinates of points about the cage's centre, in its diagonals, (p, 4)."""
    scaled = (points - cage.vertices.mean(axis=0)) / cage.diagonal
    return np.column_stack([np.ones(len(points)), scaled])
