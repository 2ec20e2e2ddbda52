"""Solve frames of which some vertices are missing, weigh less, or are outliers.

Vertex j of a frame has a weight ω_j from 0 (missing, or rejected) to 1. The cage c of the plain
solve, of all vertices alike, is corrected by d,

    (A − E) d = (α/n) LᵀL c_rest (R' − R) − (β/m) Σ_j (1 − ω_j) w_j H_jᵀ r_j,
    E = (β/m) Σ_j (1 − ω_j) w_j H_jᵀ H_j,

with the normal matrix A, the residuals r = v − H c and the rotations R of the plain solve, and the
rotations R' of the weighted frame. Only vertices with ω_j < 1 are in the sums, so the price is
theirs. It is the limit of the rounds ṽ = H c + ω (v − H c), which keep A but converge slowly where
a piece is missing.

Weights of outliers follow the residual in tolerances, u = |r_j| / t_j: 1 up to u = 1, then 1/u in
the first rounds (Huber 1964) and exp(1 − u²) in the others (Welsch; Holland and Welsch 1977), if
the vertex is torn from the surface. A frame without outliers keeps the plain solution, to the last
bit.

A vertex is an outlier by itself if its neighbours are none: `find_outlier_vertices` compares a
frame before any solve, `find_torn_vertices` the residuals of one. Pieces of the surface that jump
as a whole have no such vertex; `is_often_torn` finds them by the edges around them.
"""

from collections.abc import Iterable

import numpy as np

from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.method.solve.dual_laplacian import MAX_CONDITION, DualLaplacianSolver, Solution
from cageik_cli.util.arrays import Floats, Integers, Mask, Workspace, spread_evenly
from cageik_cli.util.errors import NumericalError

HUBER_ROUNDS = 2
"""First rounds, in which outliers still pull, so that the next start close to the solution."""

MAX_ROBUST_ROUNDS = 20
"""Rounds of weighing the followed vertices of a frame and solving it, at most."""

WEIGHT_CHANGE_TOL = 0.01
"""Rounds end when no weight of the frame changes by more."""

MIN_OUTLIER_RATIO = 8.0
"""Vertices are off by themselves that are off by more times as much as their neighbours."""

MIN_OUTLIER_EDGE_CHANGE = 5.0
"""Percent of the diagonal; edges of outlier vertices change by more. In clean clips of a dancer, a
horse and a cartoon chicken no vertex does so by itself by more than 2.9 %. A vertex that is off
by 9 % of the diagonal is seen in 70 to 100 % of tries there, one off by 5 % or less hardly ever:
clean vertices come too near to that."""

MIN_TEAR = 1.0
"""Percent of the diagonal; torn edges change their length by more from a frame to the next."""

MIN_TEAR_RATIO = 20.0
"""Torn edges change by more times as much as they do in the median, and as `USUAL_CHANGE`."""

USUAL_CHANGE = 0.01
"""Percent of the diagonal by which an edge may change in any clip."""

MIN_TORN_PERCENT = 0.1
"""A surface is torn between two frames if more of its edges are. In clean clips of a dancer, a
horse and a figure they are 0.03 %, at every frame to every eighth; of a cartoon chicken, whose
wings flap at once, up to 6 %, but in a third of the pairs at most. A displaced piece of 5 % of the
vertices has 0.6 to 4 % of the edges around it."""

MAX_COMPARED_EDGES = 50_000
"""Edges that are compared, evenly spread over a larger mesh, so that memory has a bound."""


