"""Result files: written beside their name, renamed when whole, read with every check."""

import json
import zlib
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
from cageik_cli.layout import printable
from cageik_cli.mesh import Floats, TriMesh
from cageik_cli.metrics import FrameFigures
from cageik_cli.outputs import PatientFile, whole_file

FORMAT = "cageik.result"
SCHEMA = 1
FIGURES = tuple(field.name for field in fields(FrameFigures))
WHOLE_FIGURES = ("worst_vertex",)
CHUNK_BYTES = 1 << 18
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
    fps : float
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
    fps: float
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
    fps : float
    settings : dict
    notes : tuple of str
    keep_weights : bool
    """

    binding: Binding
    quality: Quality
    frames: tuple[str, ...]
    fps: float
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
        file["tris"] = cage.faces.astype(np.int32)
        file["cage/verts"], file["rest/verts"] = cage.vertices, rest.vertices
        file["rest/tris"] = rest.faces.astype(np.int32)
        file.create_dataset("frames/name", data=header.frames, dtype=h5py.string_dtype())
        for name in FIGURES:
            kind = "i8" if name in WHOLE_FIGURES else "f8"
            file.create_dataset(f"metrics/{name}", (self._count,), kind)
        file.attrs.update(format=FORMAT, schema=SCHEMA, version=__version__, fps=header.fps)
        file.attrs["settings"] = _json(header.settings)
        file.attrs["notes"] = _json(header.notes)
        file.attrs["quality"] = _json(asdict(header.quality))
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
            _write_deflated(self._file, "weights", self._weights)
        self._file.attrs["sources"] = _json(sources)
        self._file.attrs["complete"] = True


@contextmanager
def create(path: Path, header: Header, overwrite: bool) -> Iterator[ResultWriter]:
    """Write a result beside its name; it takes the name when the block ends without an error."""
    # Neither times nor addresses go into the file: same input, same bytes.
    with (
        whole_file(path, overwrite) as sink,
        h5py.File(sink, "w", libver=("earliest", "v110")) as file,
    ):
        yield ResultWriter(file, sink, header)


def is_result(path: Path) -> bool:
    """Whether an HDF5 file calls itself one of our results."""
    with opened(path) as file:
        return _calls_itself_ours(file)


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
        frames, cage_vertices, _ = dataset(file, "verts", "f", (None, None, 3)).shape
        rest = TriMesh(
            numbers(file, "rest/verts", "f", (None, 3)),
            numbers(file, "rest/tris", "iu", (None, 3)),
        )
        cage = TriMesh(
            numbers(file, "cage/verts", "f", (cage_vertices, 3)),
            numbers(file, "tris", "iu", (None, 3)),
        )
        if rest.diagonal == 0:
            raise InputError("`rest/verts` are all one point; extract it again")
        return Result(
            path=path,
            version=printable(str(file.attrs.get("version", "unknown"))),
            fps=_positive(file, "fps"),
            settings=_parsed(file, "settings", dict),
            sources=_sources(file),
            quality=_quality(file),
            notes=tuple(map(str, _parsed(file, "notes", list))),
            frames=_frame_names(file, frames),
            rest=rest,
            cage=cage,
            figures=_figures(file, frames, len(rest.vertices)),
        )


def _calls_itself_ours(file: h5py.File) -> bool:
    name = file.attrs.get("format")
    return isinstance(name, str) and name == FORMAT


def _refuse_other_files(file: h5py.File) -> None:
    if not _calls_itself_ours(file):
        raise InputError("is not a result of cageik extract")
    schema = file.attrs.get("schema")
    if not (isinstance(schema, np.integer) and schema == SCHEMA):
        raise InputError(
            f"is of schema {schema}, this program reads schema {SCHEMA}; extract it again"
        )
    complete = file.attrs.get("complete")
    if not (isinstance(complete, np.bool_) and complete):
        raise InputError("is not complete: the run that wrote it was interrupted; extract it again")


def _positive(file: h5py.File, name: str) -> float:
    value = file.attrs.get(name)
    if not isinstance(value, np.floating | np.integer) or not 0 < float(value) < np.inf:
        raise InputError(f"attribute `{name}` is {value!r}, expected a number above zero")
    return float(value)


def _parsed(file: h5py.File, name: str, kind: type) -> Any:
    text = file.attrs.get(name)
    try:
        value = json.loads(
            text if isinstance(text, str) else "",
            parse_float=_finite,
            parse_int=_finite_integer,
            parse_constant=_finite,
        )
        json.dumps(value, ensure_ascii=False).encode()  # what is no Unicode text fails here
    except ValueError:
        value = None
    if not isinstance(value, kind):
        raise InputError(f"attribute `{name}` is not a JSON {kind.__name__}; extract it again")
    return value


def _sources(file: h5py.File) -> dict[str, Any]:
    sources: dict[str, Any] = _parsed(file, "sources", dict)
    if not all(isinstance(source, dict) for source in sources.values()):
        raise InputError("attribute `sources` does not name files; extract it again")
    return sources


def _frame_names(file: h5py.File, count: int) -> tuple[str, ...]:
    names = dataset(file, "frames/name", "O", (count,))
    if h5py.check_string_dtype(names.dtype) is None:
        raise InputError("`frames/name` does not hold text; extract it again")
    return tuple(names.asstr(errors="replace")[:])


def _quality(file: h5py.File) -> Quality:
    figures = _parsed(file, "quality", dict)
    expected = {field.name for field in fields(Quality)}
    numbers_only = all(isinstance(value, int | float) for value in figures.values())
    if set(figures) != expected or not numbers_only:
        raise InputError(f"attribute `quality` is not {', '.join(sorted(expected))}")
    return Quality(**figures)


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


def _write_deflated(file: h5py.File, name: str, matrix: Floats) -> None:
    """Write a float64 matrix through HDF5's own filters, shuffle and deflate, by chunks of rows.

    The digits of weights do not repeat: Huffman codes alone make the file as small as deflate's
    search for repetitions does, which HDF5 cannot be told to leave out, in under half the time.
    """
    rows = max(1, min(len(matrix), CHUNK_BYTES // matrix[0].nbytes))
    chunks = (rows, matrix.shape[1])
    filters = {"shuffle": True, "compression": "gzip", "compression_opts": 1}
    dataset = file.create_dataset(name, matrix.shape, "f8", chunks=chunks, **filters)
    for start in range(0, len(matrix), rows):
        chunk = np.zeros(chunks)
        chunk[: len(matrix) - start] = matrix[start : start + rows]
        shuffled = chunk.view(np.uint8).reshape(-1, 8).T.tobytes()
        deflate = zlib.compressobj(1, strategy=zlib.Z_HUFFMAN_ONLY)
        dataset.id.write_direct_chunk((start, 0), deflate.compress(shuffled) + deflate.flush())


def _finite(text: str) -> float:
    value = float(text)
    if not np.isfinite(value):
        raise ValueError(f"{text} is not a finite number")
    return value


def _finite_integer(text: str) -> int:
    _finite(text)
    return int(text)


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True)
