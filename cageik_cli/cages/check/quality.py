"""Weaknesses of a cage that binds: each has a limit, a place and a remedy.

Where limbs share one loop of the cage is found by plane sections of the cage and its model.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, islice

import numpy as np

from cageik_cli.cages.check.enclosure import Placement
from cageik_cli.cages.check.faults import Finding, format_elements
from cageik_cli.cages.surface_points import sample_surface, take_evenly
from cageik_cli.cages.transform import MAX_SIZE_RATIO, find_transform
from cageik_cli.geometry.intersections import crossing_face_pairs
from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.geometry.parts import count_by_part, describe_by_part, name_vertex
from cageik_cli.geometry.points import measure_distances
from cageik_cli.geometry.shape import (
    bounds_volume,
    corner_angles,
    degenerate_face_mask,
    thin_face_pairs,
)
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.messages import say
from cageik_cli.util.text import group_digits

MIN_ANGLE = 2.0
"""Cage faces with a smaller angle, degrees, are needles."""

MIN_SHEET_RATIO = 0.02
"""Sheets closer to each other than this, relative to the face width, cannot be told apart."""

MIN_CLEARANCE = 1e-4
"""Rest vertices closer to the cage than this, in diagonals, follow single faces of it."""

MIN_INFLUENCE = 0.05
"""A cage vertex whose weights are all smaller has hardly any influence on the model."""

MIN_MODEL_VERTICES = 500
"""The room around models with fewer vertices is not judged: any cage has nearly as many."""

MIN_LIMB_SIZE = 0.025
"""Smaller loops, in diagonals of the model, are no limbs."""

MIN_CAGED_GAP = 0.008
"""Limbs nearer to each other than this, in diagonals, count as one: no cage fits between."""

DEFAULT_SECTIONS = 24
"""Positions along each axis at which cage and model are cut."""

MAX_LIMB_REACH = 0.05
"""Loops are of one limb if the surface joins them within this distance of the plane, diagonals."""


def find_needle_faces(cage: TriMesh) -> Iterator[Finding]:
    """Find faces with a small angle; degenerate faces are another finding."""
    angles = corner_angles(cage).min(axis=1)
    sharp = np.flatnonzero((angles < MIN_ANGLE) & ~degenerate_face_mask(cage))
    if len(sharp):
        worst = sharp[angles[sharp].argmin()]
        message = (
            f"the cage has angles below {MIN_ANGLE:g} degrees at {format_elements('face', sharp)}, "
            f"the smallest {angles[worst]:.2g} degrees at face {worst}"
        )
        remedy = "flip or collapse edges there; weights nearby are less accurate"
        yield Finding("needle", "warning", message, remedy, "faces", sharp, angles[worst])


def find_thin_parts(cage: TriMesh) -> Iterator[Finding]:
    """Find faces with another sheet close by, inside or outside, in a sound cage."""
    sheets, nearness = thin_face_pairs(cage, MIN_SHEET_RATIO)
    if len(sheets):
        worst = int(nearness.argmin())
        pairs = np.unique(np.sort(sheets, axis=1), axis=0)
        message = (
            f"the cage has sheets closer to each other than {MIN_SHEET_RATIO:g} face widths at "
            f"{format_elements('face pair', pairs)}, the closest at {nearness[worst]:.2g} between "
            f"faces {sheets[worst, 0]} and {sheets[worst, 1]}"
        )
        remedy = "move them apart; the solve can hardly distinguish their vertices"
        yield Finding("thin", "warning", message, remedy, "face pairs", pairs, nearness[worst])


def find_low_clearance(placement: Placement) -> Iterator[Finding]:
    """Find rest vertices on the cage, or close to it."""
    clearance = placement.clearance / placement.rest.diagonal
    near = np.flatnonzero(clearance < MIN_CLEARANCE)
    if len(near):
        worst = near[clearance[near].argmin()]
        percent = 100 * clearance[worst]
        message = (
            f"vertices of the rest pose are closer to the cage than {100 * MIN_CLEARANCE:g} % of "
            f"the diagonal: {format_elements('vertex', near)}"
            f"{describe_by_part(count_by_part(placement.rest, near))}, the closest, with "
            f"{percent:.2g} %, is vertex {name_vertex(placement.rest, int(worst))} at face "
            f"{placement.closest.face[worst]}"
        )
        remedy = "enlarge the cage there; these vertices follow single faces of the cage"
        yield Finding("clearance", "warning", message, remedy, "vertices", near, percent, "rest")


def find_surface_crossings(placement: Placement) -> Iterator[Finding]:
    """Find rest faces that cross the cage although their vertices are inside."""
    pairs = crossing_face_pairs(placement.rest, placement.cage, placement.tolerance)
    corners = placement.rest.faces[pairs[:, 0]]
    pairs = pairs[~np.isin(corners, placement.outside_indices).any(axis=1)]
    if len(pairs):
        message = (
            "faces of the rest pose cross the cage although their vertices are inside, at "
            f"{format_elements('pair of a rest and a cage face', pairs)}"
        )
        kind, remedy, place = "surface-crossing", "move the cage outward there", "face pairs"
        yield Finding(kind, "warning", message, remedy, place, pairs, len(pairs), "both")


def find_weak_vertices(largest_weights: Floats) -> Iterator[Finding]:
    """Find cage vertices whose largest weight on the model, (n,), is small."""
    weak = np.flatnonzero(largest_weights < MIN_INFLUENCE)
    if len(weak):
        worst = weak[largest_weights[weak].argmin()]
        smallest = largest_weights[worst]
        message = (
            f"the cage has vertices whose weights are all below {MIN_INFLUENCE:g}: "
            f"{format_elements('vertex', weak)}, the smallest, {smallest:.2g}, at vertex {worst}"
        )
        remedy = "delete them or move them closer to the model; frames hardly determine them"
        yield Finding("weak-vertex", "warning", message, remedy, "vertices", weak, smallest)


def find_looseness_faults(
    cage: TriMesh, rest: TriMesh, is_thorough: bool = True, is_built: bool = False
) -> Iterator[Finding]:
    """Find what is poor about the room in a cage, closed and turned outward, around its model.

    Limbs in one loop are looked for in loose cages; in others, too, if it is to be thorough. Of
    the places where they are, the four longest are named. What helps a cage that was just built is
    to build it with more vertices.
    """
    if cage.diagonal > MAX_SIZE_RATIO * rest.diagonal:
        transform = find_transform(cage, rest)
        remedy = "fit the cage to the model"
        if transform is not None:
            remedy = f"the cage is {transform.name}: export it as the model was"
        ratio = float(cage.diagonal / rest.diagonal)
        message = (
            f"the cage is {ratio:.3g} times as large as the model, expected at most "
            f"{MAX_SIZE_RATIO:g}"
        )
        yield Finding("large", "warning", message, remedy, value=ratio)
        return
    if len(rest.vertices) < MIN_MODEL_VERTICES:
        return
    found = list(_find_loose_cage(cage, rest))
    if found or is_thorough:
        found += islice(_find_shared_loops(cage, rest), 4)
    for fault in found:
        yield replace(fault, remedy=say("raise `cage_vertices=`")) if is_built else fault


def is_too_loose(cage: TriMesh, rest: TriMesh) -> bool:
    """Return whether a cage is so large, or so loose, that it follows no part of its model well."""
    return next(find_looseness_faults(cage, rest, is_thorough=False), None) is not None


def _find_loose_cage(cage: TriMesh, rest: TriMesh) -> Iterator[Finding]:
    """Find a cage whose surface is, on average, twice as far from the model as that of built ones.

    Built cages have a mean gap of about 16.5 % of the diagonal over the root of their number of
    vertices. This was measured on cages for four characters: 2.0 to 2.4 % with 60 vertices, 1.4 to
    1.6 % with 120, 0.8 to 1.1 % with 300. It is typical, not computed for a model. Cages of fewer
    or more vertices are compared with these.
    """
    samples = take_evenly(sample_surface(cage), 1500)
    gap = float(100 * closest_points(rest, samples).distance.mean() / rest.diagonal)
    count = int(np.clip(len(cage.vertices), 60, 300))
    typical = 16.5 / np.sqrt(count)
    if gap <= 2 * typical:
        return
    found = f"{gap:.3g} % of the diagonal away from the model on average"
    expected = f"{typical:.2g} %"
    # A closed model with hardly any volume is flat: what it holds is rounding.
    if bounds_volume(rest) and abs(rest.volume) > 1e-9 * rest.diagonal**3:
        found = f"{abs(cage.volume / rest.volume):.3g} times the model's volume, {found}"
        # The gap, all over the model's surface, adds to its volume.
        layer = float(rest.face_areas.sum()) * typical / 100 * rest.diagonal
        expected = f"{1 + layer / abs(rest.volume):.2g} times and {expected}"
    message = (
        f"the cage is loose: {found}, where a built cage of {group_digits(count)} vertices "
        "typically has "
        f"{expected}"
    )
    remedy = (
        "move it closer to the model, or build one with cageik cage, with more vertices than this "
        "one has; a loose cage follows the motion poorly"
    )
    yield Finding("loose", "warning", message, remedy, value=gap)


def _find_shared_loops(cage: TriMesh, rest: TriMesh) -> Iterator[Finding]:
    """Find places where limbs share a loop, so long and the limbs so far apart that it matters.

    A cage between limbs that are nearer to each other would have no clearance.
    """
    for place in find_shared_sections(cage, rest):
        if place.gap < 0.02 * rest.diagonal or place.length < 0.04 * rest.diagonal:
            continue
        x, y, z = (float(value) for value in place.centre)
        message = (
            f"{place.limbs} limbs of the model are in one loop of the cage around ({x:.4g}, "
            f"{y:.4g}, {z:.4g}), {place.size:.3g} across, for {place.length:.3g} along "
            f"{'xyz'[place.axis]}, {place.gap:.3g} apart"
        )
        remedy = "let the cage go between them; with one loop they can hardly move apart"
        found = Finding("shared-loop", "warning", message, remedy, value=place.limbs)
        yield replace(found, place=(x, y, z))


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
        if len(faces) == 0:
            return []
        # The segments of a loop are joined by the edges on which they end.
        flat = np.sort(ends.reshape(-1, 2), axis=1)
        keys: Integers = flat[:, 0] * (int(flat.max()) + 1) + flat[:, 1]
        _, edge = np.unique(keys, return_inverse=True)
        joined: Integers = edge.reshape(-1, 2)
        loops = find_groups(joined, int(edge.max()) + 1)[joined[:, 0]]
        order = np.argsort(loops, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(loops[order])) + 1)
        return [Loop(self.axis, segments[part], int(faces[part[0], 0])) for part in parts]


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
            runs = []
            for place in now:
                # A place continues one of the section before that is beside it.
                run = next((run for run in before if _is_beside(run[-1], place)), None)
                if run is None:
                    run = []
                    found.append(run)
                run.append(place)
                runs.append(run)
            before = runs
    # A place in one section alone is only grazed.
    places = [_join_run(run) for run in found if len(run) >= 2]
    return sorted(places, key=lambda place: -place.length)


def _find_at(cage: Slicer, model: Slicer, position: float) -> list[SharedSection]:
    """Find the places in one section."""
    loops = _find_limb_loops(model, position)
    if len(loops) < 2:
        return []
    # The loops of one body of the model, two or more, that are in one loop of the cage.
    groups = []
    for border in cage.cut(position):
        if border.is_closed:
            held = [loop for loop in loops if border.goes_around(loop.points[0])]
            bodies = model.mesh.components[[loop.vertex for loop in held]]
            for body in np.unique(bodies):
                group = [held[k] for k in np.flatnonzero(bodies == body)]
                groups += [group] if len(group) > 1 else []
    if not groups:
        return []
    limbs = _label_limbs(model, position)
    places = []
    for group in groups:
        parts = _join_loops(group, limbs, MIN_CAGED_GAP * model.mesh.diagonal)
        if len(parts) > 1:
            gap = float(min(measure_distances(*pair).min() for pair in combinations(parts, 2)))
            points = np.concatenate(parts)
            low, high = points.min(axis=0), points.max(axis=0)
            size = float(np.linalg.norm(high - low))
            middle = (low + high) / 2
            places.append(SharedSection(model.axis, middle, size, 0.0, len(parts), gap))
    return places


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
        or measure_distances(one.points, other.points).min() < min_gap
    ]
    group = find_groups(np.array(near, np.int64).reshape(-1, 2), len(loops))
    return [
        np.concatenate([loop.points for loop, own in zip(loops, group, strict=True) if own == k])
        for k in np.unique(group)
    ]


def _is_beside(one: SharedSection, other: SharedSection) -> bool:
    """Return whether places in two sections across one axis are one place, by their sizes."""
    away = np.delete(one.centre - other.centre, other.axis)
    return bool(np.linalg.norm(away) < (one.size + other.size) / 4)


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
