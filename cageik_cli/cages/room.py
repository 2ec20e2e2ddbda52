"""Whether a cage that holds its model leaves it too much room: loose, or around several limbs."""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from cageik_cli.cages.findings import Finding
from cageik_cli.cages.looseness import Looseness, measure_looseness
from cageik_cli.cages.sections import SharedSection, find_shared_sections
from cageik_cli.cages.similarity import MAX_SIZE_RATIO, find_transform
from cageik_cli.geometry.mesh import TriMesh

TYPICAL_GAP = 16.5
"""Mean gap of built cages, percent of the diagonal, times the root of their number of vertices.

Measured on cages that `cageik cage` built for four characters: 2.0 to 2.4 % with 60 vertices, 1.4
to 1.6 % with 120, 0.8 to 1.1 % with 300. It is typical, not computed for a model.
"""

TYPICAL_VERTICES = (60, 300)
"""Numbers of vertices between which it was measured; outside, the nearest one counts."""

MAX_GAP_RATIO = 2.0
"""A cage is loose if its mean gap is so many times the typical one."""

MIN_MODEL_VERTICES = 500
"""Models with fewer vertices are not judged: any cage has nearly as many."""

MIN_LIMB_GAP = 0.02
"""Limbs that are nearer to each other than this, in diagonals, may share a loop: a cage between
them would have no clearance."""

MIN_LIMB_LENGTH = 0.04
"""Shorter places where limbs share a loop, in diagonals, are left out."""

MAX_PLACES = 4
"""Places that are named."""


def find_room_faults(cage: TriMesh, rest: TriMesh, is_thorough: bool = True) -> Iterator[Finding]:
    """Find what is poor about the room in a cage, closed and turned outward, around its model.

    Limbs in one loop are looked for in loose cages; in others, too, if it is to be thorough.
    """
    if cage.diagonal > MAX_SIZE_RATIO * rest.diagonal:
        yield _describe_size(cage, rest)
        return
    if len(rest.vertices) < MIN_MODEL_VERTICES:
        return
    loose = list(_find_loose_cage(cage, rest))
    yield from loose
    if not (loose or is_thorough):
        return
    least = MIN_LIMB_GAP * rest.diagonal, MIN_LIMB_LENGTH * rest.diagonal
    places = (
        place
        for place in find_shared_sections(cage, rest)
        if place.gap >= least[0] and place.length >= least[1]
    )
    yield from map(_describe_shared_section, islice(places, MAX_PLACES))


def has_too_much_room(cage: TriMesh, rest: TriMesh) -> bool:
    """Return whether a cage is so large, or so loose, that it follows no part of its model well."""
    return next(find_room_faults(cage, rest, is_thorough=False), None) is not None


def _describe_size(cage: TriMesh, rest: TriMesh) -> Finding:
    ratio = cage.diagonal / rest.diagonal
    transform = find_transform(cage, rest)
    remedy = "fit the cage to the model"
    if transform is not None:
        remedy = f"the cage is {transform.name}: export it as the model was"
    message = (
        f"the cage is {ratio:.3g} times as large as the model, expected at most {MAX_SIZE_RATIO:g}"
    )
    return Finding("large", "warning", message, remedy, value=float(ratio))


def _find_loose_cage(cage: TriMesh, rest: TriMesh) -> Iterator[Finding]:
    looseness = measure_looseness(cage, rest)
    count = int(np.clip(len(cage.vertices), *TYPICAL_VERTICES))
    typical = TYPICAL_GAP / np.sqrt(count)
    if looseness.mean_gap <= MAX_GAP_RATIO * typical:
        return
    message = (
        f"the cage is loose: {_describe_looseness(looseness)}, where a built cage of {count} "
        f"vertices typically has {_describe_typical(looseness, rest, typical)}"
    )
    remedy = (
        "move it closer to the model, or build one with cageik cage, with more vertices if this "
        "one was built; a loose cage follows the motion poorly"
    )
    yield Finding("loose", "warning", message, remedy, value=looseness.mean_gap)


def _describe_looseness(looseness: Looseness) -> str:
    gap = f"{looseness.mean_gap:.3g} % of the diagonal away from the model on average"
    if looseness.volume_ratio is None:
        return gap
    return f"{looseness.volume_ratio:.3g} times the model's volume, {gap}"


def _describe_typical(looseness: Looseness, rest: TriMesh, gap: float) -> str:
    """Say what built cages reach: their gap, all over this surface, adds to the volume."""
    if looseness.volume_ratio is None:
        return f"{gap:.2g} %"
    layer = float(rest.face_areas.sum()) * gap / 100 * rest.diagonal
    return f"{1 + layer / abs(rest.volume):.2g} times and {gap:.2g} %"


def _describe_shared_section(place: SharedSection) -> Finding:
    x, y, z = (float(value) for value in place.centre)
    message = (
        f"{place.limbs} limbs of the model are in one loop of the cage around ({x:.4g}, {y:.4g}, "
        f"{z:.4g}), {place.size:.3g} across, for {place.length:.3g} along {'xyz'[place.axis]}, "
        f"{place.gap:.3g} apart"
    )
    remedy = "let the cage go between them; with one loop they can hardly move apart"
    limbs = float(place.limbs)
    return Finding("shared-loop", "warning", message, remedy, value=limbs, place=(x, y, z))
