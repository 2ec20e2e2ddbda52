"""A cage animation as a skinned glTF: a joint per cage vertex, cage weights as skin weights."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.skin import JointMotion, Skin, SkinWeights
from cageik_cli.formats.base.writers import Animation, choose_short_names, to_float32
from cageik_cli.formats.gltf_file import GlbWriter, Singles
from cageik_cli.formats.gltf_nodes import make_part_nodes
from cageik_cli.formats.gltf_surface import cut_surface
from cageik_cli.geometry.parts import split_parts
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError

SET_SIZE = 4
"""Joints per vertex in one set of attributes; programs read one set or two."""

MAX_INFLUENCES = 2 * SET_SIZE
"""Joints per vertex that programs read."""


class SkeletonWriter(GlbWriter):
    """Writes the rest mesh, skinned to joints below a root, where `JointMotion` has them.

    There are no normals if joints only translate, which would leave them as they are at rest.
    """

    def __init__(self, target: Path, animation: Animation, skin: Skin) -> None:
        """Start writing the animation of a cage, whose `rest` is the rest cage, to `target`."""
        count = skin.weights.joints.shape[1]
        if count > MAX_INFLUENCES:
            raise OutputError(
                f"up to {count} joints move a vertex, and programs read at most {MAX_INFLUENCES} "
                "from .glb; give `influences=4`, or 8"
            )
        super().__init__(target, animation)
        self._skin = skin
        if count > SET_SIZE:
            self.notes += (
                f"three.js and other viewers read {SET_SIZE} joints per vertex, and leave out the "
                f"weaker ones; `influences={SET_SIZE}` is fitted to that",
            )
        self._vertices = to_float32(skin.rest.vertices - np.array(animation.origin))
        self._motion = JointMotion(animation.rest, skin)
        self._turns: list[Singles] = []
        (self._places,) = self.open_file(len(self._motion.names), spool_count=1)

    def append(self, frames: Floats) -> None:
        """Keep the cages of the next k frames, (k, n, 3)."""
        for places, turns in self._motion.advance(frames):
            self._places.append(to_float32(places))
            self._turns.append(turns.astype(np.float32))

    def complete(self) -> None:
        """Compose the file: nodes of the parts, what turns z up, the root joint, its children."""
        import pygltflib as gltf

        names = [part.name or "mesh" for part in split_parts(self._skin.rest)]
        nodes, tops, _ = make_part_nodes(names, 0, skin=0)
        self._root = len(nodes) + 1
        primitives, materials = self._cut_mesh()
        meshes = [
            gltf.Mesh(name=name, primitives=primitives[k])
            for k, name in enumerate(choose_short_names(names))
        ]
        self._file.complete(
            scene=0,
            scenes=[gltf.Scene(nodes=[*tops, len(nodes)])],
            nodes=[*nodes, *self._make_nodes()],
            meshes=meshes,
            materials=materials,
            skins=[self._write_skin()],
            animations=[self.make_animation(**self._write_motion())],
        )
        self._open.close()

    def _cut_mesh(self) -> tuple[dict[int, list[Any]], list[object]]:
        """Write the mesh with its weights; return the primitives of each part, and materials."""
        import pygltflib as gltf

        rest, is_shaded = self._skin.rest, self._skin.turns is not None
        surface = cut_surface(rest, has_normals=is_shaded)
        sets = _make_sets(self._skin.weights)
        normals = to_float32(surface.compute_normals(rest.vertices)) if is_shaded else None
        primitives: dict[int, list[Any]] = {}
        for primitive in surface.primitives:
            chosen = surface.origins[primitive.start : primitive.stop]
            attributes = {}
            for name, values in {"POSITION": self._vertices, **sets}.items():
                is_place = name == "POSITION"
                rows = values[chosen]
                attributes[name] = self._file.add_array(rows, gltf.ARRAY_BUFFER, bounds=is_place)
            if normals is not None:
                rows = normals[primitive.start : primitive.stop]
                attributes["NORMAL"] = self._file.add_array(rows, gltf.ARRAY_BUFFER)
            written = surface.write_primitive(self._file, primitive, attributes)
            primitives.setdefault(primitive.part, []).append(written)
        return primitives, surface.make_materials()

    def _make_nodes(self) -> list[object]:
        import pygltflib as gltf

        names, places = self._motion.names, to_float32(self._motion.rest_translations).tolist()
        joints = [
            gltf.Node(name=name, translation=place)
            for name, place in zip(names, places, strict=True)
        ]
        joints[0].children = list(range(self._root + 1, self._root + len(names)))
        transform = self.make_node_transform()
        return [
            gltf.Node(name=self._animation.name, children=[self._root], **transform),
            *joints,
        ]

    def _write_skin(self) -> object:
        import pygltflib as gltf

        places = self._motion.bind_places
        matrices = np.tile(np.eye(4), (len(places), 1, 1))
        matrices[:, 3, :3] = -places  # glTF has them column by column
        inverse = self._file.add_array(to_float32(matrices.reshape(-1, 16)))
        joints = list(range(self._root, self._root + len(places)))
        return gltf.Skin(inverseBindMatrices=inverse, skeleton=self._root, joints=joints)

    def _write_motion(self) -> dict[str, list[object]]:
        """Write the translations of all joints, and the rotations of those that turn."""
        import pygltflib as gltf

        times = self.add_times()
        channels: list[object] = []
        samplers: list[object] = []

        def add(node: int, path: str, values: NDArray[Any]) -> None:
            output = self._file.add_array(values.astype(np.float32))
            target = gltf.AnimationChannelTarget(node=node, path=path)
            channels.append(gltf.AnimationChannel(sampler=len(samplers), target=target))
            samplers.append(gltf.AnimationSampler(input=times, output=output))

        for k, turns in enumerate(np.stack(self._turns, axis=1), start=self._root):
            add(k, "rotation", turns)
        for first, block in self._places.read_blocks(0, len(self._motion.names)):
            places = block.reshape(len(block), -1, 3).swapaxes(0, 1)
            for k, moves in enumerate(places, start=self._root + first):
                add(k, "translation", moves)
        return {"channels": channels, "samplers": samplers}


def _make_sets(weights: SkinWeights) -> dict[str, NDArray[Any]]:
    """Return the joints and weights (m, 4) of each set; the root is joint 0, and weighs nothing."""
    m, count = weights.joints.shape
    joint_count = int(weights.joints.max()) + 2
    kind = np.uint8 if joint_count <= 256 else np.uint16
    joints = np.zeros((m, count + -count % SET_SIZE), kind)
    values = np.zeros(joints.shape, np.float32)
    values[:, :count] = weights.values
    joints[:, :count] = np.where(values[:, :count] > 0, weights.joints + 1, 0)
    sets: dict[str, NDArray[Any]] = {}
    for k in range(joints.shape[1] // SET_SIZE):
        columns = slice(SET_SIZE * k, SET_SIZE * (k + 1))
        sets |= {f"JOINTS_{k}": joints[:, columns], f"WEIGHTS_{k}": values[:, columns]}
    return sets
