"""A glTF file and the buffers that it names, checked before anything is computed with them.

Values of its JSON are checked when they are asked for. Its arrays may be strided, sparse, or of
small integers that stand for fractions.
"""

import base64
import binascii
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from pathlib import Path
from time import thread_time
from typing import Any, overload
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import ClaimedBytes, compute_unpacked_limit
from cageik_cli.geometry.mesh import MAX_COORDINATE
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FileAccessError, FormatError, error_context
from cageik_cli.util.files import read_input
from cageik_cli.util.json_files import JsonFormat, format_value, parse_json
from cageik_cli.util.text import format_bytes, single_line
from cageik_cli.util.trial import trials

MAX_GLTF_BYTES = 2**32 - 1
"""Bytes of a glTF file and the files that it names, together: what a .glb file can state."""

GLTF_JSON = JsonFormat("a glTF 2.0 file", MAX_GLTF_BYTES)

_COMPRESSIONS = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
)

_READ = ("KHR_mesh_quantization", "KHR_node_visibility", "EXT_mesh_gpu_instancing")

_HARMLESS = re.compile(
    r"[A-Z]+_(materials|textures?|lights?|audio)_\w+|KHR_xmp\w*|FB_ngon_encoding|[A-Z]+_\w*metadata|"
    r"EXT_(mesh_features|instance_features|mesh_primitive_edge_visibility)|"
    r"CESIUM_primitive_outline|VRM|VRMC_\w+|MOZ_hubs_components|GODOT_single_root|"
    r"KHR_node_(selectability|hoverability)"
)
"""Extensions that change no position of a vertex: looks, lights, data and behaviour."""

ACCESSORS = {"uvs": "TEXCOORD_0", "normal_fans": "NORMAL", "colours": "COLOR_0"}
"""The attributes of a primitive that hold a layer of the surface."""

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Types of numbers, by their codes."""

WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Numbers of an element, by its type."""

MAX_OBJECT_BYTES = 256 << 20
"""Memory that nodes, joints and animated values may take in any case, and 40 times the file."""

MAX_STRIDE = 2**31
"""Bytes from one element to the next are below that; glTF allows 252."""

LOOKS_PER_READING = 64
"""Objects of the file between two readings of the clock, which take as long as one."""


WATCHED_BYTES_PER_SECOND = 4 << 20
"""Files of more bytes may take longer to open."""


class TrialWanted(Exception):
    """A file takes longer to open than ordinary ones of its size do."""


class Watch:
    """Raises `TrialWanted` when this thread has taken as many seconds of a processor.

    It looks whenever an object of a file is looked at, or an array is read. So a product of numbers
    in the file that is not counted elsewhere is found while it is computed.
    """

    def __init__(self, seconds: float = inf) -> None:
        self._end, self._count = thread_time() + seconds, 0

    def allow(self, size: int) -> None:
        """Allow more seconds for more bytes."""
        self._end += size / WATCHED_BYTES_PER_SECOND

    def look(self) -> None:
        """Look at the clock, now and then."""
        self._count += 1
        if self._count % LOOKS_PER_READING == 0:
            self.read()

    def read(self) -> None:
        """Look at the clock."""
        if thread_time() > self._end:
            raise TrialWanted


