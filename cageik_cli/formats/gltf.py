"""glTF in one binary file: the rest pose, a morph target per frame, and a track of weights."""

import shutil
import struct
import tempfile
from contextlib import ExitStack
from math import sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cageik_cli import __version__
from cageik_cli.formats.base.writer import Animation, AnimationWriter, to_float32
from cageik_cli.formats.scene import Scene
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError, require_optional

MAX_FILE_BYTES = 2**32 - 1
"""Largest size that a GLB file can state."""

MAX_JSON_BYTES = 1 << 29
"""Bytes reserved for the JSON, far more than it needs."""

_Z_TO_Y = [-sqrt(0.5), 0.0, 0.0, sqrt(0.5)]
"""The quaternion (x, y, z, w) of −90° about x: from z up to y up, which glTF has."""


class Writer(AnimationWriter):
    """Morph targets are displacements from the rest pose, in float32.

    The track gives a frame weight 1 at its number / fps seconds and all others 0, linear between:
    F² floats.
    """

    suffixes = (".glb",)
    is_single = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without pygltflib."""
        with require_optional("pygltflib", "gltf", "writing .glb"):
            import pygltflib  # noqa: F401

    def __init__(self, target: Path, animation: Animation) -> None:
        vertices, faces = len(animation.rest.vertices), len(animation.rest.faces)
        frames = animation.frame_count
        self._sizes = [12 * faces, 12 * vertices * (1 + frames), 4 * frames, 4 * frames**2]
        if sum(self._sizes) > MAX_FILE_BYTES - MAX_JSON_BYTES:
            raise OutputError(
                f"{frames} frames of {vertices} vertices take {sum(self._sizes) / 2**30:.1f} GiB "
                "as morph targets, and a .glb holds less than 4 GiB; write .usdc, .abc or .pc2"
            )
        if animation.scene.start < 0:
            raise OutputError(
                f"the number of the first frame is {animation.scene.start:.10g}, and glTF has no "
                "time before 0; give another with --start, or write .usdc or .abc"
            )
        seconds = animation.scene.start / animation.scene.fps
        if seconds > 1:
            self.notes = (
                f"the first frame is at {seconds:.4g} s, as its number says, and players wait "
                "until then; --start 0 begins at once",
            )
        self._target, self._animation = target, animation
        self._bounds: list[tuple[list[float], list[float]]] = []
        rest = to_float32(animation.rest.vertices)
        self._rest = rest.astype(np.float64)
        with ExitStack() as stack:
            # The JSON comes first in the file and has the bounds of all frames.
            self._data = stack.enter_context(tempfile.TemporaryFile(dir=target.parent))
            self._data.write(animation.rest.faces.astype("<u4").tobytes())
            self._write_positions(rest)
            stack.pop_all()  # open from here on

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            self._write_positions(to_float32(positions - self._rest))

    def complete(self) -> None:
        """Write the track, and compose the file."""
        count = self._animation.frame_count
        self._data.write(self._compute_times().tobytes())
        row = np.zeros(count, "<f4")
        for k in range(count):
            row[k] = 1
            self._data.write(row.data)
            row[k] = 0
        text = self._make_json().encode()
        text += b" " * (-len(text) % 4)
        size = self._data.tell()
        self._data.seek(0)
        with self._target.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + size))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", size, b"BIN\0"))
            shutil.copyfileobj(self._data, file, 1 << 20)
        self._data.close()

    def abandon(self) -> None:
        """Close the temporary file."""
        self._data.close()

    def _compute_times(self) -> NDArray[np.float32]:
        """Return the time of each frame, (F,), seconds."""
        scene = self._animation.scene
        numbers = scene.start + scene.frame_step * np.arange(self._animation.frame_count)
        return np.asarray(numbers / scene.fps, "<f4")

    def _write_positions(self, positions: np.ndarray) -> None:
        self._data.write(positions.data)
        self._bounds.append((positions.min(axis=0).tolist(), positions.max(axis=0).tolist()))

    def _make_json(self) -> str:
        """Describe the binary chunk: views and accessors in the order of the bytes."""
        import pygltflib as gltf

        animation = self._animation
        name, count = animation.name, animation.frame_count
        rest, *targets = [gltf.Attributes(POSITION=1 + k) for k in range(1 + count)]
        shape = gltf.Primitive(attributes=rest, indices=0, targets=targets)
        channel = gltf.AnimationChannel(
            sampler=0, target=gltf.AnimationChannelTarget(node=0, path="weights")
        )
        sampler = gltf.AnimationSampler(input=2 + count, output=3 + count)
        scene = gltf.GLTF2(
            asset=gltf.Asset(generator=f"cageik {__version__}"),
            scene=0,
            scenes=[gltf.Scene(nodes=[0])],
            nodes=[gltf.Node(name=name, mesh=0, **_make_node_transform(animation.scene))],
            meshes=[gltf.Mesh(name=name, primitives=[shape])],
            animations=[gltf.Animation(name=name, channels=[channel], samplers=[sampler])],
            accessors=self._make_accessors(),
            bufferViews=self._make_views(),
            buffers=[gltf.Buffer(byteLength=sum(self._sizes))],
        )
        return str(scene.gltf_to_json(separators=(",", ":"), indent=None))

    def _make_accessors(self) -> list[object]:
        import pygltflib as gltf

        vertices, faces = self._animation.rest.vertices, self._animation.rest.faces
        count, times = self._animation.frame_count, self._compute_times()
        first, last = float(times[0]), float(times[-1])
        number = {"componentType": gltf.FLOAT, "type": gltf.SCALAR}
        corners = gltf.Accessor(
            bufferView=0, componentType=gltf.UNSIGNED_INT, type=gltf.SCALAR, count=faces.size
        )
        positions = [
            gltf.Accessor(
                bufferView=1,
                byteOffset=12 * len(vertices) * k,
                componentType=gltf.FLOAT,
                type=gltf.VEC3,
                count=len(vertices),
                min=low,
                max=high,
            )
            for k, (low, high) in enumerate(self._bounds)
        ]
        times = gltf.Accessor(bufferView=2, count=count, min=[first], max=[last], **number)
        track = gltf.Accessor(bufferView=3, count=count**2, **number)
        return [corners, *positions, times, track]

    def _make_views(self) -> list[object]:
        import pygltflib as gltf

        uses = [
            {"target": gltf.ELEMENT_ARRAY_BUFFER},
            {"target": gltf.ARRAY_BUFFER, "byteStride": 12},
            {},
            {},
        ]
        starts = np.cumsum([0, *self._sizes[:-1]]).tolist()
        return [
            gltf.BufferView(buffer=0, byteOffset=start, byteLength=size, **use)
            for start, size, use in zip(starts, self._sizes, uses, strict=True)
        ]


def _make_node_transform(scene: Scene) -> dict[str, list[float]]:
    """Return the node's transform into metres and y up; empty if the scene has these."""
    placement = {}
    if scene.up_axis == "Z":
        placement["rotation"] = _Z_TO_Y
    if scene.metres_per_unit != 1:
        placement["scale"] = [scene.metres_per_unit] * 3
    return placement
