"""What a handles file says, and what it is said of."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from cageik_cli.geometry.camera import Camera
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.posing.constraints import CageConstraints
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A value for each frame: keyframes, or one value for all.

    Attributes
    ----------
    values : (q, d) float64
    frames : (q,) int64, optional
        Of the values, increasing; None for one value, q = 1, that holds in all frames.

    Notes
    -----
    Between keyframes it is the monotone cubic of Fritsch and Butland 1984, which passes no key;
    before the first and after the last it stays.
    """

    values: Floats
    frames: Integers | None = None

    def evaluate(self, frames: Integers) -> Floats:
        """The values in frames (k,), (k, d)."""
        if self.frames is None or len(self.frames) == 1:
            return np.repeat(self.values, len(frames), axis=0)
        from scipy.interpolate import PchipInterpolator  # it takes long, and few files need it

        clipped = np.clip(frames, self.frames[0], self.frames[-1])
        # A slope of nearly nothing has no inverse; the cubic is then level, as it should be.
        with np.errstate(over="ignore"):
            return np.asarray(PchipInterpolator(self.frames, self.values)(clipped))


class Motion(Protocol):
    """How a point moves; `field_name` is what the handles file calls it."""

    field_name: ClassVar[str]

    @property
    def track(self) -> Track | None:
        """What it is moved to or by; None when it is held."""

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """Where it is to be in frames (k,) in which it is at positions (k, 3): (k, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class Pin:
    """Stay where each frame has the point."""

    field_name: ClassVar[str] = "pin"
    track: ClassVar[None] = None

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """See `Motion`."""
        return positions


@dataclass(frozen=True, slots=True, eq=False)
class MoveTo:
    """Go to the track's places in space."""

    field_name: ClassVar[str] = "target"
    track: Track

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """See `Motion`."""
        return self.track.evaluate(frames)


@dataclass(frozen=True, slots=True, eq=False)
class MoveBy:
    """Go from each frame's own position by the track's offset."""

    field_name: ClassVar[str] = "offset"
    track: Track

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """See `Motion`."""
        return positions + self.track.evaluate(frames)


@dataclass(frozen=True, slots=True, eq=False)
class ScreenTo:
    """Go to where the track's pixels are, as deep as each frame has the point."""

    field_name: ClassVar[str] = "screen.target"
    track: Track
    camera: Camera

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """See `Motion`; an InputError names a frame in which it is behind the camera."""
        return _move_to_pixels(self.camera, frames, positions, self.track.evaluate(frames))


@dataclass(frozen=True, slots=True, eq=False)
class ScreenBy:
    """Go by the track's pixels from where each frame's point is seen, as deep as it is."""

    field_name: ClassVar[str] = "screen.offset"
    track: Track
    camera: Camera

    def targets(self, frames: Integers, positions: Floats) -> Floats:
        """See `Motion`; an InputError names a frame in which it is behind the camera."""
        seen = _project_to_pixels(self.camera, frames, positions)
        return _move_to_pixels(self.camera, frames, positions, seen + self.track.evaluate(frames))


def _project_to_pixels(camera: Camera, frames: Integers, positions: Floats) -> Floats:
    """The pixels, (k, 2), in which positions (k, 3) are seen."""
    try:
        return camera.project(positions)[:, :2]
    except InputError as error:
        weigh = (camera.projection @ camera.view)[3]
        is_behind = ~(positions @ weigh[:3] + weigh[3] > 0)
        raise InputError(f"frame {frames[is_behind.argmax()]}: {error}") from error


def _move_to_pixels(camera: Camera, frames: Integers, positions: Floats, pixels: Floats) -> Floats:
    _project_to_pixels(camera, frames, positions)
    # A pixel whose ray never meets the plane is found by its target, which is not finite.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return camera.move_to_pixels(positions, pixels)


@dataclass(frozen=True, slots=True)
class OnVertex:
    """A vertex of the model, by its number."""

    vertex: int


@dataclass(frozen=True, slots=True, eq=False)
class OnFace:
    """A point of a face, by the face's number and barycentric coordinates (3,)."""

    face: int
    barycentric: Floats


@dataclass(frozen=True, slots=True, eq=False)
class NearPosition:
    """The point of the surface nearest to a position in space, (3,)."""

    position: Floats


@dataclass(frozen=True, slots=True, eq=False)
class AtPixel:
    """The front-most point that a camera sees in a pixel, (2,)."""

    pixel: Floats
    camera: Camera


Place = OnVertex | OnFace | NearPosition | AtPixel


@dataclass(frozen=True, slots=True, eq=False)
class Handle:
    """A point of the surface, and where it is to go.

    Attributes
    ----------
    name : str
        Its own among those of its set.
    place : Place
    motion : Motion
    weight : float
        How much it counts beside other handles; above 0.
    hard : bool
        Whether its target is met exactly.
    """

    name: str
    place: Place
    motion: Motion
    weight: float = 1.0
    hard: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class HandleSet:
    """Handles that move together.

    Attributes
    ----------
    handles : tuple of Handle
        At least one.
    camera : ParallelCamera, optional
        That its screen handles are seen by.
    frames : (first, last), optional
        Counted from 0 in the clip, both included, in which the edit holds in full; None for all.
    falloff : int
        Frames before and after those over which it fades.
    pick_frame : int, optional
        In whose pose pixels and positions are looked for; None for the first of `frames`.
    """

    handles: tuple[Handle, ...]
    camera: Camera | None = None
    frames: tuple[int, int] | None = None
    falloff: int = 0
    pick_frame: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Handles:
    """What a handles file says.

    Attributes
    ----------
    sets : tuple of HandleSet
        Layers, to be applied one after another.
    constraints : CageConstraints
        Of the cage's vertices, for all layers.
    """

    sets: tuple[HandleSet, ...]
    constraints: CageConstraints


@dataclass(frozen=True, slots=True)
class PlacementSettings:
    """How handles are placed.

    Attributes
    ----------
    snap : bool
        Take the surface's nearest point for a position in space, instead of refusing it.
    allow_conflicts : bool
        Take the mean of different targets of one point, instead of refusing them.
    hard : bool
        Make all anchors hard.
    """

    snap: bool = False
    allow_conflicts: bool = False
    hard: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class PosedSurface:
    """A model that handles are placed on, at rest and in motion.

    Attributes
    ----------
    mesh : TriMesh
        The rest pose, of m vertices.
    pose_at : callable
        Positions, (m, 3), in frame k.
    frame_count : int, optional
        Frames of the clip; None when there is none but one pose, `pose_at(0)`.
    """

    mesh: TriMesh
    pose_at: Callable[[int], Floats]
    frame_count: int | None = None
