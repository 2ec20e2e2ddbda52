"""Move vertices of a cage from where a motion does not need them to where its error is.

What single edits of the cage change in that error is known in closed form.
"""

import numpy as np

from cageik_cli.cages.builder.collapse import Motion
from cageik_cli.cages.builder.draft import MIN_KEPT_ANGLE, Draft
from cageik_cli.cages.builder.judge import Demand
from cageik_cli.cages.builder.loops import NO_LOOPS, Loops
from cageik_cli.cages.builder.polish import collapse_in_shape, splits_well, tighten
from cageik_cli.cages.builder.refine import complete_clearance, make_draft
from cageik_cli.cages.check.quality import find_thin_parts
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.geometry.surface import closest_points
from cageik_cli.method.weights.harmonic import MAX_HARMONIC_FACES, harmonic_weights
from cageik_cli.method.weights.settings import Accuracy
from cageik_cli.util.arrays import Floats, Integers

SKIPPED = ((0, 0), (1, 0), (0, 1))
"""How many of the best splits and collapses are left out, after each round of one that failed."""

EDIT_ALPHA = 1e-3
"""Weight of the smoothness of the cage, as in an extraction."""

MAX_SPLIT_SHARE = 0.4
"""Edges for which splits are measured, over the number of vertices, at most."""

UNREFINED = Accuracy(np.inf, 1, 0.0, 9000)
"""The accuracy of weights by which edits are compared: no face is divided for an error."""


def shift_vertices(
    cage: TriMesh, demand: Demand, motion: Motion, loops: Loops = NO_LOOPS
) -> tuple[TriMesh, int]:
    """Collapse the edges that a motion needs least, and split as many where it gains most.

    The first round moves 8 % of the vertices; a round that fails halves that. Rounds count in which
    the error falls, and sheets of the cage that nearly touch come no nearer to each other.

    Returns
    -------
    TriMesh
        The cage, in the units of the demand.
    int
        How many vertices moved.
    """
    cage, samples = complete_clearance(cage, demand, demand.samples, rounds=2)
    gains = EditGains(cage, motion, EditGains(cage, motion).squares)
    count, failures, moved = max(1, round(0.08 * len(cage.vertices))), 0, 0
    for _ in range(count_rounds(len(cage.vertices))):
        draft = make_draft(cage, demand, samples, loops)
        made = _Round(draft, gains).run(count, SKIPPED[failures], demand.most)
        edited = draft.to_mesh()
        if made and _measure_thinness(edited) >= _measure_thinness(cage):
            after = EditGains(edited, motion, gains.squares)
            if after.error < gains.error:
                cage, gains, moved, failures = edited, after, moved + made, 0
                continue
        if count > 1:
            count = (count + 1) // 2
        elif failures + 1 < len(SKIPPED):
            failures += 1
        else:
            break
    return complete_clearance(cage, demand, samples)[0], moved


def _measure_thinness(cage: TriMesh) -> float:
    """Return how near the nearest sheets of a cage are, in face widths; infinite if none are."""
    return min((fault.value for fault in find_thin_parts(cage)), default=np.inf)


def count_rounds(vertices: int) -> int:
    """Return how many rounds a cage gets, for their time: 80, of 300 vertices or less.

    The time of a round grows with the cube of their number.
    """
    return max(1, int(80 * min(1.0, 300 / vertices) ** 3))


