"""Base classes of the writers, and the animation that they are given."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.file_numbers import FrameNames
from cageik_cli.formats.settings import MorphSettings, Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import Part, split_parts
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError, SettingError
from cageik_cli.util.messages import Hint, Said
from cageik_cli.util.text import number_names

SHAPE_SUFFIX = "Shape"
"""What is added to the name of a part for its mesh, if the part is a transform above that."""


@dataclass(frozen=True, slots=True)
class NamedClip:
    """A clip of an animation that consists of several, one after another.

    Attributes
    ----------
    scene : Scene
        Of which the time counts; its space is that of the animation.
    error : float, optional
        As of `Skin`, of its frames alone.
    """

    name: str
    frame_count: int
    scene: Scene
    error: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """An animation before its first frame is written.

    Attributes
    ----------
    rest : TriMesh
        The rest pose, with the faces and the attributes of every frame.
    frame_count : int
        Number of frames.
    name : str
        Name of the object, for formats that name objects: letters, digits and underscores.
    morphs : MorphSettings
        How a format of morph targets follows the frames.
    texture : str
        Format of the images, where frames are textures: one of `TEXTURES`.
    origin : tuple of float
        What was subtracted from the rest pose, and is from all positions that are written.
    guide : str
        Name of the part that programs are not to render, in formats that can say so; none if empty.
    clips : tuple of NamedClip
        What all frames together are, in formats that hold several animations of one skeleton; one
        clip of the name and the scene of the animation if empty.
    """

    rest: TriMesh
    frame_count: int
    scene: Scene
    name: str
    morphs: MorphSettings = field(default_factory=MorphSettings)
    texture: str = "png"
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    guide: str = ""
    clips: tuple[NamedClip, ...] = ()

    def split(self) -> list[Part]:
        """Split the rest pose into its parts; a rest pose that came as one has its name.

        Their paths are all different, also without a slash at the beginning.
        """
        parts = split_parts(self.rest)
        steps = ([step for step in part.name.split("/") if step] for part in parts)
        paths = number_names("/".join(each or [self.name]) for each in steps)
        return [
            replace(part, name=f"/{path}" if part.name.startswith("/") else path)
            for part, path in zip(parts, paths, strict=True)
        ]

    def recentre(self) -> "Animation":
        """Return the animation with the rest pose around the origin, but for a round offset."""
        used = self.rest.vertices[self.rest.used_vertices]
        middle = 0.5 * used.min(axis=0) + 0.5 * used.max(axis=0)
        step = 10.0 ** np.floor(np.log10(self.rest.diagonal or 1.0))
        x, y, z = (float(value) for value in np.rint(middle / step) * step)
        rest = self.rest.move(self.rest.vertices - np.array([x, y, z]))
        return replace(self, rest=rest, origin=(x, y, z))


def choose_scene_paths(names: Sequence[str], root: str) -> list[str]:
    """Return the path of each part in a scene: its own, or below a root if it is a name alone."""
    return [name if name.startswith("/") else f"/{root}/{name}" for name in names]


def name_root(names: Sequence[str], root: str) -> str:
    """Return the path that all parts are below: what is above them in their paths, or `/root`."""
    tops = {name.split("/")[1] for name in names if name.startswith("/")}
    is_below = all(name.startswith("/") and name.count("/") > 1 for name in names)
    return f"/{tops.pop()}" if is_below and len(tops) == 1 else f"/{root}"


def nest_names(names: Sequence[str], root: str) -> list[str]:
    """Return the paths of parts in a scene of one root: their own if they share one."""
    top = name_root(names, root)
    return [name if name.startswith(f"{top}/") else f"{top}/{name.strip('/')}" for name in names]


def choose_short_names(names: Sequence[str]) -> list[str]:
    """Return the last name in the path of each part; the whole path where two have the same.

    They are all different.
    """
    last = [name.rstrip("/").rpartition("/")[2] or name for name in names]
    counts = Counter(last)
    return number_names(
        short if counts[short] == 1 else name.strip("/")
        for short, name in zip(last, names, strict=True)
    )


class AnimationWriter(ABC):
    """Writes one animation: its frames are appended in order, then it is completed.

    A writer holds a few blocks of frames in memory, whatever their number. It writes under any
    name: the file or folder is renamed when it is complete. The same animation gives the same
    bytes.

    Attributes
    ----------
    suffixes : tuple of str
        Lower case, with the dot.
    writes_folder : bool
        Whether it writes a folder with a file per frame, instead of a file.
    is_single : bool
        Whether positions are stored in single precision.
    keeps_parts : bool
        Whether the parts of a model are meshes of their own.
    is_in_part_space : bool
        Whether a file of one part has positions in its own space, as it is put onto an object whose
        transform stays.
    states_unit : bool
        Whether it says how long a unit is, which programs then follow.
    space : SceneHints
        The unit and the up axis that it brings positions into; those of the scene if they are open.
    notes : tuple of str or Text
        What a user must know about the output, one sentence each.
    """

    suffixes: tuple[str, ...]
    writes_folder: bool = False
    is_single: bool = False
    keeps_parts: bool = False
    is_in_part_space: bool = False
    states_unit: bool = False
    space: SceneHints = SceneHints()
    notes: tuple[Said, ...] = ()

    @cached_property
    def _open(self) -> ExitStack:
        """What is open until the output is complete, or given up; nothing by default."""
        return ExitStack()

    @classmethod
    def name_files(cls, name: str) -> tuple[str, ...]:
        """Return the names of files in a folder `name`; none where it writes a file or frames."""
        return ()

    @classmethod  # noqa: B027  # most need no other library
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError, with what to install, if a needed library is missing."""

    @abstractmethod
    def __init__(self, target: Path, animation: Animation) -> None:
        """Start writing to `target`, whose suffix is one of `suffixes`.

        In a folder of files per frame, the name of `target` is their pattern, see `FrameNames`; in
        another folder of files, it is that of the folder.

        Raises
        ------
        InputError
            When the format cannot hold the animation, before anything is written.
        """

    @abstractmethod
    def append(self, frames: Floats) -> None:
        """Write the next k frames, (k, m, 3), in the units of the files they came from.

        The array is overwritten after the call.
        """

    def complete(self) -> None:
        """Write what comes after the last frame, and close what is open."""
        self._open.close()

    def abandon(self) -> None:
        """Close what is open, after a failure; the output is deleted."""
        self._open.close()  # nothing is left to close after `complete`


