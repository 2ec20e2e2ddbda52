"""Result files, written beside their name and renamed when whole."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli import __version__
from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.scene import Scene
from cageik_cli.solver.dual_laplacian import Quality
from cageik_cli.solver.metrics import FIGURES, WHOLE_FIGURES, FrameFigures
from cageik_cli.store.hdf5_fields import as_json, new_file, write_deflated, write_meshes
from cageik_cli.store.result import FORMAT, SCHEMA
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.outputs import PatientFile, whole_file

LARGEST_MISS = float(np.finfo(np.float32).max)


@dataclass(frozen=True, slots=True, eq=False)
class Header:
    """What is known of a result before its first frame is solved.

    Attributes
    ----------
    binding : Binding
    quality : Quality
    frames : tuple of str
    scene : Scene
    settings : dict
    notes : tuple of str
    keep_weights : bool
    edited_from : str, optional
        The name of the result that this is an edit of.
    """

    binding: Binding
    quality: Quality
    frames: tuple[str, ...]
    scene: Scene
    settings: dict[str, Any]
    notes: tuple[str, ...]
    keep_weights: bool
    edited_from: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Ending:
    """What is known of a result when its last frame is solved.

    Attributes
    ----------
    sources : dict
    skipped : dict
        By number in the clip, why a frame was.
    vertex_rms : (m,) float64
        sqrt(mean |v̂ − v|²) of each vertex over the frames that were not skipped; nan for missing
        data.
    posed : (3,) int64
        Numbers of the worst, the median and the best frame, by rms.
    misses : (3, m, 3) float64
        Their v − v̂. A report draws them, and reads no frames.
    """

    sources: dict[str, Any]
    skipped: dict[int, str]
    vertex_rms: Floats
    posed: Integers
    misses: Floats


class ResultWriter:
    """Appends blocks of cages and figures to an open file, in order."""

    def __init__(self, file: h5py.File, sink: PatientFile, header: Header) -> None:
        self._file, self._sink = file, sink
        self._done = 0
        self._count = len(header.frames)
        self._weights = header.binding.weights if header.keep_weights else None
        binding = header.binding
        cage, rest = binding.cage, binding.rest
        self._diagonal = rest.diagonal
        file.create_dataset("verts", (self._count, *cage.vertices.shape), "f8")
        write_meshes(file, rest, cage)
        file.create_dataset("frames/name", data=header.frames, dtype=h5py.string_dtype())
        for name in FIGURES:
            kind = "i8" if name in WHOLE_FIGURES else "f8"
            file.create_dataset(f"metrics/{name}", (self._count,), kind)
        file.attrs.update(format=FORMAT, schema=SCHEMA, version=__version__)
        file.attrs.update(asdict(header.scene))
        file.attrs["settings"] = as_json(header.settings)
        file.attrs["notes"] = as_json(header.notes)
        file.attrs["quality"] = as_json(asdict(header.quality))
        if header.edited_from is not None:
            file.attrs["edited_from"] = header.edited_from
        file.attrs["complete"] = False

    def append(self, cages: Floats, figures: FrameFigures) -> None:
        """Write the next k frames: cages (k, n, 3) and their figures, which are sound."""
        done = slice(self._done, self._done + len(cages))
        self._file["verts"][done] = cages
        for name in FIGURES:
            self._file[f"metrics/{name}"][done] = getattr(figures, name)
        self._sink.check()
        self._done = done.stop

    def complete(self, ending: Ending) -> None:
        """Write the weights and what they rebuild, what was read and skipped; say it is all."""
        if self._done != self._count:
            raise ValueError(f"{self._done} of {self._count} frames were appended")
        if self._weights is not None:
            write_deflated(self._file, "weights", self._weights)
            self._file.create_dataset("poses/frame", data=ending.posed, dtype="i8")
            # Of the diagonal, they fit whatever the scene's units are.
            misses = np.clip(ending.misses / self._diagonal, -LARGEST_MISS, LARGEST_MISS)
            self._file.create_dataset("poses/misses", data=misses, dtype="f4")
        self._file.create_dataset("metrics/vertex_rms", data=ending.vertex_rms, dtype="f8")
        skipped = {str(k): text for k, text in ending.skipped.items()}
        self._file.attrs["sources"] = as_json(ending.sources)
        self._file.attrs["skipped"] = as_json(skipped)
        self._file.attrs["complete"] = True


@contextmanager
def create(
    path: Path, header: Header, overwrite: bool, beside: Path | None = None
) -> Iterator[ResultWriter]:
    """Write a result beside its name; it takes the name when the block ends without an error.

    `beside` is where it is until then, if no other run can have that name.
    """
    with whole_file(path, overwrite, beside) as sink, new_file(sink) as file:
        yield ResultWriter(file, sink, header)
