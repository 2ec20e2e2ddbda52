"""A mesh animation as textures: offsets from the rest pose, and normals.

Programs with y up turn them as they read them, by the rule of OpenVAT: (x, y, z) of a texture is
(x, z, -y) of the mesh, whose vertices are in metres with y up.
"""

import json
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.writers import (
    Animation,
    AnimationWriter,
    choose_short_names,
    to_float32,
)
from cageik_cli.formats.gltf.file import GlbFile, VectorSpool
from cageik_cli.formats.gltf.nodes import make_part_nodes
from cageik_cli.formats.gltf.surface import cut_surface
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import SceneHints
from cageik_cli.formats.vat.images import PNG_MAX, write_exr, write_png
from cageik_cli.formats.vat.layout import SAFE_SIDE, TextureLayout
from cageik_cli.geometry.shape import shade_smoothly
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import require_optional
from cageik_cli.util.text import group_digits

TO_TEXTURE = SceneConversion(axes=("Y", "Z"))
"""From the mesh to the axes of textures, which are those of Blender."""

IMAGES = {"png": write_png, "exr": write_exr}


class Writer(AnimationWriter):
    """A folder with a `.glb` of the rest pose, two textures, and JSON with what shaders need.

    The first texture has offsets from the rest pose: those of all frames are from 0 to 1 between
    the bounds in the JSON. The second has normals, halved and raised by a half. The second UVs of
    the mesh name the texel of a vertex in the first frame. Vertices at which only UVs or materials
    differ share a texel. Frames are kept in temporary files, and textures are written row by row.
    """

    suffixes = (".vat",)
    is_single = True
    keeps_parts = True
    states_unit = True
    space = SceneHints(up_axis="Y", metres_per_unit=1.0)  # of the mesh, as glTF has it

    @classmethod
    def name_files(cls, name: str) -> tuple[str, ...]:
        """Return the names that files in the folder may have."""
        images = [f"{name}_{kind}.{suffix}" for kind in ("vat", "vnrm") for suffix in IMAGES]
        return (f"{name}.glb", f"{name}-remap_info.json", *images)

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without pygltflib."""
        with require_optional("pygltflib", "writing .vat"):
            import pygltflib  # noqa: F401

    def __init__(self, target: Path, animation: Animation) -> None:
        self._folder, self._name = target.parent, target.stem
        self._conversion = SceneConversion.of_output(animation.scene, self.space)
        self._animation = self._conversion.convert_animation(animation)
        rest = shade_smoothly(self._animation.rest)
        self._rest = to_float32(rest.vertices).astype(np.float64)
        self._surface = cut_surface(rest, has_normals=True)
        assert self._surface.fans is not None
        pairs = np.stack([self._surface.origins, self._surface.fans], axis=1)
        _, self._chosen, self._columns = np.unique(
            pairs, axis=0, return_index=True, return_inverse=True
        )
        self._layout = TextureLayout.choose(len(self._chosen), animation.frame_count)
        # Of offsets in the axes of the texture, and of positions in those of the mesh.
        self._bounds = [np.full((2, 3), [[np.inf], [-np.inf]]) for _ in range(2)]
        beside = self._folder.parent  # as all in the folder is kept
        with ExitStack() as stack:
            self._moves, self._normals = (VectorSpool(beside, len(self._chosen)) for _ in range(2))
            for spool in (self._moves, self._normals):
                stack.callback(spool.close)
            self._file = GlbFile(self._folder / f"{self._name}.glb", beside)
            stack.callback(self._file.close)
            self._open = stack.pop_all()

    def append(self, frames: Floats) -> None:
        """Keep the next frames."""
        origins = self._surface.origins[self._chosen]
        for positions in self._conversion.apply(frames):
            moves = to_float32(TO_TEXTURE.apply((positions - self._rest)[origins]))
            self._moves.append(moves)
            normals = self._surface.compute_normals(positions)[self._chosen]
            self._normals.append(TO_TEXTURE.apply(normals).astype(np.float32))
            for bounds, rows in zip(self._bounds, (moves, positions[origins]), strict=True):
                np.minimum(bounds[0], rows.min(axis=0), out=bounds[0])
                np.maximum(bounds[1], rows.max(axis=0), out=bounds[1])

    def complete(self) -> None:
        """Write all files."""
        low, high = self._bounds[0]
        extent = np.where(high > low, high - low, 1.0)
        suffix, size = self._animation.texture, (self._layout.width, self._layout.height)
        for kind, spool, base, scale in (
            ("vat", self._moves, low, extent),
            ("vnrm", self._normals, -np.ones(3), np.full(3, 2.0)),
        ):
            rows = (
                ((spool.read_part(frame, start, stop) - base) / scale).clip(0, 1)
                for frame, start, stop in self._layout.list_rows()
            )
            IMAGES[suffix](self._folder / f"{self._name}_{kind}.{suffix}", size, rows)
        self._write_mesh()
        self._write_remap_info()
        self._note(high - low)
        self._open.close()

    def _write_mesh(self) -> None:
        """Write the rest pose, a mesh and a node per part, whose transforms are the identity."""
        import pygltflib as gltf

        names = [part.name for part in self._animation.split()]
        nodes, tops, _ = make_part_nodes(names)
        meshes = [gltf.Mesh(name=name) for name in choose_short_names(names)]
        texels = self._layout.locate(self._columns).astype(np.float32)
        normals = self._surface.compute_normals(self._rest).astype(np.float32)
        places = self._rest[self._surface.origins].astype(np.float32)
        for part in self._surface.primitives:
            own = slice(part.start, part.stop)
            add = partial(self._file.add_array, use=gltf.ARRAY_BUFFER)
            attributes = {
                "POSITION": add(places[own], bounds=True),
                "NORMAL": add(normals[own]),
                "TEXCOORD_1": add(texels[own]),
            }
            if "uvs" not in self._surface.layers:  # which glTF wants before the second ones
                attributes["TEXCOORD_0"] = add(np.zeros_like(texels[own]))
            primitive = self._surface.write_primitive(self._file, part, attributes)
            meshes[part.part].primitives.append(primitive)
        self._file.complete(
            scene=0,
            scenes=[gltf.Scene(nodes=tops)],
            nodes=nodes,
            meshes=meshes,
            materials=self._surface.make_materials(),
        )

    def _write_remap_info(self) -> None:
        """Write what a shader needs, by the names of OpenVAT, and what else an engine wants."""
        offsets, positions = (
            dict(zip(("Min", "Max"), bounds.tolist(), strict=True)) for bounds in self._bounds
        )
        layout, scene = self._layout, self._animation.scene
        clip = {
            "startFrame": 0,
            "endFrame": layout.frame_count - 1,
            "framerate": scene.fps / scene.frame_step,
            "looping": True,
        }
        info = {
            "os-remap": {**offsets, "Frames": layout.frame_count},
            "animations": {self._animation.name: clip},
            "cageik": {
                "Vertices": layout.vertex_count,
                "Width": layout.width,
                "Height": layout.height,
                "Bounds": positions,
            },
        }
        text = json.dumps(info, indent=4) + "\n"
        (self._folder / f"{self._name}-remap_info.json").write_text(text, encoding="utf-8")

    def _note(self, extent: Floats) -> None:
        """Note sizes and the error of rounding."""
        layout, diagonal = self._layout, self._animation.rest.diagonal
        size = f"{layout.width} × {layout.height} texels"
        written, whole = len(self._columns), len(self._rest)
        if self._animation.texture == "png" and diagonal:
            error = 100 * float(np.linalg.norm(extent)) / PNG_MAX / 2 / diagonal
            size += f", which round positions by up to {error:.2g} % of the diagonal"
        self.notes += (f"two textures of {size}",)
        if written != whole:
            self.notes += (
                f"{group_digits(whole)} vertices are {group_digits(written)} in the mesh and "
                f"{group_digits(layout.vertex_count)} in the textures, split where texture "
                "coordinates, normals or materials differ",
            )
        if max(layout.width, layout.height) > SAFE_SIDE:
            self.notes += (
                f"a side has more than {SAFE_SIDE} texels, which many phones do not read; "
                "write fewer frames for these",
            )
