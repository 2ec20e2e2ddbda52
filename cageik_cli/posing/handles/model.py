"""The records of a handles file: handles, their places and motions, and the surface."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from cageik_cli.geometry.camera import Camera
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.posing.constraints import CageConstraints
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError, InputError, SettingError


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A value for each frame: keyframes, or one constant value.

    Attributes
    ----------
    values : (q, d) float64
    frames : (q,) int64, optional
        Frames of the values, increasing; None for one value, q = 1, that holds in all frames.

    Notes
    -----
    Between keyframes it is the monotone cubic of Fritsch and Butland 1984, which does not
    overshoot; before the first and after the last keyframe it is constant.
    """

    values: Floats
    frames: Integers | None = None

    def evaluate(self, frames: Integers) -> Floats:
        """Return the values in frames (k,), as (k, d)."""
        if self.frames is None or len(self.frames) == 1:
            return np.repeat(self.values, len(frames), axis=0)
        from scipy.interpolate import PchipInterpolator  # slow to import, and few files need it

        clipped = np.clip(frames, self.frames[0], self.frames[-1])
        # The inverse of a tiny slope overflows; the cubic is then level, which is correct.
        with np.errstate(over="ignore"):
            return np.asarray(PchipInterpolator(self.frames, self.values)(clipped))


class Motion(Protocol):
    """How a point moves; `field_name` is its field in the handles file."""

    field_name: ClassVar[str]

    @property
    def track(self) -> Track | None:
        """The targets or offsets; None for a pin."""

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Return the targets, (k, 3), in frames (k,) in which the point is at positions (k, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class Pin:
    """Keep the point where it is in each frame."""

    field_name: ClassVar[str] = "pin"
    track: ClassVar[None] = None

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Return the targets, (k, 3); see `Motion`."""
        return positions


@dataclass(frozen=True, slots=True, eq=False)
class MoveTo:
    """Move the point to the positions of the track."""

    field_name: ClassVar[str] = "target"
    track: Track

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Return the targets, (k, 3); see `Motion`."""
        return self.track.evaluate(frames)


@dataclass(frozen=True, slots=True, eq=False)
class MoveBy:
    """Move the point from its position in each frame by the offsets of the track."""

    field_name: ClassVar[str] = "offset"
    track: Track

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Return the targets, (k, 3); see `Motion`."""
        return positions + self.track.evaluate(frames)


@dataclass(frozen=True, slots=True, eq=False)
class ScreenTo:
    """Move the point to the pixels of the track, at its depth in each frame."""

    field_name: ClassVar[str] = "screen.target"
    track: Track
    camera: Camera

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Return the targets, (k, 3); refuse a frame in which the point is behind the camera."""
        return _move_to_pixels(self.camera, frames, positions, self.track.evaluate(frames))


@dataclass(frozen=True, slots=True, eq=False)
class ScreenBy:
    """Move the point on the screen by the pixels of the track, at its depth in each frame."""

    field_name: ClassVar[str] = "screen.offset"
    track: Track
    camera: Camera

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Return the targets, (k, 3); refuse a frame in which the point is behind the camera."""
        seen = _project_to_pixels(self.camera, frames, positions)
        return _move_to_pixels(self.camera, frames, positions, seen + self.track.evaluate(frames))


def _project_to_pixels(camera: Camera, frames: Integers, positions: Floats) -> Floats:
    """Return the pixels, (k, 2), of positions (k, 3)."""
    try:
        return camera.project(positions)[:, :2]
    except InputError as error:
        depth_row = (camera.projection @ camera.view)[3]
        is_behind = ~(positions @ depth_row[:3] + depth_row[3] > 0)
        raise HandlesError(f"frame {frames[is_behind.argmax()]}: {error}") from error


def _move_to_pixels(camera: Camera, frames: Integers, positions: Floats, pixels: Floats) -> Floats:
    _project_to_pixels(camera, frames, positions)
    # A pixel whose ray never meets the plane gives a target that is not finite.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return camera.move_to_pixels(positions, pixels)


@dataclass(frozen=True, slots=True)
class OnVertex:
    """A vertex of the model."""

    vertex: int


@dataclass(frozen=True, slots=True, eq=False)
class OnFace:
    """A point of a face, with barycentric coordinates (3,)."""

    face: int
    barycentric: Floats


@dataclass(frozen=True, slots=True, eq=False)
class NearPosition:
    """The point of the surface closest to a position in space, (3,)."""

    position: Floats


@dataclass(frozen=True, slots=True, eq=False)
class AtPixel:
    """The front-most point that is visible in a pixel, (2,)."""

    pixel: Floats
    camera: Camera


Place = OnVertex | OnFace | NearPosition | AtPixel


@dataclass(frozen=True, slots=True, eq=False)
class Handle:
    """A point of the surface, and its motion.

    Attributes
    ----------
    name : str
        Unique in its set.
    weight : float
        Importance relative to other handles; above 0.
    hard : bool
        Whether its target is met exactly.
    radius : float, optional
        Distance in the rest pose beyond which it moves nothing; above 0.
    """

    name: str
    place: Place
    motion: Motion
    weight: float = 1.0
    hard: bool = False
    radius: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class HandleSet:
    """Handles that move together.

    Attributes
    ----------
    handles : tuple of Handle
        At least one.
    camera : Camera, optional
        The camera of its screen handles.
    frames : (first, last), optional
        Frames of full strength, counted from 0, both included; None for all frames.
    falloff : int
        Number of frames before and after those over which the edit fades.
    pick_frame : int, optional
        Frame in whose pose pixels and positions are searched; None for the first of `frames`.
    """

    handles: tuple[Handle, ...]
    camera: Camera | None = None
    frames: tuple[int, int] | None = None
    falloff: int = 0
    pick_frame: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Handles:
    """The content of a handles file.

    Attributes
    ----------
    sets : tuple of HandleSet
        Layers, applied one after another.
    constraints : CageConstraints
        Constraints on cage vertices, for all layers.
    """

    sets: tuple[HandleSet, ...]
    constraints: CageConstraints


@dataclass(frozen=True, slots=True)
class PlacementSettings:
    """How handles are placed on a surface.

    Attributes
    ----------
    snap : float, optional
        Use the closest point of the surface for a position in space that is at most this far from
        it, percent of the diagonal; None refuses all positions.
    allow_conflicts : bool
        Use the mean of different targets of one point, instead of refusing them.
    hard : bool
        Make all anchors hard.

    Raises
    ------
    SettingError
        When snap is not a finite number of 0 or above.
    """

    snap: float | None = None
    allow_conflicts: bool = False
    hard: bool = False

    def __post_init__(self) -> None:
        if self.snap is not None and not (np.isfinite(self.snap) and self.snap >= 0):
            raise SettingError(f"snap is {self.snap}, expected a finite number, zero or above")


@dataclass(frozen=True, slots=True, eq=False)
class PosedSurface:
    """A model that handles are placed on, with its poses.

    Attributes
    ----------
    mesh : TriMesh
        The rest pose, of m vertices.
    pose_at : callable
        Positions, (m, 3), in frame k.
    frame_count : int, optional
        Number of frames of the clip; None for a single pose, `pose_at(0)`.
    """

    mesh: TriMesh
    pose_at: Callable[[int], Floats]
    frame_count: int | None = None
