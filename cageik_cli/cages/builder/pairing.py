"""Which triangles of a cage are paired into quads, by an integer program, and which flips help."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp

from cageik_cli.cages.builder.draft import Edge, name_edge
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import cross, measure_angles
from cageik_cli.util.arrays import Floats, Integers

MIN_QUAD_ANGLE = 5.0
"""Degrees that the triangles of a quad have, by either diagonal."""

PAIR_VALUE = 0.5
"""What a quad counts for whatever its shape, which counts for at most one."""

KEPT_PAIR_VALUE = 0.25
"""What a quad counts for in addition that holds the model already: it gives way to two others."""

RIDGE_COST = 0.35
"""What the volume costs that a quad loses by its other diagonal, over the cage's volume for each
two triangles: the cage must grow until that one holds the model, too."""

FLIP_COST = 0.3
"""What a flip costs: a cage is flipped for quads that it would not have otherwise."""

HALVES = ((0, 1, 2), (0, 2, 3), (1, 2, 3), (1, 3, 0))
"""Corners of the triangles of a quad by one diagonal, and by the other."""

Corners = tuple[int, int, int, int]
"""The vertices of a quad; its diagonal in the cage is from the first to the third."""


@dataclass(frozen=True, slots=True)
class _Option:
    """A quad, or two that a flip makes of four triangles.

    Attributes
    ----------
    faces : tuple of int
        The triangles that it takes.
    gone : tuple of Edge
        Edges that are none any more; the last one is that which is flipped.
    others : tuple of Edge
        The other diagonals.
    added : Edge, optional
        The one that a flip adds.
    """

    value: float
    faces: tuple[int, ...]
    gone: tuple[Edge, ...]
    others: tuple[Edge, ...]
    added: Edge | None = None


class Pairing:
    """The quads that pairs of triangles of a cage would be.

    Parameters
    ----------
    cosine : float
        Between the normals of two triangles that are paired, at least: sharper edges stay.
    partners : (n,) int64, optional
        The mirror images of vertices: a quad is chosen with its mirror image.
    """

    def __init__(self, cage: TriMesh, cosine: float, partners: Integers | None = None) -> None:
        self._cage, self._cosine, self._partners = cage, cosine, partners
        self._beside = {  # the face, and its third corner, where a side goes from one to the other
            (face[k - 2], face[k - 1]): (number, face[k])
            for number, face in enumerate(cage.faces.tolist())
            for k in range(3)
        }
        ends = cage.edges.ends.tolist()
        self._quads = np.array(
            [(a, self._beside[b, a][1], b, self._beside[a, b][1]) for a, b in ends], np.int64
        )
        self._values, self._is_usable = self._weigh(self._quads)

    def choose(self, banned: set[Edge], held: set[Edge]) -> Integers:
        """Choose quads, as many and as well shaped ones as can be: (q, 4) corners.

        The diagonal that the cage has is from the first corner to the third. This is the matching
        of greatest value in the graph of triangles that share an edge; vertices keep three edges,
        and no edge is the other diagonal of two quads.

        Parameters
        ----------
        banned, held : set of Edge
            Diagonals of quads that are not to be chosen, and of those that hold the model already.
        """
        at = {edge: k for k, edge in enumerate(name_diagonals(self._quads))}
        chosen = self._solve(self._list_pairs(banned, held))
        return np.asarray(self._quads[sorted(at[option.gone[0]] for option in chosen)])

    def choose_flips(self, banned: set[Edge]) -> list[Edge]:
        """Choose the edges whose flips give more quads, apart from those that are banned."""
        chosen = self._solve([*self._list_pairs(set(), set()), *self._list_flips(banned)])
        return [option.gone[-1] for option in chosen if option.added is not None]

    def _weigh(self, quads: Integers) -> tuple[Floats, list[bool]]:
        """Return what quads count for, and which may be chosen: those whose diagonal is no edge."""
        vertices = self._cage.vertices
        scores = score_quads(vertices, quads, self._cosine)
        is_free = [(start, stop) not in self._beside for start, stop in quads[:, [1, 3]].tolist()]
        volume = 2 * abs(self._cage.volume) / len(self._cage.faces)
        growth = np.maximum(measure_ridges(vertices, quads), 0) / volume
        usable = (scores > 0) & np.array(is_free, bool)
        return PAIR_VALUE + scores - RIDGE_COST * growth, usable.tolist()

    def _list_pairs(self, banned: set[Edge], held: set[Edge]) -> list[_Option]:
        """List the quads around edges."""
        options = []
        for (a, d, b, c), value, usable in zip(
            self._quads.tolist(), self._values.tolist(), self._is_usable, strict=True
        ):
            edge = name_edge(a, b)
            if (usable or edge in held) and edge not in banned:
                faces = self._beside[a, b][0], self._beside[b, a][0]
                value += KEPT_PAIR_VALUE * (edge in held)
                options.append(_Option(value, faces, (edge,), (name_edge(c, d),)))
        return options

    def _list_flips(self, banned: set[Edge]) -> list[_Option]:
        """List two quads for each flip, each of a new triangle and one beside it."""
        flips = list(self._find_flips(banned))
        if not flips:
            return []
        quads = np.array([made for *_, made in flips], np.int64)
        values, usable = self._weigh(quads.reshape(-1, 4))
        options = []
        for k, (edge, added, faces, _) in enumerate(flips):
            if usable[2 * k] and usable[2 * k + 1]:
                value = float(values[2 * k : 2 * k + 2].sum()) - FLIP_COST
                gone = (*sorted(name_diagonals(quads[k])), edge)
                others = name_diagonals(np.roll(quads[k], 1, axis=1))
                options.append(_Option(value, faces, gone, (*others,), added))
        return options

    def _find_flips(
        self, banned: set[Edge]
    ) -> Iterator[tuple[Edge, Edge, tuple[int, ...], list[Corners]]]:
        """Yield the edge of a flip, the one that it adds, and two quads with their four faces."""
        for a, d, b, c in self._quads[self._is_usable].tolist():
            if name_edge(a, b) in banned:
                continue
            # The new triangles are a, d, c and d, b, c: a side of each, and its third corner.
            for sides in product(((a, d, c), (c, a, d)), ((d, b, c), (b, c, d))):
                beside = [self._beside[stop, start] for start, stop, _ in sides]
                faces = beside[0][0], beside[1][0], self._beside[a, b][0], self._beside[b, a][0]
                if len({*faces}) == 4:
                    far = beside[0][1], beside[1][1]
                    made = [(p, far[k], q, tip) for k, (p, q, tip) in enumerate(sides)]
                    yield name_edge(a, b), name_edge(c, d), faces, made

    def _solve(self, options: list[_Option]) -> list[_Option]:
        """Choose the options of the greatest value that go together."""
        if not options:
            return []
        count, faces = len(self._cage.vertices), self._cage.faces
        lost = _count([sum(option.gone, ()) for option in options], count)
        gained = _count([option.added or () for option in options], count)
        at: dict[Edge, int] = {}
        others = [[at.setdefault(edge, len(at)) for edge in option.others] for option in options]
        constraints = [
            LinearConstraint(_count([option.faces for option in options], len(faces)), ub=1),
            LinearConstraint(lost - gained, ub=np.bincount(faces.ravel(), minlength=count) - 3),
            LinearConstraint(_count(others, len(at)), ub=1),
        ]
        if self._partners is not None:
            constraints.append(LinearConstraint(self._tie_images(options), lb=0, ub=0))
        found = milp(
            [-option.value for option in options],
            integrality=np.ones(len(options)),
            bounds=Bounds(0, 1),
            constraints=constraints,
        )
        return [option for option, x in zip(options, found.x, strict=True) if x > 0.5]

    def _tie_images(self, options: list[_Option]) -> sparse.csr_array:
        """Return the differences between options and their mirror images, (k, k).

        The row of an option without an image is the option alone.
        """
        assert self._partners is not None
        at = {option.gone: k for k, option in enumerate(options)}
        ties = sparse.lil_array((len(options), len(options)))
        for k, option in enumerate(options):
            ends = [name_edge(*edge) for edge in self._partners[list(option.gone)].tolist()]
            image = at.get((*sorted(ends[:-1]), ends[-1]))
            ties[k, k] = 0 if image == k else 1
            if image is not None and image != k:
                ties[k, image] = -1
        return sparse.csr_array(ties)


def name_diagonals(quads: Integers) -> list[Edge]:
    """Return the diagonals of quads from their first corners to their third."""
    return [name_edge(start, stop) for start, stop in quads[:, [0, 2]].tolist()]


def _count(uses: Sequence[Sequence[int]], count: int) -> sparse.csr_array:
    """Return the matrix that counts how often each of `count` things is used, (count, k)."""
    columns = np.repeat(np.arange(len(uses)), [len(used) for used in uses])
    rows = np.array([row for used in uses for row in used], np.int64)
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, len(uses)))


def score_quads(vertices: Floats, quads: Integers, min_cosine: float) -> Floats:
    """Return how square and flat quads are, (q,), 0 to 1; 0 for those that may not be."""
    corners = vertices[quads]
    angles = np.stack([measure_angles(corners[:, half]).min(axis=1) for half in map(list, HALVES)])
    a, b, c = corners[:, HALVES].transpose(2, 1, 0, 3)
    normals = cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    whole = normals[0] + normals[1]
    is_convex = ((normals * whole).sum(axis=2) > 0.1).all(axis=0)
    cosine = (normals[0] * normals[1]).sum(axis=1)
    usable = is_convex & (cosine > min_cosine) & (angles.min(axis=0) > MIN_QUAD_ANGLE)
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    turn = (ahead * back).sum(axis=2)
    turn /= np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2)
    squareness = 1 - np.abs(turn).max(axis=1)
    return np.where(usable, squareness * np.maximum(cosine, 0), 0.0)


def measure_ridges(vertices: Floats, quads: Integers) -> Floats:
    """Return the volume that quads lose by their other diagonal, (q,); negative for valleys."""
    a, d, b, c = vertices[quads].transpose(1, 0, 2)
    return np.asarray((cross(b - a, d - a) * (c - a)).sum(axis=1) / 6)
