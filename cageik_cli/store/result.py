"""Result files: written beside their name, renamed when whole, read with every check."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli import __version__
from cageik_cli.binding import Binding
from cageik_cli.dual_laplacian import Quality
from cageik_cli.errors import InputError, NumericalError
from cageik_cli.hdf5 import dataset, numbers, opened
from cageik_cli.mesh import Floats, TriMesh
from cageik_cli.metrics import FrameFigures
from cageik_cli.outputs import PatientFile, whole_file
from cageik_cli.scene import Scene
from cageik_cli.store.parts import (
    as_json,
    calls_itself,
    new_file,
    parsed,
    parsed_notes,
    parsed_quality,
    parsed_sources,
    read_meshes,
    refuse_others,
    version_of,
    write_deflated,
    write_meshes,
)

FORMAT = "cageik.result"
SCHEMA = 1
FIGURES = tuple(field.name for field in fields(FrameFigures))
WHOLE_FIGURES = ("worst_vertex",)
LARGEST_LENGTH = 1e60
"""Far above any figure of positions that are taken; its square does not overflow."""


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What a result file says, all but the cages and the weights.

    Attributes
    ----------
    path : Path
    version : str
        Of the program that wrote it.
    scene : Scene
    settings, sources : dict
        What was asked; name and digest of what was read.
    quality : Quality
    notes : tuple of str
        What was changed or left out, one sentence each.
    frames : tuple of str
        Where each of the F frames came from.
    rest, cage : TriMesh
        The rest pose, m vertices, and its cage, n vertices.
    figures : FrameFigures
    """

    path: Path
    version: str
    scene: Scene
    settings: dict[str, Any]
    sources: dict[str, Any]
    quality: Quality
    notes: tuple[str, ...]
    frames: tuple[str, ...]
    rest: TriMesh
    cage: TriMesh
    figures: FrameFigures


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
    """

    binding: Binding
    quality: Quality
    frames: tuple[str, ...]
    scene: Scene
    settings: dict[str, Any]
    notes: tuple[str, ...]
    keep_weights: bool


class ResultWriter:
    """Appends blocks of cages and figures to an open file, in order."""

    def __init__(self, file: h5py.File, sink: PatientFile, header: Header) -> None:
        self._file, self._sink = file, sink
        self._done = 0
        self._count = len(header.frames)
        self._weights = header.binding.weights if header.keep_weights else None
        binding = header.binding
        cage, rest = binding.cage, binding.rest
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
        file.attrs["complete"] = False

    def append(self, cages: Floats, figures: FrameFigures) -> None:
        """Write the next k frames: cages (k, n, 3) and their figures.

        Raises
        ------
        NumericalError
            When they are not finite, or too large to be read again.
        """
        fault = _fault_of(figures)
        if fault is not None or not np.isfinite(cages).all():
            raise NumericalError(
                f"the solve gave {fault or 'cages that are not finite'} in frames {self._done} to "
                f"{self._done + len(cages) - 1}; scale the scene to coordinates near 1"
            )
        done = slice(self._done, self._done + len(cages))
        self._file["verts"][done] = cages
        for name in FIGURES:
            self._file[f"metrics/{name}"][done] = getattr(figures, name)
        self._sink.check()
        self._done = done.stop

    def complete(self, sources: dict[str, Any]) -> None:
        """Write the weights, say what was read, and that every frame is there."""
        if self._done != self._count:
            raise ValueError(f"{self._done} of {self._count} frames were appended")
        if self._weights is not None:
            write_deflated(self._file, "weights", self._weights)
        self._file.attrs["sources"] = as_json(sources)
        self._file.attrs["complete"] = True


@contextmanager
def create(path: Path, header: Header, overwrite: bool) -> Iterator[ResultWriter]:
    """Write a result beside its name; it takes the name when the block ends without an error."""
    with whole_file(path, overwrite) as sink, new_file(sink) as file:
        yield ResultWriter(file, sink, header)


def read_cages(path: Path, size: int) -> Iterator[Floats]:
    """The cages of a result that `read_result` has taken, in blocks of at most `size`, (k, n, 3).

    Raises
    ------
    InputError
        When a block cannot be read, or is not finite.
    """
    with opened(path) as file:
        cages = dataset(file, "verts", "f", (None, None, 3))
        for start in range(0, len(cages), size):
            block = np.asarray(cages[start : start + size], np.float64)
            wrong = np.flatnonzero(~np.isfinite(block).all(axis=(1, 2)))
            if len(wrong):
                raise InputError(f"the cage of frame {start + wrong[0]} is not finite")
            yield block


def read_weights(result: Result) -> Floats | None:
    """The weights of a result, (m, n); None if it was written without.

    Raises
    ------
    InputError
        When they are not as many as the meshes have vertices, or not finite.
    """
    shape = (len(result.rest.vertices), len(result.cage.vertices))
    with opened(result.path) as file:
        if "weights" not in file:
            return None
        weights = numbers(file, "weights", "f", shape).astype(np.float64, copy=False)
        wrong = np.flatnonzero(~np.isfinite(weights).all(axis=1))
        if len(wrong):
            raise InputError(f"`weights` are not finite at vertex {wrong[0]}; extract it again")
        return weights


def is_result(path: Path) -> bool:
    """Whether an HDF5 file calls itself one of our results."""
    with opened(path) as file:
        return calls_itself(file, FORMAT)


def read_result(path: Path) -> Result:
    """Read and check a result file.

    Raises
    ------
    InputError
        When it is not HDF5, not a result, of another schema, not complete, or damaged.
    """
    if not path.exists():
        raise InputError(f"{path}: no such result; make it with cageik extract, or name another")
    with opened(path) as file:
        _refuse_other_files(file)
        rest, cage = read_meshes(file)
        frames = len(dataset(file, "verts", "f", (None, len(cage.vertices), 3)))
        return Result(
            path=path,
            version=version_of(file),
            scene=_scene(file),
            settings=parsed(file, "settings", dict),
            sources=parsed_sources(file),
            quality=parsed_quality(file, Quality),
            notes=parsed_notes(file),
            frames=_frame_names(file, frames),
            rest=rest,
            cage=cage,
            figures=_figures(file, frames, len(rest.vertices)),
        )


def _refuse_other_files(file: h5py.File) -> None:
    refuse_others(file, FORMAT, SCHEMA, "a result of cageik extract")
    complete = file.attrs.get("complete")
    if not (isinstance(complete, np.bool_) and complete):
        raise InputError("is not complete: the run that wrote it was interrupted; extract it again")


def _scene(file: h5py.File) -> Scene:
    values = {field.name: file.attrs.get(field.name) for field in fields(Scene)}
    for name, value in values.items():
        if name == "up_axis" and isinstance(value, str):
            continue
        if not isinstance(value, np.floating | np.integer):
            raise InputError(
                f"attribute `{name}` is {value!r}, expected a number; extract it again"
            )
        values[name] = float(value)
    return Scene(**values)


def _frame_names(file: h5py.File, count: int) -> tuple[str, ...]:
    names = dataset(file, "frames/name", "O", (count,))
    if h5py.check_string_dtype(names.dtype) is None:
        raise InputError("`frames/name` does not hold text; extract it again")
    return tuple(names.asstr(errors="replace")[:])


def _figures(file: h5py.File, frames: int, vertices: int) -> FrameFigures:
    figures = FrameFigures(**{name: _column(file, name, frames) for name in FIGURES})
    fault = _fault_of(figures)
    if fault is not None:
        raise InputError(f"holds {fault}; extract it again")
    if not ((figures.worst_vertex >= 0) & (figures.worst_vertex < vertices)).all():
        raise InputError(f"`metrics/worst_vertex` names more than {vertices} vertices")
    return figures


def _column(file: h5py.File, name: str, frames: int) -> Any:
    if name in WHOLE_FIGURES:
        return numbers(file, f"metrics/{name}", "iu", (frames,))
    with np.errstate(over="ignore", invalid="ignore"):  # what does not fit is found later
        return numbers(file, f"metrics/{name}", "f", (frames,)).astype(np.float64)


def _fault_of(figures: FrameFigures) -> str | None:
    """What cannot be a figure, in words; volumes may be nan."""
    for name in ("rms", "max_deviation", "spread"):
        column = getattr(figures, name)
        if not ((column >= 0) & (column <= LARGEST_LENGTH)).all():
            return f"`metrics/{name}` that is no length"
    for name in ("volume", "volume_reconstructed"):
        if np.isinf(getattr(figures, name)).any():
            return f"`metrics/{name}` that is not finite"
    return None
