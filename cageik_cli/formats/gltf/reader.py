"""A clip in glTF: meshes that joints, morph targets or nodes move, at an even rate."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.scene_graph import Polygons, SceneMesh, SceneReader
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.gltf.animation import Animation
from cageik_cli.formats.gltf.document import Document, Item
from cageik_cli.formats.gltf.geometry import Geometry, SurfaceReader, count_targets, has_faces
from cageik_cli.formats.gltf.nodes import INSTANCING, NodeTree, Skin, read_instances
from cageik_cli.formats.settings import SceneHints
from cageik_cli.geometry.attributes import SurfaceAttributes
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, SettingError, error_context, join_truncated
from cageik_cli.util.messages import Said
from cageik_cli.util.text import number_names


class Reader(SceneReader):
    """Frames of the meshes of a scene; times are seconds."""

    suffixes = (".glb", ".gltf")

    def __init__(self, request: ClipRequest) -> None:
        self._member, self._fps = request.member, request.settings.fps
        self._warnings: list[Said] = []
        super().__init__(request)
        self._reading += (self._fps,)

    @classmethod
    def list_members(cls, path: Path) -> list[str]:
        """List the animations, if there are several."""
        names = name_animations(Document(path))
        return names if len(names) > 1 else []

    @classmethod
    def describe_contents(cls, request: ClipRequest) -> list[tuple[str, Said]]:
        """List the animations of a file that has several, if none of them is requested."""
        path = request.path
        with error_context(path):
            names = name_animations(Document(path))
            if len(names) < 2 or choose_animation(names, request.member)[0] is not None:
                return []
        listed = [("animation", name) for name in names]
        return [("holds", f"{len(names)} animations; choose one as FILE::ANIMATION"), *listed]

    def check_file(self, path: Path) -> None:
        """Check nothing, as opening the document does."""

    @contextmanager
    def guard(self) -> Iterator[list[Said]]:
        """Leave values that are not finite to the checks of frames."""
        with np.errstate(all="ignore"):
            yield self._warnings

    def list_meshes(self, path: Path) -> tuple[dict[str, Any], dict[str, str]]:
        """Read the document, and list the nodes that have meshes."""
        self._document = document = Document(path)
        names = name_animations(document)
        number, self._top = choose_animation(names, self._member)
        if number is None and len(names) > 1:
            raise SettingError(
                f"holds {len(names)} animations: {join_truncated(names)}; choose one, as in "
                f"FILE::{names[0]}" + (f"::{self._top}" if self._top else "")
            )
        tree = NodeTree(document)
        mesh_numbers = {
            k: mesh
            for k in tree.list_in_order()
            if (mesh := document.nodes[k].find_integer("mesh", len(document.meshes))) is not None
        }
        items = document.root.list_items("animations")
        self._rig = Rig(document, tree, mesh_numbers, items[number or 0] if items else None)
        self._sampled, self._scene = self._rig.animation.choose_times(self._fps)
        self._warnings += self._rig.animation.notes
        self._geometries: dict[tuple[int, int | None], Geometry] = {}
        found: dict[str, Any] = {}
        hidden: dict[str, str] = {}
        for name, k, instance in self._list_copies(mesh_numbers):
            found[name] = k, mesh_numbers[k], instance
            if not tree.is_shown[k]:
                hidden[name] = "not in the scene, or invisible"
            elif not has_faces(document.meshes[mesh_numbers[k]]):
                hidden[name] = "points or lines"
        return found, hidden

    def _list_copies(self, nodes: Iterable[int]) -> Iterator[tuple[str, int, Floats | None]]:
        """Yield the path of each copy of the meshes of nodes, the node, and the place in it."""
        paths = {k: self._rig.tree.make_path(k) for k in nodes}
        taken = sorted(paths.values())
        for k, path in paths.items():
            node = self._document.nodes[k]
            is_skinned = node.has("skin")
            if is_skinned and node.find_extension(INSTANCING):
                self._warnings.append(f"{path}: its instances are not read, as joints place it")
            instances = None if is_skinned else read_instances(self._document, node)
            if instances is None:
                yield path, k, None
                continue
            prefix = f"{path}/instance_"
            while _has_prefix(taken, prefix):
                prefix += "_"
            for number, instance in enumerate(instances):
                yield f"{prefix}{number}", k, instance

    def find_top(self, member: str | None) -> str | None:
        """Return the path of the nodes that are read, without the name of the animation."""
        return self._top

    def list_times(self, meshes: Sequence[SceneMesh]) -> set[float]:
        """List the times of the frames."""
        return set(self._sampled.tolist())

    def open_mesh(self, found: Any) -> "GltfMesh":
        """Open the mesh of a node; nodes of one mesh and one skin share it."""
        node, mesh, instance = found
        document, rig = self._document, self._rig
        skin = document.nodes[node].find_integer("skin", len(document.skins))
        key = mesh, skin
        if key not in self._geometries:
            with error_context(document.meshes[mesh].place):
                item = document.meshes[mesh]
                self._geometries[key] = Geometry(document, item, rig.find_skin(skin))
        geometry = self._geometries[key]
        document.claim(12 * len(geometry.base))
        return GltfMesh(document, rig, geometry, node, skin=skin, instance=instance)

    def replace_uneven(self, times: Floats) -> tuple[Floats, str]:
        """Return the times, which are even."""
        return times, ""

    def describe_scene(self, times: Floats, step: float | None) -> SceneHints:
        """Return the rate of sampling, and what is true of all glTF files."""
        return self._scene

    @property
    def files(self) -> Sequence[Path]:
        """The document, and the files of its buffers."""
        return self._document.files


class Rig:
    """The nodes of a file, moved by one of its animations.

    Attributes
    ----------
    find_worlds : callable
        Returns the transforms (N, 4, 4) of all nodes at a time, for columns.
    """

    def __init__(
        self, document: Document, tree: NodeTree, mesh_numbers: dict[int, int], item: Item | None
    ) -> None:
        self.tree, self._document = tree, document
        counts = {k: count_targets(document.meshes[mesh]) for k, mesh in mesh_numbers.items()}
        self.animation = Animation(document, tree, item, counts)
        self.mesh_numbers = mesh_numbers
        # The times of the frames that threads read.
        self.find_worlds = lru_cache(8)(
            lambda time: tree.compute_worlds(self.animation.evaluate_nodes(time))
        )
        self._skins: dict[int, Skin] = {}

    def find_skin(self, number: int | None) -> Skin | None:
        """Return a skin by its number."""
        if number is None:
            return None
        if number not in self._skins:
            self._skins[number] = Skin(self._document, number)
        return self._skins[number]


class GltfMesh(SceneMesh):
    """The mesh of a node, or one of its instances there.

    One with a skin is where its joints are: the transform of its own node does not count.
    """

    is_clockwise = False

    def __init__(
        self,
        document: Document,
        rig: Rig,
        geometry: Geometry,
        node: int,
        *,
        skin: int | None,
        instance: Floats | None,
    ) -> None:
        self._instance = instance
        self._document, self._rig, self._geometry, self._node = document, rig, geometry, node
        self._skin = rig.find_skin(skin)
        self._still_weights = np.zeros(geometry.target_count)
        for item in (document.meshes[rig.mesh_numbers[node]], document.nodes[node]):
            weights = item.find_numbers("weights", None)
            if weights is None:
                continue
            if len(weights) != geometry.target_count:
                raise FormatError(
                    f"{item.place} has {len(weights)} weights of {geometry.target_count} morph "
                    "targets; export the file again"
                )
            self._still_weights = weights

    def list_times(self) -> set[float]:
        """List no times, as they are those of the animation."""
        return set()

    def compute_matrix(self, time: float) -> Floats:
        """Return the transform of the node, or none for a skin."""
        if self._skin is not None:
            return np.eye(4)
        world = self._rig.find_worlds(time)[self._node]
        return np.asarray((world if self._instance is None else world @ self._instance).T)

    def has_moving_transform(self) -> bool:
        """Return whether the node, or one above it, is animated."""
        return self._skin is None and any(
            self._rig.animation.moves(k) for k in self._rig.tree.list_above(self._node)
        )

    def read_points(self, time: float) -> Floats:
        """Return the vertices, moved by morph targets and joints."""
        weights = self._rig.animation.evaluate_weights(self._node, time)
        if weights is None:
            weights = self._still_weights
        moves = None
        if self._skin is not None:
            moves = self._skin.compute_moves(self._rig.find_worlds(time))
        return self._geometry.evaluate(weights, moves)

    def list_polygon_times(self) -> list[float]:
        """List nothing, as faces never change."""
        return []

    def read_polygons(self, time: float) -> Polygons:
        """Return the triangles."""
        corners = self._geometry.corners
        return np.full(len(corners) // 3, 3), corners

    def list_surface_layers(
        self, vertex_count: int, time: float
    ) -> dict[str, Callable[[SurfaceAttributes], SurfaceAttributes]]:
        """Return what reads UVs, normals, colours and materials."""
        return SurfaceReader(self._document, self._geometry).list_layers()

    def describe_transform(self, time: float) -> list[str]:
        """Return notes on what was changed, too."""
        return [*super().describe_transform(time), *self._geometry.notes]


def _has_prefix(paths: list[str], prefix: str) -> bool:
    """Return whether one of sorted paths begins with a prefix: the first that is not before it."""
    place = bisect_left(paths, prefix)
    return place < len(paths) and paths[place].startswith(prefix)


def name_animations(document: Document) -> list[str]:
    """Return what a user types for each animation: its name, or its number if that is not clear."""
    names: list[str] = []
    seen: set[str] = set()
    for k, item in enumerate(document.root.list_items("animations")):
        name = item.read_name()
        is_clear = name and name not in seen and "::" not in name and not name.startswith("/")
        names.append(name if is_clear else f"{k}")
        seen.add(names[-1])
    return number_names(names)  # a number may be the name of another


def choose_animation(names: list[str], member: str | None) -> tuple[int | None, str | None]:
    """Return the number of the animation that is read, and the path that nodes are below.

    Parameters
    ----------
    member : str, optional
        `ANIMATION`, `/node/path`, or `ANIMATION::/node/path`; an animation by name or number. A
        text that is none of these is a part where there is no choice of animations.

    Raises
    ------
    SettingError
        When there is no such animation among several.
    """
    if member is None:
        return None, None
    typed, _, top = member.partition("::")
    if typed.startswith("/"):
        return None, member
    if typed in names:
        return names.index(typed), top or None
    if typed.isdecimal() and int(typed[:9]) < len(names):
        return int(typed), top or None
    if len(names) < 2:
        return None, member
    raise SettingError(
        f"holds no animation `{typed}`; choose one of {join_truncated(names)}; parts are named "
        f"behind it, as in ::{names[0]}::{typed}"
    )
