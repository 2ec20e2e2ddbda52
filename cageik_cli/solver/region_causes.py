"""Why a region of a model is likely to be reproduced badly: the evidence and the verdict."""

from dataclasses import dataclass
from enum import StrEnum

FAR_DISTANCE = 4.0
"""A cage is far when its surface is further away than this, percent of the diagonal."""

FAR_VERTICES = 1.5
"""Cage vertices are far when the nearest is further away than so many sizes of the region."""

MIN_FAR_VERTICES = 5.0
"""And further than this, percent of the diagonal."""

WEAK_WEIGHT = 0.25
"""Influence is weak where no cage vertex has a larger weight: they all share the region."""

THIN_ANGLE = 5.0
"""Cage faces with a smaller angle, degrees, are thin."""

COARSE_EDGE = 8.0
"""Cage faces are coarse whose edges are longer than this, percent of the diagonal, and the region.
"""


class Cause(StrEnum):
    """Why a region is likely to be off."""

    LOOSE_CAGE = "loose-cage"
    SHARED_LOOP = "shared-loop"
    THIN_FACES = "thin-faces"
    FAR_CAGE = "far-cage"
    WEAK_INFLUENCE = "weak-influence"
    COARSE_FACES = "coarse-faces"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a cause was judged by.

    Attributes
    ----------
    cage_distance : float
        Mean distance of the region from the cage, percent of the diagonal.
    vertex_distance : float
        Mean distance from the nearest cage vertices, percent of the diagonal.
    largest_weight : float
        Mean over the region of a vertex's largest weight.
    smallest_angle : float
        Of the nearest cage faces, degrees.
    edge_length : float
        Mean length of their edges, percent of the diagonal.
    in_shared_place : bool
        Whether the centre is where limbs share a loop of the cage.
    has_loose_cage : bool
        Whether the whole cage is far too loose.
    """

    cage_distance: float
    vertex_distance: float
    largest_weight: float
    smallest_angle: float
    edge_length: float
    in_shared_place: bool
    has_loose_cage: bool


def judge_cause(evidence: Evidence, size: float) -> Cause:
    """The first cause for which there is evidence; the size is percent of the diagonal."""
    if evidence.has_loose_cage:
        return Cause.LOOSE_CAGE
    if evidence.in_shared_place:
        return Cause.SHARED_LOOP
    if evidence.smallest_angle < THIN_ANGLE:
        return Cause.THIN_FACES
    far = max(FAR_VERTICES * size, MIN_FAR_VERTICES)
    if evidence.cage_distance > FAR_DISTANCE or evidence.vertex_distance > far:
        return Cause.FAR_CAGE
    if evidence.largest_weight < WEAK_WEIGHT:
        return Cause.WEAK_INFLUENCE
    if evidence.edge_length > max(size, COARSE_EDGE):
        return Cause.COARSE_FACES
    return Cause.UNKNOWN
