"""A GLB file in the making: arrays in temporary files, and JSON that describes them."""

import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from math import sqrt
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writers import Animation, AnimationWriter, NamedClip
from cageik_cli.formats.settings import GLTF_RATE_KEY, Scene
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import OutputError, require_optional
from cageik_cli.util.files import set_size
from cageik_cli.util.messages import Text, say
from cageik_cli.util.version import __version__

MAX_GLB_BYTES = 2**32 - 1
"""Largest size that a GLB file can state."""

Singles = NDArray[np.float32]

Small = TypeVar("Small", np.int8, np.int16, np.uint16)

MAX_SPOOL_BYTES = 1 << 25
"""Bytes of the vectors of all frames that are read together; the last digits depend on it."""


class VectorTargets:
    """Vectors of K targets at m vertices in the file, written some vertices at a time.

    Attributes
    ----------
    shape : (int, int)
        K and m.
    start : int
        Byte at which they begin.
    low, high : (K, 3) float32
        Bounds of what was written.
    """

    def __init__(self, shape: tuple[int, int], start: int) -> None:
        self.shape, self.start = shape, start
        self.low = np.full((shape[0], 3), np.inf, np.float32)
        self.high = -self.low

    def offset(self, target: int, vertex: int = 0) -> int:
        """Return the byte at which a target's vector of a vertex begins."""
        return self.start + 12 * (target * self.shape[1] + vertex)


