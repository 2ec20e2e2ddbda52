"""Clips in HDF5 files, in the layouts of SPLOCS and of D-FAUST."""

from contextlib import ExitStack
from dataclasses import dataclass
from difflib import get_close_matches
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.binary_frames import FramesInRuns
from cageik_cli.formats.base.clip_file import ClipFile, only, refuse_counted_from_one
from cageik_cli.formats.base.hdf5 import (
    dataset,
    lone_attributes,
    numbers,
    numeric_shapes,
    open_file,
    opened,
    sound,
)
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.scene import SceneHints, sound_hints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, first_few
from cageik_cli.util.text import printable


@dataclass(frozen=True, slots=True)
class Layout:
    """Where a file has its faces, and which axis of its positions is the frames.

    Attributes
    ----------
    faces : str
        The dataset's name.
    frame_axis : int
        0 for (F, m, 3), 2 for (m, 3, F).
    is_scaled : bool
        Whether attributes `scale` and `mean` are to be undone.
    """

    faces: str
    frame_axis: int
    is_scaled: bool


LARGEST_CHUNK = 1 << 28
"""Bytes of a chunk, which HDF5 unpacks whole for whatever is read of it."""

SPLOCS = Layout("tris", 0, True)
DFAUST = Layout("faces", 2, False)


def clips_of(file: Any) -> tuple[Layout, list[str]]:
    """The layout of a file, and the names of its clips' datasets.

    Raises
    ------
    InputError
        When there are none, with what there is instead.
    """
    kind, complete = file.attrs.get("format"), file.attrs.get("complete")
    if isinstance(kind, str) and kind == "cageik.binding":
        raise InputError("is a binding of cageik bind, not a clip; name the frames")
    if isinstance(kind, str) and kind == "cageik.result" and not np.all(complete):
        raise InputError("is not complete: the run that wrote it was interrupted; extract it again")
    if "verts" in file:
        return SPLOCS, ["verts"]
    if "default" in file:
        raise InputError("holds components of a model, not a clip; name the clip they are of")
    shapes = numeric_shapes(file, "f")
    found = [name for name, shape in shapes.items() if len(shape) == 3 and shape[1] == 3]
    if not found or "faces" not in file:
        raise InputError(
            "holds no clip; expected datasets `verts` and `tris`, or clips of (vertices, 3, "
            "frames) and `faces`"
        )
    return DFAUST, found


def chosen(names: list[str], member: str | None) -> str:
    """The clip of a file's that is asked for.

    Raises
    ------
    InputError
        When there is none of that name, or several and no name.
    """
    if member in names:
        return member
    if member is not None:
        near = get_close_matches(member, names, cutoff=0.0)
        raise InputError(
            f"holds no clip `{printable(member)}`; the nearest names are "
            f"{_listed(near)}, and cageik info lists all"
        )
    if len(names) > 1:
        raise InputError(
            f"holds {len(names)} clips: {_listed(names)}; name one of them as "
            f"FILE::{printable(names[0])}"
        )
    return names[0]


class Hdf5Frames(FramesInRuns):
    """Frames of a dataset in a file that stays open.

    Those that share chunks are read together, so that no chunk is decompressed for each of them.
    """

    def __init__(self, file: Any, name: str, layout: Layout) -> None:
        self._is_last = layout.frame_axis == 2
        shape = (None, 3, None) if self._is_last else (None, None, 3)
        self._stored = stored = dataset(file, name, "f", shape)
        self._scale, self._mean = np.ones(1), np.zeros(1)
        if layout.is_scaled:
            self._scale = _attribute(file, name, "scale", 1.0)
            self._mean = _attribute(file, name, "mean", 0.0)
        count, vertices = stored.shape[layout.frame_axis], stored.shape[0 if self._is_last else 1]
        unchunked = count if self._is_last else 1
        chunk = prod(stored.chunks or (1,)) * stored.dtype.itemsize
        if chunk > LARGEST_CHUNK:
            raise InputError(
                f"`{printable(name)}` is in chunks of {chunk} bytes, expected {LARGEST_CHUNK} at "
                "most; write it in smaller ones, such as a frame each (h5repack -l)"
            )
        layer = stored.chunks[layout.frame_axis] if stored.chunks else unchunked
        super().__init__(count, vertices, layer, stored.dtype.itemsize)

    def frame(self, index: int) -> Floats:
        """Positions of one frame, (m, 3), with `scale` and `mean` undone."""
        positions = np.array(super().frame(index), np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # frames are checked where they enter
            positions *= self._scale
            positions += self._mean
        return positions

    def run(self, start: int, stop: int) -> np.ndarray:
        """Read frames `start` to `stop`, that left out: (k, m, 3)."""
        if self._is_last:
            return np.moveaxis(self._stored[:, :, start:stop], 2, 0)
        return np.asarray(self._stored[start:stop])


def _attribute(file: Any, clip: str, name: str, default: float) -> Floats:
    """A number or three, of the file or of its clip."""
    value = file.attrs.get(name, file[clip].attrs.get(name, default))
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.shape not in ((), (1,), (3,), (1, 3)):
        raise InputError(f"attribute `{name}` is {value!r}, expected a number or three")
    return np.asarray(array, np.float64).reshape(-1)


def _listed(names: list[str]) -> str:
    return first_few(printable(name) for name in names)


class Reader(ClipFile):
    """Frames of one clip in an HDF5 file, which stays open."""

    suffixes = (".h5", ".hdf5")
    has_members = True

    def __init__(self, request: ClipRequest) -> None:
        path = only(request.paths)
        with sound(path), ExitStack() as stack:
            file = stack.enter_context(open_file(path))
            layout, names = clips_of(file)
            self._frames = Hdf5Frames(file, chosen(names, request.member), layout)
            faces = numbers(file, layout.faces, "iu", (None, 3))
            hints, notes = sound_hints(lone_attributes(file, SceneHints.__slots__))
            self.take(request, self._frames.count, hints)
            self.notes = tuple(f"{printable(path.name)}: {note}" for note in notes)
            refuse_counted_from_one(faces, self._frames.vertices)
            self.first = TriMesh(self._frames.frame(self.numbers[0]), faces)
            stack.pop_all()  # open from here on

    @classmethod
    def members(cls, path: Path) -> list[str]:
        """The clips of a file that holds several."""
        with opened(path) as file:
            _, names = clips_of(file)
        return names if len(names) > 1 else []

    @classmethod
    def outline(cls, request: ClipRequest) -> list[tuple[str, str]]:
        """The clips of a file that holds several, if none of them is asked for."""
        path = only(request.paths)
        with opened(path) as file:
            layout, names = clips_of(file)
            if len(names) == 1 or request.member is not None:
                return []
            clips = [(name, Hdf5Frames(file, name, layout)) for name in names]
            return [
                ("holds", f"{len(names)} clips, each named as FILE::CLIP"),
                *(
                    ("clip", f"{printable(name)}, {clip.count} frames of {clip.vertices} vertices")
                    for name, clip in clips
                ),
            ]

    def positions(self, index: int) -> np.ndarray:
        """Vertices of one frame."""
        with sound(self.path):
            return self._frames.frame(self.numbers[index])
