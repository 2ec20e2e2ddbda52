"""The records of a handles file: handles, their places and motions, and the surface."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cageik_cli.formats.timeline import Timeline, format_frame_number
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.pose.camera import Camera
from cageik_cli.method.pose.constraints import CageConstraints
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import HandlesError, InputError


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How a point moves.

    Attributes
    ----------
    kind : {"pin", "stay", "target", "offset", "screen.target", "screen.offset"}
        Its field in the handles file. A pin keeps the point where it is in each frame; one that
        stays remains where it is in the first frame of full strength; a target is where it goes,
        an offset is how far it goes from there; on the screen it keeps its depth.
    values : (q, d) float64, optional
        The targets or offsets: positions, or pixels on the screen; None for a pin, and before the
        place of one that stays is known.
    frames : (q,) float64, optional
        Increasing numbers of the frames of the values; None for one value, q = 1, that holds in
        all frames.
    camera : Camera, optional
        Of the screen.
    ease : {"smooth", "linear", "stepped"}
        How values go from keyframe to keyframe: along the monotone cubic of Fritsch and Butland
        1984, which does not overshoot; in straight lines; or each held until the next. Before the
        first and after the last keyframe they are constant.
    turns : bool
        Whether an offset turns with the surface around the point, from the rest pose.
    """

    kind: str
    values: Floats | None = None
    frames: Floats | None = None
    camera: Camera | None = None
    ease: str = "smooth"
    turns: bool = False

    def evaluate(self, frames: Floats) -> Floats:
        """Return the targets or offsets in frames of numbers (k,), as (k, d)."""
        assert self.values is not None
        if self.frames is None or len(self.frames) == 1:
            return np.repeat(self.values, len(frames), axis=0)
        if self.ease == "stepped":
            held = np.searchsorted(self.frames, frames, side="right") - 1
            return self.values[np.maximum(held, 0)]
        if self.ease == "linear":
            columns = [np.interp(frames, self.frames, values) for values in self.values.T]
            return np.stack(columns, axis=1)
        from scipy.interpolate import PchipInterpolator  # slow to import, and few files need it

        clipped = np.clip(frames, self.frames[0], self.frames[-1])
        # The inverse of a tiny slope overflows; the cubic is then level, which is correct.
        with np.errstate(over="ignore"):
            return np.asarray(PchipInterpolator(self.frames, self.values)(clipped))

    def targets(self, frames: Floats, positions: Floats, rotations: Floats | None = None) -> Floats:
        """Return the targets, (k, 3), in frames of numbers (k,).

        The point is at positions (k, 3) in them, and the surface around it is turned from the rest
        pose by rotations (k, 3, 3), `points @ R`; None where it does not turn.
        """
        if self.values is None:
            return positions
        values, is_offset = self.evaluate(frames), self.kind.endswith("offset")
        if self.turns and rotations is not None:
            values = (values[:, None] @ rotations)[:, 0]
        if self.camera is None:
            return positions + values if is_offset else values
        seen = _project_to_pixels(self.camera, frames, positions)
        # A pixel whose ray never meets the plane gives a target that is not finite.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return self.camera.move_to_pixels(positions, seen + values if is_offset else values)


def _project_to_pixels(camera: Camera, frames: Floats, positions: Floats) -> Floats:
    """Return the pixels, (k, 2), of positions (k, 3)."""
    try:
        return camera.project(positions)[:, :2]
    except InputError as error:
        depth_row = (camera.projection @ camera.view)[3]
        is_behind = ~(positions @ depth_row[:3] + depth_row[3] > 0)
        number = format_frame_number(frames[is_behind.argmax()])
        raise HandlesError(f"frame {number}: {error}") from error


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a handle is on the surface.

    Attributes
    ----------
    kind : {"vertex", "face", "position", "screen.source"}
        Its field in the handles file: a vertex; a point of a face; the point closest to a position
        in space; or the front-most point that is visible in a pixel.
    number : int, optional
        Of the vertex or the face.
    values : (d,) float64, optional
        Barycentric coordinates on the face, (3,); the position, (3,); or the pixel, (2,).
    camera : Camera, optional
        Of the pixel.
    """

    kind: str
    number: int = -1
    values: Floats | None = None
    camera: Camera | None = None


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
        Distance over the surface of the rest pose up to which the model moves with it; above 0.
        None chooses one from the model.
    """

    name: str
    place: Place
    motion: Motion
    weight: float = 1.0
    hard: bool = False
    radius: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class HandleSet:
    """Handles that move together, one at least.

    Attributes
    ----------
    frames : (first, last), optional
        Numbers of the frames of full strength, both included; None for all frames.
    falloff : int
        The edit fades over numbers that are this far before and after those.
    pick_frame : int, optional
        Number of the frame in whose pose pixels and positions are searched; None for the first of
        `frames`.
    hold : bool
        Whether the model stays outside the radii of its handles.
    """

    handles: tuple[Handle, ...]
    frames: tuple[float, float] | None = None
    falloff: int = 0
    pick_frame: float | None = None
    hold: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Handles:
    """The content of a handles file.

    Attributes
    ----------
    data : bytes
        All of the file.
    sets : tuple of HandleSet
        Layers, applied one after another.
    constraints : CageConstraints
        On cage vertices, for all layers.
    """

    path: Path
    data: bytes
    sets: tuple[HandleSet, ...]
    constraints: CageConstraints


@dataclass(frozen=True, slots=True, eq=False)
class PosedSurface:
    """A model that handles are placed on, with its poses.

    Attributes
    ----------
    mesh : TriMesh
        The rest pose, of m vertices.
    pose_at : callable
        Positions, (m, 3), in frame k, which is counted from 0.
    timeline : Timeline, optional
        The numbers of the frames of the clip; None for a single pose, `pose_at(0)`.
    """

    mesh: TriMesh
    pose_at: Callable[[int], Floats]
    timeline: Timeline | None = None
