"""A clip in a numpy `.npz`: an array of positions and one of faces, by their usual names."""

import io
import zipfile
import zlib
from tokenize import TokenError
from zipfile import BadZipFile

import numpy as np

from cageik_cli.errors import InputError, located
from cageik_cli.mesh import TriMesh
from cageik_cli.sequence.clip import ClipRequest
from cageik_cli.sequence.clip_file import ClipFile, only
from cageik_cli.sequence.mesh_file import read_bytes

# What numpy and zipfile raise for archives that are cut, encrypted or not of arrays.
_DAMAGES = (OSError, ValueError, EOFError, MemoryError, RuntimeError, SyntaxError, TokenError,
            zlib.error, BadZipFile)  # fmt: skip

VERTEX_NAMES = ("vertices", "verts", "V", "v")
FACE_NAMES = ("faces", "tris", "F", "f")


class Reader(ClipFile):
    """Frames of one `.npz`; the array of positions is in memory, for it is compressed as one."""

    suffixes = (".npz",)

    def __init__(self, request: ClipRequest) -> None:
        path = only(request.paths)
        with located(path):
            arrays = _members(read_bytes(path))
            faces = _faces(arrays)
            self._frames = _frames_first(_named(arrays, VERTEX_NAMES, "f"), int(faces.max()))
            self.take(request, len(self._frames))
            self.first = TriMesh(self.positions(0), faces)

    def positions(self, index: int) -> np.ndarray:
        """Vertices of one frame."""
        return np.asarray(self._frames[self.numbers[index]])


def _members(data: bytes) -> dict[str, np.ndarray]:
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise InputError("is not a .npz archive of arrays; write it with numpy.savez")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            wanted = [name for name in file.files if name in VERTEX_NAMES + FACE_NAMES]
            if {"poses", "betas", "trans"} <= set(file.files) and not wanted:
                raise InputError(
                    "holds body parameters (AMASS), not vertices; evaluate the body model first"
                )
            return {name: np.asarray(file[name]) for name in wanted}
    except _DAMAGES as error:
        raise InputError(f"is not a sound .npz of plain arrays ({error})") from error


def _named(arrays: dict[str, np.ndarray], names: tuple[str, ...], kinds: str) -> np.ndarray:
    found = [name for name in names if name in arrays]
    if len(found) != 1:
        held = ", ".join(found) or "none"
        raise InputError(f"holds {held} of the arrays {', '.join(names)}; expected just one")
    array = arrays[found[0]]
    if array.dtype.kind not in kinds or array.size == 0:
        raise InputError(
            f"`{found[0]}` is {array.dtype} of shape {array.shape}, expected "
            f"{'floating-point numbers' if kinds == 'f' else 'integers'}"
        )
    return array


def _faces(arrays: dict[str, np.ndarray]) -> np.ndarray:
    faces = _named(arrays, FACE_NAMES, "iu")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f"faces have shape {faces.shape}, expected (count, 3)")
    return faces


def _frames_first(array: np.ndarray, last_vertex: int) -> np.ndarray:
    """Positions as (F, m, 3), whichever of (F, m, 3) and (m, 3, F) they came in.

    The axis of length 3 decides; when two are, the faces do: they must find their vertices.
    """
    layouts = []
    if array.ndim == 3 and array.shape[2] == 3 and array.shape[1] > last_vertex:
        layouts.append(array)
    if array.ndim == 3 and array.shape[1] == 3 and array.shape[0] > last_vertex:
        layouts.append(array.transpose(2, 0, 1))
    if len(layouts) != 1:
        found = "could be either" if layouts else "is neither"
        raise InputError(
            f"positions of shape {array.shape} {found} of (frames, vertices, 3) and "
            f"(vertices, 3, frames) for faces that name vertex {last_vertex} (from 0; faces "
            "counted from 1 must have 1 taken off)"
        )
    return layouts[0]