class FrameFileWriter(AnimationWriter):
    """Writes a file per frame, named by its number; formats implement `encode_frame`."""

    writes_folder = True

    def __init__(self, target: Path, animation: Animation) -> None:
        names = FrameNames.parse(target.name)
        if names is None:
            raise ValueError(f"{target.name} has no place for the frame number")
        start, step = animation.scene.start, animation.scene.frame_step
        for number, name, parameter in (
            (start, "number of the first frame", "start"),
            (step, "step of frame numbers", "frame_step"),
        ):
            if number < 0 or number != int(number):
                raise SettingError(
                    f"the {name} is {number:.10g}, expected a whole number from 0 on, since "
                    "files are named by frame numbers; give one with " + Hint(parameter)
                )
        self._folder, self._names = target.parent, names
        self._next_number, self._step = int(start), int(step)

    @abstractmethod
    def encode_frame(self, positions: Floats) -> bytes:
        """Return the content of the file of one frame, (m, 3)."""

    def encode_exact(self, positions: Floats) -> bytes:
        """Return the same, with all digits of the positions, as most formats have them."""
        return self.encode_frame(positions)

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            (self._folder / self._names.file_name(self._next_number)).write_bytes(
                self.encode_frame(positions)
            )
            self._next_number += self._step


def shift_positions(block: NDArray[Any], offset: Floats) -> NDArray[Any]:
    """Return a block whose positions are moved; rows of properties are moved where they are."""
    if block.dtype.names is None:
        return np.asarray(block + offset)
    for axis, along in zip("xyz", offset, strict=True):
        block[axis] += along
    return block


def get_positions(block: NDArray[Any]) -> Floats:
    """Return the positions of a block, which has rows of properties if points turn with it."""
    if block.dtype.names is None:
        return block
    return np.stack([block[axis] for axis in "xyz"], axis=-1, dtype=np.float64)


def to_float32(positions: Floats) -> NDArray[np.float32]:
    """Return `positions` as contiguous float32."""
    with np.errstate(over="ignore"):
        singles = np.ascontiguousarray(positions, np.float32)
    if not np.isfinite(singles).all():
        raise OutputError(
            f"a coordinate of {np.abs(positions).max():g} is too large for the single precision of "
            "this format; scale the animation, or write .npz"
        )
    return singles


class PointCacheWriter(AnimationWriter):
    """Writes a header and float32 positions, frame by frame; formats implement `make_header`.

    `dtype` is numpy's name of float32 in the file's byte order.
    """

    is_single = True
    is_in_part_space = True
    dtype: str

    def __init__(self, target: Path, animation: Animation) -> None:
        scene = animation.scene
        if scene.start != 0:
            self.notes += (
                "Blender's Mesh Cache puts the first frame at scene frame 0; set its Frame Start "
                f"to {scene.start:.10g}",
            )
        if scene.frame_step != 1:
            self.notes += (
                "Blender's Mesh Cache plays one frame per scene frame; set its Frame Scale to "
                f"{1 / scene.frame_step:.6g}",
            )
        with ExitStack() as stack:
            self._file = stack.enter_context(target.open("wb"))
            self._file.write(self.make_header(animation))
            self._open = stack.pop_all()

    @abstractmethod
    def make_header(self, animation: Animation) -> bytes:
        """Return what comes before the first frame."""

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:  # one at a time stays closer to the processor
            self._file.write(to_float32(positions).astype(self.dtype, copy=False).data)
