"""Meshes and clips of one scene brought into another: its unit of length and its up axis."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isclose
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.base.skeleton import Skin
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh, make_read_only
from cageik_cli.geometry.rotations import UP_TURNS
from cageik_cli.util.arrays import Floats
from cageik_cli.util.messages import Note
from cageik_cli.util.units import SAME_UNIT_TOL, describe_unit


@dataclass(frozen=True)
class SceneConversion:
    """From one unit and up axis to another: rows times `matrix`.

    Attributes
    ----------
    units : (float, float)
        Metres per unit, before and after.
    axes : (str, str)
        Up axes, before and after.
    """

    units: tuple[float, float] = (1.0, 1.0)
    axes: tuple[str, str] = ("Y", "Y")

    @staticmethod
    def between(given: SceneHints, wanted: SceneHints) -> "SceneConversion":
        """Return the conversion of what both state; of what one leaves open there is none."""
        units, axes = (1.0, 1.0), ("Y", "Y")
        if given.metres_per_unit is not None and wanted.metres_per_unit is not None:
            units = given.metres_per_unit, wanted.metres_per_unit
        if given.up_axis is not None and wanted.up_axis is not None:
            axes = given.up_axis, wanted.up_axis
        return SceneConversion(units, axes)

    @staticmethod
    def of_output(scene: Scene, to: SceneHints) -> "SceneConversion":
        """Return the conversion of what is written of a scene to what it is asked `to` be in."""
        return SceneConversion.between(scene.space, to)

    @property
    def factor(self) -> float:
        """By what lengths are multiplied."""
        before, after = self.units
        return 1.0 if isclose(before, after, rel_tol=SAME_UNIT_TOL) else before / after

    @cached_property
    def turn(self) -> Floats:
        """The turn alone, (3, 3)."""
        return UP_TURNS.get(self.axes, np.eye(3))

    @property
    def matrix(self) -> Floats:
        """What positions, as rows, are multiplied by, (3, 3)."""
        return self.factor * self.turn

    @property
    def turns(self) -> bool:
        """Whether the up axis changes."""
        return self.axes[0] != self.axes[1]

    def __bool__(self) -> bool:
        """Return whether anything changes."""
        return self.turns or self.factor != 1

    @property
    def note(self) -> str:
        """A sentence for the user."""
        before, after = [], []
        if self.factor != 1:
            before.append(describe_unit(self.units[0]))
            after.append(describe_unit(self.units[1]))
        if self.turns:
            before.append(f"{self.axes[0].lower()} up")
            after.append(f"{self.axes[1].lower()} up")
        return f"converted from {', '.join(before)} to {', '.join(after)}"

    def apply(self, points: Floats) -> Floats:
        """Return points (..., 3) in the other scene."""
        if self.turns:
            # Exact: coordinates change places and signs.
            axes = np.abs(self.turn).argmax(axis=0)
            points = points[..., axes] * self.turn[axes, range(3)]
        return np.asarray(points * self.factor) if self.factor != 1 else points

    def convert_mesh(self, mesh: TriMesh) -> TriMesh:
        """Return a mesh in the other scene, with its parts in spaces of their own.

        A part without a transform of its own still has none; positions in the space of a part are
        converted as those in the scene are.
        """
        if not self:
            return mesh
        moved = mesh.move(self.apply(mesh.vertices))
        attributes = moved.attributes
        if attributes is None or attributes.parts is None:
            return moved
        change = np.eye(4)
        change[:3, :3] = self.matrix
        transforms = np.linalg.inv(change) @ attributes.parts.transforms @ change
        is_plain = (attributes.parts.transforms == np.eye(4)).all(axis=(1, 2))
        transforms[is_plain] = np.eye(4)
        parts = replace(attributes.parts, transforms=make_read_only(transforms))
        return TriMesh(moved.vertices, moved.faces, replace(attributes, parts=parts))

    def convert_animation(self, animation: Animation) -> Animation:
        """Return an animation in the other scene, whose frames are converted as well."""
        if not self:
            return animation
        rest, hints = self.convert_mesh(animation.rest), self.convert_hints(SceneHints())
        return replace(animation, rest=rest, scene=hints.override(animation.scene))

    def convert_skin(self, skin: Skin) -> Skin:
        """Return a skin whose mesh is in the other scene."""
        skin = replace(skin, rest=self.convert_mesh(skin.rest))
        if not self.turns:
            return skin
        turns = None if skin.turns is None else (self.turn.T @ t @ self.turn for t in skin.turns)
        return replace(skin, rotations=self.turn.T @ skin.rotations @ self.turn, turns=turns)

    def convert_loaded(self, loaded: LoadedMesh) -> LoadedMesh:
        """Return a mesh from a file in the other scene, with a note."""
        if not self:
            return loaded
        mesh, notes = self.convert_mesh(loaded.mesh), (*loaded.notes, Note(self.note))
        return replace(loaded, mesh=mesh, notes=notes)

    def convert_clip(self, clip: MeshSequence, name: str) -> MeshSequence:
        """Return a clip in the other scene, with a note of this name."""
        return ConvertedSequence(clip, self, name) if self else clip

    def convert_hints(self, hints: SceneHints) -> SceneHints:
        """Return what is stated of a scene, with the other unit and axis if they change."""
        if self.factor != 1:
            hints = replace(hints, metres_per_unit=self.units[1])
        return replace(hints, up_axis=self.axes[1]) if self.turns else hints


class ConvertedSequence(MeshSequence):
    """The frames of a clip, brought into another scene as they are read."""

    def __init__(self, clip: MeshSequence, conversion: SceneConversion, name: str) -> None:
        self._clip, self._conversion = clip, conversion
        self.names, self.missing = clip.names, clip.missing
        self.takes_missing = clip.takes_missing
        self.first = conversion.convert_mesh(clip.first)
        self.scene = conversion.convert_hints(clip.scene)
        self.notes = (*clip.notes, Note(conversion.note, place=name))

    def location(self, index: int) -> str:
        """Return where a frame is, for messages."""
        return self._clip.location(index)

    def read_positions(self, index: int) -> NDArray[Any]:
        """Read the vertices of one frame."""
        return self._conversion.apply(self._clip.read_positions(index))

    def read_frame(self, index: int) -> Floats:
        """Read the vertices of one frame, (m, 3)."""
        return self._conversion.apply(self._clip.read_frame(index))

    def digest(self, index: int) -> bytes:
        """Return the digest of the file of a frame."""
        return self._clip.digest(index)

    def content_digest(self, index: int) -> bytes:
        """Return a digest of the frame as it is stored, and of the conversion."""
        stored = self._clip.content_digest(index)
        return hashlib.sha256(stored + self._conversion.matrix.tobytes()).digest()

    def set_digests(self, start: int, digests: Sequence[bytes]) -> None:
        """Take the digests of frames from `start` on."""
        self._clip.set_digests(start, digests)

    def describe_source(self) -> dict[str, Any]:
        """Return the name and digest of all that is read."""
        return self._clip.describe_source()
