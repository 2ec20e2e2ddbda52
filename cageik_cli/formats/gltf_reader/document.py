"""A glTF file and the buffers that it names, checked before anything is computed with them."""

import base64
import binascii
import re
import struct
from functools import cached_property
from pathlib import Path
from urllib.parse import unquote

from cageik_cli.formats.base.files import ClaimedBytes
from cageik_cli.formats.gltf_reader.items import Item
from cageik_cli.util.errors import FileAccessError, FormatError, error_context
from cageik_cli.util.files import read_input
from cageik_cli.util.json_files import JsonFormat, parse_json

MAX_GLTF_BYTES = 2**32 - 1
"""Bytes of a glTF file and the files that it names, together: what a .glb file can state."""

GLTF_JSON = JsonFormat("a glTF 2.0 file", MAX_GLTF_BYTES)

_COMPRESSIONS = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
)

_HARMLESS = re.compile(
    r"KHR_mesh_quantization|KHR_node_visibility|EXT_mesh_gpu_instancing|"
    r"(KHR|EXT|MSFT|ADOBE)_(materials|texture|lights)_\w+|KHR_xmp\w*"
)
"""Extensions that change no position of a vertex, or that are read."""


class Document:
    """The content of a file.

    Attributes
    ----------
    root : Item
        Its JSON.
    files : list of Path
        The file itself, and those of its buffers that were read.
    """

    def __init__(self, path: Path) -> None:
        self.files = [path]
        data = read_input(path, MAX_GLTF_BYTES, "a smaller file")
        self._claimed = ClaimedBytes(len(data))
        text, self._binary = _split_chunks(data)
        self.root = Item(parse_json(text, GLTF_JSON), "")
        asset = self.root.find_item("asset")
        version = "" if asset is None else asset.read_text("version")
        if not version.startswith("2."):
            raise FormatError(
                f"is not glTF 2 (its version is `{version[:20]}`); export it again as glTF 2.0"
            )
        self._check_extensions()
        self.nodes = self.root.list_items("nodes")
        self.meshes = self.root.list_items("meshes")
        self.skins = self.root.list_items("skins")
        self.materials = self.root.list_items("materials")
        self.accessors = self.root.list_items("accessors")
        self._buffers: dict[int, memoryview] = {}

    def claim(self, size: int) -> None:
        """Count bytes that are taken beside those of the files, and refuse too many.

        A file of a few bytes can say that it holds the same numbers, or zeros, a million times.
        """
        self._claimed.claim(size)

    def read_view(self, number: int) -> tuple[memoryview, int | None]:
        """Return the bytes of a buffer view, and the bytes from one element to the next.

        These are None where elements follow each other.
        """
        view = self._views[number]
        buffer = self._read_buffer(view.read_whole("buffer", len(self._buffer_items)))
        length = view.read_whole("byteLength", lowest=1)
        start = view.find_whole("byteOffset") or 0
        if start + length > len(buffer):
            raise FormatError(
                f"{view.place} ends at byte {start + length} of its buffer, which has "
                f"{len(buffer)}; export the file again"
            )
        return buffer[start : start + length], view.find_whole("byteStride", lowest=1)

    @property
    def view_count(self) -> int:
        """How many buffer views there are."""
        return len(self._views)

    @cached_property
    def _views(self) -> list[Item]:
        return self.root.list_items("bufferViews")

    @cached_property
    def _buffer_items(self) -> list[Item]:
        return self.root.list_items("buffers")

    def _check_extensions(self) -> None:
        """Refuse a file that cannot be read without what cageik does not know."""
        required = self.root.list_texts("extensionsRequired")
        for name in required:
            if name in _COMPRESSIONS:
                raise make_compression_error(name)
            if not _HARMLESS.fullmatch(name):
                raise FormatError(
                    f"needs the extension {name[:60]!a}, which cageik does not read; export it "
                    "without, or as USD or Alembic"
                )

    def _read_buffer(self, number: int) -> memoryview:
        """Return the bytes of a buffer, at least as many as it states."""
        if number not in self._buffers:
            item = self._buffer_items[number]
            length = item.read_whole("byteLength", lowest=1)
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
        with error_context(name):
            data = read_input(path, MAX_GLTF_BYTES - self._claimed.packed, "a smaller file")
        self.files.append(path)
        self._claimed.packed += len(data)
        return memoryview(data)


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
