"""Sparse anchors in, cage and mesh out: cage-based inverse kinematics.

The cage of a pose minimises

    (α/n) Σ_i |(L c)_i − δ_i|²  +  (β/l) Σ_j w_j |q_j − a_j c|²,        δ = L c_rest,

over l anchors with targets q, whose rows in cage space are a_j (Savoye and Franco 2010, eq. 6, in
means instead of sums). In displacements d = c − c_rest and t = q − A c_rest everything is linear in
t, and nothing large cancels: d = R t and H d = (H R) t, with responses that are computed once.
"""

from collections.abc import Iterable
from copy import copy
from functools import cached_property

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.geometry.mesh import uniform_laplacian
from cageik_cli.posing.anchors import Anchor, anchor_matrix, anchor_positions
from cageik_cli.posing.cage_response import CageResponseSolver, Response
from cageik_cli.posing.constraints import CageConstraints, MirroredMap, free_basis
from cageik_cli.posing.rigidity import Cells, Neighbours
from cageik_cli.solver.dual_laplacian import MAX_CONDITION
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, NumericalError

DEFAULT_ALPHA = 1e-6
"""Of posing: a few anchors are to be met, where thousands of vertices are to be fitted."""

MAX_NAMED = 3
"""Anchors that are named when they cannot all be met, those first that have most part in it."""

MIN_NAMED_SHARE = 0.1
"""Those that have less part in it than this share of the first's are not named."""

MAX_WEIGHT_RATIO = 1e100
"""Of alpha to beta: far beyond, numbers overflow."""


def validate_weights(alpha: float, beta: float) -> None:
    """Refuse weights of the Laplacian and of the anchors that are not finite numbers above 0.

    So are those between which nothing is left of the anchors.

    Raises
    ------
    InputError
    """
    for name, value in (("alpha", alpha), ("beta", beta)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}, expected a finite number above 0")
    if alpha / MAX_WEIGHT_RATIO > beta:
        raise InputError(
            f"alpha is {alpha} and beta {beta}, expected no more than {MAX_WEIGHT_RATIO:g} times "
            "beta; make alpha smaller"
        )


