"""Result files, read with every check: the result, and what its frames are rebuilt from.

One table, `RESULT_FIELDS`, says how each field is written to the file, read and checked.
"""

import glob
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli.fit.settings import FitRecord
from cageik_cli.formats.base.hdf5 import (
    get_dataset,
    open_checked,
    read_array,
    read_attribute,
    read_texts,
)
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.dual_laplacian import SolveQuality
from cageik_cli.method.solve.metrics import (
    KEPT_TYPES,
    MAX_LENGTH,
    METRIC_TYPES,
    FrameMetrics,
    KeptMetrics,
    are_lengths,
    find_invalid_metric,
)
from cageik_cli.method.solve.regions import MAX_CAGE_FACES, MAX_REGIONS, Region
from cageik_cli.method.solve.vertex_bound import VertexBound
from cageik_cli.method.weights.binding import Binding, Correction, reconstruct_frames
from cageik_cli.store import fit_fields
from cageik_cli.store.fit_fields import BaselineErrors, read_fit_record, read_offset_mark
from cageik_cli.store.hdf5_fields import (
    check_format,
    has_format,
    parse_record,
    read_floats,
    read_json_attr,
    read_meshes,
    read_notes,
    read_optional_record,
    read_record,
    read_scene,
    read_sources,
    read_text_attr,
    read_version,
    to_json,
)
from cageik_cli.util.arrays import Floats, Integers, fill_gaps
from cageik_cli.util.errors import CheckpointError, FileAccessError, FormatError, SettingError
from cageik_cli.util.text import to_unicode

RESULT_FORMAT, RESULT_SCHEMA = "cageik.result", 1
"""What a result file says that it is; raise the number when older versions cannot read it."""

CHECKPOINT_SUFFIX = ".partial"


MIN_KEY_FRAMES, MAX_KEY_FRAMES = 3, 4
"""Frames that are kept in full: the worst, the median, the best, and that of the worst region."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ResultHeader:
    """What is known of a result before its first frame is solved.

    Attributes
    ----------
    settings : dict
        The settings of the run.
    notes : tuple of str
        What was changed or left out, one sentence each.
    edited_from : str, optional
        The name of the result that was edited: metrics then compare the mesh before the edit, v,
        with the edited one, v̂. None for a result that was extracted.
    """

    scene: Scene
    settings: dict[str, Any]
    notes: tuple[str, ...]
    quality: SolveQuality
    edited_from: str | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class ResultSummary:
    """What is known of a result after its last frame is solved.

    Attributes
    ----------
    vertex_rms : (m,) float64
        sqrt(mean |v̂ − v|²) of each vertex over the frames that were not skipped; nan for vertices
        that are missing data.
    regions : tuple of Region, optional
        The worst regions, the worst first; none if the largest deviation is within the usual. None
        if the result was edited, or written by a version that did not look for them.
    bound : VertexBound, optional
        The error of the best possible cage animation of the clip.
    filled : tuple of int
        Skipped frames whose cages were filled from those around them.
    sources : dict
        Name and digest of each file that was read.
    skipped : dict
        By number in the clip, why a frame was skipped.
    """

    vertex_rms: Floats
    regions: tuple[Region, ...] | None = None
    bound: VertexBound | None = None
    filled: tuple[int, ...] = ()
    sources: dict[str, Any]
    skipped: dict[int, str]


@dataclass(frozen=True, eq=False, kw_only=True)
class Result(ResultHeader, ResultSummary):
    """The content of a result file, without the cages and the weights.

    Attributes
    ----------
    version : str
        Of the program that wrote it.
    frames : tuple of str
        The source of each of the F frames.
    rest, cage : TriMesh
        The rest pose, m vertices, and its cage, n vertices.
    metrics : FrameMetrics
        nan for a frame that was skipped, and a worst vertex of -1.
    kept : KeptMetrics, optional
        Metrics over the vertices that were kept; None if all counted alike in all frames.
    fit : FitRecord, optional
        How the weights were fitted to clips, and how well they fit.
    has_offsets : bool
        As of `Binding`.
    scene, settings, notes, quality, edited_from
        As of `ResultHeader`.
    vertex_rms, regions, bound, filled, sources, skipped
        As of `ResultSummary`.

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
    frames: tuple[str, ...]
    rest: TriMesh
    cage: TriMesh
    metrics: FrameMetrics
    kept: KeptMetrics | None = None
    fit: FitRecord | None = None
    has_offsets: bool = False

    @property
    def gaps(self) -> list[int]:
        """Return the skipped frames that have no cage."""
        return sorted(set(self.skipped) - set(self.filled))

    def __repr__(self) -> str:
        return (
            f"<Result: {self.path.name}, {len(self.frames)} frames of {len(self.rest.vertices)} "
            f"vertices in a cage of {len(self.cage.vertices)}>"
        )


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrames:
    """The worst, the median and the best frame: reconstructions and their errors.

    A fourth is that of the worst region, if it is not among them.

    Attributes
    ----------
    indices : (k,) int64
        Their numbers in the clip.
    cages : (k, n, 3) float64
    reconstructed : (k, m, 3) float64
        v̂, the weights times the cages, and the turned offsets if there are any.
    errors : (k, m, 3) float64
        v − v̂, in diagonals of the rest model; nan for vertices that are missing in a frame.
    """

    indices: Integers
    cages: Floats
    reconstructed: Floats
    errors: Floats


