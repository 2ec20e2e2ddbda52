"""The regions of a model that an extraction reproduces worst, and what is likely to blame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from cageik_cli.geometry.mesh import find_groups
from cageik_cli.geometry.points import measure_distances
from cageik_cli.geometry.shape import corner_angles
from cageik_cli.geometry.surface import closest_points
from cageik_cli.method.solve.metrics import DeviationPeaks
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import Floats, Integers

MAX_RMS_RATIO = 10.0
"""Regions are given if the largest deviation is more than this many times the rms of the clip."""

MAX_DEVIATION = 0.03
"""They are also given if it is more than this, in diagonals of the rest model."""

MIN_DEVIATION = 1e-5
"""None are given if it is smaller than this, in diagonals: it may be rounding of the input."""

MAX_REGIONS = 5
"""Regions given, at most."""

MAX_CAGE_FACES = 5
"""Nearest cage faces of a region, at most."""

MIN_FACE_ANGLE = 5.0
"""Cage faces with a smaller angle, degrees, are thin."""

MAX_CAGE_DISTANCE = 4.0
"""A cage is far whose surface is further away from a region than this, percent of the diagonal."""

MAX_VERTEX_DISTANCE_RATIO = 1.5
"""Cage vertices are far whose distance is more than this many sizes of the region, and more than
`MIN_FAR_DISTANCE`."""

MIN_FAR_DISTANCE = 5.0
"""Cage vertices that are nearer than this, percent of the diagonal, are not far, however small the
region is."""

MIN_LARGEST_WEIGHT = 0.25
"""Influence is weak where no cage vertex has a larger weight: they all share the region."""

MAX_EDGE_LENGTH = 8.0
"""Cage faces are coarse whose edges are longer than this, percent of the diagonal, and the region.
"""

MAX_UNSMOOTHED_SHARE = 0.8
"""Smoothing is to blame for a deviation that was less than this share of it before."""


class Cause(StrEnum):
    """Why a region is likely to be off."""

    SMOOTHING = "smoothing"
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
    unsmoothed_share : float
        Largest deviation of the worst vertex before the cages were smoothed, as a share of that
        after; 1 if they were not.
    """

    cage_distance: float
    vertex_distance: float
    largest_weight: float
    smallest_angle: float
    edge_length: float
    in_shared_place: bool
    has_loose_cage: bool
    unsmoothed_share: float = 1.0

    def judge(self, size: float) -> Cause:
        """Return the first cause for which there is evidence.

        `size` is that of the region; it and other lengths are percent of the diagonal.
        """
        if self.unsmoothed_share < MAX_UNSMOOTHED_SHARE:
            return Cause.SMOOTHING
        if self.has_loose_cage:
            return Cause.LOOSE_CAGE
        if self.in_shared_place:
            return Cause.SHARED_LOOP
        if self.smallest_angle < MIN_FACE_ANGLE:
            return Cause.THIN_FACES
        far_vertices = max(MAX_VERTEX_DISTANCE_RATIO * size, MIN_FAR_DISTANCE)
        if self.cage_distance > MAX_CAGE_DISTANCE or self.vertex_distance > far_vertices:
            return Cause.FAR_CAGE
        if self.largest_weight < MIN_LARGEST_WEIGHT:
            return Cause.WEAK_INFLUENCE
        if self.edge_length > max(size, MAX_EDGE_LENGTH):
            return Cause.COARSE_FACES
        return Cause.UNKNOWN


@dataclass(frozen=True, slots=True)
class Region:
    """Connected vertices of the model that deviate much.

    Attributes
    ----------
    centre : tuple of float
        Mean of its vertices in the rest pose, file units.
    size : float
        Diagonal of the box around them, file units.
    vertices : int
        How many they are.
    frame : int
        The frame of the largest deviation, by its number in the clip.
    max_deviation : float
        File units.
    cage_faces : tuple of int
        The cage's faces nearest to the region, that of the worst vertex first.
    worst_vertex : int
        The vertex that deviates most.
    cause : Cause
        Why it is likely to be off.
    evidence : Evidence
        What the cause was judged by.
    """

    centre: tuple[float, float, float]
    size: float
    vertices: int
    frame: int
    max_deviation: float
    worst_vertex: int
    cage_faces: tuple[int, ...]
    cause: Cause
    evidence: Evidence

    def reassess(self, diagonal: float, **known: Any) -> "Region":
        """Return the region with more evidence; the diagonal is the rest model's, file units."""
        evidence = replace(self.evidence, **known)
        return replace(self, evidence=evidence, cause=evidence.judge(100 * self.size / diagonal))


