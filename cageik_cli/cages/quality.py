"""What makes a cage that binds a poor one: each with its limit, where it is, and what helps."""

from collections.abc import Iterator

import numpy as np

from cageik_cli.cages.enclosure import Placement
from cageik_cli.cages.findings import Finding, at
from cageik_cli.geometry.intersections import crossings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles, is_flat, opposite_sheets
from cageik_cli.util.arrays import Floats

SHARPEST = 2.0
"""Cage faces with a smaller angle, degrees, are needles."""

THINNEST_PART = 0.02
"""Sheets nearer to each other than this, over the width of the face, are one for the solve."""

NEAREST = 1e-4
"""Rest vertices nearer to the cage than this, in diagonals, follow single faces of it."""

WEAKEST = 0.05
"""A cage vertex whose weights are all smaller hardly moves the model."""

LARGEST = 5.0
"""A cage of a larger diagonal than this, over the model's, is likely in another unit."""


def needle_findings(cage: TriMesh) -> Iterator[Finding]:
    """Faces with a sharp angle; those that have no plane are another finding."""
    angles = corner_angles(cage).min(axis=1)
    sharp = np.flatnonzero((angles < SHARPEST) & ~is_flat(cage))
    if len(sharp):
        worst = sharp[angles[sharp].argmin()]
        yield Finding(
            kind="needle",
            severity="usable",
            message=f"the cage has angles below {SHARPEST:g} degrees at {at('face', sharp)}, "
            f"the smallest {angles[worst]:.2g} degrees at face {worst}",
            remedy="turn or collapse edges there; weights nearby are less exact",
            elements="faces",
            numbers=sharp,
            value=float(angles[worst]),
        )


def thin_findings(cage: TriMesh) -> Iterator[Finding]:
    """Faces with another sheet close by, inside or outside, in a cage without faults."""
    sheets, nearness = opposite_sheets(cage, THINNEST_PART)
    if len(sheets):
        worst = int(nearness.argmin())
        pairs = np.unique(np.sort(sheets, axis=1), axis=0)
        yield Finding(
            kind="thin",
            severity="usable",
            message=f"the cage has sheets nearer to each other than {THINNEST_PART:g} of a face's "
            f"width at {at('face pair', pairs)}, the nearest at {nearness[worst]:.2g} between "
            f"faces {sheets[worst, 0]} and {sheets[worst, 1]}",
            remedy="move them apart; the solve can hardly tell their vertices apart",
            elements="face pairs",
            numbers=pairs,
            value=float(nearness[worst]),
        )


def size_findings(cage: TriMesh, rest: TriMesh) -> Iterator[Finding]:
    """A cage that holds the model and is far too large for it."""
    ratio = cage.diagonal / rest.diagonal
    if ratio > LARGEST:
        yield Finding(
            kind="large",
            severity="usable",
            message=f"the cage is {ratio:.3g} times as large as the model, expected at most "
            f"{LARGEST:g}",
            remedy="export both in one unit, or move the cage nearer to the model",
            elements="",
            numbers=np.empty(0, np.int64),
            value=float(ratio),
        )


def clearance_findings(placement: Placement, rest: TriMesh) -> Iterator[Finding]:
    """Rest vertices on the cage, or nearly."""
    clearance = placement.nearest.distance / rest.diagonal
    near = np.flatnonzero(clearance < NEAREST)
    if len(near):
        worst = near[clearance[near].argmin()]
        yield Finding(
            kind="clearance",
            severity="usable",
            message=f"vertices of the rest pose are nearer to the cage than {100 * NEAREST:g} % of "
            f"the diagonal: {at('vertex', near)}, the nearest with {100 * clearance[worst]:.2g} % "
            f"vertex {worst} at face {placement.nearest.face[worst]}",
            remedy="enlarge the cage there; they follow single faces and show the cage's edges",
            elements="vertices",
            numbers=near,
            value=float(100 * clearance[worst]),
        )


def crossing_findings(placement: Placement, rest: TriMesh) -> Iterator[Finding]:
    """Rest faces that leave the cage although their vertices do not."""
    pairs = crossings(rest, placement.nearest.mesh, placement.tolerance)
    leaving = np.isin(rest.faces[pairs[:, 0]], placement.far).any(axis=1)
    pairs = pairs[~leaving]
    if len(pairs):
        yield Finding(
            kind="surface-crossing",
            severity="usable",
            message="faces of the rest pose cross the cage although their vertices are inside, at "
            f"{at('pair of a rest and a cage face', pairs)}",
            remedy="move the cage outward there",
            elements="face pairs",
            numbers=pairs,
            value=float(len(pairs)),
        )


def influence_findings(strongest: Floats) -> Iterator[Finding]:
    """Cage vertices whose largest weight on the model, (n,), is small."""
    weak = np.flatnonzero(strongest < WEAKEST)
    if len(weak):
        worst = weak[strongest[weak].argmin()]
        yield Finding(
            kind="weak-vertex",
            severity="usable",
            message=f"the cage has vertices whose weights are all below {WEAKEST:g}: "
            f"{at('vertex', weak)}, the weakest with {strongest[worst]:.2g} vertex {worst}",
            remedy="delete them or move them nearer to the model; the frames hardly hold them",
            elements="vertices",
            numbers=weak,
            value=float(strongest[worst]),
        )
