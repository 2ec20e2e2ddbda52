"""A rest model bound to its cage: the weights, and measures of their quality."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import frames_to_columns, place_columns
from cageik_cli.method.weights.settings import COORDINATES, BindSettings
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.messages import Note
from cageik_cli.util.threads import OrderedMap

FRAMES_PER_PRODUCT = 4
"""Frames per matrix product; constant, because the last digits depend on it."""

BYTES_PER_PRODUCT = 1 << 22
"""Bytes of the weights of a product; constant, too.

They stay in the cache for the next frames, as the result does until it is in its place.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Coordinates of m points in a cage of n vertices.

    Attributes
    ----------
    values : (m, n) float64
        Rows sum to one, and `values @ cage.vertices` are the points.
    panels : int
        Number of panels the cage was divided into; 0 for coordinates in closed form.
    error : float
        Estimate of the mean over points of a row's L1 distance from the exact coordinates; 0 in
        closed form.
    surface_error : float
        The same just inside the cage, measured, as a mean over panels of higher degree; 0 if there
        are none.
    """

    values: Floats
    panels: int = 0
    error: float = 0.0
    surface_error: float = 0.0


@dataclass(frozen=True, slots=True)
class WeightQuality:
    """Measures of the quality of weights.

    Attributes
    ----------
    partition_of_unity : float
        Largest distance of a row's sum from one.
    linear_precision : float
        Largest distance of `weights @ cage` from the rest vertices, in diagonals.
    min_weight : float
        Smallest weight. Exact harmonic weights are never negative, so this measures the
        discretisation error.
    panels : int
        Number of panels the cage was divided into; 0 for coordinates in closed form.
    estimated_error : float
        Estimate of the mean row L1 distance from exact coordinates.
    projected : int
        Number of vertices outside that have the weights of the closest point of the cage.
    """

    partition_of_unity: float
    linear_precision: float
    min_weight: float
    panels: int
    estimated_error: float
    projected: int


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A change of weights of low rank, E = `columns @ basis.T`.

    Attributes
    ----------
    columns : (m, r) float64
    basis : (n, r) float64
        Orthonormal, and orthogonal to 1 and to the cage's coordinates.
    """

    columns: Floats
    basis: Floats

    @staticmethod
    def none(m: int, n: int) -> Correction:
        """Return the change of (m, n) weights that changes nothing."""
        return Correction(np.empty((m, 0)), np.empty((n, 0)))

    @staticmethod
    def join(parts: Iterable[Correction], m: int, basis: Floats) -> Correction:
        """Join changes whose bases are different columns of `basis`, (n, r), in this order."""
        columns, kept = np.empty((m, basis.shape[1])), np.empty_like(basis)
        count = 0
        for part in parts:
            end = count + part.basis.shape[1]
            columns[:, count:end], kept[:, count:end] = part.columns, part.basis
            count = end
        return Correction(columns[:, :count], kept[:, :count])

    def express(self, basis: Floats) -> Floats:
        """Return E times basis vectors (n, b), as (m, b)."""
        return np.asarray(self.columns @ (self.basis.T @ basis))

    def add_to(self, weights: Floats) -> Floats:
        """Return `weights`, (m, n), with the change."""
        changed = self.columns @ self.basis.T
        changed += weights
        return np.asarray(changed)


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """What is unknown of k frames: with a binding, it gives their meshes.

    Attributes
    ----------
    cages : (k, n, 3) float64
    rotations : (k, 3, 3) float64, optional
        Of the rest pose to each frame: `points @ R`. They turn the offsets of a binding that has
        them; where it has none, they may be unknown.
    """

    cages: Floats
    rotations: Floats | None = None

    def __len__(self) -> int:
        return len(self.cages)

    def __getitem__(self, frames: slice | Integers) -> Poses:
        """Return those of some of the frames."""
        turns = None if self.rotations is None else self.rotations[frames]
        return Poses(self.cages[frames], turns)