def checkpoint_path(path: Path) -> Path:
    """Return the path of the checkpoint of the run that writes the result at `path`."""
    return path.with_name(path.name + CHECKPOINT_SUFFIX)


def placed_path(path: Path) -> Path:
    """Return the path of the frames whose occluded vertices are placed, until `path` is written."""
    return path.with_name(path.name + ".placed" + CHECKPOINT_SUFFIX)


def smoothed_path(path: Path) -> Path:
    """Return the path of the frames that are smoothed, until the result at `path` is written."""
    return path.with_name(path.name + ".smooth" + CHECKPOINT_SUFFIX)


def read_cages(result: Result, size: int, first: int = 0) -> Iterator[Floats]:
    """Yield the cages from frame `first` on, in blocks of at most `size`, (k, n, 3), gaps filled.

    The cage of a skipped frame is interpolated linearly between the frames before and after; at
    either end of the clip it is that of the nearest frame.
    """
    known = np.setdiff1d(np.arange(len(result.frames)), result.gaps)
    with open_checked(result.path) as file:
        cages = get_dataset(file, "verts", "f", (len(result.frames), len(result.cage.vertices), 3))
        for start in range(first, len(cages), size):
            block = np.asarray(cages[start : start + size], np.float64)
            fill_gaps(block, start, known, cages.__getitem__)
            wrong = np.flatnonzero(~np.isfinite(block).all(axis=(1, 2)))
            if len(wrong):
                name = result.frames[start + wrong[0]]
                raise FormatError(f"the cage of {name} is not finite")
            yield block


def has_weights(result: Result) -> bool:
    """Return whether a result was written with its weights."""
    with open_checked(result.path) as file:
        return fit_fields.holds_weights(file)


def read_weights(result: Result) -> Floats | None:
    """Read the weights of a result, (m, n); None if it was written without."""
    shape = (len(result.rest.vertices), len(result.cage.vertices))
    with open_checked(result.path) as file:
        return fit_fields.read_weights(file, *shape) if fit_fields.holds_weights(file) else None


def is_result(path: Path) -> bool:
    """Return whether an HDF5 file says that it is a result of cageik."""
    with open_checked(path) as file:
        return has_format(file, RESULT_FORMAT)


def read_result(path: Path) -> Result:
    """Read and check a result file.

    Raises
    ------
    InputError
        When it is not HDF5, not a result, of another schema, not complete, or damaged.
    """
    if not path.exists():
        raise FileAccessError(f"{path}: no such file; {_suggest_instead(path)}")
    if path.suffix == CHECKPOINT_SUFFIX:
        raise CheckpointError(
            f"{path}: is a checkpoint, not a result; rerun the command with `resume=True`"
        )
    if path.is_dir() or (path.is_file() and not h5py.is_hdf5(path)):
        found = "a folder" if path.is_dir() else "not an HDF5 file"
        raise FormatError(
            f"{path}: is {found}, expected the result of cageik extract, such as cages.h5; extract "
            "one from frames, or look at the file by cageik info"
        )
    with open_checked(path) as file:
        _check_result_format(file)
        rest, cage = read_meshes(file)
        frames = len(get_dataset(file, "verts", "f", (None, len(cage.vertices), 3)))
        skipped = read_skipped(file, frames)
        sizes = ResultSizes(frames, len(rest.vertices), len(cage.faces), skipped)
        return Result(
            path=path,
            version=read_version(file),
            frames=read_texts(file, "frames/name", frames),
            rest=rest,
            cage=cage,
            metrics=read_frame_metrics(file, sizes),
            kept=read_kept_metrics(file, sizes),
            fit=read_fit_record(file),
            has_offsets=read_offset_mark(file),
            **read_fields(file, sizes),
        )