@dataclass(frozen=True, slots=True)
class Item:
    """An object of the file.

    Attributes
    ----------
    values : dict
        As the file has them, unchecked.
    place : str
        Where it is, for messages: `nodes[3]`; empty for the whole file.
    watch : Watch
        Looks whenever an object is looked at.
    """

    values: Any
    place: str
    watch: Watch

    def __post_init__(self) -> None:
        self.watch.look()
        if not isinstance(self.values, dict):
            raise self.make_error("", self.values, "an object")

    def make_error(self, name: str, found: Any, expected: str) -> FormatError:
        """Return the error of a value that is not what was expected."""
        place = self.locate(name) if name else self.place or "the file"
        return FormatError(
            f"{place} is {format_value(found)}, expected {expected}; export the file again"
        )

    def locate(self, name: str) -> str:
        """Return the place of a value, by its key."""
        return f"{self.place}.{name}" if self.place else name

    def has(self, name: str) -> bool:
        """Return whether there is a value."""
        return self.values.get(name) is not None

    def find_integer(self, name: str, below: int | None = None, lowest: int = 0) -> int | None:
        """Return a whole number from `lowest` to below a bound; None if it is absent."""
        value = self.values.get(name)
        return None if value is None else self._check_integer(name, value, below, lowest)

    def read_integer(self, name: str, below: int | None = None, lowest: int = 0) -> int:
        """Return a whole number, which must be there."""
        return self._check_integer(name, self.values.get(name), below, lowest)

    def count(self, name: str) -> int:
        """Return how many values a list has."""
        return len(self._read_list(name))

    def list_integers(self, name: str, below: int) -> Integers:
        """Return a list of whole numbers from 0 to below a bound, (k,); empty if it is absent."""
        values = self._read_list(name)
        for k, value in enumerate(values):
            self._check_integer(f"{name}[{k}]", value, below, 0)
        return np.array(values, np.int64)

    def find_numbers(self, name: str, count: int | None) -> Floats | None:
        """Return a list of so many numbers, (count,); None if it is absent."""
        if not self.has(name):
            return None
        values = self._read_list(name)
        if count is not None and len(values) != count:
            raise self.make_error(name, values, f"{count} numbers")
        for k, value in enumerate(values):
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not is_number or abs(value) > MAX_COORDINATE:
                raise self.make_error(f"{name}[{k}]", value, f"a number up to {MAX_COORDINATE:g}")
        return np.array(values, np.float64)

    def find_item(self, name: str) -> "Item | None":
        """Return an object; None if it is absent."""
        if not self.has(name):
            return None
        return Item(self.values[name], self.locate(name), self.watch)

    def list_items(self, name: str) -> "Items":
        """Return a list of objects; empty if it is absent."""
        return Items(self._read_list(name), self.locate(name), self.watch)

    def list_texts(self, name: str) -> list[str]:
        """Return a list of texts; empty if it is absent."""
        values = self._read_list(name)
        for k, value in enumerate(values):
            if not isinstance(value, str):
                raise self.make_error(f"{name}[{k}]", value, "a text")
        return values

    def read_text(self, name: str) -> str:
        """Return a text, as it is; empty if it is absent."""
        value = self.values.get(name)
        if value is not None and not isinstance(value, str):
            raise self.make_error(name, value, "a text")
        return value or ""

    def read_name(self) -> str:
        """Return the name on one line; empty if it has none."""
        return single_line(self.read_text("name")).strip()

    def find_extension(self, name: str) -> "Item | None":
        """Return the object of an extension; None if it is absent."""
        extensions = self.find_item("extensions")
        return None if extensions is None else extensions.find_item(name)

    def _read_list(self, name: str) -> list[Any]:
        value = self.values.get(name)
        if value is not None and not isinstance(value, list):
            raise self.make_error(name, value, "a list")
        return value or []

    def _check_integer(self, name: str, value: Any, below: int | None, lowest: int) -> int:
        """Return a value if it is a whole number within its bounds."""
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        if not is_whole or value < lowest or (below is not None and value >= below):
            if below is None:
                expected = f"a whole number from {lowest} on"
            else:
                expected = (
                    f"{lowest} to {below - 1}" if below > lowest else "none, as there is none"
                )
            raise self.make_error(name, value, expected)
        return int(value)


@dataclass(frozen=True, slots=True, eq=False)
class Items(Sequence[Item]):
    """A list of objects, which are made, and checked, as they are taken: there may be millions."""

    values: list[Any]
    place: str
    watch: Watch

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[Item]:
        return (
            Item(value, f"{self.place}[{k}]", self.watch) for k, value in enumerate(self.values)
        )

    @overload
    def __getitem__(self, key: int) -> Item: ...

    @overload
    def __getitem__(self, key: slice) -> list[Item]: ...

    def __getitem__(self, key: int | slice) -> Item | list[Item]:
        if isinstance(key, slice):
            return [self[k] for k in range(len(self))[key]]
        return Item(self.values[key], f"{self.place}[{key}]", self.watch)


