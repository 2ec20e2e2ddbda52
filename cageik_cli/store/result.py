"""Read result files, with every check."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import (
    get_dataset,
    open_checked,
    read_array,
    read_attribute,
    read_texts,
)
from cageik_cli.formats.base.sequence import GapFiller
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.solver.dual_laplacian import SolveQuality
from cageik_cli.solver.fitting.record import FitRecord
from cageik_cli.solver.metrics import (
    INTEGER_METRICS,
    KEPT_COUNTS,
    KEPT_NAMES,
    METRIC_NAMES,
    FrameMetrics,
    KeptMetrics,
    are_lengths,
    find_invalid_metric,
)
from cageik_cli.solver.regions import Region
from cageik_cli.solver.summary import VertexBound
from cageik_cli.store import fit_fields
from cageik_cli.store.fit_fields import read_fit_record, read_offset_mark
from cageik_cli.store.hdf5_fields import (
    check_format,
    has_format,
    read_json_attr,
    read_meshes,
    read_notes,
    read_quality,
    read_scene,
    read_sources,
    read_text_attr,
    read_version,
)
from cageik_cli.store.json_records import parse_record
from cageik_cli.store.regions import read_regions
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import CheckpointError, FileAccessError, FormatError, error_context
from cageik_cli.util.text import to_unicode

FORMAT = "cageik.result"
SCHEMA = 1
CHECKPOINT_SUFFIX = ".partial"


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """The content of a result file, without the cages and the weights.

    Attributes
    ----------
    version : str
        Of the program that wrote it.
    settings, sources : dict
        The settings of the run; name and digest of each file that was read.
    notes : tuple of str
        What was changed or left out, one sentence each.
    frames : tuple of str
        The source of each of the F frames.
    rest, cage : TriMesh
        The rest pose, m vertices, and its cage, n vertices.
    metrics : FrameMetrics
        nan for a frame that was skipped, and a worst vertex of -1.
    vertex_rms : (m,) float64
        sqrt(mean |v̂ − v|²) of each vertex over the frames that were not skipped; nan for vertices
        that are missing data.
    skipped : dict
        By number in the clip, why a frame was skipped.
    fit : FitRecord, optional
        How the weights were fitted to clips, and how well they fit.
    has_offsets : bool
        As of `Binding`.
    bound : VertexBound, optional
        The error of the best possible cage animation of the clip.
    edited_from : str, optional
        The name of the result that was edited: metrics then compare the mesh before the edit, v,
        with the edited one, v̂. None for a result that was extracted.
    regions : tuple of Region, optional
        The worst regions, the worst first; none if the largest deviation is within the usual. None
        if the result was edited, or written by a version that did not look for them.
    kept : KeptMetrics, optional
        Metrics over the vertices that were kept; None if all counted alike in all frames.
    filled : tuple of int
        Skipped frames whose cages were filled from those around them.

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
    regions: tuple[Region, ...] | None = None
    fit: FitRecord | None = None
    has_offsets: bool = False
    bound: VertexBound | None = None
    kept: KeptMetrics | None = None
    filled: tuple[int, ...] = ()

    @property
    def gaps(self) -> list[int]:
        """Return the skipped frames that have no cage."""
        return sorted(set(self.skipped) - set(self.filled))

    def __repr__(self) -> str:
        return (
            f"<Result: {self.path.name}, {len(self.frames)} frames of {len(self.rest.vertices)} "
            f"vertices in a cage of {len(self.cage.vertices)}>"
        )


def checkpoint_path(path: Path) -> Path:
    """Return the path of the checkpoint of the run that writes the result at `path`."""
    return path.with_name(path.name + CHECKPOINT_SUFFIX)


def smoothed_path(path: Path) -> Path:
    """Return the path of the frames that are smoothed, until the result at `path` is written."""
    return path.with_name(path.name + ".smooth" + CHECKPOINT_SUFFIX)


def read_cages(result: Result, size: int, first: int = 0) -> Iterator[Floats]:
    """Yield the cages from frame `first` on, in blocks of at most `size`, (k, n, 3), gaps filled.

    The cage of a skipped frame is interpolated linearly between the frames before and after; at
    either end of the clip it is that of the nearest frame.

    Raises
    ------
    InputError
        When a block cannot be read, or is not finite.
    """
    filler = GapFiller(len(result.frames), result.gaps)
    with open_checked(result.path) as file:
        cages = get_dataset(file, "verts", "f", (len(result.frames), len(result.cage.vertices), 3))
        for start in range(first, len(cages), size):
            block = np.asarray(cages[start : start + size], np.float64)
            filler.fill(block, start, cages.__getitem__)
            wrong = np.flatnonzero(~np.isfinite(block).all(axis=(1, 2)))
            if len(wrong):
                raise FormatError(f"the cage of frame {start + wrong[0]} is not finite")
            yield block


def has_weights(result: Result) -> bool:
    """Return whether a result was written with its weights."""
    with open_checked(result.path) as file:
        return fit_fields.holds_weights(file)


def read_weights(result: Result) -> Floats | None:
    """Read the weights of a result, (m, n); None if it was written without.

    Raises
    ------
    InputError
        When their shape does not fit the meshes, or they are not finite.
    """
    shape = (len(result.rest.vertices), len(result.cage.vertices))
    with open_checked(result.path) as file:
        return fit_fields.read_weights(file, *shape) if fit_fields.holds_weights(file) else None