@dataclass(frozen=True, eq=False)
class Binding:
    """A model bound to a cage: `weights @ cage.vertices` is `rest.vertices`.

    Attributes
    ----------
    rest : TriMesh
        m vertices.
    cage : TriMesh
        n vertices, outward.
    weights : (m, n) float64
        H; each row sums to one.
    projected : int
        As in `WeightQuality`.
    notes : tuple of Note
        Changes of the cage, and warnings about the weights, one sentence each.
    has_offsets : bool
        Whether `weights @ cage.vertices` is not the rest pose, as of weights with few influences.
        A frame is then W c + R (X - W C), with R the rotation of the rest pose to the frame.

    Examples
    --------
    >>> from cageik_cli import bind, load_mesh
    >>> cage = load_mesh("data_fixtures/walker/cage.obj")
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> binding = bind(rest, cage, coordinates="mean-value")
    >>> binding
    <Binding: 1570 vertices in a cage of 80, mean-value>
    >>> bool(binding.quality.linear_precision < 1e-9)
    True
    """

    rest: TriMesh
    cage: TriMesh
    weights: Floats
    settings: BindSettings = field(default_factory=BindSettings)
    panels: int = 0
    estimated_error: float = 0.0
    projected: int = 0
    notes: tuple[Note, ...] = ()
    has_offsets: bool = False

    def __repr__(self) -> str:
        settings = [self.settings.coordinates]
        if COORDINATES[self.settings.coordinates].needs_accuracy:
            settings.append(self.settings.accuracy)
        count, cage_count = len(self.rest.vertices), len(self.cage.vertices)
        return f"<Binding: {count} vertices in a cage of {cage_count}, {', '.join(settings)}>"

    @cached_property
    def offsets(self) -> Floats | None:
        """Return what `weights @ cage` lacks to the rest pose, X - W C, (m, 3), if it has any."""
        if not self.has_offsets:
            return None
        origin = self.cage.vertices.mean(axis=0)
        reconstruction = self.weights @ (self.cage.vertices - origin)
        return np.asarray((self.rest.vertices - origin) - reconstruction)

    @property
    def rebuilt_rest(self) -> Floats:
        """Return the mesh that the rest cage gives, (m, 3)."""
        return self.rest.vertices if self.has_offsets else self.weights @ self.cage.vertices

    @cached_property
    def quality(self) -> WeightQuality:
        """Measure the quality of the weights."""
        return WeightQuality(
            partition_of_unity=float(np.abs(self.weights.sum(axis=1) - 1).max()),
            linear_precision=reproduction_error(self.rest.vertices, self),
            min_weight=float(self.weights.min()),
            panels=self.panels,
            estimated_error=self.estimated_error,
            projected=self.projected,
        )


def reproduction_error(points: Floats, binding: Binding) -> float:
    """Return the largest distance of `weights @ cage` from `points`, (m, 3), in rest diagonals.

    Vertices that are in no face do not count: they may be outside the cage.
    """
    used = binding.rest.used_vertices
    origin = points[used].mean(axis=0)
    reconstruction = binding.weights @ (binding.cage.vertices - origin)
    distances = np.linalg.norm(reconstruction[used] - (points[used] - origin), axis=1)
    return float(distances.max() / binding.rest.diagonal)


def reconstruct_frames(
    binding: Binding, poses: Poses, out: Floats | None = None, jobs: int = 1
) -> Floats:
    """Return the meshes (k, m, 3) of poses, with turned offsets if there are any.

    `out` and `jobs` are as of `reconstruct`.
    """
    meshes = reconstruct(binding.weights, poses.cages, out, jobs)
    if binding.offsets is not None:
        assert poses.rotations is not None
        meshes += binding.offsets @ poses.rotations
    return meshes


def reconstruct(weights: Floats, cages: Floats, out: Floats | None = None, jobs: int = 1) -> Floats:
    """Return the meshes (k, m, 3) of cages (k, n, 3) for weights (m, n).

    They are in `out`, if that is given. The number of threads does not change them, if each has
    the linear algebra in one thread.
    """
    meshes = np.empty((len(cages), len(weights), 3)) if out is None else out
    blocks = [
        slice(start, start + FRAMES_PER_PRODUCT)
        for start in range(0, len(cages), FRAMES_PER_PRODUCT)
    ]
    columns = [frames_to_columns(cages[block]) for block in blocks]
    origins = np.zeros((FRAMES_PER_PRODUCT, 3))

    def fill(rows: slice) -> None:
        for block, cage in zip(blocks, columns, strict=True):
            frames = meshes[block]
            place_columns(weights[rows] @ cage, origins[: len(frames)], frames, rows.start)

    parts = divide_rows(*weights.shape)
    if jobs == 1 or len(parts) == 1:
        for rows in parts:
            fill(rows)
        return meshes
    with OrderedMap(fill, parts, jobs, 2 * jobs) as filled:
        for _ in filled:
            pass
    return meshes


def divide_rows(count: int, columns: int) -> list[slice]:
    """Divide the rows of weights into parts of `BYTES_PER_PRODUCT`; the last has the rest, too.

    A smaller part could have other last digits: its products take another way through the linear
    algebra.
    """
    size = max(64, BYTES_PER_PRODUCT // (8 * max(1, columns)) // 64 * 64)
    bounds = [*range(0, max(1, count // size) * size, size), count]
    return [slice(start, stop) for start, stop in pairwise(bounds)]
