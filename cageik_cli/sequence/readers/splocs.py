"""The HDF5 layout of SPLOCS: `verts` (F, m, 3) and `tris` (t, 3), maybe with `mean` and `scale`."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.errors import InputError
from cageik_cli.hdf5 import dataset, numbers, opened
from cageik_cli.layout import printable
from cageik_cli.mesh import Floats, TriMesh
from cageik_cli.sequence.clip import MeshSequence, only


class Reader(MeshSequence):
    """Frames of one HDF5 file, read one by one."""

    suffixes = (".h5", ".hdf5")

    def __init__(self, paths: list[Path]) -> None:
        path = only(paths)
        self._path = path
        with opened(path) as file:
            if "verts" not in file:
                kind = "components of a model, not a clip" if "default" in file else "no clip"
                raise InputError(f"holds {kind}; expected datasets `verts` and `tris`")
            frames = dataset(file, "verts", "f", (None, None, 3))
            faces = numbers(file, "tris", "iu", (None, 3))
            self._scale, self._mean = _attribute(file, "scale", 1.0), _attribute(file, "mean", 0.0)
            self.names = tuple(f"{printable(path.name)}[{k}]" for k in range(len(frames)))
            self.first = TriMesh(self._restored(frames[0]), faces)

    def positions(self, index: int) -> Floats:
        """Vertices of one frame, with `scale` and `mean` undone."""
        with opened(self._path) as file:
            return self._restored(file["verts"][index])

    def source(self) -> dict[str, Any]:
        """Name and digest of the file."""
        with self._path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        return {"name": printable(self._path.name), "sha256": digest}

    def _restored(self, stored: np.ndarray) -> Floats:
        with np.errstate(over="ignore", invalid="ignore"):  # frames are checked where they enter
            return np.asarray(stored, np.float64) * self._scale + self._mean


def _attribute(file: Any, name: str, default: float) -> Floats:
    """A number or three, of the file or of its `verts`."""
    value = file.attrs.get(name, file["verts"].attrs.get(name, default))
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.shape not in ((), (1,), (3,), (1, 3)):
        raise InputError(f"attribute `{name}` is {value!r}, expected a number or three")
    return np.asarray(array, np.float64).reshape(-1)