def _check_result_format(file: h5py.File) -> None:
    check_format(file, RESULT_FORMAT, RESULT_SCHEMA, "a result of cageik extract")
    complete = read_attribute(file, "complete")
    if not (isinstance(complete, np.bool_) and complete):
        raise FormatError(
            "is not complete: the run that wrote it was interrupted; extract it again"
        )


def _suggest_instead(path: Path) -> str:
    checkpoint_file = checkpoint_path(path)
    if checkpoint_file.exists():
        return (
            f"there is a checkpoint, {checkpoint_file.name}; rerun the command with `resume=True`"
        )
    if glob.has_magic(str(path)):
        return "it is a pattern; name the files, or write it without quotes"
    return "create it with cageik extract, or give another"


def read_low_rank(result: Result) -> Correction | None:
    """Read what a fit of low rank added to the computed weights; None if there is no such fit."""
    shape = len(result.rest.vertices), len(result.cage.vertices)
    with open_checked(result.path) as file:
        return fit_fields.read_low_rank(file, result.fit, *shape)


def read_baseline_errors(result: Result) -> BaselineErrors | None:
    """Read what a result keeps of the weights before the fit; None if it keeps nothing."""
    shape = len(result.rest.vertices), len(result.cage.vertices)
    with open_checked(result.path) as file:
        return fit_fields.read_baseline_errors(file, shape, len(result.frames), result.skipped)


def read_binding(result: Result) -> Binding | None:
    """Read the binding of a result; None if it was written without weights.

    Its settings are not read.
    """
    weights = read_weights(result)
    if weights is None:
        return None
    read_low_rank(result)  # refuses weights of another form than their fit has
    return Binding(result.rest, result.cage, weights, has_offsets=result.has_offsets)


def load_binding(result: Result, user: str) -> Binding:
    """Read the binding of a result, which `user` needs.

    Raises
    ------
    SettingError
        When the result was written without weights.
    """
    binding = read_binding(result)
    if binding is None:
        raise make_weights_error(result.path, user)
    return binding


def make_weights_error(path: Path, user: str) -> SettingError:
    """Make the error of a result that was written without weights; `user` is what needs them."""
    return SettingError(
        f"{path}: has no weights, which {user} needs; extract it again with them "
        "(`keep_weights=True`)"
    )


def read_rotations(result: Result) -> Floats:
    """Read the rotations from the rest pose to each frame, (F, 3, 3); `points @ R` turns points.

    A skipped frame that was not filled has that of the nearest frame.
    """
    count = len(result.frames)
    known = np.setdiff1d(np.arange(count), result.gaps)
    with open_checked(result.path) as file:
        rotations = read_floats(file, "rotations", (count, 3, 3))
        with np.errstate(over="ignore", invalid="ignore"):
            products = rotations @ rotations.swapaxes(1, 2)
            wrong = ~(np.abs(products - np.eye(3)) < 1e-9).all(axis=(1, 2))  # RRᵀ is not I
            wrong |= ~(np.linalg.det(np.where(np.isfinite(rotations), rotations, 0)) > 0)
        wrong[result.gaps] = False
        if wrong.any():
            name = result.frames[int(np.argmax(wrong))]
            raise FormatError(f"`rotations` of {name} are not a rotation; extract it again")
    nearest = known[np.abs(known[None] - np.arange(count)[:, None]).argmin(axis=1)]
    return np.asarray(rotations[nearest])


def read_key_frames(result: Result, binding: Binding) -> KeyFrames:
    """Read the frames that are kept in full in a result with weights."""
    m, n, count = *binding.weights.shape, len(result.frames)
    rotations = read_rotations(result) if binding.has_offsets else None
    with open_checked(result.path) as file:
        frames = read_array(file, "poses/frame", "iu", (None,)).astype(np.int64)
        if not MIN_KEY_FRAMES <= len(frames) <= MAX_KEY_FRAMES:
            raise FormatError(
                f"`poses/frame` names {len(frames)} frames, expected {MIN_KEY_FRAMES} or "
                f"{MAX_KEY_FRAMES}; extract it again"
            )
        misses = read_floats(file, "poses/misses", (len(frames), m, 3))
        if not ((frames >= 0) & (frames < count)).all():
            raise FormatError(
                f"`poses/frame` names frames that are not in the clip ({count} frames); extract it "
                "again"
            )
        cages = get_dataset(file, "verts", "f", (count, n, 3))
        posed = np.stack([np.asarray(cages[k], np.float64) for k in frames])
        is_missing = np.isnan(misses) if result.kept is not None else np.zeros(misses.shape, bool)
        if not (
            are_lengths(np.abs(posed)).all() and (are_lengths(np.abs(misses)) | is_missing).all()
        ):
            raise FormatError("`poses` are not finite, or too large; extract it again")
    turns = None if rotations is None else rotations[frames]
    return KeyFrames(frames, posed, reconstruct_frames(binding, posed, turns), misses)


