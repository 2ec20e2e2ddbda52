"""Clips in HDF5 files, in the layouts of SPLOCS and of D-FAUST."""

from contextlib import ExitStack
from difflib import get_close_matches
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import (
    get_dataset,
    has_text_attribute,
    open_checked,
    open_file,
    read_array,
    read_attribute,
    read_surface,
    scalar_attributes,
    wrap_hdf5_errors,
)
from cageik_cli.formats.base.readers import ChunkedFrames, ClipFile, check_zero_based
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.settings import SceneHints, parse_scene_metadata
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import MAX_LISTED, FormatError, SettingError, join_truncated
from cageik_cli.util.messages import Note, Said
from cageik_cli.util.text import to_unicode

MAX_TOP_ENTRIES = 10_000
"""Datasets and groups at the top of a file of clips; a link to one takes 30 bytes."""

MAX_HDF5_CHUNK_BYTES = 1 << 28
"""Bytes of a chunk; HDF5 unpacks a whole chunk even if a part is read."""


def find_clips(file: Any) -> tuple[bool, list[str]]:
    """Find whether a file is as of D-FAUST, and the names of the datasets of its clips.

    D-FAUST has clips of (m, 3, F) and one dataset `faces`. SPLOCS has `tris`, and one clip `verts`
    of (F, m, 3), which may be scaled.
    """
    if has_text_attribute(file, "format", "cageik.binding"):
        raise FormatError("is a binding of cageik bind, not a clip; give the frames")
    if _is_own_animation(file) and not np.all(read_attribute(file, "complete")):
        raise FormatError("is not complete: its run was interrupted; run cageik extract again")
    if "verts" in file:
        return False, ["verts"]
    if "default" in file:
        raise FormatError(
            "holds components of a deformation model, not a clip; give the clip itself"
        )
    shapes = _list_shapes(file)
    found = [name for name, shape in shapes.items() if len(shape) == 3 and shape[1] == 3]
    if not found or "faces" not in file:
        raise FormatError(
            "holds no clip; expected datasets `verts` and `tris`, or clips of (vertices, 3, "
            "frames) and `faces`"
        )
    return True, found


def _is_own_animation(file: Any) -> bool:
    """Return whether a file is a result or an edit of cageik."""
    return any(has_text_attribute(file, "format", f"cageik.{kind}") for kind in ("result", "edit"))


