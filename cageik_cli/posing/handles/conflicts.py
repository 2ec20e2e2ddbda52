"""Handles on the same point of the surface: they are merged into one anchor, or refused."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.posing.anchors import COINCIDENT_TOL, Anchor, SurfacePoint, anchor_positions
from cageik_cli.posing.handles.model import Handle, PosedSurface
from cageik_cli.posing.handles.schedule import BlendedMotion
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError

TARGET_TOL = 1e-9
"""Targets closer to each other than this, in diagonals, are the same."""

GROUPS_PER_TRACE = 256
"""Points that are followed through a clip together, so that memory does not grow with handles."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedHandle:
    """A handle and its point on the surface."""

    handle: Handle
    point: SurfacePoint


@dataclass(frozen=True, slots=True, eq=False)
class MergedAnchor:
    """An anchor, its motion, and a note for the user if handles were merged.

    Its radius is the largest of those of the handles; nan if none has one.
    """

    anchor: Anchor
    motion: BlendedMotion
    radius: float
    note: str = ""


def merge_coincident(
    placed_handles: Sequence[PlacedHandle],
    surface: PosedSurface,
    affected_frames: range,
    allow_conflicts: bool,
) -> list[MergedAnchor]:
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
    paths = _trace_points([group for group in groups if len(group) > 1], surface, frames)
    for group in groups:
        if len(group) == 1:
            merged.append(_merge_group(group, group))
            continue
        conflict = _describe_conflict(group, surface, frames, next(paths))
        if conflict and not allow_conflicts:
            raise HandlesError(
                f"{conflict}; remove one, or use the mean of their targets with --allow-conflicts"
            )
        hard = [one for one in group if one.handle.hard] or group
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
    for start in range(0, len(groups), GROUPS_PER_TRACE):
        anchors = [_make_anchor(group[:1]) for group in groups[start : start + GROUPS_PER_TRACE]]
        paths = np.empty((len(anchors), len(frames), 3))
        for i, frame in enumerate(frames.tolist()):
            paths[:, i] = anchor_positions(anchors, surface.pose_at(frame))
        yield from paths


def _describe_conflict(
    group: Sequence[PlacedHandle], surface: PosedSurface, frames: Integers, positions: Floats
) -> str:
    """Describe two handles of one point that disagree; return "" when all agree.

    The point has positions, (k, 3), in frames, (k,).
    """
    first, *others = (one.handle for one in group)
    expected = _compute_targets(first, frames, positions)
    for other in others:
        apart = np.linalg.norm(_compute_targets(other, frames, positions) - expected, axis=1)
        if apart.max() > TARGET_TOL * surface.mesh.diagonal:
            where = "" if surface.frame_count is None else f" in frame {frames[apart.argmax()]}"
            return (
                f"handles {first.name!r} and {other.name!r} conflict: they are on the same point, "
                f"and their targets are {apart.max():.3g} apart{where}"
            )
    return ""


def _compute_targets(handle: Handle, frames: Integers, positions: Floats) -> Floats:
    return BlendedMotion((handle.name,), (handle.motion,), np.ones(1)).targets(frames, positions)


def _merge_group(
    group: Sequence[PlacedHandle], leaders: Sequence[PlacedHandle], conflict: str = ""
) -> MergedAnchor:
    """Merge a group into one anchor that moves to the mean of its leaders' targets."""
    handles = [one.handle for one in leaders]
    weights = np.array([handle.weight for handle in handles])
    motion = BlendedMotion(
        tuple(handle.name for handle in handles),
        tuple(handle.motion for handle in handles),
        weights / weights.sum(),
    )
    anchor = _make_anchor(group)
    radii = [one.handle.radius for one in group if one.handle.radius is not None]
    radius = max(radii, default=np.nan)
    if len(group) == 1:
        return MergedAnchor(anchor, motion, radius)
    if not conflict:
        names = " + ".join(one.handle.name for one in group)
        note = f"handles {names!r} are on the same point and have the same target; they are merged"
        return MergedAnchor(anchor, motion, radius, note)
    names = " + ".join(motion.names)
    return MergedAnchor(
        anchor, motion, radius, f"{conflict}; the point moves to the weighted mean of {names!r}"
    )


def _make_anchor(group: Sequence[PlacedHandle]) -> Anchor:
    return Anchor(
        " + ".join(one.handle.name for one in group),
        group[0].point,
        sum(one.handle.weight for one in group),
        any(one.handle.hard for one in group),
    )
