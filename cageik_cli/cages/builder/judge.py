"""What a cage must hold, and whether it may be handed out: by exact tests, and how good it is."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.builder.collapse import euler_characteristic
from cageik_cli.cages.builder.frame import (
    Frame,
    MirrorFrame,
    add_image,
    mirror_points,
    round_places,
    sort_mesh,
)
from cageik_cli.cages.check.faults import find_cage_faults
from cageik_cli.cages.check.quality import MIN_ANGLE, find_thin_parts
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.cages.surface_points import sample_in_blocks
from cageik_cli.geometry.intersections import crossing_face_pairs
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.shape import bounds_volume, corner_angles, degenerate_face_mask
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import group_digits

MIN_WIDTH = 1e-7
"""How wide faces without area are made, in diagonals: a distance to a face needs its plane."""

MAX_SEGMENT_PAIRS = 4_000_000
"""Pairs of edges of which those with boxes that meet are measured at once."""

CELL_SHIFT = 0.3719
"""Where a grid of cells begins, in cells: coordinates of simple shapes are round, its sides not."""


class Demand:
    """The requirements on a cage, for a model in its own frame, where its diagonal is one.

    Vertices of the model that are in no face are left out: they may be anywhere. With a mirror, the
    cage is to be its own mirror image, and must hold the model and its mirror image.

    Attributes
    ----------
    frame : Frame or MirrorFrame
    axis : int, optional
        The one across the mirror plane, which is at 0.
    surface : TriMesh
        What it must hold: the faces of the model, those without area made a little wide; in the
        frame, as all that follows.
    samples : (s, 3) float64
        Points all over the surface, about 0.01 apart.
    clearance : float
        How far it must keep off; units of the surface.
    fewest, most : int
        Cage vertices.
    is_closed : bool
        Whether the model bounds a volume, so that its own holes are known.
    holes : int
        Through the parts of the model itself, such as that of a ring; 0 if it is open.

    Raises
    ------
    FormatError
        When all vertices of the model are at one place.
    """

    def __init__(
        self, model: TriMesh, settings: BuildSettings, mirror: Mirror | None = None
    ) -> None:
        if not model.diagonal > 0:
            raise FormatError("the model is one point, expected a surface; give another mesh")
        model = model.drop_unused_vertices()
        self.axis: int | None = None
        self.frame: Frame | MirrorFrame = Frame(model)
        if mirror is not None:
            self.frame = MirrorFrame(model, mirror)
            self.axis = self.frame.axis
        placed = TriMesh(round_places(self.frame.to_units(model.vertices)), model.faces)
        held = placed if self.axis is None else add_image(placed, self.axis)
        self.surface = _widen_slivers(sort_mesh(held))
        self.samples = np.empty((0, 3))
        for block in sample_in_blocks(self.surface):
            if self.axis is not None:  # those below the plane are mirror images
                block[:, self.axis] = np.abs(block[:, self.axis])
            self.samples = keep_one_per_cell(np.concatenate([self.samples, block]), 0.01)
        if self.axis is not None:
            self.samples = mirror_points(self.samples, self.axis)
        self.clearance = settings.clearance
        self.fewest, self.most = int(np.ceil(0.9 * settings.vertices)), settings.vertices
        # Of a model and its image, the holes are not known.
        self.holes, self.is_closed = 0, mirror is None and bounds_volume(placed)
        if bounds_volume(placed):
            self.holes = int(placed.components.max()) + 1 - euler_characteristic(placed) // 2


def keep_one_per_cell(points: Floats, cell: float) -> Floats:
    """Return the first of the points in each cell of a grid, in their order."""
    cells = np.floor(points / cell + CELL_SHIFT).astype(np.int64)
    first = np.unique(cells, axis=0, return_index=True)[1]
    return np.asarray(points[np.sort(first)])


def _widen_slivers(mesh: TriMesh) -> TriMesh:
    """Put a little triangle, `MIN_WIDTH` wide, in the place of every face without area."""
    flat = np.flatnonzero(degenerate_face_mask(mesh))
    if len(flat) == 0:
        return mesh
    corners = mesh.vertices[mesh.faces[flat]]
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    longest = np.linalg.norm(sides[:, :, 0] - sides[:, :, 1], axis=2).argmax(axis=1)
    ends = sides[np.arange(len(flat)), longest]
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    is_long = length > MIN_WIDTH
    along = np.where(is_long, along / np.where(length > 0, length, 1), [[1.0, 0, 0]])
    across = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    far = np.where(is_long, ends[:, 1], ends[:, 0] + MIN_WIDTH * along)
    points = np.stack([ends[:, 0], far, ends[:, 0] + MIN_WIDTH * across], axis=1).reshape(-1, 3)
    added = len(mesh.vertices) + np.arange(len(points)).reshape(-1, 3)
    faces = np.concatenate([np.delete(mesh.faces, flat, axis=0), added])
    return TriMesh(np.concatenate([mesh.vertices, points]), faces)


@dataclass(frozen=True, slots=True)
class Verdict:
    """The figures and the faults of a cage.

    Attributes
    ----------
    faults : tuple of str
        Empty for a cage that may be handed out.
    clearance : float
        Smallest distance of the surface from the cage, units of the surface; infinite beyond twice
        what was asked for, 0 if the cage itself is faulty.
    smallest_angle : float
        Degrees.
    looseness : float
        Mean distance of the samples from the cage, units of the surface.
    """

    faults: tuple[str, ...]
    genus: int
    clearance: float
    smallest_angle: float
    largest_valence: int
    looseness: float

    @property
    def is_valid(self) -> bool:
        """Return whether the cage has no fault."""
        return not self.faults


def judge(cage: TriMesh, demand: Demand) -> Verdict:
    """Test a cage against what it must do: alone, and if it is sound, around the model."""
    faults = _list_own_faults(cage, demand)
    clearance = 0.0
    if not faults:
        distances, _ = find_near_points(demand.surface, cage, 2 * demand.clearance)
        clearance = float(distances.min(initial=np.inf))
        count = len(demand.samples)
        if outside := np.count_nonzero(winding_numbers(cage, demand.samples) < 0.5):
            faults = (f"leaves {outside} of {count} surface points outside",)
        elif len(pairs := crossing_face_pairs(demand.surface, cage, 0.0)):
            faults = (
                f"is crossed by {group_digits(len(np.unique(pairs[:, 0])))} faces of the model",
            )
        elif clearance < demand.clearance:
            share = clearance / demand.clearance
            faults = (f"is nearer to the model than asked for, {share:.2g} of the clearance",)
    return Verdict(
        faults=faults,
        genus=1 - euler_characteristic(cage) // 2,
        clearance=clearance,
        smallest_angle=float(corner_angles(cage).min()),
        largest_valence=int(np.bincount(cage.edges.ends.ravel()).max()),
        looseness=float(closest_points(cage, demand.samples).distance.mean()),
    )


def _list_own_faults(cage: TriMesh, demand: Demand) -> tuple[str, ...]:
    """Return the faults of the cage itself."""
    count = len(cage.vertices)
    if not demand.fewest <= count <= demand.most:
        return (f"has {group_digits(count)} vertices, expected {demand.fewest} to {demand.most}",)
    findings = find_cage_faults(cage)
    if not findings:
        angle = corner_angles(cage).min()
        if angle < MIN_ANGLE:
            return (f"has an angle of {angle:.2g} degrees, expected {MIN_ANGLE:g} or more",)
        findings = tuple(find_thin_parts(cage))
    return tuple(finding.message.removeprefix("the cage ") for finding in findings)


def find_near_points(surface: TriMesh, cage: TriMesh, limit: float) -> tuple[Floats, Floats]:
    """Find where a surface is nearer to the cage than `limit`, anywhere on its faces.

    Two surfaces that do not cross are nearest to each other at a vertex of one of them, or at an
    edge of each: looking at those is enough.

    Returns
    -------
    (k,) float64
        Distances, ascending.
    (k, 3) float64
        Points of the surface: its vertices, and the places on its edges and faces that are nearest
        to the cage's.
    """
    of_vertex = closest_points(cage, surface.vertices).distance
    back = closest_points(surface, cage.vertices)
    between, places = _find_near_edges(surface, cage, of_vertex, limit)
    distance = np.concatenate([of_vertex, back.distance, between])
    points = np.concatenate([surface.vertices, back.position, places])
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] < limit]
    return distance[order], points[order]


def _find_near_edges(
    surface: TriMesh, cage: TriMesh, of_vertex: Floats, limit: float
) -> tuple[Floats, Floats]:
    """Return distances of edges below the limit, (k,), and their places on the surface, (k, 3).

    Parameters
    ----------
    of_vertex : (m,)
        Distances of the surface's vertices from the cage.
    """
    ends = surface.edges.ends
    start, stop = surface.vertices[ends[:, 0]], surface.vertices[ends[:, 1]]
    length = np.linalg.norm(stop - start, axis=1)
    # On the way from one end to the other, a distance falls no faster than the way goes on.
    near = (of_vertex[ends].sum(axis=1) - length) / 2 < limit
    start, stop = start[near], stop[near]
    segments = cage.vertices[cage.edges.ends]
    found, places = [np.empty(0)], [np.empty((0, 3))]
    for near_edges, beside in _pair_boxes(start, stop, segments, limit):
        a, b = segments[beside].swapaxes(0, 1)
        distance, place = measure_segments(start[near_edges], stop[near_edges], a, b)
        found.append(distance[distance < limit])
        places.append(place[distance < limit])
    return np.concatenate(found), np.concatenate(places)


def _pair_boxes(
    start: Floats, stop: Floats, segments: Floats, limit: float
) -> Iterator[tuple[Integers, Integers]]:
    """Yield numbers of edges, and of segments (k, 2, 3) to whose boxes theirs are near.

    These are for some of the segments at a time.
    """
    low, high = np.minimum(start, stop).T - limit, np.maximum(start, stop).T + limit
    low, high = np.ascontiguousarray(low), np.ascontiguousarray(high)
    lows, highs = segments.min(axis=1), segments.max(axis=1)
    step = max(1, MAX_SEGMENT_PAIRS // max(1, len(start)))
    for block in np.split(np.arange(len(segments)), range(step, len(segments), step)):
        meeting = []
        for first, last in zip(lows[block], highs[block], strict=True):
            meets = np.flatnonzero((low[0] <= last[0]) & (high[0] >= first[0]))
            for axis in (1, 2):
                meets = meets[(low[axis, meets] <= last[axis]) & (high[axis, meets] >= first[axis])]
            meeting.append(meets)
        yield np.concatenate(meeting), np.repeat(block, [len(meets) for meets in meeting])


def measure_segments(start: Floats, stop: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return distance of segments (k, 3) from segments a b, and where on the first it is.

    Ericson, Real-Time Collision Detection (2005), section 5.1.9.
    """
    along, other, between = stop - start, b - a, start - a
    square = np.maximum((along * along).sum(axis=1), 1e-300)
    other_square = np.maximum((other * other).sum(axis=-1), 1e-300)
    products = along * other, along * between, between * other
    mixed, c, f = (product.sum(axis=1) for product in products)
    denominator = square * other_square - mixed**2
    parallel = denominator <= 1e-14 * square * other_square
    safe = np.where(parallel, 1.0, denominator)
    s = np.where(parallel, 0.0, np.clip((mixed * f - c * other_square) / safe, 0, 1))
    t = np.clip((mixed * s + f) / other_square, 0, 1)
    s = np.clip((mixed * t - c) / square, 0, 1)
    place = start + s[:, None] * along
    return np.linalg.norm(place - (a + t[:, None] * other), axis=1), place
