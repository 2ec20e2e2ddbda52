"""Result files, read with every check."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import get_dataset, open_checked, read_array
from cageik_cli.formats.scene import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.solver.dual_laplacian import SolveQuality
from cageik_cli.solver.metrics import (
    INTEGER_METRICS,
    METRIC_NAMES,
    FrameMetrics,
    are_lengths,
    find_invalid_metric,
)
from cageik_cli.store.hdf5_fields import (
    check_format,
    has_format,
    read_json_attr,
    read_meshes,
    read_notes,
    read_quality,
    read_sources,
    read_text_attr,
    read_version,
)
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError
from cageik_cli.util.text import to_unicode


def read_frame_metrics(
    file: h5py.File, frames: int, vertices: int, skipped: list[int]
) -> FrameMetrics:
    """The figures of all frames; those that were skipped have none."""
    columns = {name: _read_column(file, name, frames) for name in METRIC_NAMES}
    figures = FrameMetrics(**columns)
    held = FrameMetrics(**{name: np.delete(column, skipped) for name, column in columns.items()})
    fault = find_invalid_metric(held)
    if fault is not None:
        raise InputError(f"holds {fault}; extract it again")
    if not np.isnan(figures.rms[skipped]).all():
        raise InputError("`metrics/rms` has figures of frames that were skipped; extract it again")
    if not ((held.worst_vertex >= 0) & (held.worst_vertex < vertices)).all():
        raise InputError(f"`metrics/worst_vertex` names more than {vertices} vertices")
    return figures


def read_vertex_rms(file: h5py.File, vertices: int) -> Floats:
    """The rms of every vertex, (m,); nan for missing data."""
    values = read_array(file, "metrics/vertex_rms", "f", (vertices,)).astype(np.float64)
    is_missing = np.isnan(values)
    if is_missing.all() or not (is_missing | are_lengths(values)).all():
        raise InputError("holds `metrics/vertex_rms` that is no length; extract it again")
    return values


def _read_column(file: h5py.File, name: str, frames: int) -> Any:
    if name in INTEGER_METRICS:
        return read_array(file, f"metrics/{name}", "iu", (frames,))
    with np.errstate(over="ignore", invalid="ignore"):  # what does not fit is found later
        return read_array(file, f"metrics/{name}", "f", (frames,)).astype(np.float64)


FORMAT = "cageik.result"
SCHEMA = 1
CHECKPOINT_SUFFIX = ".partial"

KEY_FRAME_COUNT = 3
"""Frames that are held in full: the worst, the median and the best."""


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
    quality : SolveQuality
    notes : tuple of str
        What was changed or left out, one sentence each.
    frames : tuple of str
        Where each of the F frames came from.
    rest, cage : TriMesh
        The rest pose, m vertices, and its cage, n vertices.
    metrics : FrameMetrics
        nan for a frame that was skipped, and a worst vertex of -1.
    vertex_rms : (m,) float64
        sqrt(mean |v̂ − v|²) of each vertex over the frames that were not skipped; nan for vertices
        that are missing data.
    skipped : dict
        By number in the clip, why a frame was skipped.
    edited_from : str, optional
        The name of the result that this is an edit of: figures then compare the mesh before the
        edit, v, with the edited one, v̂. None for one that was extracted.

    Examples
    --------
    >>> from cageik_cli import extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> result.rest, result.cage
    (<TriMesh: 1570 vertices, 3136 triangles>, <TriMesh: 80 vertices, 156 triangles>)
    >>> result.frames[int(result.metrics.rms.argmax())]
    'walker_26.obj'
    """

    path: Path
    version: str
    scene: Scene
    settings: dict[str, Any]
    sources: dict[str, Any]
    quality: SolveQuality
    notes: tuple[str, ...]
    frames: tuple[str, ...]
    rest: TriMesh
    cage: TriMesh
    metrics: FrameMetrics
    vertex_rms: Floats
    skipped: dict[int, str] = field(default_factory=dict)
    edited_from: str | None = None

    def __repr__(self) -> str:
        return (
            f"<Result: {self.path.name}, {len(self.frames)} frames of {len(self.rest.vertices)} "
            f"vertices in a cage of {len(self.cage.vertices)}>"
        )


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrames:
    """The worst, the median and the best frame, as their cages rebuild them and as they were.

    Attributes
    ----------
    indices : (3,) int64
        Their numbers in the clip.
    cages : (3, n, 3) float64
    reconstructed : (3, m, 3) float64
        v̂, the weights times the cages.
    errors : (3, m, 3) float64
        v − v̂, in diagonals of the rest model.
    """

    indices: Integers
    cages: Floats
    reconstructed: Floats
    errors: Floats


def checkpoint_path(path: Path) -> Path:
    """What the log of a run is called that makes the result at `path`."""
    return path.with_name(path.name + CHECKPOINT_SUFFIX)


def read_cages(result: Result, size: int, first: int = 0) -> Iterator[Floats]:
    """The cages of a result from a frame on, in blocks of at most `size`, (k, n, 3), gaps filled.

    The cage of a frame that was skipped lies between those of the frames before and after, as far
    along as it is in time; beyond the last frame that was not it stays.

    Raises
    ------
    InputError
        When a block cannot be read, or is not finite.
    """
    known = np.setdiff1d(np.arange(len(result.frames)), list(result.skipped))
    with open_checked(result.path) as file:
        cages = get_dataset(file, "verts", "f", (len(result.frames), len(result.cage.vertices), 3))
        for start in range(first, len(cages), size):
            block = np.asarray(cages[start : start + size], np.float64)
            for k in range(start, start + len(block)):
                if k in result.skipped:
                    block[k - start] = _interpolate_gap(cages, known, k)
            wrong = np.flatnonzero(~np.isfinite(block).all(axis=(1, 2)))
            if len(wrong):
                raise InputError(f"the cage of frame {start + wrong[0]} is not finite")
            yield block


