"""What a shader makes of a folder of textures, written apart from the writer."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pygltflib

TYPES = {5126: np.dtype("<f4"), 5125: np.dtype("<u4"), 5123: np.dtype("<u2")}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def read_png(path):
    """The pixels of a PNG of 16 bits, (h, w, 3), from 0 to 1."""
    import png

    width, height, rows, info = png.Reader(bytes=path.read_bytes()).read()
    assert (info["bitdepth"], info["planes"], info["alpha"]) == (16, 3, False)
    assert "gamma" not in info
    return np.array([np.asarray(row) for row in rows]).reshape(height, width, 3) / 65535


def read_exr(path):
    """The pixels of an OpenEXR file of float32, (h, w, 3)."""
    import OpenEXR

    pixels = OpenEXR.File(str(path)).channels()["RGB"].pixels
    assert pixels.dtype == np.float32
    return pixels


@dataclass
class Drawn:
    """Triangles of a primitive (t, 3), and their vertices in each frame, (F, k, 3) each."""

    name: str
    material: str
    faces: np.ndarray
    rest: np.ndarray
    rest_normals: np.ndarray
    positions: np.ndarray
    normals: np.ndarray


def draw(folder: Path) -> list[Drawn]:
    """Draw all frames of all meshes in a folder, in metres with y up, one texel per look-up."""
    (mesh_path,) = folder.glob("*.glb")
    name = mesh_path.stem
    (moves_path,) = folder.glob(f"{name}_vat.*")
    read = {".png": read_png, ".exr": read_exr}[moves_path.suffix]
    moves = read(moves_path)
    turns = read(folder / f"{name}_vnrm{moves_path.suffix}")
    remap = json.loads((folder / f"{name}-remap_info.json").read_text())["os-remap"]
    low, high = np.array(remap["Min"]), np.array(remap["Max"])
    file = pygltflib.GLTF2.load(mesh_path)
    blob = file.binary_blob()

    def array(number):
        accessor = file.accessors[number]
        view = file.bufferViews[accessor.bufferView]
        width = WIDTHS[accessor.type]
        count = accessor.count * width
        return np.frombuffer(
            blob, TYPES[accessor.componentType], count, view.byteOffset or 0
        ).reshape(-1, width)

    def look_up(image, uvs, frame):
        height, width = image.shape[:2]
        x, y = uvs[:, 0] * width, (uvs[:, 1] + frame / height) * height
        return image[np.floor(y).astype(int), np.floor(x).astype(int)]

    def turn_up(vectors):
        x, y, z = vectors.T
        return np.stack([x, z, -y], axis=1)

    drawn = []
    for node in file.nodes:
        assert (node.rotation, node.scale, node.translation, node.matrix) == (None,) * 4
        for part in [] if node.mesh is None else file.meshes[node.mesh].primitives:
            uvs, rest = array(part.attributes.TEXCOORD_1), array(part.attributes.POSITION)
            frames = range(remap["Frames"])
            offsets = [low + look_up(moves, uvs, k) * (high - low) for k in frames]
            normals = [turn_up(2 * look_up(turns, uvs, k) - 1) for k in frames]
            drawn.append(
                Drawn(
                    file.meshes[node.mesh].name,
                    file.materials[part.material].name,
                    array(part.indices).reshape(-1, 3).astype(int),
                    rest.astype(float),
                    array(part.attributes.NORMAL).astype(float),
                    np.array([rest + turn_up(each) for each in offsets]),
                    np.array([each / np.linalg.norm(each, axis=1)[:, None] for each in normals]),
                )
            )
    return drawn