class Document:
    """The content of a file.

    Attributes
    ----------
    root : Item
        Its JSON.
    files : list of Path
        The file itself, and those of its buffers that were read.
    claimed : ClaimedBytes
        Counts what is taken of them.
    """

    def __init__(self, path: Path, watch: Watch | None = None) -> None:
        self.files = [path]
        self._watch = watch or Watch()
        data = read_input(path, MAX_GLTF_BYTES, "a smaller file", is_json=True)
        self.claimed = ClaimedBytes(len(data))
        self._watch.allow(len(data))
        text, self._binary = _split_chunks(data)
        self.root = Item(parse_json(text, GLTF_JSON), "", self._watch)
        asset = self.root.find_item("asset")
        if asset is None:
            raise FormatError(
                "is JSON without the `asset` of a glTF file, such as a message of an error; "
                "download it again, or export it as glTF 2.0"
            )
        version = asset.read_text("version")
        if not version.startswith("2."):
            found = f"its version is `{version[:20]}`" if version else "it states no version"
            raise FormatError(f"is not glTF 2 ({found}); export it again as glTF 2.0")
        for name in self.root.list_texts("extensionsRequired"):
            if name in _COMPRESSIONS:
                raise make_compression_error(name)
            if name not in _READ and not _HARMLESS.fullmatch(name):
                raise FormatError(
                    f"needs the extension {name[:60]!a}, which cageik does not read; export it "
                    "without, or as USD or Alembic"
                )
        required = dict.fromkeys(self.root.list_texts("extensionsRequired"))
        self.left_out = [name for name in required if name not in _READ]
        self.nodes = self.root.list_items("nodes")
        self.meshes = self.root.list_items("meshes")
        self.skins = self.root.list_items("skins")
        self.materials = self.root.list_items("materials")
        self.accessors = self.root.list_items("accessors")
        self._buffers: dict[int, memoryview] = {}
        self._named_files: dict[Path, memoryview] = {}
        self._object_bytes = 0

    def claim(self, size: int) -> None:
        """Count bytes that are taken beside those of the files, and refuse too many.

        A file of a few bytes can say that it holds the same numbers, or zeros, a million times.
        """
        self.claimed.claim(size)
        self._watch.read()

    def claim_objects(self, count: int, noun: str, size: int) -> None:
        """Count objects that take as many bytes each as they are read; refuse too many."""
        self._object_bytes += count * size
        limit = max(MAX_OBJECT_BYTES, compute_unpacked_limit(self.claimed.packed))
        if self._object_bytes > limit:
            raise FormatError(
                f"has {count} {noun}, with which its lists take {format_bytes(self._object_bytes)} "
                f"of memory, expected at most {format_bytes(limit)}; export fewer of them"
            )

    def read_view(self, number: int) -> tuple[memoryview, int | None]:
        """Return the bytes of a buffer view, and the bytes from one element to the next.

        These are None where elements follow each other.
        """
        view = self._views[number]
        buffer = self._read_buffer(view.read_integer("buffer", len(self._buffer_items)))
        length = view.read_integer("byteLength", lowest=1)
        start = view.find_integer("byteOffset") or 0
        if start + length > len(buffer):
            raise FormatError(
                f"{view.place} ends at byte {start + length} of its buffer, which has "
                f"{len(buffer)}; export the file again"
            )
        return buffer[start : start + length], view.find_integer("byteStride", MAX_STRIDE, lowest=1)

    @property
    def view_count(self) -> int:
        """How many buffer views there are."""
        return len(self._views)

    @cached_property
    def _views(self) -> Items:
        return self.root.list_items("bufferViews")

    @cached_property
    def _buffer_items(self) -> Items:
        return self.root.list_items("buffers")

    def _read_buffer(self, number: int) -> memoryview:
        """Return the bytes of a buffer, at least as many as it states."""
        if number not in self._buffers:
            item = self._buffer_items[number]
            length = item.read_integer("byteLength", lowest=1)
            with error_context(item.place):
                data = self._load_buffer(item, number)
                if len(data) < length:
                    raise FormatError(
                        f"holds {len(data)} of {length} bytes; it is cut short, so copy or export "
                        "it again"
                    )
            self._buffers[number] = data[:length]
        return self._buffers[number]

    def _load_buffer(self, item: Item, number: int) -> memoryview:
        uri = item.read_text("uri")
        if uri.startswith("data:"):
            return memoryview(_decode_data_uri(uri))
        if uri:
            return self._read_file(uri)
        if number == 0 and self._binary is not None:
            return self._binary
        used = self.root.list_texts("extensionsUsed")
        for name in _COMPRESSIONS:
            if name in used:
                raise make_compression_error(name)
        raise FormatError("names no data; export the file again")

    def _read_file(self, uri: str) -> memoryview:
        """Read a file that is named relative to the document, and beside it or below."""
        folder = self.files[0].parent
        name = unquote(uri).replace("\\", "/")
        path = folder / name
        if re.match(r"[A-Za-z][\w+.-]*:", name) or "\0" in name:
            raise FileAccessError("is not in a file; save it as .glb")
        if not path.resolve().is_relative_to(folder.resolve()):
            raise FileAccessError("is in another folder, expected a file beside the .gltf")
        file = path.resolve()
        if file not in self._named_files:  # many buffers may name one
            with error_context(name):
                data = read_input(path, MAX_GLTF_BYTES - self.claimed.packed, "a smaller file")
            self.files.append(path)
            self.claimed.packed += len(data)
            self._watch.allow(len(data))
            trials.allow(len(data))
            self._named_files[file] = memoryview(data)
        return self._named_files[file]


