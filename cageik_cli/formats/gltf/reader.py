"""A clip in glTF: meshes that joints, morph targets or nodes move, at an even rate.

Samplers of an animation give values at keys and between them, and the frames that it is sampled at.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import floor
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.mesh_data import Change, FileMesh, LayerReaders
from cageik_cli.formats.base.scene_graph import Polygons, SceneMesh, SceneReader, find_step, snap
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.gltf.document import (
    Document,
    Item,
    TrialWanted,
    Watch,
    count_rows,
    read_floats,
)
from cageik_cli.formats.gltf.geometry import Geometry, count_targets, has_faces
from cageik_cli.formats.gltf.nodes import INSTANCING, TRS_WIDTHS, NodeTree, Skin, read_instances
from cageik_cli.formats.gltf.surface import list_surface_layers
from cageik_cli.formats.settings import GLTF_RATE_KEY, SceneHints
from cageik_cli.formats.timeline import MAX_TIMELINE_NUMBER
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import (
    MAX_LISTED,
    FormatError,
    SettingError,
    error_context,
    join_truncated,
)
from cageik_cli.util.messages import Hint, Said, say
from cageik_cli.util.text import number_names
from cageik_cli.util.trial import trials

DEFAULT_SAMPLING_RATE = 24.0
"""Frames per second at which animations are sampled, as glTF states none."""

MAX_SAMPLED_TIMES = 100_000
"""Frames between the first and the last key."""

KEY_TOL = 1e-6
"""Times this near to a key, of it or of a second, are at the key: files have single precision.

That is at most a tenth of a frame, and of the way to another key: mocap may count from midnight.
"""

MAX_UNTRIED_SECONDS = 5.0
"""Seconds of a processor, besides those for its size, in which a file is opened without a trial."""

CHANNEL_BYTES = 500
"""Memory of what animates a value of a node, besides its keys."""

_INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")


class Reader(SceneReader):
    """Frames of the meshes of a scene; times are seconds."""

    suffixes = (".glb", ".gltf")

    def __init__(self, request: ClipRequest) -> None:
        self._member, self._fps = request.member, request.settings.fps
        self._warnings: list[Said] = []
        self._watch = Watch(MAX_UNTRIED_SECONDS) if trials.are_wanted else Watch()
        try:
            super().__init__(request)
        except TrialWanted:
            with error_context(request.path):
                self.try_first(request, "cageik")
            self._warnings, self._watch = [], Watch()
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

    @contextmanager
    def guard(self) -> Iterator[list[Said]]:
        """Leave values that are not finite to the checks of frames."""
        with np.errstate(all="ignore"):
            yield self._warnings

    def list_meshes(self, path: Path) -> tuple[dict[str, Any], dict[str, str]]:
        """Read the document, and list the nodes that have meshes."""
        self._document = document = Document(path, self._watch)
        self.claimed = document.claimed
        if document.left_out:
            self._warnings.append(
                "needs extensions that move no vertex and are not kept: "
                + join_truncated(document.left_out)
            )
        names = name_animations(document)
        number, self._top = choose_animation(names, self._member)
        if number is None and len(names) > 1:
            raise SettingError(
                f"holds {len(names)} animations: {join_truncated(names, MAX_LISTED)}; choose "
                "one, as in "
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
        faceless = {k for k in set(mesh_numbers.values()) if not has_faces(document.meshes[k])}
        for name, k, instance in self._list_copies(mesh_numbers):
            found[name] = k, mesh_numbers[k], instance
            if not tree.is_shown[k]:
                hidden[name] = "not in the scene, or invisible"
            elif mesh_numbers[k] in faceless:
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
        document.claimed.claim_copy(12 * len(geometry.base))
        return GltfMesh(document, rig, geometry, node, skin=skin, instance=instance)

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
    is_moved : (N,) bool
        Whether each node, or one above it, is animated.
    """

    def __init__(
        self, document: Document, tree: NodeTree, mesh_numbers: dict[int, int], item: Item | None
    ) -> None:
        self.tree, self._document = tree, document
        counts = {mesh: count_targets(document.meshes[mesh]) for mesh in set(mesh_numbers.values())}
        counts = {k: counts[mesh] for k, mesh in mesh_numbers.items()}
        self.animation = Animation(document, tree, item, counts)
        self.mesh_numbers, self._target_counts = mesh_numbers, counts
        is_moved = np.zeros(len(document.nodes), bool)
        is_moved[self.animation.list_moved()] = True
        self.is_moved = tree.mark_below(is_moved)
        # The times of the frames that threads read.
        self.find_worlds = lru_cache(8)(
            lambda time: tree.compute_worlds(self.animation.evaluate_nodes(time))
        )
        self._skins: dict[int, Skin] = {}
        self._still_weights: dict[int, Floats] = {}
        self._moves: dict[int, Callable[[float], Floats]] = {}

    def find_moves(self, skin: int, time: float) -> Floats:
        """Return what moves a vertex with each joint of a skin, (J, 4, 4), for all its meshes."""
        if skin not in self._moves:
            found = self._skins[skin]
            self._moves[skin] = lru_cache(8)(
                lambda time: found.compute_moves(self.find_worlds(time))
            )
        return self._moves[skin](time)

    def find_weights(self, node: int) -> Floats:
        """Return the weights of the morph targets of a node that no animation moves, (K,)."""
        mesh, count = self.mesh_numbers[node], self._target_counts[node]
        if mesh not in self._still_weights:
            stated = _read_weights(self._document.meshes[mesh], count)
            self._still_weights[mesh] = np.zeros(count) if stated is None else stated
        own = _read_weights(self._document.nodes[node], count)
        return self._still_weights[mesh] if own is None else own

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
        self._skin = skin
        self._still_weights = rig.find_weights(node)

    def compute_matrix(self, time: float) -> Floats:
        """Return the transform of the node, or none for a skin."""
        if self._skin is not None:
            return np.eye(4)
        world = self._rig.find_worlds(time)[self._node]
        return np.asarray((world if self._instance is None else world @ self._instance).T)

    def has_moving_transform(self) -> bool:
        """Return whether the node, or one above it, is animated."""
        return self._skin is None and bool(self._rig.is_moved[self._node])

    def read_points(self, time: float) -> Floats:
        """Return the vertices, moved by morph targets and joints."""
        weights = self._rig.animation.evaluate_weights(self._node, time)
        if weights is None:
            weights = self._still_weights
        moves = None
        if self._skin is not None:
            moves = self._rig.find_moves(self._skin, time)
        return self._geometry.evaluate(weights, moves)

    def read_mesh(self, points: Floats, time: float) -> FileMesh:
        """Return the mesh with these points; copies of a mesh share all else of it."""
        is_mirrored, shared = self.is_mirrored(time), self._geometry.surfaces
        if is_mirrored not in shared:
            shared[is_mirrored] = super().read_mesh(points, time)
        return replace(shared[is_mirrored], vertices=points)

    def read_polygons(self, time: float) -> Polygons:
        """Return the triangles."""
        corners = self._geometry.corners
        return np.full(len(corners) // 3, 3), corners

    def list_surface_layers(self, vertex_count: int, time: float) -> LayerReaders:
        """Return what reads UVs, normals, colours and materials."""
        return list_surface_layers(self._document, self._geometry)

    def describe_transform(self, time: float) -> list[str | Change]:
        """Return notes on what was changed, too."""
        return [*super().describe_transform(time), *self._geometry.notes]


def _read_weights(item: Item, count: int) -> Floats | None:
    """Return the weights of morph targets that a mesh or a node states, (count,), if it does."""
    weights = item.find_numbers("weights", None)
    if weights is not None and len(weights) != count:
        raise FormatError(
            f"{item.place} has {len(weights)} weights of {count} morph targets; export the file "
            "again"
        )
    return weights


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
        f"holds no animation `{typed}`; choose one of {join_truncated(names, MAX_LISTED)}; parts "
        "are named "
        f"behind it, as in ::{names[0]}::{typed}"
    )


