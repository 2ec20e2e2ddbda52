"""Clips in numpy's files: an array of positions, and in a `.npz` maybe one of faces, by name."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.binary_frames import Packing, StoredFrames
from cageik_cli.formats.base.clip_file import (
    PackedClip,
    PackedClipFile,
    only,
    refuse_counted_from_one,
)
from cageik_cli.formats.base.sequence import LAYOUTS, ClipRequest
from cageik_cli.formats.npz.archive import Archive, FileArray, lone_array
from cageik_cli.formats.scene import SceneHints, sound_hints
from cageik_cli.util.errors import InputError


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read an array of positions.

    Attributes
    ----------
    layout : str
        One of `LAYOUTS`.
    frames, vertices : int
    """

    layout: str
    frames: int
    vertices: int

    def __str__(self) -> str:
        return f"{self.layout} ({self.frames} frames of {self.vertices} vertices)"


def readings_of(shape: tuple[int, ...], layout: str | None) -> list[Reading]:
    """Every way to read an array of this shape, in `layout` if one is given.

    Raises
    ------
    InputError
        When there is none.
    """
    found = [
        Reading(order, shape[order.index("f")], shape[order.index("v")])
        for order in LAYOUTS
        if len(shape) == 3 and shape[order.index("x")] == 3 and layout in (None, order)
    ]
    if not found or min(shape) < 1:
        expected = " or ".join(map(_spelt, LAYOUTS if layout is None else (layout,)))
        raise InputError(f"positions have shape {shape}, expected {expected}")
    return found


def likeliest(readings: list[Reading], named: int | None) -> Reading:
    """The one reading that is possible.

    Parameters
    ----------
    readings : list of Reading
    named : int, optional
        How many vertices the faces name. A reading with as many goes before one with more, and
        fewer there cannot be.

    Raises
    ------
    InputError
        When several readings are as likely, naming them.
    """
    if len(readings) == 1:
        return readings[0]
    exact = [reading for reading in readings if reading.vertices == named]
    larger = [reading for reading in readings if named is None or reading.vertices > named]
    best = exact or larger or readings
    if len(best) > 1:
        raise InputError(
            f"positions can be read as {' or '.join(map(str, best))}; say which with --layout"
        )
    return best[0]


def _spelt(layout: str) -> str:
    return (
        "(" + ", ".join({"f": "frames", "v": "vertices", "x": "3"}[axis] for axis in layout) + ")"
    )


VERTEX_NAMES = ("vertices", "verts", "V", "v")
FACE_NAMES = ("faces", "tris", "F", "f")


class Reader(PackedClipFile):
    """Frames of one `.npz` or `.npy`, whose axes may be in any order of `LAYOUTS`."""

    suffixes = (".npz", ".npy")
    has_layout = True

    @classmethod
    def opened(cls, request: ClipRequest) -> PackedClip:
        """Find the arrays, and which axis is which."""
        path = only(request.paths)
        if path.suffix.lower() == ".npy":
            return PackedClip(_frames(lone_array(path), None, request))
        archive = _clip_archive(path)
        positions, faces = _named(archive, VERTEX_NAMES), None
        if archive.names.intersection(FACE_NAMES):
            faces = _faces(_named(archive, FACE_NAMES))
        said = {name: archive.scalar(name) for name in SceneHints.__slots__}
        return PackedClip(_frames(positions, faces, request), faces, *sound_hints(said))


def _clip_archive(path: Path) -> Archive:
    archive = Archive(path)
    if not archive.names.intersection(VERTEX_NAMES) and "poses" in archive.names:
        raise InputError(
            "holds body parameters (AMASS or SMPL: poses, betas, trans), not vertices; evaluate "
            "the body model, and write its vertices"
        )
    return archive


def _named(archive: Archive, names: tuple[str, ...]) -> FileArray:
    found = [name for name in names if name in archive.names]
    if len(found) != 1:
        held = ", ".join(found) or "none"
        raise InputError(f"holds {held} of the arrays {', '.join(names)}; expected just one")
    return archive.array(found[0])


def _faces(array: FileArray) -> np.ndarray:
    if array.kind.kind not in "iu" or len(array.shape) != 2 or array.shape[1] != 3:
        raise InputError(
            f"faces are {array.kind} of shape {array.shape}, expected integers of shape (count, 3)"
        )
    faces = array.values()
    if not faces.size:
        raise InputError("faces are none, expected one at least")
    return faces


def _frames(array: FileArray, faces: np.ndarray | None, request: ClipRequest) -> StoredFrames:
    """The frames of an array of positions, of the vertices that faces or the rest pose name."""
    if array.kind.kind != "f":
        raise InputError(
            f"positions are {array.kind} of shape {array.shape}, expected floating-point numbers"
        )
    readings, named = readings_of(array.shape, request.how.layout), None
    if faces is not None:
        for reading in readings:
            refuse_counted_from_one(faces, reading.vertices)
        named = int(faces.max()) + 1
    elif request.rest is not None:
        named = len(request.rest.mesh.vertices)
    found = likeliest(readings, named)
    order = found.layout[::-1] if array.is_reversed else found.layout
    packing = Packing(array.offset, array.kind, found.frames, found.vertices, order)
    return StoredFrames(array.file, packing)
