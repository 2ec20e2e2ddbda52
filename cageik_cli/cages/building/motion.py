"""What a cage can express of a motion, and what single edits of the cage would change in that."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.coordinates.harmonic import MAX_FACES, harmonic_weights
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers

MAX_POINTS = 1200
"""Points at which a motion is looked at."""

MAX_RANK = 40
"""Directions that a motion is reduced to."""

ALPHA = 1e-3
"""Weight of the smoothness of the cage, as in an extraction."""

SPLIT_SHARE = 0.4
"""Edges for which splits are measured together, over the number of vertices, at most."""

TINY = 1e-12
"""What a gain or a loss is divided by, at least: an edit that changes nothing gains nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Displacements of points of a model from its rest pose, reduced to their main directions.

    Attributes
    ----------
    points : (s, 3) float64
        In the rest pose, units of the model.
    displacements : (s, r) float64
        Left singular vectors of the displacements, times their singular values.
    """

    points: Floats
    displacements: Floats

    @staticmethod
    def reduce(rest: Floats, posed: Floats) -> "Motion":
        """Return the motion of poses (k, m, 3) that are rigidly aligned to the rest pose (m, 3)."""
        step = max(1, -(-len(rest) // MAX_POINTS))
        points = rest[::step]
        moves = (posed[:, ::step] - points).transpose(1, 0, 2).reshape(len(points), -1)
        left, size, _ = np.linalg.svd(moves, full_matrices=False)
        return Motion(points, left[:, :MAX_RANK] * size[:MAX_RANK])


@dataclass(frozen=True, slots=True, eq=False)
class EditGains:
    """How edits of a cage change what a motion cannot be expressed in.

    Attributes
    ----------
    error : float
        Squared error of the cage as it is, without the cost of its smoothness.
    squares : (s,) float64
        The part that each point of the motion has in it.
    splits : (k, 2) int64
        Ends of edges that may be split at their middle. No two of them are sides of one face.
    gains : (k,) float64
        By how much each split lowers the error and that cost.
    edges : (e, 2) int64
        Ends of all edges.
    losses : (e,) float64
        By how much it raises both to merge the ends of each.
    """

    error: float
    squares: Floats
    splits: Integers
    gains: Floats
    edges: Integers
    losses: Floats


def measure_edits(cage: TriMesh, motion: Motion, squares: Floats | None = None) -> EditGains:
    """Measure what splits and collapses of edges change, in closed form.

    The cages of a motion D minimise |D − H c|² + a |L c|². A split adds a column g to H, which has
    no cost of its own, and takes |gᵀ R|² / gᵀ (1 − H N⁻¹ Hᵀ) g off the minimum, with the residual R
    and the normal matrix N = Hᵀ H + a Lᵀ L. To merge the cage vertices i and j adds
    |c_i − c_j|² / (e_i − e_j)ᵀ N⁻¹ (e_i − e_j): the cost of a linear constraint.

    Parameters
    ----------
    cage : TriMesh
        Sound, n vertices.
    squares : (s,) float64, optional
        The residuals of a cage before this one, which tell where splits are worth looking at; no
        splits are measured without them.
    """
    count, edges = len(cage.vertices), cage.edges.ends
    chosen = edges[:0] if squares is None else _choose_splits(cage, motion.points, squares)
    divided = split_edges(cage, chosen)
    weights = harmonic_weights(divided, motion.points, "preview").values
    hats, own = weights[:, count:], weights[:, :count].copy()
    for side in range(2):
        np.add.at(own.T, chosen[:, side], 0.5 * hats.T)
    inverse = np.linalg.inv(_normal_matrix(own, uniform_laplacian(cage)))
    cages = inverse @ (own.T @ motion.displacements)
    residual = motion.displacements - own @ cages
    product = own.T @ hats
    new = (hats**2).sum(axis=0) - (product * (inverse @ product)).sum(axis=0)
    first, second = edges.T
    apart = ((cages[first] - cages[second]) ** 2).sum(axis=1)
    slack = inverse.diagonal()[edges].sum(axis=1) - 2 * inverse[first, second]
    return EditGains(
        error=float((residual**2).sum()),
        squares=(residual**2).sum(axis=1),
        splits=chosen,
        gains=((hats.T @ residual) ** 2).sum(axis=1) / np.maximum(new, TINY),
        edges=edges,
        losses=apart / np.maximum(slack, TINY),
    )


def split_edges(cage: TriMesh, chosen: Integers) -> TriMesh:
    """Split edges (k, 2), no two of one face, at their middles: vertices n to n + k − 1."""
    faces, count = cage.faces.tolist(), len(cage.vertices)
    middles = {(a, b): count + k for k, (a, b) in enumerate(chosen.tolist())}
    divided = []
    for face in faces:
        for k in range(3):
            a, b, c = face[k], face[k - 2], face[k - 1]
            middle = middles.get((min(a, b), max(a, b)))
            if middle is not None:
                divided += [[a, middle, c], [middle, b, c]]
                break
        else:
            divided.append(face)
    vertices = np.concatenate([cage.vertices, cage.vertices[chosen].mean(axis=1)])
    return TriMesh(vertices, np.array(divided, np.int64))


def _choose_splits(cage: TriMesh, points: Floats, squares: Floats) -> Integers:
    """Choose edges whose faces have large parts of the error, no two of one face."""
    face = closest_points(cage, points).face
    part = np.bincount(face, weights=squares, minlength=len(cage.faces))
    edges = cage.edges
    score = np.zeros(len(edges.ends))
    for side in range(3):
        np.add.at(score, edges.side_edges[:, side], part)
    score *= np.linalg.norm(np.diff(cage.vertices[edges.ends], axis=1)[:, 0], axis=1)
    chosen: list[int] = []
    is_free = np.ones(len(cage.faces), bool)
    beside: list[list[int]] = [[] for _ in edges.ends]
    for number, sides in enumerate(edges.side_edges.tolist()):
        for edge in sides:
            beside[edge].append(number)
    # Each split adds two faces, and weights are computed of no more than so many.
    most = min(int(SPLIT_SHARE * len(cage.vertices)), (MAX_FACES - len(cage.faces)) // 2)
    for edge in np.argsort(-score, kind="stable").tolist():
        if len(chosen) < most and is_free[beside[edge]].all():
            is_free[beside[edge]] = False
            chosen.append(edge)
    return np.asarray(edges.ends[chosen])


def _normal_matrix(weights: Floats, laplacian: Floats) -> Floats:
    """Return Hᵀ H + a Lᵀ L, scaled as in an extraction."""
    points, count = weights.shape
    return np.asarray(weights.T @ weights + ALPHA * points / count * laplacian.T @ laplacian)
