"""Anchors that move through a clip, and how the edit comes and goes."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import MAX_COORDINATE
from cageik_cli.posing.anchors import Anchor
from cageik_cli.posing.handles.model import Motion
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError, error_context


@dataclass(frozen=True, slots=True, eq=False)
class BlendedMotion:
    """What one anchor follows: a handle's motion, or the mean of several.

    Attributes
    ----------
    names : tuple of str
        Of the handles.
    motions : tuple of Motion
    shares : (s,) float64
        Of each motion in the target; they sum to one.
    """

    names: tuple[str, ...]
    motions: tuple[Motion, ...]
    shares: Floats

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Where the anchor is to be in frames (k,) that have it at positions (k, 3): (k, 3).

        Raises
        ------
        InputError
            Naming the handle and the frame, when there is no such place.
        """
        found = np.zeros_like(positions)
        for name, motion, share in zip(self.names, self.motions, self.shares, strict=True):
            with error_context(f"handle {name!r}: {motion.field_name}"):
                targets = motion.targets(frames, positions)
                _check_targets(frames, targets)
            found += share * targets
        return found


@dataclass(frozen=True, slots=True, eq=False)
class HandleSchedule:
    """Anchors and where they are to go, frame by frame.

    Attributes
    ----------
    anchors : tuple of Anchor
        l of them.
    motions : tuple of BlendedMotion
        One for each anchor.
    full_strength : range
        Frames in which the edit is of full strength.
    affected_frames : range
        All that it may change, in the clip; `range(1)` for a single pose.
    falloff : int
        Frames over which it comes before `full_strength`, and goes after it.
    notes : tuple of str
        What a user should know of how the handles were placed.
    """

    anchors: tuple[Anchor, ...]
    motions: tuple[BlendedMotion, ...]
    full_strength: range
    affected_frames: range
    falloff: int = 0
    notes: tuple[str, ...] = ()

    def blend(self, frames: Integers) -> Floats:
        """Strength of the edit in frames (k,), (k,): from 0 to 1, with two smooth derivatives.

        It is 6x⁵ − 15x⁴ + 10x³ of the way x through the falloff; without one, a step.
        """
        frames = np.asarray(frames)
        off = np.maximum(
            np.maximum(self.full_strength.start - frames, frames - self.full_strength[-1]), 0
        )
        x = np.clip(1 - off / self.falloff, 0, 1) if self.falloff else (off == 0) * 1.0
        return np.asarray(x**3 * (x * (6 * x - 15) + 10))

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Where the anchors are to be at full strength, (k, l, 3).

        Parameters
        ----------
        frames : (k,) int64
            Of the span.
        positions : (k, l, 3)
            Where the anchors are in them.

        Raises
        ------
        InputError
            Naming the handle and the frame, when a camera cannot see where that is.
        """
        columns = np.moveaxis(positions, 1, 0)
        found = [m.targets(frames, column) for m, column in zip(self.motions, columns, strict=True)]
        return np.stack(found, axis=1)

    def displacements(self, frames: Integers, positions: Floats) -> Floats:
        """By how much the anchors are to be moved in any frames, (k, l, 3); see `targets`."""
        strength, displacements = self.blend(frames), np.zeros_like(positions)
        is_moved = strength > 0  # elsewhere a target may be nowhere
        away = self.targets(frames[is_moved], positions[is_moved]) - positions[is_moved]
        displacements[is_moved] = strength[is_moved, None, None] * away
        return displacements


def _check_targets(frames: Integers, targets: Floats) -> None:
    is_somewhere = (np.abs(targets) <= MAX_COORDINATE).all(axis=1)
    if not is_somewhere.all():
        raise InputError(
            f"frame {frames[is_somewhere.argmin()]}: it is no place, or one too far away; choose "
            "another, or another view"
        )