class GlbFile:
    """Arrays of a GLB file, which are described by accessors, and the scene over them.

    Arrays are kept in a temporary file until `target` is complete: in `folder`, or beside it.
    """

    def __init__(self, target: Path, folder: Path | None = None) -> None:
        self._target = target
        place = folder or target.parent
        self._data = tempfile.TemporaryFile(dir=place)  # noqa: SIM115  # until complete
        self._size = 0
        self._views: list[object] = []
        self._accessors: list[object] = []

    def add_array(
        self,
        array: NDArray[Any],
        use: int | None = None,
        *,
        bounds: bool = False,
        is_normalized: bool = False,
    ) -> int:
        """Add an array, (k,) or (k, width), and return the number of its accessor.

        Parameters
        ----------
        array : (k,) or (k, width)
            float32, or integers of 1, 2 or 4 bytes.
        use : int, optional
            What graphics cards use it for: pygltflib's ARRAY_BUFFER or ELEMENT_ARRAY_BUFFER.
        bounds : bool
            State the smallest and largest value.
        is_normalized : bool
            Whether integers stand for numbers up to 1, their largest.
        """
        import pygltflib as gltf

        array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        rows = array.reshape(len(array), -1)
        limits: dict[str, Any] = {}
        if bounds:
            limits = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        if is_normalized:
            limits["normalized"] = True
        written, stride = rows, None
        if use == gltf.ARRAY_BUFFER and rows.strides[0] % 4:  # attributes begin at whole words
            padding = -rows.strides[0] % 4 // rows.itemsize
            written = np.pad(rows, ((0, 0), (0, padding)))
            stride = written.strides[0]
        start = self._reserve(written.nbytes)
        self._write_at(start, written)
        return self._add_accessor(start, rows, use, limits, stride)

    def reserve_targets(self, target_count: int, vertex_count: int) -> VectorTargets:
        """Reserve a place for vectors of targets."""
        start = self._reserve(12 * target_count * vertex_count)
        return VectorTargets((target_count, vertex_count), start)

    def write_targets(self, targets: VectorTargets, vertex: int, vectors: Singles) -> None:
        """Write vectors (K, b, 3) of all targets at b vertices from `vertex` on."""
        np.minimum(targets.low, vectors.min(axis=1), out=targets.low)
        np.maximum(targets.high, vectors.max(axis=1), out=targets.high)
        for k, rows in enumerate(vectors):
            self._write_at(targets.offset(k, vertex), np.ascontiguousarray(rows, "<f4"))

    def add_targets(self, targets: VectorTargets, bounds: bool) -> list[int]:
        """Return the accessors of the targets, when all of them are written."""
        import pygltflib as gltf

        shape = np.broadcast_to(np.float32(0), (targets.shape[1], 3))
        numbers = []
        for k, (low, high) in enumerate(zip(targets.low, targets.high, strict=True)):
            limits = {"min": low.tolist(), "max": high.tolist()} if bounds else {}
            place = targets.offset(k)
            numbers.append(self._add_accessor(place, shape, gltf.ARRAY_BUFFER, limits))
        return numbers

    def complete(self, **scene: Any) -> None:
        """Compose the file: `scene` are the other fields of pygltflib's GLTF2."""
        import pygltflib as gltf

        document = gltf.GLTF2(
            asset=gltf.Asset(generator=f"cageik {__version__}"),
            accessors=self._accessors,
            bufferViews=self._views,
            buffers=[gltf.Buffer(byteLength=self._size)],
            **scene,
        )
        text = document.gltf_to_json(separators=(",", ":"), indent=None).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + self._size
        if size > MAX_GLB_BYTES:
            raise OutputError(describe_excess(size))
        self._data.seek(0)
        with self._target.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, size))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", self._size, b"BIN\0"))
            shutil.copyfileobj(self._data, file, 1 << 20)
        self.close()

    def close(self) -> None:
        """Close the temporary file."""
        self._data.close()

    def _reserve(self, size: int) -> int:
        """Return the byte at which `size` more bytes begin; their end is padded to 4 bytes."""
        start = self._size
        self._size += size + -size % 4
        set_size(self._data, self._size)
        return start

    def _write_at(self, start: int, array: NDArray[Any]) -> None:
        self._data.seek(start)
        self._data.write(array.data)

    def _add_accessor(
        self,
        start: int,
        rows: NDArray[Any],
        use: int | None,
        limits: dict[str, Any],
        stride: int | None = None,
    ) -> int:
        """Describe `rows` (k, width) that begin at a byte, by a view of their own.

        They are `stride` bytes apart, if that is more than they take.
        """
        import pygltflib as gltf

        shapes = {1: gltf.SCALAR, 2: gltf.VEC2, 3: gltf.VEC3, 4: gltf.VEC4, 16: gltf.MAT4}
        kinds = {
            "f4": gltf.FLOAT,
            "u4": gltf.UNSIGNED_INT,
            "u2": gltf.UNSIGNED_SHORT,
            "u1": gltf.UNSIGNED_BYTE,
            "i2": gltf.SHORT,
            "i1": gltf.BYTE,
        }
        size = rows.nbytes if stride is None else stride * len(rows)
        view = gltf.BufferView(
            buffer=0, byteOffset=start, byteLength=size, byteStride=stride, target=use
        )
        self._views.append(view)
        accessor = gltf.Accessor(
            bufferView=len(self._views) - 1,
            componentType=kinds[f"{rows.dtype.kind}{rows.dtype.itemsize}"],
            type=shapes[rows.shape[1]],
            count=len(rows),
            **limits,
        )
        self._accessors.append(accessor)
        return len(self._accessors) - 1


def round_to(values: Floats, kind: type[Small]) -> NDArray[Small]:
    """Round numbers from -1, or 0, to 1 to integers, of which the largest is 1."""
    return np.rint(values * np.iinfo(kind).max).astype(kind)


def read_rounded(values: NDArray[Any]) -> Floats:
    """Return the numbers that integers stand for, of which the largest is 1; floats as they are."""
    size = 1 if values.dtype.kind == "f" else np.iinfo(values.dtype).max
    return np.asarray(values.astype(np.float64) / size)


def describe_excess(size: int) -> Text:
    """Return the message of a file of `size` bytes, which is too large."""
    return f"it would take {size / 2**30:.1f} GiB, and a .glb holds less than 4 GiB; " + say(
        "give a lower `morphs=`, or fewer frames, or write .usdc or .abc"
    )