def is_result(path: Path) -> bool:
    """Return whether an HDF5 file says that it is a result of cageik."""
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
        raise FileAccessError(f"{path}: no such result; {_suggest_instead(path)}")
    if path.suffix == CHECKPOINT_SUFFIX:
        raise CheckpointError(
            f"{path}: is a checkpoint, not a result; rerun the command with --resume"
        )
    with open_checked(path) as file:
        _check_result_format(file)
        rest, cage = read_meshes(file)
        frames = len(get_dataset(file, "verts", "f", (None, len(cage.vertices), 3)))
        skipped = _read_skipped(file, frames)
        return Result(
            path=path,
            version=read_version(file),
            scene=read_scene(file),
            settings=read_json_attr(file, "settings", dict),
            sources=read_sources(file),
            quality=read_quality(file, SolveQuality),
            notes=read_notes(file),
            frames=_read_frame_names(file, frames),
            rest=rest,
            cage=cage,
            metrics=_read_frame_metrics(file, frames, len(rest.vertices), list(skipped)),
            vertex_rms=_read_vertex_rms(file, len(rest.vertices)),
            skipped=skipped,
            edited_from=read_text_attr(file, "edited_from"),
            regions=read_regions(
                file,
                frames=frames,
                vertices=len(rest.vertices),
                cage_faces=len(cage.faces),
            ),
            fit=read_fit_record(file),
            has_offsets=read_offset_mark(file),
            bound=_read_bound(file),
            filled=_read_filled(file, skipped),
            kept=_read_kept_metrics(file, frames, len(rest.vertices), list(skipped)),
        )


def _check_result_format(file: h5py.File) -> None:
    check_format(file, FORMAT, SCHEMA, "a result of cageik extract")
    complete = read_attribute(file, "complete")
    if not (isinstance(complete, np.bool_) and complete):
        raise FormatError(
            "is not complete: the run that wrote it was interrupted; extract it again"
        )


def _read_frame_metrics(
    file: h5py.File, frames: int, vertices: int, skipped: list[int]
) -> FrameMetrics:
    """Read the metrics of all frames; skipped ones have none."""
    columns = {name: _read_column(file, name, frames) for name in METRIC_NAMES}
    figures = FrameMetrics(**columns)
    held = FrameMetrics(**{name: np.delete(column, skipped) for name, column in columns.items()})
    fault = find_invalid_metric(held)
    if fault is not None:
        raise FormatError(f"holds {fault}; extract it again")
    if not np.isnan(figures.rms[skipped]).all():
        raise FormatError("`metrics/rms` has values for skipped frames; extract it again")
    if not ((held.worst_vertex >= 0) & (held.worst_vertex < vertices)).all():
        raise FormatError(
            f"`metrics/worst_vertex` names vertices that the model does not have ({vertices} "
            "vertices); extract it again"
        )
    return figures


def _read_kept_metrics(
    file: h5py.File, frames: int, vertices: int, skipped: list[int]
) -> KeptMetrics | None:
    """Read the metrics over what was kept, if the result has them."""
    if f"metrics/{KEPT_NAMES[0]}" not in file:
        return None
    columns = {name: _read_column(file, name, frames) for name in KEPT_NAMES}
    for name, column in columns.items():
        held = np.delete(column, skipped)
        fits = (held >= 0) & (held <= vertices) if name in KEPT_COUNTS else are_lengths(held)
        if not fits.all():
            raise FormatError(f"holds `metrics/{name}` that is impossible; extract it again")
    return KeptMetrics(**columns)


def _read_filled(file: h5py.File, skipped: dict[int, str]) -> tuple[int, ...]:
    """Read which of the skipped frames were filled."""
    held = read_json_attr(file, "filled", list) if "filled" in file.attrs else []
    if not all(type(k) is int and k in skipped for k in held):
        raise FormatError("attribute `filled` names frames that are not skipped; extract it again")
    return tuple(held)


def _read_vertex_rms(file: h5py.File, vertices: int) -> Floats:
    """Read the rms of every vertex, (m,); nan for missing data."""
    values = read_array(file, "metrics/vertex_rms", "f", (vertices,)).astype(np.float64)
    is_missing = np.isnan(values)
    if is_missing.all() or not (is_missing | are_lengths(values)).all():
        raise FormatError("`metrics/vertex_rms` is not a length everywhere; extract it again")
    return values


def _read_column(file: h5py.File, name: str, frames: int) -> Any:
    if name in INTEGER_METRICS + KEPT_COUNTS:
        return read_array(file, f"metrics/{name}", "iu", (frames,))
    with np.errstate(over="ignore", invalid="ignore"):  # values that do not fit are found later
        return read_array(file, f"metrics/{name}", "f", (frames,)).astype(np.float64)


def _read_bound(file: h5py.File) -> VertexBound | None:
    if "bound" not in file.attrs:
        return None
    held = read_json_attr(file, "bound", dict)
    with error_context("attribute `bound`"):
        bound: VertexBound = parse_record(VertexBound, held, "bound")
    return bound


def _read_frame_names(file: h5py.File, count: int) -> tuple[str, ...]:
    return read_texts(file, "frames/name", count)


def _suggest_instead(path: Path) -> str:
    checkpoint_file = checkpoint_path(path)
    if checkpoint_file.exists():
        return f"there is a checkpoint, {checkpoint_file.name}; rerun the command with --resume"
    return "create it with cageik extract, or give another"


def _read_skipped(file: h5py.File, frames: int) -> dict[int, str]:
    held = read_json_attr(file, "skipped", dict)
    numbers_only = all(key.isdecimal() and int(key) < frames for key in held)
    if not numbers_only or not all(isinstance(text, str) for text in held.values()):
        raise FormatError(
            "attribute `skipped` does not say which frames are skipped and why; extract it again"
        )
    if len(held) == frames:
        raise FormatError("every frame is skipped; extract it again")
    return {int(key): to_unicode(held[key]) for key in sorted(held, key=int)}
