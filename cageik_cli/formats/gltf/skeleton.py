"""A cage animation as a skinned glTF: joints that the cage has become, and weights of the mesh.

The skin is posed as programs pose it from the file, to measure what is left out or rounded. Keys
of joints are those of all frames, or as few as lines between them replace: translations move on a
line from one key to the next, and rotations turn evenly about one axis (slerp). The frame that lies
furthest off becomes a key, until all are within what is allowed (Ramer 1972; Douglas and Peucker
1973).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.skeleton import CAGE_KEY, PosedSkin, Skeleton, Skin, SkinWeights
from cageik_cli.formats.base.writers import (
    Animation,
    NamedClip,
    choose_short_names,
    to_float32,
)
from cageik_cli.formats.gltf.file import (
    GlbWriter,
    VectorSpool,
    read_rounded,
    round_to,
)
from cageik_cli.formats.gltf.nodes import make_part_nodes
from cageik_cli.formats.gltf.surface import cut_surface
from cageik_cli.geometry.parts import split_parts
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import OutputError
from cageik_cli.util.messages import Hint, say
from cageik_cli.util.text import format_count

SET_SIZE = 4
"""Joints per vertex in one set of attributes; programs read one set or two."""

MAX_INFLUENCES = 2 * SET_SIZE
"""Joints per vertex that programs read."""

FIRST_SHARE = 4.0
"""Each joint may first err by so much of the tolerance: joints above each other seldom add up."""

MIN_TOLERANCE_SHARE = 1e-4
"""All keys are kept where less than this share of the tolerance is left: it is rounding."""

TRIED_VERTICES = 1000
"""Vertices on which keys that are left out are tried first, about."""

QUANTIZATION = "KHR_mesh_quantization"
"""The extension by which positions and normals may be integers; it needs no decoder."""

ReadFrames = Callable[[int, int], tuple[Floats, Floats]]
"""Returns translations (k, J, 3) and quaternions (k, T, 4) of frames from the first number on."""

FRAMES_PER_BLOCK = 16
"""Frames that are posed together."""

TRANSLATION, ROTATION = "translation", "rotation"
TRACK_WIDTHS = {TRANSLATION: 3, ROTATION: 4}
"""Numbers of a translation, and of a quaternion."""

MIN_SAVED_NUMBERS = 32
"""Numbers that the description of times of their own takes the space of."""


class SkeletonWriter(GlbWriter):
    """Writes the rest mesh, skinned to joints, where `Skeleton` has them.

    There are no normals if joints only translate, which would leave them as they are at rest.

    Parameters
    ----------
    target : Path
    animation : Animation
        Of the joints, whose `rest` has them at rest. Each of its clips is an animation of the file.
    is_extracted : bool
        As of `Skeleton`.
    tolerance : float, optional
        How far keys that are left out may move a vertex, percent of the diagonal of the rest pose;
        no key is left out if absent.
    is_quantized : bool
        Whether attributes of vertices and rotations are small integers.
    """

    def __init__(
        self,
        target: Path,
        animation: Animation,
        skin: Skin,
        *,
        is_extracted: bool = False,
        tolerance: float | None = None,
        is_quantized: bool = False,
    ) -> None:
        count = skin.weights.joints.shape[1]
        if count > MAX_INFLUENCES:
            raise OutputError(
                f"up to {count} joints move a vertex, and programs read at most "
                f"{MAX_INFLUENCES} from .glb; " + say("give `influences=4`, or 8")
            )
        super().__init__(target, animation)
        skin = replace(skin, rest=skin.rest.move(skin.rest.vertices - np.array(animation.origin)))
        self._skin, self._tolerance, self._is_quantized = skin, tolerance, is_quantized
        if count > SET_SIZE:
            self.notes += (
                f"three.js and other viewers read {SET_SIZE} joints per vertex, and leave "
                "out the weaker ones; " + Hint("influences", SET_SIZE) + " is fitted to that",
            )
        self._vertices: NDArray[np.float32] = to_float32(skin.rest.vertices)
        self._skeleton = Skeleton(
            animation.rest.vertices,
            skin,
            up_axis=animation.scene.up_axis,
            is_extracted=is_extracted,
        )
        self.open_file(0, spool_count=0)
        self._bind_places = self._skeleton.bind_places
        whole = NamedClip(animation.name, animation.frame_count, animation.scene, skin.error)
        self._clips = animation.clips or (whole,)
        self._keys: list[JointKeys] = []

    def append(self, frames: Floats) -> None:
        """Keep the joints of the next k frames, (k, n, 3), which may be of several clips."""
        while len(frames):
            if not self._keys or self._keys[-1].frame_count == self._clip.frame_count:
                self._begin_clip()
            left = self._clip.frame_count - self._keys[-1].frame_count
            for places, turns in self._skeleton.advance(frames[:left]):
                self._keys[-1].append(to_float32(places), turns.astype(np.float32))
            frames = frames[left:]

    @property
    def _clip(self) -> NamedClip:
        """The clip whose frames are being kept."""
        return self._clips[len(self._keys) - 1]

    def _begin_clip(self) -> None:
        names, count = self._skeleton.names, self._skeleton.turn_count
        self._skeleton.begin_clip()
        self._keys.append(JointKeys(self._target.parent, len(names), count))
        self._open.callback(self._keys[-1].close)

    def complete(self) -> None:
        """Compose the file: nodes of the parts, what turns z up, the root joint, its children."""
        import pygltflib as gltf

        self._attributes = SkinAttributes(self._vertices, self._skin.weights, self._is_quantized)
        clips = list(zip(self._clips, self._keys, strict=True))
        tracks = [self._choose_tracks(clip, keys) for clip, keys in clips]
        names = [part.name or "mesh" for part in split_parts(self._skin.rest)]
        nodes, tops, _ = make_part_nodes(names, skin=0)
        self._root = len(nodes) + 1
        primitives, materials = self._cut_mesh()
        meshes = [
            gltf.Mesh(name=name, primitives=primitives[k])
            for k, name in enumerate(choose_short_names(names))
        ]
        extensions = [QUANTIZATION] if self._is_quantized else []
        self._file.complete(
            scene=0,
            scenes=[gltf.Scene(nodes=[*tops, len(nodes)])],
            nodes=[*nodes, *self._make_nodes()],
            meshes=meshes,
            materials=materials,
            skins=[self._write_skin()],
            animations=[
                self.make_animation(**self._write_motion(clip, keys, chosen), clip=clip)
                for (clip, keys), chosen in zip(clips, tracks, strict=True)
            ],
            extensionsUsed=extensions,
            extensionsRequired=extensions,
        )
        self._open.close()

    def _choose_tracks(self, clip: NamedClip, keys: "JointKeys") -> "list[Track] | None":
        """Choose the keys, None for all, and note what those left out and rounding change."""
        if self._tolerance is None and not self._is_quantized:
            return None
        tracks = None
        read = keys.read_rounded_frames if self._is_quantized else keys.read_frames
        exact, written = self._pose_skins(self._skin.rest.used_vertices)
        rms, largest = measure_change(keys, read, exact, written)
        if self._tolerance is not None:
            limit = self._tolerance / 100 * self._skin.rest.diagonal
            if largest > limit:
                raise OutputError(
                    "rounding to 16 bits moves vertices by up to "
                    f"{self._format_percent(largest)}, more than "
                    + Hint("tolerance", f"{self._tolerance:g}")
                    + say("; leave out `quantize=True`, or give a larger tolerance")
                )
            tracks = self._reduce_tracks(keys, exact, written, limit)
        if tracks is not None:
            rms, largest = measure_change(keys, partial(evaluate_tracks, tracks), exact, written)
        count = keys.track_count * keys.frame_count
        if tracks is not None:
            count = sum(len(track.frames) for track in tracks)
        self._note_change(clip, count, keys.track_count * keys.frame_count, (rms, largest))
        return tracks

    def _reduce_tracks(
        self, keys: "JointKeys", exact: PosedSkin, written: PosedSkin, limit: float
    ) -> "list[Track] | None":
        """Leave out keys as long as no vertex moves by more than `limit`; None if that is none.

        A few vertices are looked at first, and all where these hold it.
        """
        reach = dict(zip((TRANSLATION, ROTATION), exact.measure_reach(), strict=True))
        used = self._skin.rest.used_vertices
        few = self._pose_skins(used[:: max(1, len(used) // TRIED_VERTICES)])
        share = FIRST_SHARE
        while share > MIN_TOLERANCE_SHARE:
            tracks = [
                reduce_track(path, k, values, share * limit / reach[path][k])
                for path, k, values in keys.read_tracks()
            ]
            keep_length(tracks, keys)
            if self._is_quantized:
                tracks = [round_track(track) for track in tracks]
            read = partial(evaluate_tracks, tracks)
            for skins in (few, (exact, written)):
                largest = measure_change(keys, read, *skins)[1]
                if largest > limit:
                    break
            else:
                return tracks
            share *= min(0.7, 0.9 * limit / largest)
        return None

    def _pose_skins(self, vertices: Integers) -> tuple[PosedSkin, PosedSkin]:
        """Return some vertices of the skin, as it is and as it is written."""
        count = len(self._animation.rest.vertices)
        places = self._bind_places[self._skeleton.lead :]
        exact = self._vertices, self._skin.weights.to_sparse(count)
        skins = (exact, self._attributes.decode(count) if self._is_quantized else exact)
        first, second = (
            PosedSkin(points[vertices], weights[vertices], places, self._skeleton)
            for points, weights in skins
        )
        return first, second

    def _format_percent(self, distance: float) -> str:
        """Return a distance in percent of the diagonal."""
        return f"{100 * distance / self._skin.rest.diagonal:.2g} %"

    def _note_change(
        self, clip: NamedClip, count: int, every: int, errors: tuple[float, float]
    ) -> None:
        """Note how many keys of all there are, and what they and rounding change: rms, largest."""
        rms, largest = errors
        changes = ["numbers are rounded"] if self._is_quantized else []
        if self._tolerance is not None:
            changes.insert(0, f"{count} of {format_count(every, 'key')} are kept")
        note = f"{clip.name}: " if self._animation.clips else ""
        note += (
            f"{' and '.join(changes)}, by which vertices are off by an rms of "
            f"{self._format_percent(rms)}, {self._format_percent(largest)} at most"
        )
        if clip.error is not None:
            total = clip.error + 100 * rms / self._skin.rest.diagonal
            note += f"; against the input, the rms is at most {total:.2g} %"
        self.notes += (note,)

    def _cut_mesh(self) -> tuple[dict[int, list[Any]], list[object]]:
        """Write the mesh with its weights; return the primitives of each part, and materials."""
        rest, is_shaded = self._skin.rest, self._skin.turns is not None
        surface = cut_surface(rest, has_normals=is_shaded)
        arrays = self._attributes.list_arrays(self._skeleton.lead)
        every = {name: values[surface.origins] for name, values in arrays.items()}
        if is_shaded:
            normals = surface.compute_normals(rest.vertices)
            every["NORMAL"] = (
                round_to(normals, np.int8) if self._is_quantized else to_float32(normals)
            )
        primitives: dict[int, list[Any]] = {}
        for primitive in surface.primitives:
            rows = slice(primitive.start, primitive.stop)
            attributes = {name: self._add(name, values[rows]) for name, values in every.items()}
            written = surface.write_primitive(
                self._file, primitive, attributes, is_quantized=self._is_quantized
            )
            primitives.setdefault(primitive.part, []).append(written)
        return primitives, surface.make_materials()

    def _add(self, name: str, values: NDArray[Any]) -> int:
        """Write an attribute of vertices, and return the number of its accessor."""
        import pygltflib as gltf

        is_normalized = values.dtype.kind != "f" and not name.startswith("JOINTS")
        return self._file.add_array(
            values, gltf.ARRAY_BUFFER, bounds=name == "POSITION", is_normalized=is_normalized
        )

    def _make_nodes(self) -> list[object]:
        import pygltflib as gltf

        tree = self._skeleton
        places = to_float32(tree.rest_translations).tolist()
        joints = [
            gltf.Node(name=name, translation=place, extras={CAGE_KEY: alias} if alias else {})
            for name, place, alias in zip(tree.names, places, tree.aliases, strict=True)
        ]
        for k, parent in enumerate(tree.parents.tolist()):
            if parent >= 0:
                joints[parent].children.append(self._root + k)
        transform = self.make_node_transform()
        return [
            gltf.Node(name=self._animation.name, children=[self._root], **transform),
            *joints,
        ]

    def _write_skin(self) -> object:
        """Write the matrices from the vertices, as they are written, to the joints."""
        import pygltflib as gltf

        attributes, places = self._attributes, self._bind_places
        matrices = np.tile(np.eye(4), (len(places), 1, 1))
        matrices[:, :3, :3] *= attributes.scale
        matrices[:, 3, :3] = attributes.centre - places  # glTF has them column by column
        inverse = self._file.add_array(to_float32(matrices.reshape(-1, 16)))
        joints = list(range(self._root, self._root + len(places)))
        return gltf.Skin(inverseBindMatrices=inverse, skeleton=self._root, joints=joints)

    def _write_motion(
        self, clip: NamedClip, keys: "JointKeys", tracks: "list[Track] | None"
    ) -> dict[str, list[object]]:
        """Write the keys of the joints; tracks with keys in the same frames share their times.

        Without tracks, the keys are those of all frames.
        """
        import pygltflib as gltf

        inputs: dict[bytes, int] = {}
        channels: list[object] = []
        samplers: list[object] = []
        every = np.arange(keys.frame_count)
        whole = (Track(path, k, every, values) for path, k, values in keys.read_tracks())
        for track in whole if tracks is None else tracks:
            key = track.frames.tobytes()
            if key not in inputs:
                inputs[key] = self.add_times(track.frames, clip.scene)
            is_small = self._is_quantized and track.path == ROTATION
            values = round_to(track.values, np.int16) if is_small else to_float32(track.values)
            output = self._file.add_array(values, is_normalized=is_small)
            node = gltf.AnimationChannelTarget(node=self._root + track.joint, path=track.path)
            channels.append(gltf.AnimationChannel(sampler=len(samplers), target=node))
            samplers.append(gltf.AnimationSampler(input=inputs[key], output=output))
        return {"channels": channels, "samplers": samplers}


class SkinAttributes:
    """Positions and weights as they are written, and the scale and centre that they are coded by.

    A vertex is at `centre + scale * code`. Floats have the scale 1.
    """

    def __init__(self, vertices: NDArray[np.float32], weights: SkinWeights, is_small: bool) -> None:
        self._weights = weights
        self.scale, self.centre = 1.0, np.zeros(3)
        self._positions: NDArray[Any] = vertices
        self._values: NDArray[Any] = weights.values.astype(np.float32)
        if is_small:
            low, high = vertices.min(axis=0).astype(float), vertices.max(axis=0).astype(float)
            self.centre = (low + high) / 2
            self.scale = float((high - low).max() / 2) or 1.0
            self._positions = round_to((vertices - self.centre) / self.scale, np.int16)
            self._values = _round_weights(weights.values)

    def decode(self, joint_count: int) -> tuple[Floats, Any]:
        """Return the positions, (m, 3), and the weights, sparse (m, n), that programs read."""
        positions = self.centre + self.scale * read_rounded(self._positions)
        values = read_rounded(self._values)
        return positions, replace(self._weights, values=values).to_sparse(joint_count)

    def list_arrays(self, lead: int) -> dict[str, NDArray[Any]]:
        """Return positions, and joints and weights (m, 4) of each set; joints begin with `lead`.

        What weighs nothing is of joint 0.
        """
        m, count = self._weights.joints.shape
        joint_count = int(self._weights.joints.max()) + 1 + lead
        kind = np.uint8 if joint_count <= 256 else np.uint16
        joints = np.zeros((m, count + -count % SET_SIZE), kind)
        values = np.zeros(joints.shape, self._values.dtype)
        values[:, :count] = self._values
        joints[:, :count] = np.where(self._values > 0, self._weights.joints + lead, 0)
        arrays = {"POSITION": self._positions}
        for k in range(joints.shape[1] // SET_SIZE):
            columns = slice(SET_SIZE * k, SET_SIZE * (k + 1))
            arrays |= {f"JOINTS_{k}": joints[:, columns], f"WEIGHTS_{k}": values[:, columns]}
        return arrays


def _round_weights(values: Floats) -> NDArray[np.uint16]:
    """Round weights (m, k) to 16 bits whose rows sum to the largest: those next to it go up.

    Eight bits would move a vertex between far joints by more than all else that is rounded.
    """
    most = np.iinfo(np.uint16).max
    scaled = most * values
    found = np.floor(scaled)
    missing = np.rint(most - found.sum(axis=1, keepdims=True)).astype(np.int64)
    ranks = np.argsort(np.argsort(found - scaled, axis=1, kind="stable"), axis=1)
    return np.asarray(found + (ranks < missing)).astype(np.uint16)


def measure_change(
    keys: "JointKeys", read_written: ReadFrames, exact: PosedSkin, written: PosedSkin
) -> tuple[float, float]:
    """Return the rms and the largest distance between two skins, in the unit of the scene.

    One is exact, and posed by the keys of all frames; the other by what `read_written` returns.
    """
    squares = largest = 0.0
    for start in range(0, keys.frame_count, FRAMES_PER_BLOCK):
        stop = min(start + FRAMES_PER_BLOCK, keys.frame_count)
        apart = written.pose(*read_written(start, stop)) - exact.pose(
            *keys.read_frames(start, stop)
        )
        distances = np.square(apart).sum(axis=2)
        squares += float(distances.sum())
        largest = max(largest, float(distances.max()))
    count = keys.frame_count * len(exact.vertices)
    return float(np.sqrt(squares / count)), float(np.sqrt(largest))


class JointKeys:
    """Translations and rotations of joints in all frames, relative to their parents.

    They are in temporary files in `folder`, in single precision.

    Parameters
    ----------
    joint_count, turn_count : int
        Joints that translate, and those of them that turn: the first ones.
    """

    def __init__(self, folder: Path, joint_count: int, turn_count: int) -> None:
        self._spools = {
            TRANSLATION: VectorSpool(folder, joint_count, TRACK_WIDTHS[TRANSLATION]),
            ROTATION: VectorSpool(folder, turn_count, TRACK_WIDTHS[ROTATION]),
        }

    def append(self, places: NDArray[np.float32], turns: NDArray[np.float32]) -> None:
        """Keep translations (J, 3) and quaternions (T, 4), real part last, of the next frame."""
        self._spools[TRANSLATION].append(places)
        self._spools[ROTATION].append(turns)

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return self._spools[TRANSLATION].frame_count

    @property
    def track_count(self) -> int:
        """Number of tracks: one per joint that translates, and one per joint that turns."""
        return sum(spool.vertex_count for spool in self._spools.values())

    def read_frames(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Return translations (k, J, 3) and quaternions (k, T, 4) of some frames."""
        moves, turns = (spool.read_frames(start, stop) for spool in self._spools.values())
        return moves, turns

    def read_rounded_frames(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Return the same, with quaternions as they are read of 16 bits."""
        moves, turns = self.read_frames(start, stop)
        return moves, read_rounded(round_to(turns, np.int16))

    def read_tracks(self) -> Iterator[tuple[str, int, Floats]]:
        """Yield `TRANSLATION` or `ROTATION`, the joint, and its values in all frames, (F, w)."""
        for path, spool in self._spools.items():
            for first, block in spool.read_blocks(0, spool.vertex_count):
                count = block.shape[1] // spool.width
                values = block.reshape(len(block), count, spool.width)
                yield from ((path, first + k, values[:, k]) for k in range(count))

    def close(self) -> None:
        """Delete the temporary files."""
        for spool in self._spools.values():
            spool.close()


class Track:
    """Values of a joint at its keys, (k, w), and the frames of these, (k,)."""

    def __init__(self, path: str, joint: int, frames: Integers, values: Floats) -> None:
        self.path, self.joint, self.frames, self.values = path, joint, frames, values

    def evaluate(self, start: int, stop: int) -> Floats:
        """Return the values at some frames, (stop - start, w)."""
        wanted = np.arange(start, stop)
        if len(self.frames) == 1:
            return np.repeat(self.values, len(wanted), axis=0)
        after = np.searchsorted(self.frames, wanted, side="right").clip(1, len(self.frames) - 1)
        first, last = self.frames[after - 1], self.frames[after]
        shares = (wanted - first) / (last - first)
        between = interpolate_moves if self.path == TRANSLATION else interpolate_turns
        return between(self.values[after - 1], self.values[after], shares)


def reduce_track(path: str, joint: int, values: Floats, allowed: float) -> Track:
    """Keep few keys of values (F, w), which give the others within `allowed`.

    That is a distance of translations, and an angle of rotations. All keys are kept where that
    takes fewer bytes, because keys of all frames share their times.
    """
    every = np.arange(len(values))
    measure = _measure_distances if path == TRANSLATION else _measure_angles
    if measure(values, values[:1]).max() <= allowed:
        return Track(path, joint, every[:1], values[:1])
    frames = every[[0, -1]]
    while True:
        guess = Track(path, joint, frames, values[frames]).evaluate(0, len(values))
        errors = measure(values, guess)
        errors[frames] = 0
        starts = frames[:-1]  # the worst frame of each span, all spans at once
        worst = np.maximum.reduceat(errors, starts)
        spans = np.searchsorted(frames, every, side="right").clip(1, len(starts)) - 1
        is_worst = (errors > allowed) & (errors == worst[spans])
        if not is_worst.any():
            break
        frames = np.union1d(frames, every[is_worst])
    width = TRACK_WIDTHS[path]
    if (width + 1) * len(frames) + MIN_SAVED_NUMBERS > width * len(every):
        frames = every
    return Track(path, joint, frames, values[frames])


def keep_length(tracks: list[Track], keys: JointKeys) -> None:
    """Give a track its last key, in place, where no other has a key in the last frame.

    Otherwise the animation would end before.
    """
    last = keys.frame_count - 1
    if not any(track.frames[-1] == last for track in tracks):
        first = tracks[0]
        values = np.concatenate([first.values, keys.read_frames(last, last + 1)[0][:, 0]])
        tracks[0] = Track(first.path, first.joint, np.array([*first.frames, last]), values)


def evaluate_tracks(tracks: Sequence[Track], start: int, stop: int) -> tuple[Floats, Floats]:
    """Return translations (k, J, 3) and quaternions (k, T, 4) of some frames."""
    moves, turns = (
        np.stack([track.evaluate(start, stop) for track in tracks if track.path == path], axis=1)
        for path in (TRANSLATION, ROTATION)
    )
    return moves, turns


def round_track(track: Track) -> Track:
    """Return a track whose quaternions are those that are read of 16 bits."""
    if track.path == TRANSLATION:
        return track
    values = read_rounded(round_to(track.values, np.int16))
    return Track(track.path, track.joint, track.frames, values)


def interpolate_moves(start: Floats, end: Floats, shares: Floats) -> Floats:
    """Return points at shares (k,) of the lines between `start` and `end`, (k, 3)."""
    return np.asarray((1 - shares[:, None]) * start + shares[:, None] * end)


def interpolate_turns(start: Floats, end: Floats, shares: Floats) -> Floats:
    """Return quaternions at shares (k,) of the short way between `start` and `end` (slerp)."""
    start, end = _normalize(start), _normalize(end)
    cosines = (start * end).sum(axis=1, keepdims=True)
    end = np.where(cosines < 0, -end, end)
    angles = 2 * np.arctan2(
        np.linalg.norm(end - start, axis=1), np.linalg.norm(end + start, axis=1)
    )
    sines = np.sin(angles)
    is_still = sines < 1e-9  # the limit is a line
    safe = np.where(is_still, 1.0, sines)
    before = np.where(is_still, 1 - shares, np.sin((1 - shares) * angles) / safe)
    after = np.where(is_still, shares, np.sin(shares * angles) / safe)
    return _normalize(before[:, None] * start + after[:, None] * end)


def _normalize(quaternions: Floats) -> Floats:
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def _measure_distances(values: Floats, guess: Floats) -> Floats:
    return np.asarray(np.linalg.norm(values - guess, axis=1))


def _measure_angles(values: Floats, guess: Floats) -> Floats:
    """Return the angles of the rotations between quaternions, radians."""
    values = _normalize(values)
    apart, together = (np.linalg.norm(values + s * guess, axis=1) for s in (-1, 1))
    return np.asarray(4 * np.arctan2(np.minimum(apart, together), np.maximum(apart, together)))