@dataclass(frozen=True, slots=True)
class ResultSizes:
    """How many frames, vertices and cage faces a result has, and which frames were skipped."""

    frames: int
    vertices: int
    cage_faces: int
    skipped: dict[int, str]


def _write_json(file: h5py.File, name: str, value: Any) -> None:
    """Write an attribute; none for None, which stands for a part that a result does not have."""
    if value is not None:
        file.attrs[name] = to_json(value)


@dataclass(frozen=True, slots=True)
class ResultField:
    """How a field of a result is read and written.

    Attributes
    ----------
    read : callable
        Returns the value in a file, which is checked against the sizes of the result.
    write : callable
        Writes the value to a file, by its name; an attribute of JSON by default.
    """

    read: Callable[[h5py.File, ResultSizes], Any]
    write: Callable[[h5py.File, str, Any], None] = _write_json


def write_fields(file: h5py.File, part: ResultHeader | ResultSummary) -> None:
    """Write one part of a result, field by field, in the order of its record."""
    for field in fields(part):
        RESULT_FIELDS[field.name].write(file, field.name, getattr(part, field.name))


def read_fields(file: h5py.File, sizes: ResultSizes) -> dict[str, Any]:
    """Read both parts of a result."""
    return {name: field.read(file, sizes) for name, field in RESULT_FIELDS.items()}


def _write_text(file: h5py.File, name: str, text: str | None) -> None:
    if text is not None:
        file.attrs[name] = text


def _write_vertex_rms(file: h5py.File, name: str, values: Floats) -> None:
    file.create_dataset(f"metrics/{name}", data=values, dtype="f8")


def _read_vertex_rms(file: h5py.File, sizes: ResultSizes) -> Floats:
    values = read_floats(file, "metrics/vertex_rms", (sizes.vertices,))
    is_missing = np.isnan(values)
    if is_missing.all() or not (is_missing | are_lengths(values)).all():
        raise FormatError("`metrics/vertex_rms` is not a length everywhere; extract it again")
    return values


def _read_regions(file: h5py.File, sizes: ResultSizes) -> tuple[Region, ...] | None:
    """Read the worst regions; None if the result was written without them."""
    if "regions" not in file.attrs:
        return None
    held = read_json_attr(file, "regions", list)
    try:
        regions: tuple[Region, ...] = parse_record(tuple[Region, ...], held, "regions")
    except FormatError as error:
        raise _make_region_error(f"does not describe regions ({error})") from error
    if len(regions) > MAX_REGIONS:
        raise _make_region_error(f"has {len(regions)} regions, expected at most {MAX_REGIONS}")
    for region in regions:
        _check_names(region, sizes)
        lengths = (region.size, region.max_deviation)
        if not all(0 <= length <= MAX_LENGTH for length in lengths):
            raise _make_region_error(
                f"has sizes or deviations that are no lengths (found {lengths})"
            )
        if not all(abs(place) <= MAX_LENGTH for place in region.centre):
            raise _make_region_error("has a centre that is too far away")
    return regions


def _check_names(region: Region, sizes: ResultSizes) -> None:
    """Refuse a region that names what the result does not have."""
    numbers = [
        ("frames", sizes.frames, (region.frame,)),
        ("vertices", sizes.vertices, (region.worst_vertex,)),
        ("cage faces", sizes.cage_faces, region.cage_faces),
    ]
    for noun, count, found in numbers:
        if not all(0 <= number < count for number in found):
            raise _make_region_error(f"names {noun} that are not there (found {found}, of {count})")
    if not 1 <= region.vertices <= sizes.vertices:
        raise _make_region_error(
            f"has a region of {region.vertices} vertices, expected 1 to {sizes.vertices}"
        )
    if not 0 < len(region.cage_faces) <= MAX_CAGE_FACES:
        raise _make_region_error(
            f"has a region near {len(region.cage_faces)} cage faces, expected 1 to {MAX_CAGE_FACES}"
        )


def _make_region_error(fault: str) -> FormatError:
    return FormatError(f"attribute `regions` {fault}; extract it again")


def _write_filled(file: h5py.File, name: str, filled: tuple[int, ...]) -> None:
    _write_json(file, name, filled or None)


def _read_filled(file: h5py.File, sizes: ResultSizes) -> tuple[int, ...]:
    held = read_json_attr(file, "filled", list) if "filled" in file.attrs else []
    if not all(type(k) is int and k in sizes.skipped for k in held):
        raise FormatError("attribute `filled` names frames that are not skipped; extract it again")
    return tuple(held)