class RobustSolver:
    """Solver of frames whose vertices count differently.

    Parameters
    ----------
    tolerances : (m,) float64, optional
        Residuals that a vertex may have, file units; above, it is an outlier. Without them
        outliers are not looked for.

    Both are attributes too.

    Attributes
    ----------
    rest_pull, offset_pull : (n, 3) float64
        (α/n) LᵀL c_rest, and (β/m) HᵀW times the offsets of the binding.
    offsets : (m, 3) float64, optional
        As of `Binding`.
    """

    def __init__(self, solver: DualLaplacianSolver, tolerances: Floats | None = None) -> None:
        self.solver, self.tolerances = solver, tolerances
        binding = solver.binding
        self.rest_pull = solver.smoothness @ solver.rest_cage
        self.offsets = binding.offsets
        self.offset_pull = np.zeros_like(self.rest_pull)
        if self.offsets is not None:
            weighted = solver.vertex_weights[:, None] * self.offsets
            self.offset_pull = solver.data_scale * (binding.weights.T @ weighted)

    def solve(
        self, frames: Floats, given: Floats | None = None, workspace: Workspace | None = None
    ) -> Solution:
        """Return the cages of `frames`, (k, m, 3), whose vertices have given weights, (k, m).

        Weights are from 0 to 1; vertices of weight 0 may be anywhere near the others. With
        `workspace`, the reconstructions are valid until it is used again.
        """
        plain = self.solver.solve(frames, workspace)
        block = _WeighedBlock(self, frames, plain, given)
        left = np.arange(len(frames))
        for count in range(5):  # times that all vertices are looked through for outliers
            left = block.search(left, is_first=count == 0)
            if not len(left):
                break
            block.apply_corrections(left)
        return plain if block.is_plain else block.finish()


