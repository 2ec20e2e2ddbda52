"""Sparse anchors in, cage and mesh out: cage-based inverse kinematics.

The cage of a pose minimises

    (α/n) Σ_i |(L c)_i − δ_i|²  +  (β/l) Σ_j w_j |q_j − a_j c|²,        δ = L c_rest,

over l anchors with targets q, whose rows in cage space are a_j (Savoye and Franco 2010, eq. 6, in
means instead of sums). In displacements d = c − c_rest and t = q − A c_rest everything is linear in
t, and nothing large cancels: d = R t and H d = (H R) t, with responses R that are computed once.

With `rigidity`, δ turns with the cells of the cage (`method.pose.rigidity`).
"""

from collections.abc import Iterable
from copy import copy
from functools import cached_property

import numpy as np

from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.pose.anchors import Anchor, anchor_matrix, anchor_positions
from cageik_cli.method.pose.cage_response import CageResponseSolver, MirroredMap, Response
from cageik_cli.method.pose.constraints import CageConstraints, free_basis
from cageik_cli.method.pose.rigidity import Cells, Neighbours
from cageik_cli.method.pose.settings import DEFAULT_POSE_ALPHA, validate_weights
from cageik_cli.method.solve.dual_laplacian import MAX_CONDITION
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import HandlesError, NumericalError
from cageik_cli.util.messages import Said, say
from cageik_cli.util.text import format_count


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

    Attributes
    ----------
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
    ) -> None:
        validate_weights(alpha, beta)
        self.binding, self.alpha, self.beta = binding, alpha, beta
        self.constraints = constraints or CageConstraints()
        cage = binding.cage
        laplacian = uniform_laplacian(cage)
        self._neighbours = Neighbours(laplacian)
        signs = (1,) if self.constraints.mirror is None else (1, -1)
        bases = [free_basis(cage, self.constraints, sign) for sign in signs]
        self._response_solvers = [CageResponseSolver(cage, laplacian, basis) for basis in bases]
        self._solve_responses(tuple(anchors))

    def __repr__(self) -> str:
        vertices, cage_vertices = self.binding.weights.shape
        anchors = format_count(len(self.anchors), "anchor")
        return f"<Poser: {anchors} on {vertices} vertices in a cage of {cage_vertices}>"

    def with_anchor(self, anchor: Anchor) -> "Poser":
        """Return a poser with one more anchor; the cage is not factored again."""
        return self._with_anchors((*self.anchors, anchor))

    def without_anchor(self, name: str) -> "Poser":
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
        moved = self._cage_map(displacements)
        if rigidity and displacements.any():
            moved = self._rotate_cells(self._cells_at_rest, moved, rigidity)
        return np.asarray(self.binding.cage.vertices + moved)

    def solve_mesh(self, displacements: Floats, rigidity: int = 0) -> Floats:
        """Return the mesh, (m, 3), for displacements of the anchors from the rest pose, (l, 3).

        In memory all x come first, then all y, then all z, which is faster to compute.
        """
        columns = self._rest_columns.copy()
        if rigidity:
            moved = self.solve_cage(displacements, rigidity) - self.binding.cage.vertices
            for column, coordinate in zip(columns, moved.T, strict=True):
                column += self.binding.weights @ coordinate
        else:
            self._mesh_map.add_to(columns, displacements)
        return columns.T

    def edit_cages(self, cages: Floats, displacements: Floats, rigidity: int = 0) -> Floats:
        """Move the anchors of cages (k, n, 3) by displacements (k, l, 3).

        Each cage keeps its own δ = L c, and with it its motion and detail. A cage whose anchors
        are not displaced stays the same bit for bit.
        """
        is_moved = displacements.any(axis=(1, 2))
        edited, chosen = cages.copy(), cages[is_moved]
        moved = self._cage_map(displacements[is_moved])
        if rigidity:
            for cage, unrotated in zip(chosen, moved, strict=True):
                unrotated[...] = self._rotate_cells(
                    Cells(self._neighbours, cage), unrotated, rigidity
                )
        edited[is_moved] += moved
        return edited

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

    def _with_anchors(self, anchors: tuple[Anchor, ...]) -> "Poser":
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
        responses = [one.solve_response(rows, compliance) for one in self._response_solvers]
        for response in responses:
            _check_independent(response, anchors)
        self.condition_number = max(response.condition_number for response in responses)
        self.free_modes = sum(response.free_modes for response in responses)
        mirror = self.constraints.mirror
        self._cage_map = MirroredMap([response.anchor_response for response in responses], mirror)
        self._differential_map = MirroredMap(
            [response.differential_response for response in responses], mirror
        )
        self.__dict__.pop("_mesh_map", None)

    @cached_property
    def _cells_at_rest(self) -> Cells:
        return Cells(self._neighbours, self.binding.cage.vertices)

    @cached_property
    def _mesh_map(self) -> MirroredMap:
        return self._cage_map.compose(self.binding.weights)

    @cached_property
    def _rest_columns(self) -> Floats:
        return np.ascontiguousarray(self.binding.rest.vertices.T)


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
