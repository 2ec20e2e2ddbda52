"""Weaknesses of a cage that binds: each has a limit, a place and a remedy."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from cageik_cli.cages.check.enclosure import Placement
from cageik_cli.cages.check.faults import Finding, format_elements
from cageik_cli.cages.check.misfit import MAX_SIZE_RATIO, find_transform
from cageik_cli.cages.check.sections import find_shared_sections
from cageik_cli.cages.surface_points import sample_surface, take_evenly
from cageik_cli.geometry.intersections import crossing_face_pairs
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import count_by_part, describe_by_part, name_vertex
from cageik_cli.geometry.shape import (
    bounds_volume,
    corner_angles,
    degenerate_face_mask,
    thin_face_pairs,
)
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.arrays import Floats
from cageik_cli.util.messages import say

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
        angle = float(angles[worst])
        yield Finding("needle", "warning", message, remedy, value=angle).at("faces", sharp)


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
        ratio = float(nearness[worst])
        yield Finding("thin", "warning", message, remedy, value=ratio).at("face pairs", pairs)


def find_low_clearance(placement: Placement) -> Iterator[Finding]:
    """Find rest vertices on the cage, or close to it."""
    clearance = placement.clearance / placement.rest.diagonal
    near = np.flatnonzero(clearance < MIN_CLEARANCE)
    if len(near):
        worst = near[clearance[near].argmin()]
        percent = float(100 * clearance[worst])
        message = (
            f"vertices of the rest pose are closer to the cage than {100 * MIN_CLEARANCE:g} % of "
            f"the diagonal: {format_elements('vertex', near)}"
            f"{describe_by_part(count_by_part(placement.rest, near))}, the closest, with "
            f"{percent:.2g} %, is vertex {name_vertex(placement.rest, int(worst))} at face "
            f"{placement.closest.face[worst]}"
        )
        remedy = "enlarge the cage there; these vertices follow single faces of the cage"
        found = Finding("clearance", "warning", message, remedy, value=percent)
        yield found.at("vertices", near, "rest")


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
        kind, remedy, count = "surface-crossing", "move the cage outward there", float(len(pairs))
        yield Finding(kind, "warning", message, remedy, value=count).at("face pairs", pairs, "both")


def find_weak_vertices(largest_weights: Floats) -> Iterator[Finding]:
    """Find cage vertices whose largest weight on the model, (n,), is small."""
    weak = np.flatnonzero(largest_weights < MIN_INFLUENCE)
    if len(weak):
        worst = weak[largest_weights[weak].argmin()]
        smallest = float(largest_weights[worst])
        message = (
            f"the cage has vertices whose weights are all below {MIN_INFLUENCE:g}: "
            f"{format_elements('vertex', weak)}, the smallest, {smallest:.2g}, at vertex {worst}"
        )
        remedy = "delete them or move them closer to the model; frames hardly determine them"
        found = Finding("weak-vertex", "warning", message, remedy, value=smallest)
        yield found.at("vertices", weak)


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
        f"the cage is loose: {found}, where a built cage of {count} vertices typically has "
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
        limbs = float(place.limbs)
        yield Finding("shared-loop", "warning", message, remedy, value=limbs, place=(x, y, z))
