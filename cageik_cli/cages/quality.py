"""Weaknesses of a cage that binds: each has a limit, a place and a remedy."""

from collections.abc import Iterator

import numpy as np

from cageik_cli.cages.enclosure import Placement
from cageik_cli.cages.findings import Finding, format_elements
from cageik_cli.geometry.intersections import crossing_face_pairs
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles, degenerate_face_mask, thin_face_pairs
from cageik_cli.util.arrays import Floats

MIN_ANGLE = 2.0
"""Cage faces with a smaller angle, degrees, are needles."""

MIN_SHEET_RATIO = 0.02
"""Sheets closer to each other than this, relative to the face width, cannot be told apart."""

MIN_CLEARANCE = 1e-4
"""Rest vertices closer to the cage than this, in diagonals, follow single faces of it."""

MIN_INFLUENCE = 0.05
"""A cage vertex whose weights are all smaller has hardly any influence on the model."""


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
        yield Finding("needle", "warning", message, remedy, "faces", sharp, angle)


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
        yield Finding("thin", "warning", message, remedy, "face pairs", pairs, ratio)


def find_low_clearance(placement: Placement, rest: TriMesh) -> Iterator[Finding]:
    """Find rest vertices on the cage, or close to it."""
    clearance = placement.clearance / rest.diagonal
    near = np.flatnonzero(clearance < MIN_CLEARANCE)
    if len(near):
        worst = near[clearance[near].argmin()]
        percent = float(100 * clearance[worst])
        message = (
            f"vertices of the rest pose are closer to the cage than {100 * MIN_CLEARANCE:g} % of "
            f"the diagonal: {format_elements('vertex', near)}, the closest, with {percent:.2g} %, "
            f"is vertex {worst} at face {placement.closest.face[worst]}"
        )
        remedy = "enlarge the cage there; these vertices follow single faces of the cage"
        yield Finding("clearance", "warning", message, remedy, "vertices", near, percent, "rest")


def find_surface_crossings(placement: Placement, rest: TriMesh) -> Iterator[Finding]:
    """Find rest faces that cross the cage although their vertices are inside."""
    pairs = crossing_face_pairs(rest, placement.closest.mesh, placement.tolerance)
    leaving = np.isin(rest.faces[pairs[:, 0]], placement.outside_indices).any(axis=1)
    pairs = pairs[~leaving]
    if len(pairs):
        message = (
            "faces of the rest pose cross the cage although their vertices are inside, at "
            f"{format_elements('pair of a rest and a cage face', pairs)}"
        )
        kind, remedy, count = "surface-crossing", "move the cage outward there", float(len(pairs))
        yield Finding(kind, "warning", message, remedy, "face pairs", pairs, count, "both")


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
        yield Finding("weak-vertex", "warning", message, remedy, "vertices", weak, smallest)
