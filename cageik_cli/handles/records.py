"""What a handles file says, and what it is said of."""

from collections.abc import Callable
from dataclasses import dataclass

from cageik_cli.geometry.camera import Camera
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.handles.motions import Motion
from cageik_cli.ties import Ties
from cageik_cli.util.arrays import Floats


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
class NearTo:
    """The point of the surface nearest to a position in space, (3,)."""

    position: Floats


@dataclass(frozen=True, slots=True, eq=False)
class InPixel:
    """The front-most point that a camera sees in a pixel, (2,)."""

    pixel: Floats
    camera: Camera


Place = OnVertex | OnFace | NearTo | InPixel


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
    camera : Camera, optional
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
    ties : Ties
        Of the cage's vertices, for all layers.
    """

    sets: tuple[HandleSet, ...]
    ties: Ties


@dataclass(frozen=True, slots=True)
class PlaceSettings:
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
class Surface:
    """A model that handles are placed on, at rest and in motion.

    Attributes
    ----------
    mesh : TriMesh
        The rest pose, of m vertices.
    pose : callable
        Positions, (m, 3), in frame k.
    count : int, optional
        Frames of the clip; None when there is none but one pose, `pose(0)`.
    """

    mesh: TriMesh
    pose: Callable[[int], Floats]
    count: int | None = None
