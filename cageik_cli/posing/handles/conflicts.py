"""Handles on one point of the surface: they pull as one, or are refused."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.posing.anchors import ON_ONE_POINT, Anchor, SurfacePoint, positions_of
from cageik_cli.posing.handles.model import Handle, Surface
from cageik_cli.posing.handles.schedule import Mover
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError

SAME_TARGET = 1e-9
"""Targets nearer to each other than this, in diagonals, are the same."""


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """A handle and where on the surface it is."""

    handle: Handle
    point: SurfacePoint


@dataclass(frozen=True, slots=True, eq=False)
class Pull:
    """An anchor, what it follows, and what a user should know of it, if anything."""

    anchor: Anchor
    mover: Mover
    note: str = ""


def merged(
    held: Sequence[Held], surface: Surface, span: range, allow_conflicts: bool
) -> list[Pull]:
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
    for group in _groups(held, surface):
        if len(group) == 1:
            pulls.append(_pull(group, group))
            continue
        conflict = _conflict(group, surface, span)
        if conflict and not allow_conflicts:
            raise InputError(
                f"{conflict}; leave one out, or take their targets' mean with --allow-conflicts"
            )
        hard = [one for one in group if one.handle.hard] or group
        pulls.append(_pull(group, hard if conflict else hard[:1], conflict))
    return pulls


def _groups(held: Sequence[Held], surface: Surface) -> list[list[Held]]:
    """Those of one point each; coincident vertices are one."""
    rest, nearest = surface.mesh.vertices, ON_ONE_POINT * surface.mesh.diagonal
    positions = positions_of([_anchor([one]) for one in held], rest)
    number = np.full(len(held), -1)
    for k, position in enumerate(positions):
        if number[k] < 0:
            is_here = np.linalg.norm(positions - position, axis=1) <= nearest
            number[is_here & (number < 0)] = k
    return [
        [one for one, of in zip(held, number, strict=True) if of == k] for k in np.unique(number)
    ]


def _conflict(group: Sequence[Held], surface: Surface, span: range) -> str:
    """What two handles of one point disagree on; nothing when all agree."""
    frames = np.arange(span.start, span.stop)
    anchor = _anchor(group[:1])
    positions = np.array([positions_of([anchor], surface.pose(k))[0] for k in span])
    first, *others = (one.handle for one in group)
    wanted = _targets(first, frames, positions)
    for other in others:
        apart = np.linalg.norm(_targets(other, frames, positions) - wanted, axis=1)
        if apart.max() > SAME_TARGET * surface.mesh.diagonal:
            where = "" if surface.count is None else f" in frame {frames[apart.argmax()]}"
            return (
                f"handles {first.name!r} and {other.name!r} are on one point of the surface, "
                f"and their targets are {apart.max():.3g} apart{where}"
            )
    return ""


def _targets(handle: Handle, frames: Integers, positions: Floats) -> Floats:
    return Mover((handle.name,), (handle.motion,), np.ones(1)).targets(frames, positions)


def _pull(group: Sequence[Held], leaders: Sequence[Held], conflict: str = "") -> Pull:
    """One anchor of a group that goes to the mean of its leaders' targets."""
    handles = [one.handle for one in leaders]
    weights = np.array([handle.weight for handle in handles])
    mover = Mover(
        tuple(handle.name for handle in handles),
        tuple(handle.motion for handle in handles),
        weights / weights.sum(),
    )
    anchor = _anchor(group)
    if len(group) == 1:
        return Pull(anchor, mover)
    what = conflict or f"the handles of {anchor.name!r} are on one point, with the same target"
    how = " + ".join(mover.names)
    then = f"it goes to the mean of {how!r}, by weight" if conflict else "they pull as one"
    return Pull(anchor, mover, f"{what}; {then}")


def _anchor(group: Sequence[Held]) -> Anchor:
    return Anchor(
        " + ".join(one.handle.name for one in group),
        group[0].point,
        sum(one.handle.weight for one in group),
        any(one.handle.hard for one in group),
    )
