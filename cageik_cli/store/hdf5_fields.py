"""Parts that the HDF5 files of cageik share: attributes, meshes, compressed weights."""

import json
import zlib
from dataclasses import MISSING, asdict, fields, is_dataclass
from enum import StrEnum
from types import NoneType, UnionType
from typing import (
    Any,
    Literal,
    NotRequired,
    TypedDict,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import (
    has_text_attribute,
    read_array,
    read_attribute,
    read_surface,
    write_surface,
)
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import are_pairs, find_mirror
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, SettingError, error_context, join_truncated
from cageik_cli.util.json_files import format_value, parse_json
from cageik_cli.util.messages import Note
from cageik_cli.util.outputs import DeferredErrorFile
from cageik_cli.util.text import single_line, to_unicode
from cageik_cli.util.threads import OrderedMap, count_processors

MAX_STORED_CHUNK_BYTES = 1 << 18
"""Bytes of the rows of a matrix that are compressed together."""

Record = TypeVar("Record")


class SourceRecord(TypedDict):
    """A file, or a series of files, that was read.

    Attributes
    ----------
    name : str
        Of the file, or of the first and the last one; behind `::` what was read of it.
    sha256 : str
        The digest of what was read, hexadecimal; missing for a mesh that is a frame of the clip.
    files : int
        Number of files in a series.
    """

    name: str
    sha256: NotRequired[str]
    files: NotRequired[int]


def create_hdf5(sink: DeferredErrorFile) -> h5py.File:
    """Create an HDF5 file without times and addresses: the same input gives the same bytes."""
    return h5py.File(sink, "w", libver=("earliest", "v110"))


def has_format(file: h5py.File, format_name: str) -> bool:
    """Return whether the attribute `format` is `format_name`; it may hold anything."""
    return has_text_attribute(file, "format", format_name)


def check_format(file: h5py.File, format_name: str, schema: int, description: str) -> None:
    """Refuse a file that is not `description`, of this format and schema."""
    if not has_format(file, format_name):
        raise FormatError(f"is not {description}; give one")
    check_schema(file, schema)


def check_schema(file: h5py.File, schema: int) -> None:
    """Refuse a file of another schema."""
    found = read_attribute(file, "schema")
    if not (isinstance(found, np.integer) and found == schema):
        raise FormatError(f"has schema {found}, expected {schema}; write it again")


def write_meshes(file: h5py.File, rest: TriMesh, cage: TriMesh) -> None:
    """Write the rest pose and its cage, as results and bindings have them.

    Of a cage that is its own mirror image, the partner of each vertex is written, for others: this
    program finds pairs by the vertices, as those of cages in other files.
    """
    file["tris"] = cage.faces.astype(np.int32)
    file["cage/verts"], file["rest/verts"] = cage.vertices, rest.vertices
    file["rest/tris"] = rest.faces.astype(np.int32)
    write_surface(file, "attributes/cage", cage)
    write_surface(file, "attributes/rest", rest)
    mirror = find_mirror(cage.vertices)
    partners = None if mirror is None else mirror.find_pairs(cage.vertices)
    if partners is not None and are_pairs(cage.vertices, partners):  # as it is read
        file["cage/partners"] = partners.astype(np.int32)


def read_meshes(file: h5py.File) -> tuple[TriMesh, TriMesh]:
    """Read the rest pose and its cage.

    Raises
    ------
    InputError
        When they are missing or not meshes, the rest pose has no extent, or a vertex of the cage
        is in no face.
    """
    rest, cage = (
        TriMesh(
            read_array(file, vertices, "f", (None, 3)), read_array(file, faces, "iu", (None, 3))
        )
        for vertices, faces in (("rest/verts", "rest/tris"), ("cage/verts", "tris"))
    )
    if rest.diagonal == 0:
        raise FormatError("`rest/verts` are all one point; write it again")
    lone = cage.unused_vertices
    if len(lone):
        raise FormatError(f"cage vertex {lone[0]} is in no face of `tris`; write it again")
    if "cage/partners" in file:
        partners = read_array(file, "cage/partners", "iu", (len(cage.vertices),))
        if not are_pairs(cage.vertices, partners):
            raise FormatError(
                "`cage/partners` are not mirror images of the vertices of the cage; write it again"
            )
    rest = read_surface(file, "attributes/rest", rest)
    return rest, read_surface(file, "attributes/cage", cage)


def read_floats(file: h5py.File, name: str, shape: tuple[int | None, ...]) -> Floats:
    """Read a whole dataset of numbers, of any precision, as float64."""
    return read_array(file, name, "f", shape).astype(np.float64, copy=False)


def read_version(file: h5py.File) -> str:
    """Read the version of the program that wrote the file."""
    return to_unicode(str(read_attribute(file, "version", "unknown")))


def read_notes(file: h5py.File) -> tuple[Note, ...]:
    """Read what was changed or left out."""
    try:
        return tuple(map(Note.unpack, _clean(read_json_attr(file, "notes", list))))
    except ValueError as error:
        raise FormatError(f"attribute `notes` holds {error}; write it again") from error


def _clean(value: Any) -> Any:
    """Return lists and mappings of texts that are each on one line."""
    if isinstance(value, str):
        return single_line(value)
    if isinstance(value, dict):
        return {key: _clean(one) for key, one in value.items()}
    return [_clean(one) for one in value] if isinstance(value, list) else value


def to_json(value: Any) -> str:
    """Return plain values, records of them, and notes as the text of an attribute."""
    return json.dumps(value, sort_keys=True, allow_nan=False, default=_make_plain)


def _make_plain(value: Any) -> Any:
    return _clean(value.pack()) if isinstance(value, Note) else asdict(value)


def read_json_attr(file: h5py.File, name: str, expected_type: type) -> Any:
    """Read an attribute of JSON, within the limits of `parse_json`."""
    text = read_attribute(file, name)
    try:
        value = parse_json(text.encode() if isinstance(text, str) else b"")
        json.dumps(value, ensure_ascii=False).encode()  # fails for invalid Unicode
    except (FormatError, ValueError):
        value = None
    if not isinstance(value, expected_type):
        raise FormatError(
            f"attribute `{name}` is not a JSON {expected_type.__name__}; write it again"
        )
    return value


def read_sources(file: h5py.File) -> dict[str, SourceRecord]:
    """Read name and digest of each file that was read."""
    sources: dict[str, SourceRecord] = read_json_attr(file, "sources", dict)
    if not all(isinstance(source, dict) for source in sources.values()):
        raise FormatError("attribute `sources` does not name files; write it again")
    return sources


def read_text_attr(file: h5py.File, name: str) -> str:
    """Read an attribute of plain text."""
    text = read_attribute(file, name)
    if not isinstance(text, str):
        raise FormatError(f"attribute `{name}` is not text; write it again")
    return to_unicode(text)


def read_scene(file: h5py.File) -> Scene:
    """Read the attributes that describe the scene."""
    values = {field.name: read_attribute(file, field.name) for field in fields(Scene)}
    for name, value in values.items():
        if name == "up_axis" and isinstance(value, str):
            continue
        if not isinstance(value, np.floating | np.integer):
            raise FormatError(
                f"attribute `{name}` is {value!r}, expected a number; extract it again"
            )
        values[name] = float(value)
    return Scene(**values)


def write_deflated(file: h5py.File, name: str, matrix: Floats) -> None:
    """Write a float64 matrix with HDF5's own filters, shuffle and deflate, by chunks of rows.

    The digits of weights do not repeat: Huffman codes alone make the file as small as deflate's
    search for repetitions does, in under half the time. HDF5 has no option to omit that search, so
    chunks are compressed here.
    """
    if not matrix.size:
        file.create_dataset(name, data=matrix)
        return
    rows = max(1, min(len(matrix), MAX_STORED_CHUNK_BYTES // matrix[0].nbytes))
    chunks = (rows, matrix.shape[1])
    filters = {"shuffle": True, "compression": "gzip", "compression_opts": 1}
    dataset = file.create_dataset(name, matrix.shape, "f8", chunks=chunks, **filters)

    def compress_chunk(start: int) -> bytes:
        chunk = np.zeros(chunks)
        chunk[: len(matrix) - start] = matrix[start : start + rows]
        shuffled = chunk.view(np.uint8).reshape(-1, 8).T.tobytes()
        deflate = zlib.compressobj(1, strategy=zlib.Z_HUFFMAN_ONLY)
        return deflate.compress(shuffled) + deflate.flush()

    starts, jobs = range(0, len(matrix), rows), count_processors()
    with OrderedMap(compress_chunk, starts, jobs, 2 * jobs) as parts:
        for start, data in zip(starts, parts, strict=True):
            dataset.id.write_direct_chunk((start, 0), data)


_KIND_NAMES = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a string",
    NoneType: "null",
}


def parse_record(kind: Any, value: Any, name: str) -> Any:
    """Return a JSON value as `kind`.

    Parameters
    ----------
    kind : type
        A dataclass of such kinds, `bool`, `int`, `float`, `str`, an enumeration or a choice of
        texts, None, a union, or a tuple of them.
    value : JSON value
        Its numbers are finite.

    Raises
    ------
    FormatError
        Naming the value that is not of its kind.
    """
    if get_origin(kind) is UnionType:  # of null and another kind
        other = next(one for one in get_args(kind) if one is not NoneType)
        return None if value is None else parse_record(other, value, name)
    if get_origin(kind) is tuple:
        return _parse_tuple(kind, value, name)
    if is_dataclass(kind):
        return _parse_dataclass(kind, value, name)
    choices = get_args(kind) if get_origin(kind) is Literal else ()
    if choices or issubclass(kind, StrEnum):
        choices = choices or tuple(kind)
        if value not in choices:
            raise FormatError(
                f"`{name}` is {format_value(value)}, expected one of {', '.join(map(str, choices))}"
            )
        return choices[choices.index(value)]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind is float and is_number:
        return float(value)
    if not isinstance(value, kind) or (kind is int and not is_number):
        raise FormatError(f"`{name}` is {format_value(value)}, expected {_KIND_NAMES[kind]}")
    return value


def read_record(file: h5py.File, name: str, kind: type[Record]) -> Record:
    """Read an attribute of JSON as the dataclass `kind`."""
    held = read_json_attr(file, name, dict)
    with error_context(f"attribute `{name}`"):
        record: Record = parse_record(kind, held, name)
    return record


def read_optional_record(file: h5py.File, name: str, kind: type[Record]) -> Record | None:
    """Read an attribute of JSON as the dataclass `kind`; None if it is missing."""
    return read_record(file, name, kind) if name in file.attrs else None


def _parse_tuple(kind: Any, value: Any, name: str) -> tuple[Any, ...]:
    kinds = get_args(kind)
    if not isinstance(value, list):
        raise FormatError(f"`{name}` is {format_value(value)}, expected a list")
    if kinds[-1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(kinds) != len(value):
        raise FormatError(f"`{name}` has {len(value)} values, expected {len(kinds)}")
    return tuple(
        parse_record(one, held, f"{name}[{k}]")
        for k, (one, held) in enumerate(zip(kinds, value, strict=True))
    )


def _parse_dataclass(kind: Any, value: Any, name: str) -> Any:
    """Parse a record: fields that an older version did not have take their defaults."""
    known = {field.name: field for field in fields(kind)}
    held = value if isinstance(value, dict) else {}
    missing = [
        key
        for key, field in known.items()
        if key not in held and field.default is MISSING and field.default_factory is MISSING
    ]
    if missing or not isinstance(value, dict):
        raise FormatError(f"`{name}` does not hold {', '.join(missing or known)}; write it again")
    unknown = sorted(held.keys() - known.keys())
    if unknown:
        raise FormatError(
            f"`{name}` holds {join_truncated(unknown)}, which this version does not know: it was "
            "written by a newer version of cageik; update cageik"
        )
    kinds = get_type_hints(kind)
    values = {key: parse_record(kinds[key], held[key], f"{name}.{key}") for key in held}
    try:
        return kind(**values)
    except SettingError as error:
        raise FormatError(f"`{name}`: {error}") from error