def has_bad_regions(rms: float, max_deviation: float, diagonal: float) -> bool:
    """Whether the largest deviation of a clip is so large that its regions are worth a look."""
    limit = min(MAX_RMS_RATIO * rms, MAX_DEVIATION * diagonal)
    return max_deviation > max(limit, MIN_DEVIATION * diagonal)


def find_worst_regions(
    binding: Binding, peaks: DeviationPeaks, threshold: float | None = None
) -> tuple[Region, ...]:
    """Group the vertices that deviate by more than a threshold into connected regions.

    The threshold, in file units, is half of the largest deviation by default. The worst region is
    the first; there are `MAX_REGIONS` at most, and none if nothing deviates.
    """
    if threshold is None:
        threshold = 0.5 * float(peaks.deviations.max())
    chosen = peaks.deviations > max(threshold, 0.0)
    ends = binding.rest.edges.ends
    ends = ends[chosen[ends].all(axis=1)]
    label = find_groups(ends, len(chosen))[chosen]
    order = np.argsort(label, kind="stable")
    starts = np.flatnonzero(np.diff(label[order])) + 1
    found = np.split(np.flatnonzero(chosen)[order], starts)
    groups = sorted(
        (group for group in found if len(group)), key=lambda group: -peaks.deviations[group].max()
    )
    return tuple(_describe(binding, peaks, group) for group in groups[:MAX_REGIONS])


def attribute_to_shared_places(
    regions: Sequence[Region], places: Sequence[tuple[Floats, float]], diagonal: float
) -> tuple[Region, ...]:
    """Judge the causes of regions again, where limbs share a loop of the cage.

    Places are centres, (3,), and radii of balls in which limbs are known to share a loop, in file
    units, as is the diagonal of the rest model.
    """
    judged = []
    for region in regions:
        distances = [(np.linalg.norm(centre - region.centre), radius) for centre, radius in places]
        is_inside = any(distance <= radius for distance, radius in distances)
        judged.append(region.reassess(diagonal, in_shared_place=is_inside))
    return tuple(judged)


def attribute_to_loose_cage(regions: Sequence[Region], diagonal: float) -> tuple[Region, ...]:
    """Judge the causes of regions again, in a cage that is known to be far too loose."""
    return tuple(region.reassess(diagonal, has_loose_cage=True) for region in regions)


def attribute_to_smoothing(
    regions: Sequence[Region], unsmoothed: DeviationPeaks, diagonal: float
) -> tuple[Region, ...]:
    """Judge the causes of regions again, of which deviations before smoothing are known."""
    judged = []
    for region in regions:
        share = float(unsmoothed.deviations[region.worst_vertex]) / region.max_deviation
        judged.append(region.reassess(diagonal, unsmoothed_share=share))
    return tuple(judged)


def _describe(binding: Binding, peaks: DeviationPeaks, group: Integers) -> Region:
    """Describe the region of connected vertices, (k,), and judge its cause."""
    points, percent = binding.rest.vertices[group], 100 / binding.rest.diagonal
    x, y, z = points.mean(axis=0)
    worst = int(group[peaks.deviations[group].argmax()])
    nearest = closest_points(binding.cage, points)
    # The cage faces that are nearest to most points, that of the worst point first.
    counts = np.bincount(nearest.face, minlength=len(binding.cage.faces))
    counts[nearest.face[group == worst]] = len(group) + 1
    faces = np.argsort(-counts, kind="stable")[:MAX_CAGE_FACES]
    faces = faces[counts[faces] > 0]
    corners = binding.cage.vertices[binding.cage.faces[faces]]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    evidence = Evidence(
        cage_distance=float(nearest.distance.mean() * percent),
        vertex_distance=float(measure_distances(binding.cage.vertices, points).mean() * percent),
        largest_weight=float(binding.weights[group].max(axis=1).mean()),
        smallest_angle=float(corner_angles(binding.cage)[faces].min()),
        edge_length=float(edges.mean() * percent),
        in_shared_place=False,
        has_loose_cage=False,
    )
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    return Region(
        centre=(float(x), float(y), float(z)),
        size=size,
        vertices=len(group),
        frame=int(peaks.frames[worst]),
        max_deviation=float(peaks.deviations[worst]),
        worst_vertex=worst,
        cage_faces=tuple(faces.tolist()),
        cause=evidence.judge(100 * size / binding.rest.diagonal),
        evidence=evidence,
    )
