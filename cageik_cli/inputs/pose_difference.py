"""Poses of one mesh that differ in more than the pose: in the unit of length, or the up axis.

A unit changes the length of every edge by one factor, which no pose does. A change of the up axis
is certain only if the same pose is there with both, or every frame of a clip is turned so.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from cageik_cli.formats.scene_conversion import UP_TURNS
from cageik_cli.method.solve.alignment import best_motions
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.units import LONG_UNIT_NAMES, find_units_of_ratio, list_unit_ratios

MAX_POSE_STRETCH = 1.5
"""The median edge of a pose is at most so many times longer than that of another; the smallest
ratio of two units is 2.54."""

UNIT_RATIO_TOL = 0.05
"""A ratio of edges is that of two units if it differs by less, relative to itself."""

MAX_EDGE_SPREAD = 1.6
"""A pose in another unit has edges whose ratios differ by less, from the lowest tenth to the
highest: those of dancers do by up to 1.4, those of a shape that is stretched by more."""

MIN_CLEAR_RATIO = 9.0
"""A larger ratio of two units explains edges that differ more: no edit makes a shape so much
larger."""

SAME_POSE_TOL = 5e-3
"""Poses are the same if they differ by less, rms in diagonals, and their place does not count."""

MIN_POSE_DIFFERENCE = 0.05
"""Poses differ clearly by more, rms in diagonals."""

MAX_TILT = 20.0
"""The up axis of a clip may lean by so much against that of its rest pose, degrees."""


@dataclass(frozen=True, slots=True)
class PoseDifference:
    """How a given mesh differs from a reference, beyond its pose.

    Attributes
    ----------
    factor : float
        By what the given mesh must be multiplied; 1 if it fits.
    units : (str, str), optional
        The units of the given mesh and of the reference that explain the factor.
    axes : (str, str), optional
        The up axes of both, if they differ.
    is_certain : bool
        Whether nothing else than units and axes explains it.
    """

    factor: float = 1.0
    units: tuple[str, str] | None = None
    axes: tuple[str, str] | None = None
    is_certain: bool = True

    @property
    def name(self) -> str:
        """What explains it: `in metres instead of centimetres`; empty if no unit or axis does."""
        words = []
        if self.units is not None:
            own, its = (LONG_UNIT_NAMES[name] for name in self.units)
            words.append(f"in {own} instead of {its}")
        if self.axes is not None:
            own, its = (axis.lower() for axis in self.axes)
            words.append(f"with {own} up instead of {its} up")
        return ", ".join(words)

    def describe(self, beside: str) -> str:
        """Say what was measured, beside the edges that a message calls `beside`."""
        seen = []
        if self.factor != 1:
            size = f"{max(self.factor, 1 / self.factor):.4g} times as "
            size += "short" if self.factor > 1 else "long"
            seen.append(f"its edges are {size} as {beside}")
        if self.axes is not None:
            seen.append("its poses are turned so")
        return ", and ".join(seen)


def find_pose_difference(
    pairs: Iterable[tuple[Floats, Floats]], ends: Integers, *, is_paired: bool = False
) -> PoseDifference | None:
    """Find how the first poses of pairs differ from the second ones; None if they fit.

    Parameters
    ----------
    pairs : iterable of ((n, 3), (n, 3))
        A given pose and a reference; positions may be nan. The others are taken only if the first
        pair differs.
    ends : (e, 2) int64
        The vertices of the edges.
    is_paired : bool
        Whether the pairs are of one moment each, so that all differ by the same turn if one does.
    """
    rest = iter(pairs)
    first = next(rest)
    if _is_alike(first, ends):
        return None
    every = list(chain([first], rest))
    factor, units = _find_factor(every, ends)
    scaled = [(factor * given, reference) for given, reference in every]
    axes, is_exact = _find_axes(scaled, is_paired)
    if factor == 1 and axes is None:
        return None
    is_certain = (factor == 1 or units is not None) and (axes is None or is_exact)
    if units is not None and axes is not None and not is_exact:
        axes, is_certain = None, True  # the unit alone is
    return PoseDifference(factor, units, axes, is_certain)


def measure_edge_ratios(given: Floats, reference: Floats, ends: Integers) -> Floats:
    """Return how many times as long the edges of a reference (n, 3) are.

    Returns
    -------
    (3,)
        The ratio that a tenth, a half and nine tenths of the edges are below.
    """
    lengths = [
        np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)
        for points in (given, reference)
    ]
    known = np.isfinite(lengths).all(axis=0) & (np.minimum(*lengths) > 0)
    if not known.any():
        return np.ones(3)
    return np.asarray(np.percentile(lengths[1][known] / lengths[0][known], [10, 50, 90]))


def _find_factor(
    pairs: list[tuple[Floats, Floats]], ends: Integers
) -> tuple[float, tuple[str, str] | None]:
    """Return the factor between the edges of the poses that differ least, and what explains it."""
    ratios = np.array([measure_edge_ratios(given, other, ends) for given, other in pairs])
    low, nearest, high = ratios[np.abs(np.log(ratios[:, 1])).argmin()].tolist()
    if 1 / MAX_POSE_STRETCH <= nearest <= MAX_POSE_STRETCH:
        return 1.0, None
    units = find_units_of_ratio(nearest, UNIT_RATIO_TOL)
    is_clear = high <= MAX_EDGE_SPREAD * low or max(nearest, 1 / nearest) >= MIN_CLEAR_RATIO
    return (nearest, None) if units is None or not is_clear else (list_unit_ratios()[units], units)


def _is_alike(pair: tuple[Floats, Floats], ends: Integers) -> bool:
    """Return whether the edges have about one length, and neither pose lies on its side."""
    _, ratio, _ = measure_edge_ratios(*pair, ends).tolist()
    if not 1 / MAX_POSE_STRETCH <= ratio <= MAX_POSE_STRETCH:
        return False
    return not any(_measure_tilt(_find_rotation(*pair), axes) <= MAX_TILT for axes in UP_TURNS)


def _find_axes(
    pairs: list[tuple[Floats, Floats]], is_paired: bool
) -> tuple[tuple[str, str] | None, bool]:
    """Return the up axes by which all poses differ, and whether that is certain."""
    if any(_measure_distance(*pair) <= SAME_POSE_TOL for pair in pairs):
        return None, False
    rotations = [_find_rotation(*pair) for pair in pairs]
    for axes, turn in UP_TURNS.items():
        is_same = any(
            _measure_distance(given @ turn, reference) <= SAME_POSE_TOL
            and _measure_distance(given, reference) >= MIN_POSE_DIFFERENCE
            for given, reference in pairs
        )
        if all(_measure_tilt(rotation, axes) <= MAX_TILT for rotation in rotations):
            are_turned = all(_measure_angle(rotation, turn) <= MAX_TILT for rotation in rotations)
            return axes, is_same or (is_paired and are_turned)
        if is_same:
            return axes, True
    return None, False


def _find_rotation(given: Floats, reference: Floats) -> Floats:
    """Return the rotation (3, 3) of rows that brings a pose nearest to a reference."""
    known = np.isfinite(given).all(axis=1) & np.isfinite(reference).all(axis=1)
    given, reference = given[known], reference[known]
    if len(given) < 3:
        return np.eye(3)
    centred = np.ascontiguousarray(reference - reference.mean(axis=0))
    _, rotations = best_motions(np.ascontiguousarray(given)[None], centred, np.ones(len(given)))
    return np.asarray(rotations[0].T)


def _measure_tilt(rotation: Floats, axes: tuple[str, str]) -> float:
    """Return the angle between the first axis, turned, and the second one, degrees."""
    before, after = ("XYZ".index(axis) for axis in axes)
    return float(np.degrees(np.arccos(np.clip(rotation[before, after], -1, 1))))


def _measure_angle(rotation: Floats, turn: Floats) -> float:
    """Return the angle between two rotations, degrees."""
    cosine = (np.trace(rotation.T @ turn) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _measure_distance(given: Floats, reference: Floats) -> float:
    """Return the rms distance of two poses about their centroids, in diagonals."""
    known = np.isfinite(given).all(axis=1) & np.isfinite(reference).all(axis=1)
    given, reference = given[known], reference[known]
    if not len(reference):
        return 0.0
    apart = (given - given.mean(axis=0)) - (reference - reference.mean(axis=0))
    diagonal = float(np.linalg.norm(np.ptp(reference, axis=0)))
    return float(np.sqrt((apart**2).sum(axis=1).mean()) / diagonal) if diagonal > 0 else 0.0