class Poser:
    """Poses of a cage and its mesh by the same anchors, any number of them.

    Parameters
    ----------
    binding : Binding
        m vertices in a cage of n.
    anchors : iterable of Anchor
        l of them, with names of their own. Without any the cage is free to go anywhere, and stays.
    alpha, beta : float
        Weights of the Laplacian and of the anchors that are not hard; finite, above 0.
    constraints : CageConstraints, optional
        Cage vertices that are locked, or mirrored.

    Attributes
    ----------
    binding : Binding
    anchors : tuple of Anchor
    alpha, beta : float
    constraints : CageConstraints
    condition_number : float
        Of the anchors' system: how much it magnifies errors of what it is given.
    free_modes : int
        In how many ways parts of the cage could move as one and no anchor says how; they stay, or
        follow those that are held.

    Raises
    ------
    InputError
        When alpha or beta is no weight, anchors share a name, or ties do not fit the cage.
    NumericalError
        When hard anchors cannot be met independently of each other.

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
        alpha: float = DEFAULT_ALPHA,
        beta: float = 1.0,
        constraints: CageConstraints | None = None,
    ) -> None:
        validate_weights(alpha, beta)
        self.binding, self.alpha, self.beta, self.constraints = (
            binding,
            alpha,
            beta,
            constraints or CageConstraints(),
        )
        cage = binding.cage
        laplacian = uniform_laplacian(cage)
        self._neighbours = Neighbours(laplacian)
        signs = (1,) if self.constraints.mirror is None else (1, -1)
        bases = [free_basis(cage, self.constraints, sign) for sign in signs]
        self._response_solvers = [CageResponseSolver(cage, laplacian, basis) for basis in bases]
        self._solve_responses(tuple(anchors))

    def __repr__(self) -> str:
        count, (vertices, cage_vertices) = len(self.anchors), self.binding.weights.shape
        anchors = f"{count} anchor{'s' * (count != 1)}"
        return f"<Poser: {anchors} on {vertices} vertices in a cage of {cage_vertices}>"

    def with_anchor(self, anchor: Anchor) -> "Poser":
        """The same with one anchor more; the cage is not factored again."""
        return self._with_anchors((*self.anchors, anchor))

    def without_anchor(self, name: str) -> "Poser":
        """The same with one anchor less; the cage is not factored again.

        Raises
        ------
        InputError
            When no anchor has the name.
        """
        kept = tuple(anchor for anchor in self.anchors if anchor.name != name)
        if len(kept) == len(self.anchors):
            raise InputError(f"there is no anchor called {name!r}")
        return self._with_anchors(kept)

    def displacements(self, targets: Floats) -> Floats:
        """t, (l, 3), that brings the anchors from the rest pose to targets, (l, 3)."""
        return np.asarray(targets - self._rest_positions)

    def solve_cage(self, displacements: Floats, rigidity: int = 0) -> Floats:
        """The cage, (n, 3), for displacements of the anchors from the rest pose, (l, 3).

        `rigidity` is the number of rounds in which the cage's cells turn with the motion; without
        any, what turns far is sheared.
        """
        moved = self._cage_map(displacements)
        if rigidity and displacements.any():
            moved = self._rotate_cells(self._cells_at_rest, moved, rigidity)
        return np.asarray(self.binding.cage.vertices + moved)

    def solve_mesh(self, displacements: Floats, rigidity: int = 0) -> Floats:
        """The mesh, (m, 3), for displacements of the anchors from the rest pose, (l, 3).

        It lies in memory coordinate by coordinate, which is faster: all x, then all y, then all z.
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
        """Cages (k, n, 3) with their anchors moved by displacements (k, l, 3).

        Each cage's own δ = L c is kept, so that its motion and detail stay. A cage whose anchors
        are not displaced stays as it is, bit for bit.
        """
        is_moved = displacements.any(axis=(1, 2))
        edited, chosen = cages.copy(), cages[is_moved]
        moved = self._cage_map(displacements[is_moved])
        if rigidity:
            for cage, unrotated in zip(chosen, moved, strict=True):
                unrotated[...] = self._rotate_cells(
                    self._neighbours.build_cells(cage), unrotated, rigidity
                )
        edited[is_moved] += moved
        return edited

    def _rotate_cells(self, cells: Cells, unrotated: Floats, rounds: int) -> Floats:
        """Displacements (n, 3) of a cage whose cells turn, from those of cells that do not."""
        moved = unrotated
        for _ in range(rounds):
            moved = unrotated + self._differential_map(
                cells.rotate_differences(cells.fit_rotations(moved))
            )
        return moved

    def _with_anchors(self, anchors: tuple[Anchor, ...]) -> "Poser":
        """What does not depend on the anchors is shared."""
        other = copy(self)
        other._solve_responses(anchors)
        return other

    def _solve_responses(self, anchors: tuple[Anchor, ...]) -> None:
        """Solve for the responses to anchors."""
        names = [anchor.name for anchor in anchors]
        duplicate = next((name for name in names if names.count(name) > 1), None)
        if duplicate is not None:
            raise InputError(f"two anchors are called {duplicate!r}; give each a name of its own")
        self.anchors = anchors
        rows = anchor_matrix(anchors, self.binding.weights)
        self._rest_positions = anchor_positions(anchors, self.binding.rest.vertices)
        unit_compliance = self.alpha * len(anchors) / (self.beta * len(self.binding.cage.vertices))
        compliance = np.array(
            [0.0 if anchor.hard else unit_compliance / anchor.weight for anchor in anchors]
        )
        responses = [field.solve_response(rows, compliance) for field in self._response_solvers]
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
        return self._neighbours.build_cells(self.binding.cage.vertices)

    @cached_property
    def _mesh_map(self) -> MirroredMap:
        return self._cage_map.compose(self.binding.weights)

    @cached_property
    def _rest_columns(self) -> Floats:
        return np.ascontiguousarray(self.binding.rest.vertices.T)


def _check_independent(response: Response, anchors: tuple[Anchor, ...]) -> None:
    """Refuse anchors that cannot go where they are to, each for itself."""
    if response.condition_number <= MAX_CONDITION:
        return
    parts = np.round(np.abs(response.weakest_mode) / np.abs(response.weakest_mode).max(), 6)
    order = np.argsort(-parts, kind="stable")[:MAX_NAMED]
    names = [repr(anchors[k].name) for k in order if parts[k] > MIN_NAMED_SHARE]
    raise NumericalError(
        f"the anchors cannot all be met: the system's condition number is "
        f"{response.condition_number:.1e}, more than {MAX_CONDITION:.0e}, and "
        f"{' and '.join(names)} {'has' if len(names) == 1 else 'have'} most part in it; leave one "
        "out, make it soft, raise alpha, or unlock cage vertices near it"
    )