class _WeighedBlock:
    """A block of frames: their weights, corrections of their cages, and what is left.

    Attributes
    ----------
    given, weights : (k, m) float64
        How much vertices may count, and how much they do.
    plain_residuals : (k, m, 3) float64
        v − H c of the plain solve.
    """

    def __init__(
        self, robust: RobustSolver, frames: Floats, plain: Solution, given: Floats | None
    ) -> None:
        self.robust, self.solver = robust, robust.solver
        self.frames, self.plain = frames, plain
        self.given = np.ones(frames.shape[:2]) if given is None else given
        self.plain_residuals = frames - plain.reconstructions
        self._residuals = self.plain_residuals
        self._rotations = plain.rotations.copy()
        self._corrections = np.zeros_like(plain.cages)
        self._followed = np.zeros(frames.shape[:2], bool)
        self.weights = self.given.copy()
        self.faults: dict[int, str] = {}

    @property
    def is_plain(self) -> bool:
        """Whether all vertices count alike, so that nothing is corrected."""
        return bool((self.weights == 1).all())

    def search(self, places: Integers, is_first: bool) -> Integers:
        """Look for outliers that are not followed yet, and solve the frames that have any.

        Frames of which some vertices have a given weight are solved the first time. Returned are
        the places of the frames that were solved.
        """
        solved = []
        for place in places.tolist():
            is_given = self.given[place] != 1
            limits = self._measure_limits(place)
            is_new = np.zeros(len(is_given), bool)
            if limits is not None:
                squares = np.einsum("jx,jx->j", self._residuals[place], self._residuals[place])
                is_new = (squares > limits**2) & (self.given[place] > 0) & ~self._followed[place]
            if not (is_new.any() or (is_first and is_given.any())):
                continue
            self._followed[place] |= is_given | is_new
            if limits is not None:
                # Vertices that are off by half as much may become outliers in the rounds.
                self._followed[place] |= squares > (0.5 * limits) ** 2
            try:
                self._solve_frame(place, limits)
                solved.append(place)
            except NumericalError as error:
                self.faults[place] = str(error)
        return np.array(solved, np.int64)

    def _measure_limits(self, place: int) -> Floats | None:
        """Return the residuals of a frame, (m,), above which a vertex is an outlier.

        Tolerances grow with the frame: where half of the vertices that are data are off by more
        than half a tolerance, the frame is far off as a whole, and they are no outliers for that.
        Vertices that are not torn from the surface have no limit.
        """
        tolerances = self.robust.tolerances
        is_data = self.given[place] > 0
        if tolerances is None or not is_data.any():
            return None
        residuals = self._residuals[place]
        relative = np.sqrt(np.einsum("jx,jx->j", residuals, residuals)) / tolerances
        middle = np.median(relative if is_data.all() else relative[is_data])
        limits = tolerances * max(1.0, 2 * float(middle))
        if ((relative * tolerances > 0.5 * limits) & is_data & ~self._followed[place]).any():
            is_torn = find_torn_vertices(self.solver.binding.rest, residuals, limits, is_data)
            limits[~is_torn] = np.inf
        return limits

    def _solve_frame(self, place: int, limits: Floats | None) -> None:
        """Weigh the followed vertices of a frame and solve it, in turn.

        Parameters
        ----------
        limits : (m,) float64, optional
            From `_measure_limits`.
        """
        frame = _FollowedVertices(self, place, np.flatnonzero(self._followed[place]))
        given = self.given[place, frame.rows]
        weights = self.weights[place, frame.rows]
        if limits is None:
            frame.solve(weights)
        else:
            for count in range(MAX_ROBUST_ROUNDS):
                relative = np.sqrt(np.einsum("jx,jx->j", frame.residuals, frame.residuals))
                relative /= limits[frame.rows]
                found = given * weigh(relative, is_huber=count < HUBER_ROUNDS)
                if count > HUBER_ROUNDS and np.abs(found - weights).max() <= WEIGHT_CHANGE_TOL:
                    break
                weights = found
                frame.solve(weights)
        self.weights[place, frame.rows] = weights
        self._corrections[place], self._rotations[place] = frame.correction, frame.rotation

    def apply_corrections(self, places: Integers) -> None:
        """Compute what the corrections leave of the residuals of all vertices."""
        n = self._corrections.shape[1]
        columns = self._corrections[places].transpose(1, 0, 2).reshape(n, -1)
        moved = (self.solver.binding.weights @ columns).reshape(-1, len(places), 3)
        if self._residuals is self.plain_residuals:
            self._residuals = self.plain_residuals.copy()
        self._residuals[places] = self.plain_residuals[places] - moved.transpose(1, 0, 2)
        if self.robust.offsets is not None:
            turned = self._rotations[places] - self.plain.rotations[places]
            self._residuals[places] -= self.robust.offsets @ turned

    def finish(self) -> Solution:
        """Return the corrected solution."""
        plain, sampled = self.plain, self.plain.sampled.copy()
        rebuilt = np.subtract(self.frames, self._residuals, out=plain.reconstructions)
        for place in np.flatnonzero((self.weights != 1).any(axis=1)).tolist():
            # A vertex that is missing or rejected is sampled where its reconstruction is.
            frame = rebuilt[place] + self.weights[place, :, None] * self._residuals[place]
            moved = self.solver.sample(frame, self._rotations[place])
            sampled[:, 3 * place : 3 * place + 3] = moved
        return Solution(
            cages=plain.cages + self._corrections,
            reconstructions=rebuilt,
            rotations=self._rotations,
            sampled=sampled,
            weights=self.weights,
            faults=self.faults,
        )