@dataclass(frozen=True, eq=False)
class Sampler:
    """Values at keys, and between them.

    Attributes
    ----------
    keys : (k,) float64
        Seconds, ascending; a time that is there twice is a jump.
    values : (k, width) or (k, 3, width) float64
        The latter of splines: in-tangent, value, out-tangent.
    is_rotation : bool
        Whether values are quaternions, which turn at an even speed on the shorter way.
    """

    keys: Floats
    values: Floats
    interpolation: str
    is_rotation: bool

    def evaluate(self, time: float) -> Floats:
        """Return the value at a time, (width,); before the first key and after the last, theirs."""
        k, part = self._locate(time)
        if self.interpolation == "CUBICSPLINE":
            return self._evaluate_spline(k, part)
        if part == 0 or self.interpolation == "STEP":
            return np.asarray(self.values[k])
        start, stop = self.values[k], self.values[k + 1]
        if self.is_rotation:
            return turn_between(start, stop, part)
        return np.asarray(start + part * (stop - start))

    def _locate(self, time: float) -> tuple[int, float]:
        """Return the last key that is not after a time, and the part of the way to the next."""
        keys = self.keys
        tolerance = find_tolerance(time, self._shortest_step)
        k = int(np.searchsorted(keys, time + tolerance, "right")) - 1
        if k < 0 or k == len(keys) - 1 or time - keys[k] <= tolerance:
            return max(k, 0), 0.0
        return k, float((time - keys[k]) / (keys[k + 1] - keys[k]))

    @cached_property
    def _shortest_step(self) -> float:
        steps = np.diff(self.keys)
        return float(steps.min(initial=np.inf, where=steps > 0))

    def _evaluate_spline(self, k: int, t: float) -> Floats:
        value = self.values[k, 1]
        if t == 0:
            return np.asarray(value)
        step, after = self.keys[k + 1] - self.keys[k], self.values[k + 1]
        t2, t3 = t * t, t * t * t
        return np.asarray(
            (2 * t3 - 3 * t2 + 1) * value
            + step * (t3 - 2 * t2 + t) * self.values[k, 2]
            + (3 * t2 - 2 * t3) * after[1]
            + step * (t3 - t2) * after[0]
        )