class EditGains:
    """How edits of a cage change what a motion cannot be expressed in, in closed form.

    The cages of a motion D minimise |D − H c|² + a |L c|², a being `EDIT_ALPHA` s / n. A split adds
    a column g to H, which has no cost of its own, and takes |gᵀ R|² / gᵀ (1 − H N⁻¹ Hᵀ) g off the
    minimum, with the residual R and the normal matrix N = Hᵀ H + a Lᵀ L. To merge the cage vertices
    i and j adds |c_i − c_j|² / (e_i − e_j)ᵀ N⁻¹ (e_i − e_j): the cost of a linear constraint.

    Parameters
    ----------
    cage : TriMesh
        Sound, n vertices.
    squares : (s,) float64, optional
        The residuals of a cage before this one, which tell where splits are worth looking at; no
        splits are measured without them.

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

    def __init__(self, cage: TriMesh, motion: Motion, squares: Floats | None = None) -> None:
        count, self.edges = len(cage.vertices), cage.edges.ends
        self.splits = self.edges[:0]
        if squares is not None:
            self.splits = _choose_splits(cage, motion.points, squares)
        divided = split_edges(cage, self.splits)
        weights = harmonic_weights(divided, motion.points, UNREFINED).values
        columns, own = weights[:, count:], weights[:, :count].copy()
        for side in range(2):
            np.add.at(own.T, self.splits[:, side], 0.5 * columns.T)
        laplacian = uniform_laplacian(cage)
        smoothness = EDIT_ALPHA * len(own) / count * laplacian.T @ laplacian
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
    most = min(
        int(MAX_SPLIT_SHARE * len(cage.vertices)), (MAX_HARMONIC_FACES - len(cage.faces)) // 2
    )
    for edge in np.argsort(-score, kind="stable").tolist():
        if len(chosen) < most and is_free[beside[edge]].all():
            is_free[beside[edge]] = False
            chosen.append(edge)
    return np.asarray(edges.ends[chosen])


class _Round:
    """Edits of a draft that do not touch each other, so that their gains add up nearly."""

    def __init__(self, draft: Draft, gains: EditGains) -> None:
        self._draft, self._gains = draft, gains
        self._touched: set[int] = set()  # vertices whose faces were edited

    def run(self, count: int, skipped: tuple[int, int], most: int) -> int:
        """Move up to `count` vertices, to `most` vertices in all; return how many were added.

        So many of the best splits and collapses are left out.
        """
        gains = self._gains
        order = np.argsort(-gains.gains, kind="stable")
        splits = [k for k in order if self._is_splittable(*gains.splits[k])][skipped[0] :]
        kept = {int(v) for k in splits[:count] for v in self._around_edge(*gains.splits[k])}
        # A vertex moves if the collapse costs clearly less than the split gains.
        self._collapse_edges(0.9 * gains.gains[splits][:count], kept, skipped[1])
        done, free = 0, most - self._draft.count
        for start, stop in gains.splits[splits].tolist():
            around = {start, stop, *self._around_edge(start, stop).tolist()}
            # An edge that was collapsed has no faces any more, but its ends are touched.
            is_free = done < free and not self._touched & around
            if is_free and self._is_splittable(start, stop):
                self._touched |= {*around, self._draft.split(start, stop)}
                done += 1
        tighten(self._draft, self._draft.samples, self._touched)
        return done

    def _collapse_edges(self, worth: Floats, kept: set[int], left_out: int) -> None:
        """Collapse edges, apart from `kept` vertices, that cost less than splits are worth."""
        made, losses = 0, self._gains.losses
        for k in np.argsort(losses, kind="stable"):
            if made == len(worth) or losses[k] > worth[made]:
                break
            start, stop = map(int, self._gains.edges[k])
            around = {v for end in (start, stop) for v in self._draft.neighbours(end).tolist()}
            if around & (kept | self._touched):
                continue
            if left_out > 0:
                left_out -= 1
                continue
            if any(collapse_in_shape(self._draft, start, stop, share) for share in (0.5, 0, 1)):
                self._touched |= around
                made += 1

    def _is_splittable(self, start: int, stop: int) -> bool:
        valence = self._draft.count_faces()
        return splits_well(self._draft, int(start), int(stop), valence, MIN_KEPT_ANGLE)

    def _around_edge(self, start: int, stop: int) -> Integers:
        """Return the vertices of the faces at an edge."""
        return np.unique(self._draft.faces[self._draft.faces_at_edge(int(start), stop)])
