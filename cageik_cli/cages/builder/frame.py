"""The frame in which a cage is built: the same one however a file states the surface."""

from itertools import permutations, product

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.util.arrays import Floats

MOMENT_TIE_TOL = 1e-5
"""Moments of the surface that differ by less are a tie, in units of the frame."""

MOMENT_POWERS = tuple(
    powers
    for degree in (2, 3, 4)
    for powers in product((4, 3, 2, 1, 0), repeat=3)
    if sum(powers) == degree
)
"""Of the coordinates in the moments that tell the axes: a model whose moments are all the same when
it is turned is taken to be symmetric."""

AXIS_TURNS = tuple(
    (order, signs)
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(np.eye(3)[list(order)] * np.array(signs)[:, None]) > 0
)
"""The 24 ways to permute axes and turn them over that are turns, as orders and signs; the first
leaves them as they are."""

PLACE_STEP = 2.0**-30
"""Places are rounded to multiples of it, in units of the frame. It is far more than the rounding of
double precision, and far less than a clearance; round numbers are no odd multiples of its half."""

PLACE_DECIMALS = 6
"""Digits of a position that decide which vertex comes first: single precision has seven."""

MAX_UNEVENNESS = 1e-4
"""How far points are moved so that no two edges of a symmetric shape are equally long, and no plane
is flat, in units of the frame: otherwise, the last digits of a file would decide."""

WAVES = np.array([[68.5, 86.5, 45.5], [44.5, 74.5, 98.5], [80.5, 36.5, 63.5]])
"""Wave vectors of these moves, per unit of the frame: no two are alike along any axis. Waves are as
long as ten cells of a shell's grid, and bend a plane over one by more than single precision."""


class Frame:
    """A model's own frame: its box at the origin, of a diagonal of one, its longest axis first.

    Axes are permuted and turned over, as the surface is spread along them and leans to one side,
    and stay right-handed. A model that is moved, scaled or turned by 90 degrees has the same
    coordinates in it, unless it is symmetric.

    Parameters
    ----------
    unit : float, optional
        In place of the diagonal, file units.
    """

    def __init__(self, model: TriMesh, unit: float | None = None) -> None:
        low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
        self._centre, self._scale = low + (high - low) / 2, unit or model.diagonal
        self._order, self._signs = np.arange(3), np.ones(3)
        # By area: the same for vertices that are split where normals or UVs differ.
        order, signs = _choose_turn(self.to_units(model.vertices), lumped_areas(model))
        self._order, self._signs = np.array(order), np.array(signs)

    def to_units(self, points: Floats) -> Floats:
        """Return places in file units, (..., 3), in units of the frame."""
        units = (points - self._centre) / self._scale
        return np.asarray(units[..., self._order] * self._signs)

    def to_file_units(self, points: Floats) -> Floats:
        """Undo the turn, the move and the scale of (k, 3) points."""
        turned = np.empty_like(points)
        turned[:, self._order] = points * self._signs
        return np.asarray(turned * self._scale + self._centre)


def _choose_turn(points: Floats, areas: Floats) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the turn that makes moments largest, each where those before it leave a choice.

    The first is the spread along x, then come that along y, how far all axes lean, and the others.
    """
    shares = areas / areas.sum() if areas.sum() > 0 else np.full(len(areas), 1 / len(areas))
    moments = {powers: float(shares @ (points**powers).prod(axis=1)) for powers in MOMENT_POWERS}
    left = np.arange(len(AXIS_TURNS))
    for values in np.array([_turn_moments(moments, *turn) for turn in AXIS_TURNS]).T:
        left = left[values[left] > values[left].max() - MOMENT_TIE_TOL]
    return AXIS_TURNS[left[0]]


def _turn_moments(
    moments: dict[tuple[int, ...], float], order: tuple[int, ...], signs: tuple[float, ...]
) -> list[float]:
    """Return the moments of a turned model in the order in which they decide."""
    turned = {}
    for powers in moments:
        before = tuple(powers[order.index(axis)] for axis in range(3))
        turned[powers] = float(np.prod(np.power(signs, powers))) * moments[before]
    lean = turned[3, 0, 0] + turned[0, 3, 0] + turned[0, 0, 3]
    return [turned[2, 0, 0], turned[0, 2, 0], lean, *turned.values()]


def round_places(points: Floats) -> Floats:
    """Return places in the frame, (k, 3), without the rounding of the file's coordinates.

    All choices of the builder are then the same, however the model was moved, turned or scaled.
    """
    return np.asarray(np.round(points / PLACE_STEP) * PLACE_STEP)


def sort_mesh(mesh: TriMesh) -> TriMesh:
    """Return a mesh with its vertices ordered by their places, and its faces by their vertices."""
    order = np.lexsort(mesh.vertices.round(PLACE_DECIMALS).T[::-1])
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    faces = number[mesh.faces]
    first = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    faces = np.take_along_axis(faces, first, axis=1)
    return TriMesh(mesh.vertices[order], faces[np.lexsort(faces.T[::-1])])


def break_ties(points: Floats) -> Floats:
    """Move points, (k, 3), by smooth waves that have no symmetry, `MAX_UNEVENNESS` at most."""
    return np.asarray(points + MAX_UNEVENNESS * np.sin(points @ WAVES.T + [0.3, 1.1, 2.3]))