def find_tolerance(time: float, step: float) -> float:
    """Return how near to a time a key is at it; a step is that of keys, or of frames."""
    return min(KEY_TOL * max(1.0, abs(time)), 0.1 * step)


def turn_between(start: Floats, stop: Floats, part: float) -> Floats:
    """Return the quaternion (4,) a part of the shorter way from one to another."""
    start, stop = (one / (np.linalg.norm(one) or 1.0) for one in (start, stop))
    if start @ stop < 0:
        stop = -stop
    # The half angle between them from both chords, as the arc cosine is inexact near 0.
    angle = 2 * np.arctan2(np.linalg.norm(stop - start), np.linalg.norm(stop + start))
    if np.sin(angle) < 1e-12:
        return np.asarray(start + part * (stop - start))
    return np.asarray(
        (np.sin((1 - part) * angle) * start + np.sin(part * angle) * stop) / np.sin(angle)
    )


class Animation:
    """What one of the animations of a file moves; None moves nothing.

    Attributes
    ----------
    notes : list of str or Text
        What is not read.
    """

    def __init__(
        self, document: Document, tree: NodeTree, item: Item | None, target_counts: dict[int, int]
    ) -> None:
        """Read the channels.

        Parameters
        ----------
        target_counts : dict
            How many morph targets the mesh of each node has, by the number of the node.
        """
        self._document, self._tree, self._target_counts = document, tree, target_counts
        self._item = item
        self._samplers: dict[tuple[int, str], Sampler] = {}
        self.notes: list[Said] = []
        self._read: dict[tuple[int, str, int], Sampler] = {}
        others: set[str] = set()
        channels = () if item is None else item.list_items("channels")
        document.claim_objects(len(channels), "animated values", CHANNEL_BYTES)
        for channel in channels:
            target = channel.find_item("target")
            node = None if target is None else target.find_integer("node", len(document.nodes))
            path = "" if target is None else target.read_text("path")
            if node is None or path not in {*TRS_WIDTHS, "weights"}:
                others.add(path)
                continue
            self._add_channel(channel, node, path)
        if others:
            self.notes.append("channels that move no node are left out")
        if any((np.diff(each.keys) == 0).any() for each in self._read.values()):
            self.notes.append("some keys are at the same time, where values jump")

    def list_moved(self) -> list[int]:
        """List the nodes whose place is animated."""
        return [node for node, path in self._samplers if path in TRS_WIDTHS]

    def evaluate_nodes(self, time: float) -> dict[str, Floats]:
        """Return the values of all nodes at a time, for `NodeTree.compute_worlds`."""
        found = {name: values.copy() for name, values in self._tree.values.items()}
        for (node, path), sampler in self._samplers.items():
            if path in found:
                found[path][node] = sampler.evaluate(time)
        return found

    def evaluate_weights(self, node: int, time: float) -> Floats | None:
        """Return the weights of the morph targets of a node at a time; None if not animated."""
        sampler = self._samplers.get((node, "weights"))
        return None if sampler is None else sampler.evaluate(time)

    def choose_times(self, fps: float | None) -> tuple[Floats, SceneHints]:
        """Return the times of the frames, (F,), and what that says of the scene.

        They are from the first to the last key, which is included to rounding. Without keys there
        is one frame, without a number.

        Parameters
        ----------
        fps : float, optional
            What cageik states in its own files if absent, or else `DEFAULT_SAMPLING_RATE`.

        Raises
        ------
        SettingError
            When there are too many.
        """
        keys = [each.keys for each in self._read.values()]
        if not keys:
            return np.zeros(1), SceneHints(up_axis="Y", metres_per_unit=1.0)
        first = min(float(each[0]) for each in keys)
        last = max(float(each[-1]) for each in keys)
        rate, step, stated_start = _find_stated_rate(self._item)
        if fps is not None and fps != rate:
            rate, step, stated_start = fps, 1.0, None
        tolerance = find_tolerance(max(abs(first), abs(last)), step / rate) * rate
        start = first * rate
        if abs(start - round(start)) <= tolerance:
            start = float(round(start))
        start = snap(start)
        span = (last * rate - start + tolerance) / step
        count = max(1, floor(min(span, MAX_SAMPLED_TIMES)) + 1)
        if count > MAX_SAMPLED_TIMES:
            raise SettingError(
                f"its keys are from {first:g} to {last:g} s, which is {span:.0f} frames at "
                f"{rate:g} per second, expected at most {MAX_SAMPLED_TIMES}; "
                + say("give a lower `fps=`")
            )
        if fps is None:
            self._note_other_rate(np.unique(np.concatenate(keys)), rate / step)
        number = start if stated_start is None else stated_start
        hints = SceneHints(rate, number, "Y", 1.0, None if step == 1 else step)
        return np.asarray((start + step * np.arange(count)) / rate), hints

    def _note_other_rate(self, keys: Floats, fps: float) -> None:
        """Note even keys between which the frames fall."""
        step = find_step(keys) if len(keys) > 2 else None
        rate = 0.0 if step is None else round(1 / step, 3)
        if rate and abs(fps / rate - round(fps / rate)) > KEY_TOL:
            self.notes.append(
                f"its keys are {rate:g} per second, and it is sampled at {fps:g}; "
                + Hint("fps", f"{rate:g}")
                + " takes the keys as they are"
            )

    def _add_channel(self, channel: Item, node: int, path: str) -> None:
        width = TRS_WIDTHS.get(path) or self._target_counts.get(node, 0)
        if not width:
            self.notes.append(f"nodes[{node}] has no morph targets for its animated weights")
            return
        if (node, path) in self._samplers:
            raise FormatError(
                f"{channel.place} moves {path} of nodes[{node}] a second time; export the file "
                "again"
            )
        if path in TRS_WIDTHS and node in self._tree.matrices:
            raise FormatError(
                f"nodes[{node}] has a matrix, and its {path} is animated, expected translation, "
                "rotation and scale; export it again"
            )
        assert self._item is not None
        samplers = self._item.list_items("samplers")
        number = channel.read_integer("sampler", len(samplers))
        known = number, path, width
        if known not in self._read:
            self._read[known] = self._read_sampler(samplers[number], path, width)
        self._samplers[node, path] = self._read[known]

    def _read_sampler(self, item: Item, path: str, width: int) -> Sampler:
        document = self._document
        interpolation = item.read_text("interpolation") or "LINEAR"
        if interpolation not in _INTERPOLATIONS:
            expected = f"one of {', '.join(_INTERPOLATIONS)}"
            raise item.make_error("interpolation", interpolation, expected)
        count = len(document.accessors)
        keys = read_floats(document, item.read_integer("input", count), (1,), needs_float=True)
        document.claim(8 * len(keys))
        keys = keys[:, 0].astype(np.float64)
        late = np.flatnonzero(np.diff(keys) < 0)
        if not np.isfinite(keys).all() or len(late):
            where = f"key {late[0] + 1} is at {keys[late[0] + 1]:g} s, after" if len(late) else ""
            why = f"{where} one at {keys[late[0]]:g} s" if where else "they are not all finite"
            raise FormatError(
                f"{item.locate('input')} are not ascending times ({why}); export the file again"
            )
        output = item.read_integer("output", count)
        is_spline = interpolation == "CUBICSPLINE"
        widths = (width,) if path in TRS_WIDTHS else (1,)
        per_key = (3 if is_spline else 1) * (1 if path in TRS_WIDTHS else width)
        if count_rows(document, output) != len(keys) * per_key:
            raise FormatError(
                f"{item.locate('output')} has {count_rows(document, output)} values, expected "
                f"{len(keys) * per_key} for {len(keys)} keys; export the file again"
            )
        values = read_floats(document, output, widths)
        document.claim(8 * values.size)
        values = values.astype(np.float64)
        if not np.isfinite(values).all():
            raise FormatError(
                f"{item.locate('output')} has values that are not finite; export it again"
            )
        shape = (len(keys), 3, width) if is_spline else (len(keys), width)
        return Sampler(keys, values.reshape(shape), interpolation, path == "rotation")


def _find_stated_rate(item: Item | None) -> tuple[float, float, float | None]:
    """Return the frames per second, and step and first of frame numbers that cageik has written.

    A file without the first has its frames at the times of their numbers.
    """
    extras = None if item is None else item.values.get("extras")
    stated = extras.get(GLTF_RATE_KEY) if isinstance(extras, dict) else None
    if isinstance(stated, list) and len(stated) in (2, 3):
        rate, step, *start = stated
        is_number = all(isinstance(x, int | float) for x in stated)
        if is_number and all(0 < x < MAX_SAMPLED_TIMES for x in (rate, step)):
            is_late = start and abs(start[0]) >= MAX_TIMELINE_NUMBER
            first = float(start[0]) if start and not is_late else None
            return float(rate), float(step), first
    return DEFAULT_SAMPLING_RATE, 1.0, None
