"""Plane sections of a cage and its model: where limbs share one loop of the cage."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.geometry.points import measure_distances
from cageik_cli.util.arrays import Floats, Integers

MIN_LIMB_SIZE = 0.025
"""Smaller loops, in diagonals of the model, are no limbs."""

MIN_CAGED_GAP = 0.008
"""Limbs nearer to each other than this, in diagonals, count as one: no cage fits between."""

DEFAULT_SECTIONS = 24
"""Positions along each axis at which cage and model are cut."""

MAX_LIMB_REACH = 0.05
"""Loops are of one limb if the surface joins them within this distance of the plane, diagonals."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedSection:
    """A place where limbs of the model are in one loop of the cage.

    Attributes
    ----------
    axis : int
        The axis across which both were cut: 0, 1, 2 for x, y, z.
    centre : (3,) float64
        Middle of the limbs' loops, file units.
    size : float
        Diagonal of the box around them, file units.
    length : float
        How far the place goes along the axis, file units.
    limbs : int
        How many limbs are in the loop, at most.
    gap : float
        Smallest distance between the limbs there, file units.
    """

    axis: int
    centre: Floats
    size: float
    length: float
    limbs: int
    gap: float


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """A loop in which a plane across an axis cuts a mesh.

    Attributes
    ----------
    axis : int
        0, 1, 2 for x, y, z.
    segments : (s, 2, 3) float64
        Ends of the segment in each face that is cut; the inside is on the same side of all.
    vertex : int
        A vertex of the mesh beside the loop.
    """

    axis: int
    segments: Floats
    vertex: int

    @property
    def points(self) -> Floats:
        """Return where the segments begin, (s, 3)."""
        return self.segments[:, 0]

    @property
    def size(self) -> float:
        """Return the diagonal of the box around the loop."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @property
    def is_closed(self) -> bool:
        """Return whether it ends where it begins, up to rounding; not so where a mesh is open."""
        ends = self.segments.sum(axis=0)
        return bool(np.linalg.norm(ends[1] - ends[0]) <= 1e-9 * len(self.segments) * self.size)

    def goes_around(self, point: Floats) -> bool:
        """Return whether it goes around a point of its plane, (3,)."""
        kept = [k for k in range(3) if k != self.axis]
        one, two = ((self.segments[:, end] - point)[:, kept] for end in range(2))
        turn = np.arctan2(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0], (one * two).sum(axis=1))
        return bool(abs(turn.sum()) > np.pi)


class Slicer:
    """Cuts a mesh, often, across one axis: 0, 1, 2 for x, y, z."""

    def __init__(self, mesh: TriMesh, axis: int) -> None:
        self.mesh, self.axis = mesh, axis
        a, b, c = (mesh.vertices[mesh.faces[:, k], axis] for k in range(3))
        self._low, self._high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)

    def find_cut_faces(self, position: float) -> Integers:
        """Find the faces with vertices on both sides; vertices in the plane count as above it."""
        return np.flatnonzero((self._low < position) & (self._high >= position))

    def cut(self, position: float) -> list[Loop]:
        """Return the loops in which a plane cuts the mesh."""
        faces = self.mesh.faces[self.find_cut_faces(position)]
        side = self.mesh.vertices[faces, self.axis] >= position
        # The corner that is alone on its side first: its two edges are the ones that are cut.
        lone = np.where(side.sum(axis=1) == 1, side.argmax(axis=1), (~side).argmax(axis=1))
        corners = np.take_along_axis(faces, (lone[:, None] + np.arange(3)) % 3, axis=1)
        ends = np.stack([corners[:, [0, 1]], corners[:, [0, 2]]], axis=1)
        # Faces whose lone corner is below pass the plane the other way.
        flipped = ~np.take_along_axis(side, lone[:, None], axis=1)[:, 0]
        ends[flipped] = ends[flipped][:, ::-1]
        one, two = self.mesh.vertices[ends[:, :, 0]], self.mesh.vertices[ends[:, :, 1]]
        height, other = one[..., self.axis] - position, two[..., self.axis] - position
        segments = one + (height / (height - other))[..., None] * (two - one)
        return [
            Loop(self.axis, segments[chosen], int(faces[chosen[0], 0]))
            for chosen in _list_loops(ends)
        ]


def _list_loops(ends: Integers) -> list[Integers]:
    """Return the segments of each loop, found by the edges (s, 2, 2) on which they end."""
    if len(ends) == 0:
        return []
    flat = np.sort(ends.reshape(-1, 2), axis=1)
    keys: Integers = flat[:, 0] * (int(flat.max()) + 1) + flat[:, 1]
    _, edge = np.unique(keys, return_inverse=True)
    joined: Integers = edge.reshape(-1, 2)
    loops = find_groups(joined, int(edge.max()) + 1)[joined[:, 0]]
    order = np.argsort(loops, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(loops[order])) + 1)


def find_shared_sections(
    cage: TriMesh, model: TriMesh, near: Floats | None = None
) -> list[SharedSection]:
    """Find where two or more limbs of the model go through one loop of the cage.

    Parameters
    ----------
    cage, model : TriMesh
        The cage holds the model.
    near : (k, 3) float64, optional
        Only the sections within a step of these points are made, which is faster; all by default.

    Returns
    -------
    list of SharedSection
        One of each place, the longest first. Limbs are of one connected body: loops of another
        component, or inside others, are none, and loops that the surface joins near the plane are
        one limb.
    """
    found: list[list[SharedSection]] = []
    for axis in range(3):
        low, high = model.vertices[:, axis].min(), model.vertices[:, axis].max()
        step = (high - low) / DEFAULT_SECTIONS
        slicers = Slicer(cage, axis), Slicer(model, axis)
        before: list[list[SharedSection]] = []
        for k in range(DEFAULT_SECTIONS):
            position = low + (k + 0.5) * step
            is_wanted = near is None or (np.abs(near[:, axis] - position) <= step).any()
            now = _find_at(*slicers, position) if is_wanted else []
            runs = [_continue_run(place, before) for place in now]
            found += [run for run in runs if len(run) == 1]
            before = runs
    # A place in one section alone is only grazed.
    places = [_join_run(run) for run in found if len(run) >= 2]
    return sorted(places, key=lambda place: -place.length)


def _find_at(cage: Slicer, model: Slicer, position: float) -> list[SharedSection]:
    """Find the places in one section."""
    loops = _find_limb_loops(model, position)
    if len(loops) < 2:
        return []
    groups = list(_group_loops(loops, cage.cut(position), model.mesh))
    if not groups:
        return []
    limbs = _label_limbs(model, position)
    places = []
    for group in groups:
        parts = _join_loops(group, limbs, MIN_CAGED_GAP * model.mesh.diagonal)
        if len(parts) > 1:
            gap = min(_measure_gap(*pair) for pair in combinations(parts, 2))
            points = np.concatenate(parts)
            low, high = points.min(axis=0), points.max(axis=0)
            size = float(np.linalg.norm(high - low))
            middle = (low + high) / 2
            places.append(SharedSection(model.axis, middle, size, 0.0, len(parts), gap))
    return places


def _group_loops(loops: list[Loop], borders: list[Loop], model: TriMesh) -> Iterator[list[Loop]]:
    """Yield the loops of one body of the model, two or more, that are in one loop of the cage."""
    for border in borders:
        if not border.is_closed:
            continue
        held = [loop for loop in loops if border.goes_around(loop.points[0])]
        bodies = model.components[[loop.vertex for loop in held]]
        for body in np.unique(bodies):
            chosen = np.flatnonzero(bodies == body)
            if len(chosen) > 1:
                yield [held[k] for k in chosen]


def _find_limb_loops(model: Slicer, position: float) -> list[Loop]:
    """Return the loops of a section that are large, and in no other."""
    min_size = MIN_LIMB_SIZE * model.mesh.diagonal
    large = [loop for loop in model.cut(position) if loop.size >= min_size and loop.is_closed]
    first = np.array([loop.points[0] for loop in large]).reshape(-1, 3)
    held = np.zeros(len(large), bool)
    for number, other in enumerate(large):
        # A loop goes around no point outside its box, which is quick to see.
        low, high = other.points.min(axis=0), other.points.max(axis=0)
        inside = (first >= low) & (first <= high)
        inside[:, model.axis] = True
        near = inside.all(axis=1) & ~held
        near[number] = False
        for k in np.flatnonzero(near):
            held[k] = other.goes_around(first[k])
    return [loop for loop, is_held in zip(large, held, strict=True) if not is_held]


def _label_limbs(model: Slicer, position: float) -> Integers:
    """Return equal numbers, (m,), for what the surface joins near a plane; −1 for others.

    Near is what is less than `MAX_LIMB_REACH` away, in diagonals.
    """
    mesh = model.mesh
    height = mesh.vertices[:, model.axis] - position
    near = np.abs(height) < MAX_LIMB_REACH * mesh.diagonal
    near[mesh.faces[model.find_cut_faces(position)]] = True
    one, two = mesh.edges.ends[:, 0], mesh.edges.ends[:, 1]
    number = np.cumsum(near) - 1
    groups = np.full(len(near), -1)
    joined = number[mesh.edges.ends[near[one] & near[two]]]
    groups[near] = find_groups(joined, int(near.sum()))
    return groups


def _join_loops(loops: list[Loop], limbs: Integers, min_gap: float) -> list[Floats]:
    """Return the points of each limb: loops of one limb, and loops that nearly touch, are one."""
    near = [
        (i, j)
        for i, one in enumerate(loops)
        for j, other in enumerate(loops[:i])
        if limbs[one.vertex] == limbs[other.vertex]
        or _measure_gap(one.points, other.points) < min_gap
    ]
    group = find_groups(np.array(near, np.int64).reshape(-1, 2), len(loops))
    return [
        np.concatenate([loop.points for loop, own in zip(loops, group, strict=True) if own == k])
        for k in np.unique(group)
    ]


def _measure_gap(one: Floats, other: Floats) -> float:
    return float(measure_distances(one, other).min())


def _continue_run(place: SharedSection, before: list[list[SharedSection]]) -> list[SharedSection]:
    """Return the run of the section before that this place continues, or a new one."""
    for run in before:
        away = np.delete(run[-1].centre - place.centre, place.axis)
        if np.linalg.norm(away) < (run[-1].size + place.size) / 4:
            run.append(place)
            return run
    return [place]


def _join_run(run: list[SharedSection]) -> SharedSection:
    axis = run[0].axis
    heights = [place.centre[axis] for place in run]
    return SharedSection(
        axis=axis,
        centre=np.mean([place.centre for place in run], axis=0),
        size=max(place.size for place in run),
        length=float(max(heights) - min(heights)),
        limbs=max(place.limbs for place in run),
        gap=min(place.gap for place in run),
    )
