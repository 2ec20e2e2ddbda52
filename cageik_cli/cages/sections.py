"""Plane sections of a cage and its model: where limbs share one loop of the cage."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cageik_cli.cages.plane_sections import (
    Section,
    Slicer,
    is_closed,
    measure_box,
    winds_around,
)
from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.geometry.points import measure_distances
from cageik_cli.util.arrays import Floats, Integers

SECTIONS = 24
"""Positions along each axis at which both are cut."""

LIMB_LENGTH = 0.05
"""Loops belong to different limbs if the surface does not join them within so far of the plane,
in diagonals of the model."""

MIN_LOOP_SIZE = 0.025
"""Smaller loops, in diagonals of the model, are no limbs."""

MIN_RUN = 2
"""Limbs share a loop in so many sections that follow each other; in fewer, a section grazes."""

MIN_GAP = 0.008
"""Limbs nearer to each other than this, in diagonals, count as one: no cage fits between."""

NEAR_STEPS = 1.0
"""Sections are near a point if they are so many distances between sections away, or less."""


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


def find_shared_sections(
    cage: TriMesh, model: TriMesh, near: Floats | None = None
) -> list[SharedSection]:
    """Find where two or more limbs of the model go through one loop of the cage.

    Parameters
    ----------
    cage, model : TriMesh
        The cage holds the model.
    near : (k, 3) float64, optional
        Only the sections near these points are made, which is faster; all by default.

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
        step = (high - low) / SECTIONS
        slicers = Slicer.prepare(cage, axis), Slicer.prepare(model, axis)
        before: list[list[SharedSection]] = []
        for k in range(SECTIONS):
            position = low + (k + 0.5) * step
            is_wanted = near is None or (
                (np.abs(near[:, axis] - position) <= NEAR_STEPS * step).any()
            )
            now = _find_at(*slicers, position) if is_wanted else []
            runs = [_continue_run(place, before) for place in now]
            found += [run for run in runs if len(run) == 1]
            before = runs
    places = [_join_run(run) for run in found if len(run) >= MIN_RUN]
    return sorted(places, key=lambda place: -place.length)


def _find_at(cage: Slicer, model: Slicer, position: float) -> list[SharedSection]:
    """Find the places in one section."""
    axis, mesh = model.axis, model.mesh
    inner = model.cut(position)
    loops = _find_limb_loops(inner, axis, MIN_LOOP_SIZE * mesh.diagonal)
    if len(loops) < 2:
        return []
    groups = list(_group_loops(loops, inner, cage.cut(position), model))
    if not groups:
        return []
    limbs = _label_limbs(model, position)
    places = []
    for group in groups:
        vertices = mesh.faces[[inner.faces[loop[0]] for loop in group], 0]
        parts = [inner.segments[loop][:, 0] for loop in group]
        parts = _join_parts(parts, limbs[vertices], MIN_GAP * mesh.diagonal)
        if len(parts) > 1:
            places.append(_describe(parts, axis))
    return places


def _group_loops(
    loops: list[Integers], inner: Section, outer: Section, model: Slicer
) -> Iterator[list[Integers]]:
    """Yield the loops of one body of the model, two or more, that are in one loop of the cage."""
    axis, mesh = model.axis, model.mesh
    for number in np.unique(outer.loops):
        border = outer.segments[outer.loops == number]
        if not is_closed(border):
            continue
        held = [loop for loop in loops if winds_around(border, inner.segments[loop][0, 0], axis)]
        bodies = mesh.components[mesh.faces[[inner.faces[loop[0]] for loop in held], 0]]
        for body in np.unique(bodies):
            chosen = np.flatnonzero(bodies == body)
            if len(chosen) > 1:
                yield [held[k] for k in chosen]


def _find_limb_loops(section: Section, axis: int, min_size: float) -> list[Integers]:
    """Return the segments of each loop that is large, and in no other."""
    order = np.argsort(section.loops, kind="stable")
    starts = np.flatnonzero(np.diff(section.loops[order])) + 1
    large = [
        loop
        for loop in np.split(order, starts)
        if len(loop)
        and measure_box(section.segments[loop][:, 0]) >= min_size
        and is_closed(section.segments[loop])
    ]
    return _drop_held_loops(large, section.segments, axis)


def _drop_held_loops(large: list[Integers], segments: Floats, axis: int) -> list[Integers]:
    """Return the loops that no other one goes around."""
    first = np.array([segments[loop[0], 0] for loop in large]).reshape(-1, 3)
    held = np.zeros(len(large), bool)
    for number, other in enumerate(large):
        border = segments[other]
        # A loop goes around no point outside its box, which is quick to see.
        inside = (first >= border[:, 0].min(axis=0)) & (first <= border[:, 0].max(axis=0))
        inside[:, axis] = True
        near = inside.all(axis=1) & ~held
        near[number] = False
        for k in np.flatnonzero(near):
            held[k] = winds_around(border, first[k], axis)
    return [loop for loop, is_held in zip(large, held, strict=True) if not is_held]


def _label_limbs(model: Slicer, position: float) -> Integers:
    """Return equal numbers, (m,), for what the surface joins near a plane; −1 for others."""
    mesh = model.mesh
    height = mesh.vertices[:, model.axis] - position
    near = np.abs(height) < LIMB_LENGTH * mesh.diagonal
    near[mesh.faces[model.find_cut_faces(position)]] = True
    one, two = mesh.edges.ends[:, 0], mesh.edges.ends[:, 1]
    number = np.cumsum(near) - 1
    groups = np.full(len(near), -1)
    joined = number[mesh.edges.ends[near[one] & near[two]]]
    groups[near] = find_groups(joined, int(near.sum()))
    return groups


def _join_parts(parts: list[Floats], limbs: Integers, min_gap: float) -> list[Floats]:
    """Return the points of each limb: loops of one limb, and loops that nearly touch, are one."""
    near = [
        (i, j)
        for i in range(len(parts))
        for j in range(i)
        if limbs[i] == limbs[j] or _measure_gap(parts[i], parts[j]) < min_gap
    ]
    group = find_groups(np.array(near, np.int64).reshape(-1, 2), len(parts))
    return [
        np.concatenate([part for part, own in zip(parts, group, strict=True) if own == number])
        for number in np.unique(group)
    ]


def _measure_gap(one: Floats, other: Floats) -> float:
    return float(measure_distances(one, other).min())


def _describe(parts: list[Floats], axis: int) -> SharedSection:
    """Describe the place where limbs, the points of each (k, 3), are in one loop."""
    gap = min(_measure_gap(*pair) for pair in combinations(parts, 2))
    points = np.concatenate(parts)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return SharedSection(axis, centre, measure_box(points), 0.0, len(parts), gap)


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