def _interpolate_gap(cages: h5py.Dataset, known: Integers, frame: int) -> Floats:
    """What the cages of the nearest `known` frames give for one between them."""
    place = int(np.searchsorted(known, frame))
    before, after = (int(known[np.clip(k, 0, len(known) - 1)]) for k in (place - 1, place))
    share = (frame - before) / (after - before) if after > before else 0.0
    return np.asarray((1 - share) * cages[before] + share * cages[after])


def has_weights(result: Result) -> bool:
    """Whether a result was written with its weights."""
    with open_checked(result.path) as file:
        return "weights" in file


def read_weights(result: Result) -> Floats | None:
    """The weights of a result, (m, n); None if it was written without.

    Raises
    ------
    InputError
        When they are not as many as the meshes have vertices, or not finite.
    """
    shape = (len(result.rest.vertices), len(result.cage.vertices))
    with open_checked(result.path) as file:
        if "weights" not in file:
            return None
        weights = read_array(file, "weights", "f", shape).astype(np.float64, copy=False)
        largest = np.maximum(weights.max(axis=1), -weights.min(axis=1))
        wrong = np.flatnonzero(~are_lengths(largest))
        if len(wrong):
            raise InputError(
                f"`weights` are not finite at vertex {wrong[0]}, or far too large; extract it again"
            )
        return weights


def read_key_frames(result: Result, weights: Floats) -> KeyFrames:
    """The frames that a result written with its weights holds in full.

    Raises
    ------
    InputError
        When they are not there, or are no frames of it.
    """
    m, n, count = *weights.shape, len(result.frames)
    with open_checked(result.path) as file:
        frames = read_array(file, "poses/frame", "iu", (KEY_FRAME_COUNT,)).astype(np.int64)
        misses = read_array(file, "poses/misses", "f", (KEY_FRAME_COUNT, m, 3)).astype(np.float64)
        if not ((frames >= 0) & (frames < count)).all():
            raise InputError(f"`poses/frame` names other frames than the {count} there are")
        cages = get_dataset(file, "verts", "f", (count, n, 3))
        posed = np.stack([np.asarray(cages[k], np.float64) for k in frames])
        if not all(are_lengths(np.abs(held)).all() for held in (posed, misses)):
            raise InputError("`poses` are not finite, or far too large; extract it again")
    return KeyFrames(frames, posed, weights @ posed, misses)


def is_result(path: Path) -> bool:
    """Whether an HDF5 file calls itself one of our results."""
    with open_checked(path) as file:
        return has_format(file, FORMAT)


def read_result(path: Path) -> Result:
    """Read and check a result file.

    Raises
    ------
    InputError
        When it is not HDF5, not a result, of another schema, not complete, or damaged.
    """
    if not path.exists():
        raise InputError(f"{path}: no such result; {_suggest_instead(path)}")
    if path.suffix == CHECKPOINT_SUFFIX:
        raise InputError(
            f"{path}: is what an interrupted run has left, and no result; go on with the same "
            "command and --resume"
        )
    with open_checked(path) as file:
        _check_result_format(file)
        rest, cage = read_meshes(file)
        frames = len(get_dataset(file, "verts", "f", (None, len(cage.vertices), 3)))
        skipped = _read_skipped(file, frames)
        return Result(
            path=path,
            version=read_version(file),
            scene=_read_scene(file),
            settings=read_json_attr(file, "settings", dict),
            sources=read_sources(file),
            quality=read_quality(file, SolveQuality),
            notes=read_notes(file),
            frames=_read_frame_names(file, frames),
            rest=rest,
            cage=cage,
            metrics=read_frame_metrics(file, frames, len(rest.vertices), list(skipped)),
            vertex_rms=read_vertex_rms(file, len(rest.vertices)),
            skipped=skipped,
            edited_from=read_text_attr(file, "edited_from"),
        )


def _check_result_format(file: h5py.File) -> None:
    check_format(file, FORMAT, SCHEMA, "a result of cageik extract")
    complete = file.attrs.get("complete")
    if not (isinstance(complete, np.bool_) and complete):
        raise InputError("is not complete: the run that wrote it was interrupted; extract it again")


def _read_scene(file: h5py.File) -> Scene:
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


def _read_frame_names(file: h5py.File, count: int) -> tuple[str, ...]:
    names = get_dataset(file, "frames/name", "O", (count,))
    if h5py.check_string_dtype(names.dtype) is None:
        raise InputError("`frames/name` does not hold text; extract it again")
    return tuple(names.asstr(errors="replace")[:])


def _suggest_instead(path: Path) -> str:
    log = checkpoint_path(path)
    if log.exists():
        return f"an interrupted run has left {log.name}; go on with cageik extract --resume"
    return "make it with cageik extract, or name another"


def _read_skipped(file: h5py.File, frames: int) -> dict[int, str]:
    held = read_json_attr(file, "skipped", dict)
    numbers_only = all(key.isdecimal() and int(key) < frames for key in held)
    if not numbers_only or not all(isinstance(text, str) for text in held.values()):
        raise InputError("attribute `skipped` does not say which frames were and why")
    if len(held) == frames:
        raise InputError("every frame was skipped; extract it again")
    return {int(key): to_unicode(held[key]) for key in sorted(held, key=int)}
