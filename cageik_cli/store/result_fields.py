"""The fields of a result, in one table: how each is written to its file, read and checked."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import (
    read_array,
)
from cageik_cli.formats.settings import Scene
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
from cageik_cli.method.solve.summary import VertexBound
from cageik_cli.store.hdf5_fields import (
    parse_record,
    read_floats,
    read_json_attr,
    read_notes,
    read_optional_record,
    read_record,
    read_scene,
    read_sources,
    read_text_attr,
    to_json,
)
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError
from cageik_cli.util.messages import Note
from cageik_cli.util.text import to_unicode


@dataclass(frozen=True, eq=False, kw_only=True)
class ResultHeader:
    """What is known of a result before its first frame is solved.

    Attributes
    ----------
    settings : dict
        The settings of the run.
    notes : tuple of Note
        What was changed or left out, one sentence each.
    edited_from : str, optional
        The name of the result that was edited: metrics then compare the mesh before the edit, v,
        with the edited one, v̂. None for a result that was extracted.
    """

    scene: Scene
    settings: dict[str, Any]
    notes: tuple[Note, ...]
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