class VectorSpool:
    """F frames of m vectors, written frame by frame and read for all frames together.

    They are in a temporary file in `folder`; `vertex_count` is m. Vectors have `width` numbers.
    """

    def __init__(self, folder: Path, vertex_count: int, width: int = 3) -> None:
        self.frame_count, self.vertex_count, self.width = 0, vertex_count, width
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # closed by `close`

    def append(self, vectors: Singles) -> None:
        """Write the vectors (m, width) of the next frame."""
        self._file.write(np.ascontiguousarray(vectors, np.float32).data)
        self.frame_count += 1

    def read_blocks(self, start: int, stop: int) -> Iterator[tuple[int, Floats]]:
        """Yield the first of each block of b vectors, and their (F, width b) of all frames."""
        size = max(1, MAX_SPOOL_BYTES // (8 * self.width * max(1, self.frame_count)))
        for first in range(start, stop, size):
            count = min(size, stop - first)
            block = np.empty((self.frame_count, self.width * count), np.float32)
            for frame, row in enumerate(block):
                self._file.seek(4 * self.width * (frame * self.vertex_count + first))
                self._file.readinto(row.data)
            yield first, block.astype(np.float64)

    def read_frames(self, start: int, stop: int) -> Floats:
        """Return the vectors of some frames, (k, m, width)."""
        block = np.empty((stop - start, self.vertex_count, self.width), np.float32)
        self._file.seek(4 * self.width * start * self.vertex_count)
        self._file.readinto(block.data)
        return block.astype(np.float64)

    def read_part(self, frame: int, start: int, stop: int) -> Floats:
        """Return the vectors of some vertices in a frame, (k, width)."""
        rows = np.empty((stop - start, self.width), np.float32)
        self._file.seek(4 * self.width * (frame * self.vertex_count + start))
        self._file.readinto(rows.data)
        return rows.astype(np.float64)

    def close(self) -> None:
        """Delete the temporary file."""
        self._file.close()


class GlbWriter(AnimationWriter):
    """Keeps what is written of each frame in temporary files, and composes the file at the end."""

    suffixes = (".glb",)
    is_single = True
    keeps_parts = True
    states_unit = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without pygltflib."""
        with require_optional("pygltflib", "writing .glb"):
            import pygltflib  # noqa: F401

    def __init__(self, target: Path, animation: Animation) -> None:
        self._target, self._animation = target, animation
        starts = [clip.scene.start for clip in animation.clips or (animation,)]
        self.notes = tuple(
            f"frame {start:.10g} is at 0 s, where players begin; cageik reads its number"
            for start in dict.fromkeys(starts)
            if start not in (0, 1)
        )

    def open_file(self, vector_count: int, spool_count: int) -> list[VectorSpool]:
        """Open the file, and spools of as many vectors per frame."""
        with ExitStack() as stack:
            self._file = GlbFile(self._target)
            stack.callback(self._file.close)
            spools = [VectorSpool(self._target.parent, vector_count) for _ in range(spool_count)]
            for spool in spools:
                stack.callback(spool.close)
            self._open = stack.pop_all()
        return spools

    def add_times(self, frames: Integers | None = None, scene: Scene | None = None) -> int:
        """Add the time of each frame, or of some, seconds; return the number of the accessor.

        The first is at 0 s: players loop from there, and would wait for a later one in each loop.
        A clip of several has a `scene` of its own.
        """
        scene = scene or self._animation.scene
        chosen = np.arange(self._animation.frame_count) if frames is None else frames
        numbers = scene.frame_step * chosen
        return self._file.add_array(np.asarray(numbers / scene.fps, np.float32), bounds=True)

    def make_animation(
        self, channels: list[object], samplers: list[object], clip: NamedClip | None = None
    ) -> object:
        """Return the animation, which states rate and numbers of its frames for cageik itself.

        It is that of a `clip`, if there are several.
        """
        import pygltflib as gltf

        scene = (clip or self._animation).scene
        return gltf.Animation(
            name=(clip or self._animation).name,
            channels=channels,
            samplers=samplers,
            extras={GLTF_RATE_KEY: [scene.fps, scene.frame_step, scene.start]},
        )

    def make_node_transform(self) -> dict[str, list[float]]:
        """Return a node's transform into metres and y up; empty if the scene has these."""
        scene, placement = self._animation.scene, {}
        if scene.up_axis == "Z":
            # The quaternion (x, y, z, w) of −90° about x.
            placement["rotation"] = [-sqrt(0.5), 0.0, 0.0, sqrt(0.5)]
        if scene.metres_per_unit != 1:
            placement["scale"] = [scene.metres_per_unit] * 3
        return placement
