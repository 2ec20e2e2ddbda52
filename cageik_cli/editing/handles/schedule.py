"""The anchors of handles, their targets in each frame of a clip, and the strength of the edit.

Handles on the same point of the surface are merged into one anchor, or refused.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cageik_cli.editing.handles.model import Handle, Motion, PosedSurface
from cageik_cli.formats.timeline import Timeline, format_frame_number
from cageik_cli.geometry.mesh import MAX_COORDINATE
from cageik_cli.method.pose.anchors import COINCIDENT_TOL, Anchor, SurfacePoint, anchor_positions
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError, error_context
from cageik_cli.util.messages import say

SAME_TARGET_TOL = 1e-9
"""Targets closer to each other than this, in diagonals, are the same."""

MAX_TRACED_GROUPS = 256
"""Points that are followed through a clip together, so that memory does not grow with handles."""

PlacedHandle = tuple[Handle, SurfacePoint]
"""A handle and its point on the surface."""


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledAnchor:
    """An anchor and its motion: that of a handle, or the mean of several.

    Attributes
    ----------
    names : tuple of str
        Names of the handles.
    shares : (s,) float64
        Share of each motion in the target; the sum is one.
    note : str
        For the user, if handles were merged.
    """

    anchor: Anchor
    names: tuple[str, ...]
    motions: tuple[Motion, ...]
    shares: Floats
    note: str = ""

    @property
    def turns(self) -> bool:
        """Whether one of its motions turns with the surface."""
        return any(motion.turns for motion in self.motions)

    def targets(
        self, numbers: Floats, positions: Floats, rotations: Floats | None = None
    ) -> Floats:
        """Return the targets, (k, 3), in frames of numbers (k,).

        Positions, (k, 3), and turns of the surface, (k, 3, 3), if any, are those of these frames.
        """
        mean = np.zeros_like(positions)
        for name, motion, share in zip(self.names, self.motions, self.shares, strict=True):
            mean += share * _compute_targets(name, motion, numbers, positions, rotations)
        return mean


@dataclass(frozen=True, slots=True, eq=False)
class HandleSchedule:
    """Anchors and their targets, frame by frame.

    Attributes
    ----------
    scheduled : tuple of ScheduledAnchor
        l of them.
    full_strength : range
        Frames of full strength.
    affected_frames : range
        All frames of the clip that the edit may change; `range(1)` for a single pose.
    falloff : float
        Number of frames over which the edit fades in and out.
    timeline : Timeline
        The numbers of all frames; those above are counted from 0.
    notes : tuple of str
        Notes for the user on how the handles were placed.
    """

    scheduled: tuple[ScheduledAnchor, ...]
    full_strength: range
    affected_frames: range
    falloff: float = 0.0
    timeline: Timeline = field(default_factory=lambda: Timeline(1, 0))
    notes: tuple[str, ...] = ()

    @property
    def anchors(self) -> tuple[Anchor, ...]:
        """The l anchors."""
        return tuple(one.anchor for one in self.scheduled)

    def blend(self, frames: Integers) -> Floats:
        """Return the strength of the edit in frames (k,), as `blend_frames` does."""
        return blend_frames(frames, self.full_strength, self.falloff)

    def targets(
        self, frames: Integers, positions: Floats, rotations: Mapping[int, Floats] | None = None
    ) -> Floats:
        """Return the targets of the anchors at full strength, (k, l, 3).

        Frames, (k,), are some of `affected_frames`; anchors have positions (k, l, 3) in them, and
        the surface around some of them, by number, turns (k, 3, 3).
        """
        numbers, turns = self.timeline.numbers(frames), rotations or {}
        columns = [
            one.targets(numbers, positions[:, k], turns.get(k))
            for k, one in enumerate(self.scheduled)
        ]
        return np.stack(columns, axis=1)

    def displacements(
        self, frames: Integers, positions: Floats, rotations: Mapping[int, Floats] | None = None
    ) -> Floats:
        """Return the displacements of the anchors in any frames, (k, l, 3); see `targets`."""
        strength, displacements = self.blend(frames), np.zeros_like(positions)
        is_moved = strength > 0  # in other frames a target may not exist
        turns = {k: turn[is_moved] for k, turn in (rotations or {}).items()}
        targets = self.targets(frames[is_moved], positions[is_moved], turns)
        full = targets - positions[is_moved]
        displacements[is_moved] = strength[is_moved, None, None] * full
        return displacements


def blend_frames(frames: Integers, full_strength: range, falloff: float) -> Floats:
    """Return the strength of an edit in frames (k,), as (k,): from 0 to 1.

    It is 6x⁵ − 15x⁴ + 10x³, where x goes from 0 to 1 over the falloff, a number of frames, so that
    its first and second derivatives are continuous. Without a falloff it is a step.
    """
    frames = np.asarray(frames)
    off = np.maximum(np.maximum(full_strength.start - frames, frames - full_strength[-1]), 0)
    x = np.clip(1 - off / falloff, 0, 1) if falloff else (off == 0) * 1.0
    return np.asarray(x**3 * (x * (6 * x - 15) + 10))


def _compute_targets(
    name: str, motion: Motion, numbers: Floats, positions: Floats, rotations: Floats | None = None
) -> Floats:
    """Return the targets of a handle, (k, 3), which exist and are not too far away."""
    with error_context(f"handle {name!r}: {motion.kind}"):
        targets = motion.targets(numbers, positions, rotations)
        is_valid = (np.abs(targets) <= MAX_COORDINATE).all(axis=1)
        if not is_valid.all():
            number = format_frame_number(numbers[is_valid.argmin()])
            raise HandlesError(
                f"frame {number}: the target is not finite or too far away "
                f"(at most {MAX_COORDINATE:g}); choose another target or camera"
            )
    return targets


def merge_coincident(
    placed_handles: Sequence[PlacedHandle],
    surface: PosedSurface,
    affected_frames: range,
    allow_conflicts: bool,
) -> list[ScheduledAnchor]:
    """Return one anchor for each point that handles are on, in the order of the handles.

    Handles on one point become one anchor, because two anchors there cannot be met independently.
    Its weight is the sum of their weights, and it is hard if one of them is.

    Raises
    ------
    HandlesError
        When two handles on one point have different targets, unless conflicts are allowed. The
        anchor then moves to the weighted mean of the targets: of the hard ones if there are any.
    """
    merged = []
    groups = _group_by_point(placed_handles, surface)
    frames = np.arange(affected_frames.start, affected_frames.stop)
    numbers = (surface.timeline or Timeline(1, 0)).numbers(frames)
    paths = _trace_points([group for group in groups if len(group) > 1], surface, frames)
    for group in groups:
        if len(group) == 1:
            merged.append(_merge_group(group, group))
            continue
        conflict = _describe_conflict(group, surface, numbers, next(paths))
        if conflict and not allow_conflicts:
            raise HandlesError(
                f"{conflict}; "
                + say("remove one, or use the mean of their targets with `allow_conflicts=True`")
            )
        hard = [one for one in group if one[0].hard] or group
        merged.append(_merge_group(group, hard if conflict else hard[:1], conflict))
    return merged


def _group_by_point(
    placed_handles: Sequence[PlacedHandle], surface: PosedSurface
) -> list[list[PlacedHandle]]:
    """Group handles by point; coincident vertices are one point."""
    rest, nearest = surface.mesh.vertices, COINCIDENT_TOL * surface.mesh.diagonal
    positions = anchor_positions([_make_anchor([one]) for one in placed_handles], rest)
    number = np.full(len(placed_handles), -1)
    for k, position in enumerate(positions):
        if number[k] < 0:
            is_here = np.linalg.norm(positions - position, axis=1) <= nearest
            number[is_here & (number < 0)] = k
    groups: dict[int, list[PlacedHandle]] = {}
    for one, k in zip(placed_handles, number.tolist(), strict=True):
        groups.setdefault(k, []).append(one)
    return list(groups.values())


def _trace_points(
    groups: Sequence[Sequence[PlacedHandle]], surface: PosedSurface, frames: Integers
) -> Iterator[Floats]:
    """Yield the positions of each group in k frames, (k, 3); a pose serves many groups."""
    for start in range(0, len(groups), MAX_TRACED_GROUPS):
        anchors = [_make_anchor(group[:1]) for group in groups[start : start + MAX_TRACED_GROUPS]]
        paths = np.empty((len(anchors), len(frames), 3))
        for i, frame in enumerate(frames.tolist()):
            paths[:, i] = anchor_positions(anchors, surface.pose_at(frame))
        yield from paths


def _describe_conflict(
    group: Sequence[PlacedHandle], surface: PosedSurface, numbers: Floats, positions: Floats
) -> str:
    """Describe two handles of one point that disagree; return "" when all agree.

    The point has positions, (k, 3), in frames of numbers (k,).
    """
    first, *others = (handle for handle, _ in group)
    # The surface turns alike for all of them, so offsets are compared as they are in the file.
    expected = _compute_targets(first.name, first.motion, numbers, positions)
    for other in others:
        if other.motion.turns != first.motion.turns:
            return (
                f"handles {first.name!r} and {other.name!r} conflict: they are on the same point, "
                "and only one of them has the axes of the surface"
            )
        found = _compute_targets(other.name, other.motion, numbers, positions)
        apart = np.linalg.norm(found - expected, axis=1)
        if apart.max() > SAME_TARGET_TOL * surface.mesh.diagonal:
            number = format_frame_number(numbers[apart.argmax()])
            where = "" if surface.timeline is None else f" in frame {number}"
            return (
                f"handles {first.name!r} and {other.name!r} conflict: they are on the same point, "
                f"and their targets are {apart.max():.3g} apart{where}"
            )
    return ""


def _merge_group(
    group: Sequence[PlacedHandle], leaders: Sequence[PlacedHandle], conflict: str = ""
) -> ScheduledAnchor:
    """Merge a group into one anchor that moves to the mean of its leaders' targets."""
    handles = [handle for handle, _ in leaders]
    weights = np.array([handle.weight for handle in handles])
    anchor, names = _make_anchor(group), tuple(handle.name for handle in handles)
    note = ""
    if conflict:
        note = f"{conflict}; the point moves to the weighted mean of {' + '.join(names)!r}"
    elif len(group) > 1:
        note = (
            f"handles {anchor.name!r} are on the same point and have the same target; they are "
            "merged"
        )
    return ScheduledAnchor(
        anchor=anchor,
        names=names,
        motions=tuple(handle.motion for handle in handles),
        shares=weights / weights.sum(),
        note=note,
    )


def _make_anchor(group: Sequence[PlacedHandle]) -> Anchor:
    radii = [handle.radius for handle, _ in group if handle.radius is not None]
    return Anchor(
        " + ".join(handle.name for handle, _ in group),
        group[0][1],
        sum(handle.weight for handle, _ in group),
        any(handle.hard for handle, _ in group),
        max(radii, default=None),
    )
