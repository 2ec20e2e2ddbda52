"""What a cage can express of a motion, and what single edits of the cage would change in that."""

import numpy as np
from scipy.spatial import cKDTree

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import choose_farthest
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.geometry.surface import closest_points
from cageik_cli.method.weights.harmonic import MAX_HARMONIC_FACES, harmonic_weights
from cageik_cli.method.weights.settings import Accuracy
from cageik_cli.util.arrays import Floats, Integers

POSE_TOL = 1e-9
"""Frames that differ by a smaller root mean square, in diagonals, are one pose: moves round."""

UNREFINED = Accuracy(np.inf, 1, 0.0, 9000)
"""The accuracy of weights by which edits are compared: no face is divided for an error."""


class Motion:
    """A model in its rest pose and in others, each moved rigidly onto the rest pose.

    Parameters
    ----------
    rest : (m, 3) float64
    frames : (k, m, 3) float64
        In any place.

    Attributes
    ----------
    poses : (p, m, 3) float64
        The frames that differ most from the rest pose and from each other.
    points : (s, 3) float64
        Some of the vertices, in the rest pose.
    displacements : (s, r) float64
        Displacements of these in all frames, reduced to their main directions: left singular
        vectors times their singular values.
    """

    def __init__(self, rest: Floats, frames: Floats) -> None:
        self._rest = rest
        # Each frame is moved rigidly onto the rest pose.
        centre = rest.mean(axis=0)
        centred = frames - frames.mean(axis=1, keepdims=True)
        turns = _find_turns(np.einsum("kmx,my->kxy", centred, rest - centre))
        aligned = np.einsum("kmx,kxy->kmy", centred, turns) + centre

        def measure(pose: Floats) -> Floats:
            squares = ((aligned - pose) ** 2).sum(axis=2).mean(axis=1)
            return np.where(squares > POSE_TOL**2, squares, 0.0)

        chosen = choose_farthest(min(8, len(frames)), measure(rest), lambda k: measure(aligned[k]))
        self.poses = aligned[chosen]
        step = max(1, -(-len(rest) // 1200))
        self.points = rest[::step]
        moves = (aligned[:, ::step] - self.points).transpose(1, 0, 2).reshape(len(self.points), -1)
        left, size, _ = np.linalg.svd(moves, full_matrices=False)
        self.displacements = left[:, :40] * size[:40]

    def carry(self, points: Floats) -> Floats:
        """Return where points beside the rest pose go in the poses, (p, n, 3).

        Each follows the best rigid motion of the model's vertices near it (Müller et al. 2005).
        """
        distance, near = cKDTree(self._rest).query(points, min(24, len(self._rest)))
        near = near.reshape(len(points), -1)
        # Vertices around that are no further than this, in diagonals, count about equally.
        weight = 1 / (distance.reshape(len(points), -1) + 0.01) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        source = self._rest[near]
        centre = np.einsum("pn,pnx->px", weight, source)
        spread = source - centre[:, None]
        carried = np.empty((len(self.poses), len(points), 3))
        for k, pose in enumerate(self.poses):
            target = pose[near]
            middle = np.einsum("pn,pnx->px", weight, target)
            turn = _find_turns(np.einsum("pn,pnx,pny->pxy", weight, spread, target))
            carried[k] = middle + np.einsum("px,pxy->py", points - centre, turn)
        return carried


def _find_turns(products: Floats) -> Floats:
    """Return the rotations R with rows x R nearest to y, from Σ xᵀy, (p, 3, 3) (Kabsch 1976)."""
    left, _, right = np.linalg.svd(products)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)


class EditGains:
    """How edits of a cage change what a motion cannot be expressed in, in closed form.

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
    alpha : float
        Weight of the smoothness of the cage, as in an extraction: a is alpha s / n.
    split_share : float
        Edges for which splits are measured, over the number of vertices, at most.

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

    def __init__(
        self,
        cage: TriMesh,
        motion: Motion,
        squares: Floats | None = None,
        alpha: float = 1e-3,
        split_share: float = 0.4,
    ) -> None:
        count, self.edges = len(cage.vertices), cage.edges.ends
        self.splits = self.edges[:0]
        if squares is not None:
            self.splits = _choose_splits(cage, motion.points, squares, split_share)
        divided = split_edges(cage, self.splits)
        weights = harmonic_weights(divided, motion.points, UNREFINED).values
        columns, own = weights[:, count:], weights[:, :count].copy()
        for side in range(2):
            np.add.at(own.T, self.splits[:, side], 0.5 * columns.T)
        laplacian = uniform_laplacian(cage)
        smoothness = alpha * len(own) / count * laplacian.T @ laplacian
        inverse = np.linalg.inv(own.T @ own + smoothness)
        cages = inverse @ (own.T @ motion.displacements)
        residual = motion.displacements - own @ cages
        self.error, self.squares = float((residual**2).sum()), (residual**2).sum(axis=1)
        tiny = 1e-12  # an edit that changes nothing gains nothing
        product = own.T @ columns
        new = (columns**2).sum(axis=0) - (product * (inverse @ product)).sum(axis=0)
        self.gains = ((columns.T @ residual) ** 2).sum(axis=1) / np.maximum(new, tiny)
        first, second = self.edges.T
        apart = ((cages[first] - cages[second]) ** 2).sum(axis=1)
        slack = inverse.diagonal()[self.edges].sum(axis=1) - 2 * inverse[first, second]
        self.losses = apart / np.maximum(slack, tiny)


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


def _choose_splits(cage: TriMesh, points: Floats, squares: Floats, split_share: float) -> Integers:
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
    most = min(int(split_share * len(cage.vertices)), (MAX_HARMONIC_FACES - len(cage.faces)) // 2)
    for edge in np.argsort(-score, kind="stable").tolist():
        if len(chosen) < most and is_free[beside[edge]].all():
            is_free[beside[edge]] = False
            chosen.append(edge)
    return np.asarray(edges.ends[chosen])