def make_compression_error(name: str) -> FormatError:
    """Return the error of meshes that an extension has compressed."""
    others = ", or in Blender" if "draco" in name else ""
    return FormatError(
        f"its meshes are compressed ({name}), which cageik does not unpack; unpack them with "
        f"`gltf-transform cp in.glb out.glb` (npm install -g @gltf-transform/cli){others}"
    )


def _split_chunks(data: bytes) -> tuple[bytes, memoryview | None]:
    """Return the JSON and the binary part of a .glb file; a .gltf file is JSON alone."""
    if not data.startswith(b"glTF"):
        if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
            raise FormatError("is not a glTF file; export it again")
        return data, None
    if len(data) < 20:
        raise FormatError("is cut short in its header; copy or export it again")
    version, length, text_length, kind = struct.unpack_from("<III4s", data, 4)
    if version != 2:
        raise FormatError(f"is glTF {version}, expected glTF 2.0; convert it, or export it again")
    if length > len(data) or 20 + text_length > length:
        raise FormatError(
            f"holds {len(data)} of {max(length, 20 + text_length)} bytes; it is cut short, so copy "
            "or export it again"
        )
    if kind != b"JSON":
        raise FormatError("does not begin with JSON, as .glb files do; export it again")
    start = 20 + text_length
    if start + 8 > length:
        return data[20:start], None
    size, kind = struct.unpack_from("<I4s", data, start)
    if kind != b"BIN\0":
        return data[20:start], None
    if start + 8 + size > length:
        raise FormatError(
            f"its binary part has {length - start - 8} of {size} bytes; copy or export it again"
        )
    return data[20:start], memoryview(data)[start + 8 : start + 8 + size]


def _decode_data_uri(uri: str) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma or not head.endswith(";base64"):
        raise FormatError("is a data URI of another kind, expected base64; save it as .glb")
    try:
        return base64.b64decode(unquote(body) if "%" in body else body, validate=True)
    except (binascii.Error, ValueError) as error:
        raise FormatError(f"is not base64 ({error}); export the file again") from error


@dataclass(frozen=True, slots=True, eq=False)
class SparseRows:
    """Rows (count, width) that are zero but for some.

    Attributes
    ----------
    indices : (s,) int64
        Numbers of the others, ascending.
    values : (s, width)
    """

    count: int
    indices: Integers
    values: NDArray[Any]

    def to_dense(self) -> NDArray[Any]:
        """Return all rows."""
        rows = np.zeros((self.count, self.values.shape[1]), self.values.dtype)
        rows[self.indices] = self.values
        return rows


Rows = NDArray[Any] | SparseRows


def read_floats(
    document: Document, number: int, widths: tuple[int, ...], needs_float: bool = False
) -> Floats | NDArray[np.float32]:
    """Read an accessor as floats, (count, width).

    Parameters
    ----------
    needs_float : bool
        Refuse integers.

    Raises
    ------
    FormatError
        Naming the accessor.
    """
    rows = read_rows(document, number, widths, needs_float)
    if isinstance(rows, SparseRows):
        document.claim(rows.count * rows.values.shape[1] * rows.values.itemsize)
        return rows.to_dense()
    return rows