def _list_shapes(file: h5py.File) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the datasets at the top of a file that hold floating-point numbers."""
    if len(file) > MAX_TOP_ENTRIES:
        raise FormatError(
            f"has {len(file)} datasets and groups at its top, expected at most {MAX_TOP_ENTRIES}; "
            "split it into several files"
        )
    held = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
    found = {name: file[name] for name in held if file.get(name, getclass=True) is h5py.Dataset}
    return {
        name: each.shape
        for name, each in found.items()
        if each.dtype.kind == "f" and each.shape is not None
    }


def choose_clip(names: list[str], member: str | None) -> str:
    """Return the requested clip of those in a file."""
    if member in names:
        return member
    if member is not None:
        near = get_close_matches(member, names, cutoff=0.0)
        raise SettingError(
            f"holds no clip `{to_unicode(member)}`; the nearest names are "
            f"{_join_names(near)}; cageik info lists all"
        )
    if len(names) > 1:
        named = next((name for name in names if name.strip()), None)
        remedy = "give them names" if named is None else "choose one, as in FILE::" + named
        raise SettingError(f"holds {len(names)} clips: {_join_names(names)}; {to_unicode(remedy)}")
    return names[0]


class Hdf5Frames(ChunkedFrames):
    """Frames of a dataset in a file that stays open.

    Frames that share chunks are read together, so that each chunk is decompressed once.
    """

    def __init__(self, file: Any, name: str, is_dfaust: bool) -> None:
        self._is_dfaust, frame_axis = is_dfaust, 2 if is_dfaust else 0
        shape = (None, 3, None) if is_dfaust else (None, None, 3)
        self._stored = stored = get_dataset(file, name, "f", shape)
        self._scale, self._mean = np.ones(1), np.zeros(1)
        if not is_dfaust:
            self._scale = _read_attribute(file, name, "scale", 1.0)
            self._mean = _read_attribute(file, name, "mean", 0.0)
        count, vertices = stored.shape[frame_axis], stored.shape[0 if is_dfaust else 1]
        unchunked = count if is_dfaust else 1
        chunk = prod(stored.chunks or (1,)) * stored.dtype.itemsize
        if chunk > MAX_HDF5_CHUNK_BYTES:
            raise FormatError(
                f"`{to_unicode(name)}` has chunks of {chunk} bytes, expected at most "
                f"{MAX_HDF5_CHUNK_BYTES}; write smaller ones, such as a frame each (h5repack -l)"
            )
        chunk_frames = stored.chunks[frame_axis] if stored.chunks else unchunked
        super().__init__(count, vertices, chunk_frames, stored.dtype.itemsize)

    def read_frame(self, index: int) -> Floats:
        """Read the positions of one frame, (m, 3), scaled and with `mean` added."""
        positions = np.array(super().read_frame(index), np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # checked when the frame is read
            positions *= self._scale
            positions += self._mean
        return positions

    def read_chunk(self, start: int, stop: int) -> np.ndarray:
        """Read frames `start` up to `stop`, exclusive: (k, m, 3)."""
        if self._is_dfaust:
            return np.moveaxis(self._stored[:, :, start:stop], 2, 0)
        return np.asarray(self._stored[start:stop])


def _read_attribute(file: Any, clip: str, name: str, default: float) -> Floats:
    """Read an attribute of one or three numbers, of the file or of its clip."""
    value = read_attribute(file, name, read_attribute(file[clip], name, default))
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.shape not in ((), (1,), (3,), (1, 3)):
        found = repr(value) if array.ndim == 0 else f"{array.dtype} of shape {array.shape}"
        raise FormatError(f"attribute `{name}` is {found}, expected one or three numbers")
    return np.asarray(array, np.float64).reshape(-1)


def _join_names(names: list[str]) -> str:
    shown = (to_unicode(name) if name.strip() else repr(name) for name in names)
    return join_truncated(shown, MAX_LISTED)


class Reader(ClipFile):
    """Frames of one clip in an HDF5 file, which stays open."""

    suffixes = (".h5", ".hdf5")
    has_members = True

    def __init__(self, request: ClipRequest) -> None:
        path = request.path
        with wrap_hdf5_errors(path), ExitStack() as stack:
            file = stack.enter_context(open_file(path))
            is_dfaust, names = find_clips(file)
            self._frames = Hdf5Frames(file, choose_clip(names, request.member), is_dfaust)
            faces = read_array(file, "faces" if is_dfaust else "tris", "iu", (None, 3))
            hints, notes = parse_scene_metadata(scalar_attributes(file, SceneHints.__slots__))
            self.set_frames(request, self._frames.frame_count, hints)
            self.notes = tuple(Note(text, place=to_unicode(path.name)) for text in notes)
            check_zero_based(faces, self._frames.vertex_count)
            first = self._frames.read_frame(self.frame_indices[0])
            mesh = TriMesh(request.complete_first(first), faces)
            # Other programs may have another group of that name.
            is_own = _is_own_animation(file)
            self.first = read_surface(file, "attributes/cage", mesh) if is_own else mesh
            stack.pop_all()  # open from here on

    @classmethod
    def list_members(cls, path: Path) -> list[str]:
        """List the clips in a file that holds several."""
        with open_checked(path) as file:
            _, names = find_clips(file)
        return names if len(names) > 1 else []

    @classmethod
    def describe_contents(cls, request: ClipRequest) -> list[tuple[str, Said]]:
        """List the clips in a file that holds several, if none of them is requested."""
        path = request.path
        with open_checked(path) as file:
            is_dfaust, names = find_clips(file)
            if len(names) == 1 or request.member is not None:
                return []
            clips = [(name, Hdf5Frames(file, name, is_dfaust)) for name in names]
            return [
                ("holds", f"{len(names)} clips; choose one as FILE::CLIP"),
                *(
                    (
                        "clip",
                        f"{to_unicode(name)}, {clip.frame_count} frames of {clip.vertex_count} "
                        "vertices",
                    )
                    for name, clip in clips
                ),
            ]

    def read_positions(self, index: int) -> np.ndarray:
        """Read the vertices of one frame."""
        with wrap_hdf5_errors(self.path):
            return self._frames.read_frame(self.frame_indices[index])