class _FollowedVertices:
    """The vertices of a frame that may count less than others, and the cage by their weights.

    Attributes
    ----------
    rows : (c,) int64
        Numbers of these vertices.
    residuals : (c, 3) float64
        v − H c of the cage that was solved last.
    correction : (n, 3) float64
        Of the plain cage.
    rotation : (3, 3) float64
    """

    def __init__(self, block: _WeighedBlock, place: int, rows: Integers) -> None:
        self._robust, self._solver = block.robust, block.solver
        self.rows = rows
        # Missing vertices are the most, and stay missing: their part is computed once.
        self._is_missing = block.given[place, rows] == 0
        gone, weights = rows[self._is_missing], self._solver.vertex_weights
        self._matrix = self._solver.normal - self._solver.weigh_data(weights[gone], gone)
        frame = block.frames[place]
        centred = frame - weights @ frame / weights.sum()
        self._vertices = centred[rows]
        self._covariance = (self._solver.rest * weights[:, None]).T @ centred
        self._turn = block.plain.rotations[place]
        self._weights = self._solver.binding.weights[rows]
        self._vertex_weights = weights[rows]
        self._rest = self._solver.rest[rows]
        self._plain = block.plain_residuals[place, rows]
        self.residuals, self.rotation = self._plain, self._turn
        self.correction = np.zeros_like(self._robust.rest_pull)

    def solve(self, weights: Floats) -> None:
        """Solve the cage with these weights, (c,).

        Raises
        ------
        NumericalError
            When the vertices that are left do not determine the cage.
        """
        lost = (1 - weights) * self._vertex_weights
        total = float(self._solver.vertex_weights.sum())
        left = total - float(lost.sum())
        if left <= 1e-12 * total:
            raise NumericalError("no vertex of it is data")
        if self._solver.is_aligned:
            # The rotation of the rest pose to the frame without what is lost.
            moved, rest = lost @ self._vertices, lost @ self._rest
            lost_part = (lost[:, None] * self._rest).T @ self._vertices
            covariance = self._covariance - lost_part - np.outer(rest, moved) / left
            self.rotation = np.asarray(nearest_rotations_by_svd(covariance[None])[0])
        turned = self.rotation - self._turn
        residuals = self._plain
        if self._robust.offsets is not None:
            residuals = residuals - self._robust.offsets[self.rows] @ turned
        scale, robust = self._solver.data_scale, self._robust
        right = (robust.rest_pull - robust.offset_pull) @ turned
        right -= scale * (self._weights.T @ (lost[:, None] * residuals))
        some = np.flatnonzero((lost > 0) & ~self._is_missing)
        roots = np.sqrt(lost[some, None]) * self._weights[some]
        self.correction = solve_definite(self._matrix - scale * (roots.T @ roots), right)
        self.residuals = residuals - self._weights @ self.correction


def weigh(relative: Floats, is_huber: bool) -> Floats:
    """Weigh vertices by their residuals in tolerances, with Huber's weights or Welsch's.

    Weights below 1e-4 are 0.
    """
    far = np.maximum(relative, 1.0)
    weights = 1 / far if is_huber else np.exp(1 - np.minimum(far, 1e3) ** 2)
    return np.where(weights < 1e-4, 0.0, weights)


def solve_definite(matrix: Floats, right: Floats) -> Floats:
    """Solve a symmetric positive definite system, (n, n) and (n, k)."""
    import scipy.linalg

    try:
        factor, lower = scipy.linalg.cho_factor(matrix, lower=True, check_finite=False)
    except scipy.linalg.LinAlgError:
        factor = None
    if factor is not None:
        pivots = np.diag(factor) ** 2
        if pivots.max() <= MAX_CONDITION * pivots.min():
            solved = scipy.linalg.cho_solve((factor, lower), right, check_finite=False)
            return np.asarray(solved)
    raise NumericalError("the vertices that are data do not determine the cage")


def average_neighbours(mesh: TriMesh, values: Floats) -> Floats:
    """Return the mean of the values, (m,), of each vertex's neighbours; its own if it has none."""
    first, second = mesh.edges.ends.T
    own = np.concatenate([first, second])
    others = values[np.concatenate([second, first])]
    counts = np.bincount(own, minlength=len(values))
    sums = np.bincount(own, others, minlength=len(values))
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), values))


def has_outlier_vertices(mesh: TriMesh, frames: Iterable[Floats]) -> bool:
    """Return whether single vertices of frames, (m, 3) each, are outliers, see below."""
    return any(bool(find_outlier_vertices(mesh, frame).any()) for frame in frames)


