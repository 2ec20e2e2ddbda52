"""The HDF5 layout of SPLOCS: `verts` (F, m, 3) and `tris` (t, 3), maybe with `mean` and `scale`."""

from collections import deque
from contextlib import ExitStack
from threading import Lock
from typing import Any

import numpy as np

from cageik_cli.errors import InputError
from cageik_cli.hdf5 import dataset, numbers, open_file, sound
from cageik_cli.mesh import Floats, TriMesh
from cageik_cli.sequence.clip import ClipRequest
from cageik_cli.sequence.clip_file import ClipFile, only

LARGEST_RUN = 1 << 26
"""Bytes of frames that are read at once and kept; a few times more than usual chunks hold."""


class Reader(ClipFile):
    """Frames of one HDF5 file, which stays open.

    Frames that share chunks are read together, so that no chunk is decompressed for each of them;
    the last two such runs are kept, for threads that read ahead ask for both sides of a border.
    """

    suffixes = (".h5", ".hdf5")

    def __init__(self, request: ClipRequest) -> None:
        path = only(request.paths)
        with sound(path), ExitStack() as stack:
            file = stack.enter_context(open_file(path))
            if "verts" not in file:
                kind = "components of a model, not a clip" if "default" in file else "no clip"
                raise InputError(f"holds {kind}; expected datasets `verts` and `tris`")
            frames = dataset(file, "verts", "f", (None, None, 3))
            faces = numbers(file, "tris", "iu", (None, 3))
            self._frames, self._run = frames, _frames_a_run(frames)
            self._kept: deque[tuple[int, np.ndarray]] = deque(maxlen=2)
            self._lock = Lock()
            self._scale, self._mean = _attribute(file, "scale", 1.0), _attribute(file, "mean", 0.0)
            self.take(request, len(frames))
            self.first = TriMesh(self.positions(0), faces)
            stack.pop_all()  # open from here on

    def positions(self, index: int) -> Floats:
        """Vertices of one frame, with `scale` and `mean` undone."""
        with sound(self.path), self._lock:
            stored = self._stored(self.numbers[index])
        with np.errstate(over="ignore", invalid="ignore"):  # frames are checked where they enter
            return np.asarray(stored, np.float64) * self._scale + self._mean

    def _stored(self, index: int) -> np.ndarray:
        start = index - index % self._run
        kept = next((run for first, run in self._kept if first == start), None)
        if kept is None:
            kept = self._frames[start : start + self._run]
            self._kept.append((start, kept))
        return np.asarray(kept[index - start])


def _frames_a_run(frames: Any) -> int:
    """How many frames of the dataset lie in one layer of chunks, if they fit the bound."""
    layer = frames.chunks[0] if frames.chunks else 1
    return int(max(1, min(layer, LARGEST_RUN * len(frames) // frames.nbytes)))


def _attribute(file: Any, name: str, default: float) -> Floats:
    """A number or three, of the file or of its `verts`."""
    value = file.attrs.get(name, file["verts"].attrs.get(name, default))
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.shape not in ((), (1,), (3,), (1, 3)):
        raise InputError(f"attribute `{name}` is {value!r}, expected a number or three")
    return np.asarray(array, np.float64).reshape(-1)