def _write_skipped(file: h5py.File, name: str, skipped: dict[int, str]) -> None:
    _write_json(file, name, {str(k): text for k, text in skipped.items()})


def read_skipped(file: h5py.File, frames: int) -> dict[int, str]:
    """Read why frames were skipped, by number; first of all, as other fields depend on it."""
    held = read_json_attr(file, "skipped", dict)
    numbers_only = all(key.isdecimal() and int(key) < frames for key in held)
    if not numbers_only or not all(isinstance(text, str) for text in held.values()):
        raise FormatError(
            "attribute `skipped` does not say which frames are skipped and why; extract it again"
        )
    if len(held) == frames:
        raise FormatError("every frame is skipped; extract it again")
    return {int(key): to_unicode(held[key]) for key in sorted(held, key=int)}


RESULT_FIELDS = {
    "scene": ResultField(
        lambda file, _: read_scene(file), lambda file, _, scene: file.attrs.update(asdict(scene))
    ),
    "settings": ResultField(lambda file, _: read_json_attr(file, "settings", dict)),
    "notes": ResultField(lambda file, _: read_notes(file)),
    "quality": ResultField(lambda file, _: read_record(file, "quality", SolveQuality)),
    "edited_from": ResultField(lambda file, _: read_text_attr(file, "edited_from"), _write_text),
    "vertex_rms": ResultField(_read_vertex_rms, _write_vertex_rms),
    "regions": ResultField(_read_regions),
    "bound": ResultField(lambda file, _: read_optional_record(file, "bound", VertexBound)),
    "filled": ResultField(_read_filled, _write_filled),
    "sources": ResultField(lambda file, _: read_sources(file)),
    "skipped": ResultField(lambda _, sizes: sizes.skipped, _write_skipped),
}
"""How each field of `ResultHeader` and of `ResultSummary` is read and written."""


def create_columns(file: h5py.File, frames: int, types: Mapping[str, str]) -> None:
    """Create the columns of metrics, (F,) each."""
    for name, kind in types.items():
        file.create_dataset(f"metrics/{name}", (frames,), kind)


def write_columns(
    file: h5py.File, rows: slice, metrics: FrameMetrics | KeptMetrics, types: Mapping[str, str]
) -> None:
    """Write the metrics of some frames into their columns."""
    for name in types:
        file[f"metrics/{name}"][rows] = getattr(metrics, name)


def _read_columns(file: h5py.File, frames: int, types: Mapping[str, str]) -> dict[str, Any]:
    columns = {}
    with np.errstate(over="ignore", invalid="ignore"):  # values that do not fit are found later
        for name, kind in types.items():
            letters = "iu" if kind == "i8" else "f"
            found = read_array(file, f"metrics/{name}", letters, (frames,))
            columns[name] = found if kind == "i8" else found.astype(np.float64)
    return columns


def read_frame_metrics(file: h5py.File, sizes: ResultSizes) -> FrameMetrics:
    """Read the metrics of all frames; skipped ones have none."""
    columns, skipped = _read_columns(file, sizes.frames, METRIC_TYPES), list(sizes.skipped)
    figures = FrameMetrics(**columns)
    held = FrameMetrics(**{name: np.delete(column, skipped) for name, column in columns.items()})
    fault = find_invalid_metric(held)
    if fault is not None:
        raise FormatError(f"holds {fault}; extract it again")
    if not np.isnan(figures.rms[skipped]).all():
        raise FormatError("`metrics/rms` has values for skipped frames; extract it again")
    if not ((held.worst_vertex >= 0) & (held.worst_vertex < sizes.vertices)).all():
        raise FormatError(
            f"`metrics/worst_vertex` names vertices that the model does not have ({sizes.vertices} "
            "vertices); extract it again"
        )
    return figures


def read_kept_metrics(file: h5py.File, sizes: ResultSizes) -> KeptMetrics | None:
    """Read the metrics over what was kept, if the result has them."""
    if not any(f"metrics/{name}" in file for name in KEPT_TYPES):
        return None
    columns = _read_columns(file, sizes.frames, KEPT_TYPES)
    for name, column in columns.items():
        held, is_count = np.delete(column, list(sizes.skipped)), KEPT_TYPES[name] == "i8"
        fits = (held >= 0) & (held <= sizes.vertices) if is_count else are_lengths(held)
        if not fits.all():
            raise FormatError(f"holds `metrics/{name}` that is impossible; extract it again")
    return KeptMetrics(**columns)
