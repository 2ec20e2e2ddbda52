"""How fields of results and edits are stored: each is declared once, at its record.

The records are in `result.py`, the declaration and the form of single fields here.
"""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import read_array
from cageik_cli.formats.settings import Scene
from cageik_cli.method.solve.metrics import (
    AREA_COLUMNS,
    KEPT_TYPES,
    MAX_LENGTH,
    METRIC_TYPES,
    FrameMetrics,
    KeptMetrics,
    are_lengths,
    find_impossible_kept,
    find_invalid_metric,
)
from cageik_cli.method.solve.regions import MAX_CAGE_FACES, MAX_REGIONS, Region
from cageik_cli.store.hdf5_fields import parse_record, read_floats, read_json_attr, to_json
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, join_truncated
from cageik_cli.util.messages import Row, Said, map_words, pack_parts, unpack_parts
from cageik_cli.util.text import group_digits, to_unicode


@dataclass(frozen=True, slots=True)
class ClipSizes:
    """How many frames, vertices and cage faces a clip has, and which frames were skipped."""

    frames: int
    vertices: int
    cage_faces: int
    skipped: dict[int, Said]


def write_json(file: h5py.File, name: str, value: Any) -> None:
    """Write an attribute; none for None, which stands for a field that a result does not have."""
    if value is not None:
        file.attrs[name] = to_json(value)


@dataclass(frozen=True, slots=True)
class StoredField:
    """How a field of a result or an edit is read, checked, written, shown and exported.

    Attributes
    ----------
    read : callable
        Returns the value in a file, which is checked against the sizes of the clip.
    write : callable
        Writes the value to a file, by its name.
    columns : mapping of str to str, optional
        Names and types of the fields of its value that have a number per frame. They are written
        with the frames.
    show : callable, optional
        Returns the lines on the record that `info` shows of it.
    export : str, optional
        Its name in the JSON of a report, for a field that is there as it is.
    """

    read: Callable[[h5py.File, ClipSizes], Any]
    write: Callable[[h5py.File, str, Any], None] = write_json
    columns: Mapping[str, str] | None = None
    show: Callable[[Any], list[Row]] | None = None
    export: str | None = None

    @property
    def is_json(self) -> bool:
        """Whether it is an attribute of JSON."""
        return self.columns is None and self.write in (write_json, write_list, write_skipped)


def declare_field(
    read: Callable[[h5py.File, ClipSizes], Any], *, default: Any = MISSING, **options: Any
) -> Any:
    """Declare how a field of a record is stored, with the options of `StoredField`."""
    return field(default=default, metadata={"stored": StoredField(read, **options)})


def list_fields(kind: type) -> dict[str, StoredField]:
    """Return how the fields of a record of this kind are stored, by name."""
    return {one.name: one.metadata["stored"] for one in fields(kind) if "stored" in one.metadata}


def list_field_rows(record: Any) -> list[Row]:
    """Return the lines on a result or an edit, field by field."""
    shown = [one.show for one in list_fields(type(record)).values() if one.show is not None]
    return [row for show in shown for row in show(record)]


def export_fields(record: Any) -> dict[str, Any]:
    """Return the fields that the JSON of a report has as they are, by their names there."""
    declared = list_fields(type(record))
    return {one.export: getattr(record, name) for name, one in declared.items() if one.export}


def write_plain(file: h5py.File, name: str, value: str | bool) -> None:
    """Write an attribute of plain text, or a truth value."""
    file.attrs[name] = value


def write_names(file: h5py.File, _: str, frames: tuple[str, ...]) -> None:
    """Write the sources of frames."""
    file.create_dataset("frames/name", data=frames, dtype=h5py.string_dtype())


def write_scene(file: h5py.File, _: str, scene: Scene) -> None:
    """Write the attributes that describe the scene."""
    file.attrs.update(asdict(scene))


def show_scene(clip: Any) -> list[Row]:
    """Describe the time and the space of a clip."""
    scene = clip.scene
    steps = "" if scene.frame_step == 1 else f" in steps of {scene.frame_step:.10g}"
    text = (
        f"{scene.fps:g} frames per second from frame {scene.start:.10g}{steps}, "
        f"{scene.up_axis} up, {scene.metres_per_unit:g} m per unit"
    )
    return [("scene", text)]


def show_skipped(clip: Any) -> list[Row]:
    """Name the frames that were skipped."""
    if not clip.skipped:
        return []
    names = join_truncated(clip.frames[k] for k in clip.skipped)
    return [("skipped", f"{names}; cageik report says why")]


def write_vertex_rms(file: h5py.File, name: str, values: Floats) -> None:
    """Write the rms of each vertex."""
    file.create_dataset(f"metrics/{name}", data=values, dtype="f8")


