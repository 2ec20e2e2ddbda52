"""Handles on one point of the surface: they pull as one, or are refused."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.posing.anchors import COINCIDENT_TOL, Anchor, SurfacePoint, anchor_positions
from cageik_cli.posing.handles.model import Handle, PosedSurface
from cageik_cli.posing.handles.schedule import BlendedMotion
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError

TARGET_TOL = 1e-9
"""Targets nearer to each other than this, in diagonals, are the same."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedHandle:
    """A handle and where on the surface it is."""

    handle: Handle
    point: SurfacePoint


@dataclass(frozen=True, slots=True, eq=False)
class MergedAnchor:
    """An anchor, what it follows, and what a user should know of it, if anything."""

    anchor: Anchor
    motion: BlendedMotion
    note: str = ""


def merge_coincident(
    placed_handles: Sequence[PlacedHandle],
    surface: PosedSurface,
    affected_frames: range,
    allow_conflicts: bool,
) -> list[MergedAnchor]:
    """An anchor for each point that handles are on, in their order.

    Handles on one point become one anchor, of the sum of their weights and hard if one of them is:
    no two anchors can be met independently of each other there, whatever vertices they name.

    Raises
    ------
    InputError
        Naming two handles that pull one point to different targets, unless conflicts are allowed;
        the anchor then goes to their targets' mean by weight, of the hard ones if there are some.
    """
    pulls = []
    for group in _group_by_point(placed_handles, surface):
        if len(group) == 1:
            pulls.append(_merge_group(group, group))
            continue
        conflict = _describe_conflict(group, surface, affected_frames)
        if conflict and not allow_conflicts:
            raise InputError(
                f"{conflict}; leave one out, or take their targets' mean with --allow-conflicts"
            )
        hard = [one for one in group if one.handle.hard] or group
        pulls.append(_merge_group(group, hard if conflict else hard[:1], conflict))
    return pulls


def _group_by_point(
    placed_handles: Sequence[PlacedHandle], surface: PosedSurface
) -> list[list[PlacedHandle]]:
    """Those of one point each; coincident vertices are one."""
    rest, nearest = surface.mesh.vertices, COINCIDENT_TOL * surface.mesh.diagonal
    positions = anchor_positions([_make_anchor([one]) for one in placed_handles], rest)
    number = np.full(len(placed_handles), -1)
    for k, position in enumerate(positions):
        if number[k] < 0:
            is_here = np.linalg.norm(positions - position, axis=1) <= nearest
            number[is_here & (number < 0)] = k
    return [
        [one for one, of in zip(placed_handles, number, strict=True) if of == k]
        for k in np.unique(number)
    ]


def _describe_conflict(
    group: Sequence[PlacedHandle], surface: PosedSurface, affected_frames: range
) -> str:
    """What two handles of one point disagree on; nothing when all agree."""
    frames = np.arange(affected_frames.start, affected_frames.stop)
    anchor = _make_anchor(group[:1])
    positions = np.array(
        [anchor_positions([anchor], surface.pose_at(k))[0] for k in affected_frames]
    )
    first, *others = (one.handle for one in group)
    wanted = _compute_targets(first, frames, positions)
    for other in others:
        apart = np.linalg.norm(_compute_targets(other, frames, positions) - wanted, axis=1)
        if apart.max() > TARGET_TOL * surface.mesh.diagonal:
            where = "" if surface.frame_count is None else f" in frame {frames[apart.argmax()]}"
            return (
                f"handles {first.name!r} and {other.name!r} are on one point of the surface, "
                f"and their targets are {apart.max():.3g} apart{where}"
            )
    return ""


def _compute_targets(handle: Handle, frames: Integers, positions: Floats) -> Floats:
    return BlendedMotion((handle.name,), (handle.motion,), np.ones(1)).targets(frames, positions)


def _merge_group(
    group: Sequence[PlacedHandle], leaders: Sequence[PlacedHandle], conflict: str = ""
) -> MergedAnchor:
    """One anchor of a group that goes to the mean of its leaders' targets."""
    handles = [one.handle for one in leaders]
    weights = np.array([handle.weight for handle in handles])
    mover = BlendedMotion(
        tuple(handle.name for handle in handles),
        tuple(handle.motion for handle in handles),
        weights / weights.sum(),
    )
    anchor = _make_anchor(group)
    if len(group) == 1:
        return MergedAnchor(anchor, mover)
    what = conflict or f"the handles of {anchor.name!r} are on one point, with the same target"
    names = " + ".join(mover.names)
    then = f"it goes to the mean of {names!r}, by weight" if conflict else "they pull as one"
    return MergedAnchor(anchor, mover, f"{what}; {then}")


def _make_anchor(group: Sequence[PlacedHandle]) -> Anchor:
    return Anchor(
        " + ".join(one.handle.name for one in group),
        group[0].point,
        sum(one.handle.weight for one in group),
        any(one.handle.hard for one in group),
    )
