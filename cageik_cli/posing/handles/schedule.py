"""The targets of anchors in each frame of a clip, and the strength of the edit."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import MAX_COORDINATE
from cageik_cli.posing.anchors import Anchor
from cageik_cli.posing.handles.model import Motion
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError, error_context


@dataclass(frozen=True, slots=True, eq=False)
class BlendedMotion:
    """The motion of one anchor: that of a handle, or the mean of several.

    Attributes
    ----------
    names : tuple of str
        Names of the handles.
    shares : (s,) float64
        Share of each motion in the target; the sum is one.
    """

    names: tuple[str, ...]
    motions: tuple[Motion, ...]
    shares: Floats

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Return the targets, (k, 3), in frames (k,) in which the anchor is at positions (k, 3).

        Raises
        ------
        HandlesError
            When a target does not exist or is too far away; the message names handle and frame.
        """
        mean = np.zeros_like(positions)
        for name, motion, share in zip(self.names, self.motions, self.shares, strict=True):
            with error_context(f"handle {name!r}: {motion.field_name}"):
                targets = motion.targets(frames, positions)
                _check_targets(frames, targets)
            mean += share * targets
        return mean


@dataclass(frozen=True, slots=True, eq=False)
class HandleSchedule:
    """Anchors and their targets, frame by frame.

    Attributes
    ----------
    anchors : tuple of Anchor
        l of them.
    motions : tuple of BlendedMotion
        One for each anchor.
    full_strength : range
        Frames of full strength.
    affected_frames : range
        All frames of the clip that the edit may change; `range(1)` for a single pose.
    radii : (l,) float64
        Distances in the rest pose beyond which anchors move nothing; nan for none.
    falloff : int
        Number of frames over which the edit fades in and out.
    notes : tuple of str
        Notes for the user on how the handles were placed.
    """

    anchors: tuple[Anchor, ...]
    motions: tuple[BlendedMotion, ...]
    full_strength: range
    affected_frames: range
    radii: Floats
    falloff: int = 0
    notes: tuple[str, ...] = ()

    def blend(self, frames: Integers) -> Floats:
        """Return the strength of the edit in frames (k,), as (k,): from 0 to 1.

        It is 6x⁵ − 15x⁴ + 10x³, where x goes from 0 to 1 over the falloff, so that its first and
        second derivatives are continuous. Without a falloff it is a step.
        """
        frames = np.asarray(frames)
        off = np.maximum(
            np.maximum(self.full_strength.start - frames, frames - self.full_strength[-1]), 0
        )
        x = np.clip(1 - off / self.falloff, 0, 1) if self.falloff else (off == 0) * 1.0
        return np.asarray(x**3 * (x * (6 * x - 15) + 10))

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Return the targets of the anchors at full strength, (k, l, 3).

        Parameters
        ----------
        frames : (k,) int64
            Frames among `affected_frames`.
        positions : (k, l, 3)
            Positions of the anchors in these frames.

        Raises
        ------
        HandlesError
            When a target does not exist; the message names handle and frame.
        """
        columns = np.moveaxis(positions, 1, 0)
        found = [m.targets(frames, column) for m, column in zip(self.motions, columns, strict=True)]
        return np.stack(found, axis=1)

    def displacements(self, frames: Integers, positions: Floats) -> Floats:
        """Return the displacements of the anchors in any frames, (k, l, 3); see `targets`."""
        strength, displacements = self.blend(frames), np.zeros_like(positions)
        is_moved = strength > 0  # in other frames a target may not exist
        full = self.targets(frames[is_moved], positions[is_moved]) - positions[is_moved]
        displacements[is_moved] = strength[is_moved, None, None] * full
        return displacements


def _check_targets(frames: Integers, targets: Floats) -> None:
    is_valid = (np.abs(targets) <= MAX_COORDINATE).all(axis=1)
    if not is_valid.all():
        raise HandlesError(
            f"frame {frames[is_valid.argmin()]}: the target is not finite or too far away "
            f"(at most {MAX_COORDINATE:g}); choose another target or camera"
        )