def read_rows(
    document: Document, number: int, widths: tuple[int, ...], needs_float: bool = False
) -> Rows:
    """Read an accessor as floats; one whose elements are zero but for some is not expanded."""
    item = document.accessors[number]
    code = _read_code(item)
    is_fraction = item.values.get("normalized") is True

    def convert(raw: NDArray[Any]) -> NDArray[Any]:
        if raw.dtype.kind == "f":
            return raw
        if needs_float:
            raise item.make_error("componentType", code, "5126, single precision")
        exact = raw.astype(np.float64)
        if not is_fraction:
            return exact
        return np.maximum(exact / np.iinfo(raw.dtype).max, -1.0)

    found = _read_raw(document, item, widths)
    if isinstance(found, SparseRows):
        return SparseRows(found.count, found.indices, convert(found.values))
    if found.dtype.kind != "f":
        document.claim(8 * found.size)
    return convert(found)


def read_integers(document: Document, number: int, width: int) -> Integers:
    """Read an accessor as whole numbers, (count, width), which are not below 0."""
    item = document.accessors[number]
    if COMPONENTS[_read_code(item)][1] != "u":
        found = item.values["componentType"]
        raise item.make_error("componentType", found, "5121, 5123 or 5125, which count from 0")
    rows = _read_raw(document, item, (width,))
    count = rows.count if isinstance(rows, SparseRows) else len(rows)
    document.claim(8 * count * width)
    return (rows.to_dense() if isinstance(rows, SparseRows) else rows).astype(np.int64)


def count_rows(document: Document, number: int) -> int:
    """Return how many elements an accessor states."""
    return document.accessors[number].read_integer("count", lowest=1)


def _read_code(item: Item) -> int:
    code = item.read_integer("componentType")
    if code not in COMPONENTS:
        raise item.make_error("componentType", code, f"one of {', '.join(map(str, COMPONENTS))}")
    return code


def _read_raw(document: Document, item: Item, widths: tuple[int, ...]) -> Rows:
    """Return the rows as the file has them; those of no bytes are zeros."""
    kind = np.dtype(COMPONENTS[_read_code(item)])
    name = item.read_text("type")
    width = WIDTHS.get(name, 0)
    if width not in widths:
        wanted = [name for name, each in WIDTHS.items() if each in widths]
        raise item.make_error("type", name, " or ".join(wanted))
    count = item.read_integer("count", lowest=1)
    view = item.find_integer("bufferView", document.view_count)
    sparse = item.find_item("sparse")
    indices, values = np.zeros(0, np.int64), np.zeros((0, width), kind)
    if sparse is not None:
        indices, values = _read_sparse(document, sparse, (count, width), kind)
    if view is None:
        return SparseRows(count, indices, values)
    rows = _view_rows(document, item, view, (count, width), kind)
    if sparse is None:
        return rows
    document.claim(rows.size * kind.itemsize)
    rows = rows.copy()
    rows[indices] = values
    return rows


def _read_sparse(
    document: Document, sparse: Item, shape: tuple[int, int], kind: np.dtype[Any]
) -> tuple[Integers, NDArray[Any]]:
    """Return the numbers of the rows that differ, ascending, and these rows."""
    count = sparse.read_integer("count", shape[0] + 1, lowest=1)
    parts = []
    for name, row_width in (("indices", 1), ("values", shape[1])):
        part = sparse.find_item(name)
        if part is None:
            raise sparse.make_error(name, None, "an object")
        held = kind if name == "values" else np.dtype(COMPONENTS[_read_code(part)])
        view = part.read_integer("bufferView", document.view_count)
        parts.append(_view_rows(document, part, view, (count, row_width), held))
    indices = parts[0][:, 0].astype(np.int64)
    if indices[0] < 0 or indices[-1] >= shape[0] or (np.diff(indices) <= 0).any():
        raise FormatError(
            f"{sparse.place}.indices are not ascending numbers below {shape[0]}; export the file "
            "again"
        )
    return indices, parts[1]


def _view_rows(
    document: Document, item: Item, view: int, shape: tuple[int, int], kind: np.dtype[Any]
) -> NDArray[Any]:
    """Return rows in the bytes of a view, which are not copied."""
    data, stride = document.read_view(view)
    width = shape[1] * kind.itemsize
    step = stride or width
    start = item.find_integer("byteOffset") or 0
    stop = start + step * (shape[0] - 1) + width
    if step < width or stop > len(data):
        raise FormatError(
            f"{item.place}: {shape[0]} elements of {width} bytes, {step} apart, end at byte {stop} "
            f"of a view of {len(data)}; export the file again"
        )
    # That of a single element goes nowhere, and may be any number.
    return np.ndarray(shape, kind, data, start, (min(step, len(data)), kind.itemsize))