def find_outlier_vertices(mesh: TriMesh, frame: Floats) -> Mask:
    """Return which vertices of a frame, (m, 3), are outliers by themselves, (m,).

    The data alone tells, before any solve: all edges of such a vertex change their length by far
    more than some edge of each neighbour does. Limbs that bend, and surfaces that stretch as a
    whole, do not count. Nor do neighbours that are outliers together, unless single vertices are
    outliers elsewhere in the frame.

    Parameters
    ----------
    mesh : TriMesh
        A pose that the frame is compared with; its vertex may be the outlier.
    frame : (m, 3) float64
        nan for missing vertices, whose edges do not count.
    """
    first, second = mesh.edges.ends.T
    before = np.linalg.norm(mesh.vertices[first] - mesh.vertices[second], axis=1)
    change = np.abs(np.linalg.norm(frame[first] - frame[second], axis=1) - before)
    change[np.isnan(change)] = np.inf
    least = np.full(len(mesh.vertices), np.inf)  # by how much an edge of each vertex changes
    for ends in (first, second):
        np.minimum.at(least, ends, change)
    least[~np.isfinite(least)] = 0.0
    is_large = 100 * least > MIN_OUTLIER_EDGE_CHANGE * mesh.diagonal
    if not is_large.any():
        return is_large
    is_alone = is_large & (least > MIN_OUTLIER_RATIO * average_neighbours(mesh, least))
    return np.asarray(is_large if is_alone.any() else is_alone)


def is_often_torn(mesh: TriMesh, pairs: Iterable[tuple[Floats, Floats]]) -> bool:
    """Return whether pieces of the surface jump by themselves, in most pairs of frames.

    The edges around such a piece change their length at once, by far more than they usually do;
    where a surface moves quickly, many edges do, and all the time. The data alone tells, before
    any solve. Of missing vertices nothing is known, so their edges do not count.

    Parameters
    ----------
    pairs : iterable of two (m, 3) float64
        Frames that follow each other, spread over the clip; nan for missing vertices.
    """
    ends = mesh.edges.ends
    ends = ends[spread_evenly(len(ends), MAX_COMPARED_EDGES)]

    def measure_edges(frame: Floats) -> Floats:
        return np.asarray(np.linalg.norm(frame[ends[:, 0]] - frame[ends[:, 1]], axis=1))

    steps = [np.abs(measure_edges(after) - measure_edges(before)) for before, after in pairs]
    changes = 100 / mesh.diagonal * np.nan_to_num(np.array(steps))
    if not changes.size:
        return False
    usual = np.maximum(np.median(changes, axis=0), USUAL_CHANGE)
    is_torn = (changes > MIN_TEAR) & (changes > MIN_TEAR_RATIO * usual)
    return bool((100 * is_torn.mean(axis=1) > MIN_TORN_PERCENT).mean() > 0.5)


def find_torn_vertices(mesh: TriMesh, residuals: Floats, limits: Floats, is_data: Mask) -> Mask:
    """Return which vertices, (m,), are torn from the surface in a frame.

    The cage is smooth, so that residuals jump only where the data do. Where it cannot follow a
    quick motion, they are large, but grow from vertex to vertex. So an edge is torn if residuals
    differ by more than the mean of its limits along it, and vertices are if all ways to the
    largest part of their component have a torn edge. A lone vertex has no edge that tells: it is.

    Parameters
    ----------
    residuals : (m, 3) float64
        v − H c.
    limits : (m,) float64
        Lengths of residuals above which a vertex may be an outlier.
    is_data : (m,) bool
        The surface ends at vertices that are not; they are not torn.
    """
    count, ends, components = len(limits), mesh.edges.ends, mesh.components
    if not is_data.all():
        ends = ends[is_data[ends].all(axis=1)]
        components = find_groups(ends, count)
    jumps = np.diff(residuals[ends], axis=1)[:, 0]
    is_joined = np.einsum("ex,ex->e", jumps, jumps) <= limits[ends].mean(axis=1) ** 2
    parts = components if is_joined.all() else find_groups(ends[is_joined], count)
    sizes, largest = np.bincount(parts)[parts], np.zeros(count, np.int64)
    np.maximum.at(largest, components, sizes)
    largest = largest[components]
    return np.asarray(is_data & ((sizes < largest) | (largest == 1)))
