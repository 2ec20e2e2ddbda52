"""Sparse anchors in, cage and mesh out: cage-based inverse kinematics.

The cage of a pose minimises

    (α/n) Σ_i |(L c)_i − δ_i|²  +  (β/l) Σ_j w_j |q_j − a_j c|²,        δ = L c_rest,

over l anchors with targets q, whose rows in cage space are a_j (Savoye and Franco 2010, eq. 6, in
means instead of sums). In displacements d = c − c_rest and t = q − A c_rest everything is linear in
t, and nothing large cancels: d = R t and H d = (H R) t, with responses R that are computed once.

With the forces λ by which anchors cause displacements t, this minimum is where

    LᵀL d = Aᵀ λ,        A d + E λ = t.

LᵀL does not depend on the anchors: it is factored once per cage. G is its inverse outside the free
modes P (components of the cage that move as one). Then d = G Aᵀ λ + P u, and

    (A G Aᵀ + E) λ + A P u = t,        (A P)ᵀ λ = 0

is a system of the size of the anchors. It gives the same minimum as the normal matrix of both
terms, and stays well conditioned however small E is: hard anchors are the limit E = 0.

With `rigidity`, δ turns with the cells of the cage (`method.pose.rigidity`).

A pose that holds the rest adds the dense term of `method.pose.hold`. Its normal matrix stands in
place of LᵀL, and no component is free that the model is in. The motion u that it asks for is that
of the anchors near them, so d = d_u + R (t − A d_u), where d_u is the minimum without anchors.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dgemv

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.pose.anchors import Anchor, anchor_matrix, anchor_positions
from cageik_cli.method.pose.constraints import MAX_ASYMMETRY, CageConstraints, free_basis
from cageik_cli.method.pose.hold import HeldSurface, Reach
from cageik_cli.method.pose.rigidity import Cells, Neighbours
from cageik_cli.method.pose.settings import DEFAULT_POSE_ALPHA, validate_weights
from cageik_cli.method.solve.dual_laplacian import MAX_CONDITION, MIN_REFINED_CONDITION
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import Floats, Mask
from cageik_cli.util.errors import HandlesError, NumericalError
from cageik_cli.util.messages import Said, say
from cageik_cli.util.text import format_count

FREE_MODE_TOL = 1e-9
"""Free modes that couple to all anchors more weakly than this are not decided by them."""

BASIS_TOL = 1e-9
"""A motion of length one may lose this much when it is projected on the free coordinates."""


class Poser:
    """Solver for poses of a cage and its mesh with a fixed set of anchors.

    Parameters
    ----------
    binding : Binding
        A model of m vertices in a cage of n.
    anchors : iterable of Anchor
        l anchors with different names. Without any, the cage stays at rest.
    alpha, beta : float
        Weights of the Laplacian and of the soft anchors; finite, above 0.
    constraints : CageConstraints, optional
        Locked cage vertices, and a mirror.
    hold : bool
        Whether the model stays outside the radii of the anchors; else, all of it follows them.

    Attributes
    ----------
    reaches : list of Reach
        What the anchors, and then their mirror images, take with them; none without `hold`.
    condition_number : float
        Condition number of the anchors' system.
    free_modes : int
        Number of motions of whole components that no anchor decides; these components stay, or
        follow those that are anchored.

    Raises
    ------
    SettingError
        When alpha or beta is not a valid weight.
    HandlesError
        When anchors share a name, or the constraints do not fit the cage.
    NumericalError
        When anchors conflict: they cannot be met independently of each other.

    Examples
    --------
    >>> import numpy as np
    >>> from cageik_cli import Anchor, Poser, bind, load_mesh, point_at_vertex
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> cage = load_mesh("data_fixtures/walker/cage.obj")
    >>> hand = Anchor("hand", point_at_vertex(rest, 1040))
    >>> foot = Anchor("foot", point_at_vertex(rest, 994))
    >>> poser = Poser(bind(rest, cage, accuracy="preview"), [hand, foot])
    >>> poser
    <Poser: 2 anchors on 1570 vertices in a cage of 80>
    >>> moves = np.array([[0.1, 0.4, 0.2], [0.0, 0.0, 0.0]])
    >>> mesh, posed_cage = poser.solve_mesh(moves), poser.solve_cage(moves)
    >>> bool(np.abs(mesh[1040] - rest.vertices[1040] - moves[0]).max() < 1e-4)
    True
    >>> mesh.shape, posed_cage.shape
    ((1570, 3), (80, 3))
    """

    def __init__(
        self,
        binding: Binding,
        anchors: Iterable[Anchor],
        alpha: float = DEFAULT_POSE_ALPHA,
        beta: float = 1.0,
        constraints: CageConstraints | None = None,
        hold: bool = True,
    ) -> None:
        validate_weights(alpha, beta)
        self.binding, self.alpha, self.beta = binding, alpha, beta
        self.constraints = constraints or CageConstraints()
        cage = binding.cage
        laplacian = uniform_laplacian(cage)
        self._neighbours = Neighbours(laplacian)
        signs = (1,) if self.constraints.mirror is None else (1, -1)
        bases = [free_basis(cage, self.constraints, sign) for sign in signs]
        self._surface = HeldSurface(binding) if hold else None
        gram = None if self._surface is None else self._surface.gram
        self._response_solvers = [
            CageResponseSolver(cage, laplacian, basis, gram) for basis in bases
        ]
        self._solve_responses(tuple(anchors))

    def __repr__(self) -> str:
        vertices, cage_vertices = self.binding.weights.shape
        anchors = format_count(len(self.anchors), "anchor")
        return f"<Poser: {anchors} on {vertices} vertices in a cage of {cage_vertices}>"

    def with_anchor(self, anchor: Anchor) -> Poser:
        """Return a poser with one more anchor; the cage is not factored again."""
        return self._with_anchors((*self.anchors, anchor))

    def without_anchor(self, name: str) -> Poser:
        """Return a poser without one anchor; the cage is not factored again.

        Raises
        ------
        HandlesError
            When no anchor has this name.
        """
        kept = tuple(anchor for anchor in self.anchors if anchor.name != name)
        if len(kept) == len(self.anchors):
            names = ", ".join(repr(anchor.name) for anchor in self.anchors) or "none"
            raise HandlesError(f"there is no anchor {name!r}; the anchors are: {names}")
        return self._with_anchors(kept)

    def displacements(self, targets: Floats) -> Floats:
        """Return the displacements t of the anchors from the rest pose to targets, both (l, 3)."""
        return np.asarray(targets - self._rest_positions)

    def solve_cage(self, displacements: Floats, rigidity: int = 0) -> Floats:
        """Return the cage, (n, 3), for displacements of the anchors from the rest pose, (l, 3).

        `rigidity` is the number of rounds of rigid rotations of the cage's cells; without them,
        parts that turn far are sheared.
        """
        cage = self.binding.cage.vertices
        if self._surface is None:
            moved = self._cage_map(displacements)
        else:
            moved = np.zeros_like(cage)
            for rest_reach, motion in self._move_reaches(displacements):
                moved += rest_reach.cage_map(motion)
        if rigidity and displacements.any():
            moved = self._rotate_cells(self._cells_at_rest, moved, rigidity)
        return np.asarray(cage + moved)

    def solve_mesh(self, displacements: Floats, rigidity: int = 0) -> Floats:
        """Return the mesh, (m, 3), for displacements of the anchors from the rest pose, (l, 3).

        In memory all x come first, then all y, then all z, which is faster to compute.
        """
        columns = self._rest_columns.copy()
        if rigidity:
            moved = self.solve_cage(displacements, rigidity) - self.binding.cage.vertices
            for column, coordinate in zip(columns, moved.T, strict=True):
                column += self.binding.weights @ coordinate
        elif self._surface is None:
            self._mesh_map.add_to(columns, displacements)
        else:
            for rest_reach, motion in self._move_reaches(displacements):
                rest_reach.mesh_map.add_to(columns, motion)
        return columns.T

    def edit_cages(self, cages: Floats, displacements: Floats, rigidity: int = 0) -> Floats:
        """Move the anchors of cages (k, n, 3) by displacements (k, l, 3).

        Each cage keeps its own δ = L c, and with it its motion and detail. A cage whose anchors
        are not displaced stays the same bit for bit.
        """
        is_moved = displacements.any(axis=(1, 2))
        edited, chosen = cages.copy(), cages[is_moved]
        moved = self._move_cages(chosen, displacements[is_moved])
        if rigidity:
            for cage, unrotated in zip(chosen, moved, strict=True):
                unrotated[...] = self._rotate_cells(
                    Cells(self._neighbours, cage), unrotated, rigidity
                )
        edited[is_moved] += moved
        return edited

    def _move_reaches(self, displacements: Floats) -> Iterator[tuple[RestReach, Floats]]:
        """Yield the reaches of anchors that are displaced, (l, 3), and their motions, at rest."""
        moved = set(np.flatnonzero(displacements.any(axis=1)).tolist())
        for reach in self._rest_reaches:
            if reach.anchor in moved:
                yield reach, reach.compute_motion(displacements[reach.anchor])

    def _move_cages(self, cages: Floats, displacements: Floats) -> Floats:
        """Return the motions of cages (k, n, 3) whose anchors move, (k, l, 3), unrotated."""
        moved = self._cage_map(displacements)
        forces = np.zeros_like(cages)
        for reach in self.reaches:
            arms = reach.find_arms(cages)
            for k in np.flatnonzero(displacements[:, reach.anchor].any(axis=1)):
                motion = reach.compute_motion(arms[k], displacements[k, reach.anchor])
                forces[k] += reach.compute_forces(cages[k]) @ motion
        if forces.any():
            moved += self._force_map(forces)
        return np.asarray(moved)

    def _rotate_cells(self, cells: Cells, unrotated: Floats, rounds: int) -> Floats:
        """Return displacements (n, 3) with rotated cells, from those without rotations.

        The anchors go to their targets in steps, one per round, and the cells follow them. Of a
        large motion at once, nearly equal ones may end in different minima: the pose jumps.
        """
        settling = max(3, rounds // 10)  # rounds for which anchors stay at their targets
        steps = max(1, rounds - settling)
        moved = unrotated / steps
        for step in range(2, rounds + 2):
            moved = min(1.0, step / steps) * unrotated + self._differential_map(
                cells.rotate_differences(cells.fit_rotations(moved))
            )
        return moved

    def _with_anchors(self, anchors: tuple[Anchor, ...]) -> Poser:
        """Return a poser with other anchors; what does not depend on them is shared."""
        other = copy(self)
        other._solve_responses(anchors)
        return other

    def _solve_responses(self, anchors: tuple[Anchor, ...]) -> None:
        """Solve for the responses to anchors, and keep them."""
        names = [anchor.name for anchor in anchors]
        duplicate = next((name for name in names if names.count(name) > 1), None)
        if duplicate is not None:
            raise HandlesError(f"two anchors are named {duplicate!r}; give them different names")
        self.anchors = anchors
        rows = anchor_matrix(anchors, self.binding.weights)
        self._rest_positions = anchor_positions(anchors, self.binding.rest.vertices)
        unit_compliance = self.alpha * len(anchors) / (self.beta * len(self.binding.cage.vertices))
        compliance = np.array(
            [0.0 if anchor.hard else unit_compliance / anchor.weight for anchor in anchors]
        )
        responses = [
            solver.solve_response(rows, compliance, acts)
            for solver, acts in zip(self._response_solvers, self._list_acting(), strict=True)
        ]
        for response in responses:
            _check_independent(response, anchors)
        self.condition_number = max(response.condition_number for response in responses)
        self.free_modes = sum(response.free_modes for response in responses)
        mirror = self.constraints.mirror
        self._cage_map = MirroredMap([response.anchor_response for response in responses], mirror)
        self._differential_map = MirroredMap(
            [response.differential_response for response in responses], mirror
        )
        self._force_map = MirroredMap([response.force_response for response in responses], mirror)
        self.reaches = [] if self._surface is None else self._surface.find_reaches(anchors, mirror)
        for name in ("_mesh_map", "_rest_reaches"):
            self.__dict__.pop(name, None)

    def _list_acting(self) -> list[Mask]:
        """Return for each solver which anchors act: across a mirror, those on its plane stay."""
        everywhere, mirror = np.ones(len(self.anchors), bool), self.constraints.mirror
        if mirror is None:
            return [everywhere]
        heights = (self._rest_positions - mirror.reflect(self._rest_positions)) @ mirror.normal / 2
        return [everywhere, np.abs(heights) > MAX_ASYMMETRY * self.binding.cage.diagonal]

    @cached_property
    def _cells_at_rest(self) -> Cells:
        return Cells(self._neighbours, self.binding.cage.vertices)

    @cached_property
    def _mesh_map(self) -> MirroredMap:
        return self._cage_map.compose(self.binding.weights)

    @cached_property
    def _rest_reaches(self) -> list[RestReach]:
        cage, mirror = self.binding.cage.vertices, self.constraints.mirror
        rest_reaches = []
        for reach in self.reaches:
            forces = reach.compute_forces(cage)
            # The response to an anchor is that of itself, and not of its image.
            own = float(reach.mirror is None)
            maps = zip(self._cage_map.matrices, self._force_map.matrices, strict=True)
            columns = [
                np.column_stack([own * response[:, reach.anchor], force_response @ forces])
                for response, force_response in maps
            ]
            cage_map = MirroredMap(columns, mirror)
            rest_reaches.append(RestReach(reach, reach.find_arms(cage), cage_map, self.binding))
        return rest_reaches

    @cached_property
    def _rest_columns(self) -> Floats:
        return np.ascontiguousarray(self.binding.rest.vertices.T)


class RestReach:
    """A reach at rest, whose motions are products with few columns.

    Attributes
    ----------
    anchor : int
        The number of its anchor.
    cage_map : MirroredMap
        The cage per displacement of the anchor, and per entry of the motion of the reach.
    """

    def __init__(self, reach: Reach, arm: Floats, cage_map: MirroredMap, binding: Binding) -> None:
        self._reach, self._arm, self._binding = reach, arm, binding
        self.anchor, self.cage_map = reach.anchor, cage_map

    @cached_property
    def mesh_map(self) -> MirroredMap:
        """The same of the mesh."""
        return self.cage_map.compose(self._binding.weights)

    def compute_motion(self, displacement: Floats) -> Floats:
        """Return what the maps act on, (3 K + 2, 3), for a displacement (3,) of the anchor."""
        motion = self._reach.compute_motion(self._arm, displacement)
        return np.concatenate([displacement[None], motion])


def _check_independent(response: Response, anchors: tuple[Anchor, ...]) -> None:
    """Refuse anchors that cannot be met independently of each other, naming the main ones."""
    if response.condition_number <= MAX_CONDITION:
        return
    parts = np.round(np.abs(response.weakest_mode) / np.abs(response.weakest_mode).max(), 6)
    order = np.argsort(-parts, kind="stable")[:3]
    # Those with a small share in the conflict, relative to the largest, are not named.
    names = [repr(anchors[k].name) for k in order if parts[k] > 0.1]
    numbers = f"{response.condition_number:.1e}", f"{MAX_CONDITION:.0e}"
    found, limit = (number.replace("e+", "e") for number in numbers)
    if len(names) == 1:
        what = f"anchor {names[0]} cannot be met"
        remedy: Said = "make it soft, or unlock cage vertices near it"
    else:
        what = f"anchors {', '.join(names[:-1])} and {names[-1]} conflict"
        remedy = say("remove one, make it soft, or raise `alpha=`")
    raise NumericalError(f"{what} (condition number {found}, limit {limit}): " + remedy)


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """The linear response of one coordinate of a cage to its anchors.

    Attributes
    ----------
    anchor_response : (n, l) float64
        Displacements of the cage per displacement of an anchor.
    differential_response : (n, n) float64
        Displacements of the cage per change of δ, with the anchors' targets fixed.
    force_response : (n, n) float64
        Displacements of the cage per force on a cage vertex, with the anchors' targets fixed.
    condition_number : float
        Condition number of the anchors' system, in the 2-norm.
    weakest_mode : (l,) float64
        Eigenvector of the smallest eigenvalue, in anchors; of length one.
    free_modes : int
        Number of free modes that the anchors do not decide; those motions are minimal.
    """

    anchor_response: Floats
    differential_response: Floats
    force_response: Floats
    condition_number: float
    weakest_mode: Floats
    free_modes: int


class CageResponseSolver:
    """Solver for one coordinate of all cage vertices, factored once per cage.

    Parameters
    ----------
    laplacian : (n, n) float64
    basis : (n, r) float64
        Orthonormal columns: what may move, from `constraints.free_basis`.
    gram : (n, n) float64, optional
        That of dense constraints, which is added to LᵀL.
    """

    def __init__(
        self, cage: TriMesh, laplacian: Floats, basis: Floats, gram: Floats | None = None
    ) -> None:
        self._basis = basis
        self._free_modes = _find_free_modes(cage, basis)
        if gram is not None and self._free_modes.size:
            # Components that the model is in are not free; motions of the others remain.
            held = self._free_modes.T @ gram @ self._free_modes
            values, motions = np.linalg.eigh(held)
            is_free = values <= FREE_MODE_TOL * np.trace(gram) / len(gram)
            self._free_modes = self._free_modes @ motions[:, is_free]
        self._can_move_as_one = bool(self._free_modes.size) and bool(
            np.ptp(self._free_modes[:, 0]) < BASIS_TOL
        )
        differences, free = laplacian @ basis, basis.T @ self._free_modes
        normal = differences.T @ differences + free @ free.T
        if gram is not None:
            normal += basis.T @ gram @ basis
        self._factor = scipy.linalg.cho_factor(normal, check_finite=False)
        self._laplacian_response = self._solve_forces(laplacian.T)
        self._force_response = self._solve_forces(np.eye(len(laplacian)))

    def solve_response(
        self, rows: Floats, compliance: Floats, acts: Mask | None = None
    ) -> Response:
        """Return the response to anchors with rows A, (l, n), and compliance E, a diagonal (l,).

        The cage does not respond to those that do not act, (l,); by default all do.
        """
        if acts is None or acts.all():
            return self._solve_acting(rows, compliance)
        found = self._solve_acting(rows[acts], compliance[acts])
        anchor_response = np.zeros(rows.T.shape)
        anchor_response[:, acts] = found.anchor_response
        weakest_mode = np.zeros(len(rows))
        weakest_mode[acts] = found.weakest_mode
        return replace(found, anchor_response=anchor_response, weakest_mode=weakest_mode)

    def _solve_acting(self, rows: Floats, compliance: Floats) -> Response:
        influence, rigid_coupling = self._solve_forces(rows.T), rows @ self._free_modes
        system = rows @ influence + np.diag(compliance)
        # Forces on anchors, (l, l − rank), that move no component as one.
        left, sizes, _ = np.linalg.svd(rigid_coupling)
        balanced = np.asarray(left[:, np.count_nonzero(sizes > FREE_MODE_TOL) :])
        inner = balanced.T @ system @ balanced
        values, vectors = np.linalg.eigh(inner)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = balanced @ (vectors / values) @ vectors.T @ balanced.T
        # The free modes, (p, l), per displacement of an anchor that forces do not cause.
        free_motions = _invert_rigid_coupling(rigid_coupling)
        if self._can_move_as_one and len(rows):
            # Where the anchors leave a choice, components of the cage move relative to each other
            # as little as possible.
            centring = np.eye(len(rows)) - 1 / len(rows)
            apart = _invert_rigid_coupling(centring @ rigid_coupling[:, 1:]) @ centring
            together = (np.eye(len(rows)) - rigid_coupling[:, 1:] @ apart).mean(axis=0)
            free_motions = np.concatenate([(together / self._free_modes[0, 0])[None], apart])

        def respond(displacements: Floats) -> tuple[Floats, Floats]:
            forces = inverse @ displacements
            motions = free_motions @ (displacements - system @ forces)
            return influence @ forces + self._free_modes @ motions, forces

        anchor_response, forces = respond(np.eye(len(rows)))
        least, most = map(float, values[[0, -1]] if len(values) else (1, 1))
        condition = most / least if least > 0 else float("inf")
        if MIN_REFINED_CONDITION < condition <= MAX_CONDITION:
            # What the anchors miss, from the motion itself: the system has lost these digits.
            missed = np.eye(len(rows)) - rows @ anchor_response - compliance[:, None] * forces
            anchor_response += respond(missed)[0]
        return Response(
            anchor_response=anchor_response,
            differential_response=self._laplacian_response
            - anchor_response @ (rows @ self._laplacian_response),
            force_response=self._force_response - anchor_response @ (rows @ self._force_response),
            condition_number=condition,
            weakest_mode=balanced @ vectors[:, 0] if len(values) else np.zeros(len(rows)),
            free_modes=len(self._free_modes.T) - (len(rows) - len(inner)),
        )

    def _solve_forces(self, forces: Floats) -> Floats:
        """Return G f, (n, k), for forces f on cage vertices: displacements without free modes."""
        inside = self._basis.T @ forces
        moved = scipy.linalg.cho_solve(self._factor, inside, check_finite=False)
        return np.asarray(self._basis @ moved - self._free_modes @ (self._free_modes.T @ forces))


class MirroredMap:
    """A linear map of points, which may differ for the coordinate across a mirror.

    Parameters
    ----------
    maps : one or two (p, q) float64
        For all coordinates; or for those along the mirror, and for the one across it.
    """

    def __init__(self, maps: Sequence[Floats], mirror: Mirror | None) -> None:
        self._mirror, self._along, self.matrices = mirror, maps[0], maps
        self._across_difference = maps[0] if mirror is None else maps[1] - maps[0]

    def __call__(self, points: Floats) -> Floats:
        """Map points (…, q, 3) to (…, p, 3)."""
        if self._mirror is None:
            return np.asarray(self._along @ points)
        normal = self._mirror.normal
        heights = (self._across_difference @ (points @ normal)[..., None])[..., 0]
        return np.asarray(self._along @ points + heights[..., None] * normal)

    def add_to(self, columns: Floats, points: Floats) -> None:
        """Add the mapped points (q, 3) to `columns`, (3, p) float64, in place.

        Each row of `columns` must be contiguous in memory.
        """
        if not len(points):
            return
        for column, coordinate in zip(columns, points.T, strict=True):
            # y + A x in one pass is faster than a product of so few columns.
            dgemv(1.0, self._along, coordinate, beta=1.0, y=column, overwrite_y=True)
        if self._mirror is not None:
            normal = self._mirror.normal
            columns += normal[:, None] * (self._across_difference @ (points @ normal))

    def compose(self, matrix: Floats) -> MirroredMap:
        """Return the map followed by a matrix that is the same for all coordinates."""
        across = [] if self._mirror is None else [self._along + self._across_difference]
        maps = [np.asfortranarray(matrix @ values) for values in (self._along, *across)]
        return MirroredMap(maps, self._mirror)


def _find_free_modes(cage: TriMesh, basis: Floats) -> Floats:
    """Return P, (n, p), orthonormal: components of the cage moving as one within the basis.

    If the whole cage can move as one, that is the first column.
    """
    components = np.eye(cage.components.max() + 1)[cage.components]
    components /= np.linalg.norm(components, axis=0)
    lost = components - basis @ (basis.T @ components)
    _, sizes, motions = np.linalg.svd(lost, full_matrices=False)
    free = components @ motions[sizes < BASIS_TOL].T
    whole = np.full(len(components), len(components) ** -0.5)
    shares = free.T @ whole
    if np.linalg.norm(free @ shares - whole) > BASIS_TOL:
        return np.asarray(free)
    others = np.linalg.svd(shares[None])[2][1:]
    return np.column_stack([whole, free @ others.T])


def _invert_rigid_coupling(rigid_coupling: Floats) -> Floats:
    """Return the pseudoinverse, (p, l), with singular values below `FREE_MODE_TOL` taken as 0."""
    left, sizes, right = np.linalg.svd(rigid_coupling, full_matrices=False)
    is_coupled = sizes > FREE_MODE_TOL
    return np.asarray((right[is_coupled].T / sizes[is_coupled]) @ left[:, is_coupled].T)