def read_vertex_rms(file: h5py.File, sizes: ClipSizes) -> Floats:
    """Read the rms of each vertex; nan where it is missing data."""
    values = read_floats(file, "metrics/vertex_rms", (sizes.vertices,))
    is_missing = np.isnan(values)
    if is_missing.all() or not (is_missing | are_lengths(values)).all():
        raise FormatError("`metrics/vertex_rms` is not a length everywhere; extract it again")
    return values


def read_regions(file: h5py.File, sizes: ClipSizes) -> tuple[Region, ...] | None:
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


def _check_names(region: Region, sizes: ClipSizes) -> None:
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
            f"has a region of {group_digits(region.vertices)} vertices, expected 1 to "
            f"{sizes.vertices}"
        )
    if not 0 < len(region.cage_faces) <= MAX_CAGE_FACES:
        raise _make_region_error(
            f"has a region near {len(region.cage_faces)} cage faces, expected 1 to {MAX_CAGE_FACES}"
        )


def _make_region_error(fault: str) -> FormatError:
    return FormatError(f"attribute `regions` {fault}; extract it again")


def write_list(file: h5py.File, name: str, values: tuple[Any, ...]) -> None:
    """Write a list that is left out where it is empty."""
    write_json(file, name, values or None)


def read_filled(file: h5py.File, sizes: ClipSizes) -> tuple[int, ...]:
    """Read which skipped frames were filled."""
    held = read_json_attr(file, "filled", list) if "filled" in file.attrs else []
    if not all(type(k) is int and k in sizes.skipped for k in held):
        raise FormatError("attribute `filled` names frames that are not skipped; extract it again")
    return tuple(held)


def pack_reasons(skipped: Mapping[int, Said]) -> dict[str, Any]:
    """Return why frames were skipped as plain values: texts, or their parts if they have hints."""
    packed = {str(k): pack_parts(one) for k, one in skipped.items()}
    return {
        number: "".join(parts) if all(isinstance(part, str) for part in parts) else parts
        for number, parts in packed.items()
    }


def unpack_reasons(packed: Mapping[str, Any]) -> dict[int, Said]:
    """Return why frames were skipped, by number; raises ValueError for other values."""
    reasons: dict[int, Said] = {}
    for key in sorted(packed, key=int):
        one = packed[key]
        if not isinstance(one, str | list):
            raise ValueError(f"no reason for frame {key}")
        text = one if isinstance(one, str) else unpack_parts(one)
        reasons[int(key)] = map_words(to_unicode, text)
    return reasons


def write_skipped(file: h5py.File, name: str, skipped: dict[int, Said]) -> None:
    """Write why frames were skipped."""
    write_json(file, name, pack_reasons(skipped))


def read_skipped(file: h5py.File, frames: int) -> dict[int, Said]:
    """Read why frames were skipped, by number; first of all, as other fields depend on it."""
    held = read_json_attr(file, "skipped", dict)
    try:
        if not all(key.isdecimal() and int(key) < frames for key in held):
            raise ValueError("no number of a frame")
        reasons = unpack_reasons(held)
    except ValueError as error:
        raise FormatError(
            "attribute `skipped` does not say which frames are skipped and why; extract it again"
        ) from error
    if len(held) == frames:
        raise FormatError("every frame is skipped; extract it again")
    return reasons


def _read_columns(file: h5py.File, frames: int, types: Mapping[str, str]) -> dict[str, Any]:
    columns = {}
    with np.errstate(over="ignore", invalid="ignore"):  # values that do not fit are found later
        for name, kind in types.items():
            letters = "iu" if kind == "i8" else "f"
            found = read_array(file, f"metrics/{name}", letters, (frames,))
            columns[name] = found if kind == "i8" else found.astype(np.float64)
    return columns


def read_frame_metrics(file: h5py.File, sizes: ClipSizes) -> FrameMetrics:
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


def read_kept_metrics(file: h5py.File, sizes: ClipSizes) -> KeptMetrics | None:
    """Read the metrics over what was kept, if the result has them."""
    if not any(f"metrics/{name}" in file for name in KEPT_TYPES):
        return None
    unknown = [name for name in AREA_COLUMNS if f"metrics/{name}" not in file]  # in older results
    held = {name: kind for name, kind in KEPT_TYPES.items() if name not in unknown}
    columns = _read_columns(file, sizes.frames, held)
    columns |= {name: np.full(sizes.frames, np.nan) for name in unknown}
    kept = KeptMetrics(**columns)
    name = find_impossible_kept(kept, sizes.vertices, list(sizes.skipped))
    if name is not None:
        raise FormatError(f"holds `metrics/{name}` that is impossible; extract it again")
    return kept
