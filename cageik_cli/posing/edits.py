"""Edits of a cage animation, one over the other: each sees what those before it have done."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.binding import Binding, rebuilt
from cageik_cli.posing.anchors import Anchor, positions_of, rows_of
from cageik_cli.posing.handles.model import Handles, PlaceSettings, Surface
from cageik_cli.posing.handles.placement import placed
from cageik_cli.posing.handles.schedule import Drag
from cageik_cli.posing.poser import DEFAULT_ALPHA, Poser, refuse_no_weights
from cageik_cli.solver.metrics import FrameFigures, measure
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import located


@dataclass(frozen=True, slots=True)
class PosingSettings:
    """How handles move a cage.

    Attributes
    ----------
    alpha, beta : float
        As `Poser` has them.
    rigidity : int
        Rounds in which the cage's cells turn.
    place : PlaceSettings

    Raises
    ------
    InputError
        When alpha or beta is not a finite number above 0.
    """

    alpha: float = DEFAULT_ALPHA
    beta: float = 1.0
    rigidity: int = 0
    place: PlaceSettings = field(default_factory=PlaceSettings)

    def __post_init__(self) -> None:
        refuse_no_weights(self.alpha, self.beta)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """What cages make of a model: `mesh + weights @ (cages - cage)`.

    Attributes
    ----------
    weights : (m, n) float64
    cage : (n, 3) float64
    mesh : (m, 3) float64
        What that cage is to give exactly, whatever weights times cage are; zeros and zeros for
        weights times cages alone.
    """

    weights: Floats
    cage: Floats
    mesh: Floats

    @classmethod
    def at_rest(cls, binding: Binding) -> "Skin":
        """One that gives the rest pose bit for bit."""
        return cls(binding.weights, binding.cage.vertices, binding.rest.vertices)

    @classmethod
    def rebuilding(cls, binding: Binding) -> "Skin":
        """One that gives what a result's cages rebuild."""
        m, n = binding.weights.shape
        return cls(binding.weights, np.zeros((n, 3)), np.zeros((m, 3)))

    def meshes(self, cages: Floats) -> Floats:
        """The meshes (k, m, 3) of cages (k, n, 3)."""
        meshes = rebuilt(self.weights, cages - self.cage)
        meshes += self.mesh
        return meshes

    def positions(self, anchors: Sequence[Anchor], cages: Floats) -> Floats:
        """Where anchors are on the meshes of cages (k, n, 3): (k, l, 3)."""
        rows = rows_of(anchors, self.weights)
        return np.asarray(positions_of(anchors, self.mesh) + rows @ (cages - self.cage))


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One set of handles, ready to be applied.

    Attributes
    ----------
    drag : Drag
        Where its anchors are to go.
    poser : Poser
        Of those anchors.
    rigidity : int
        Rounds in which cells turn.
    name : str
        Where its set is in the file of handles; "" for the only one.
    """

    drag: Drag
    poser: Poser
    rigidity: int
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """What layers are laid over.

    Attributes
    ----------
    binding : Binding
    skin : Skin
    cage : callable
        The cage of a frame, (n, 3), by its number.
    count : int, optional
        Of its frames; None for a single pose, whose only frame is 0.
    """

    binding: Binding
    skin: Skin
    cage: Callable[[int], Floats]
    count: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Edit:
    """What layers did to k frames.

    Attributes
    ----------
    cages : (k, n, 3) float64
        As they are after all layers.
    starts : (k, l, 3) float64
        Where the anchors of all layers were, each before its own layer.
    targets : (k, l, 3) float64
        Where they were to be, at the strength that their layer has in each frame.
    """

    cages: Floats
    starts: Floats
    targets: Floats


def layers_of(handles: Handles, clip: Clip, settings: PosingSettings) -> list[Layer]:
    """The sets of a file of handles as layers; points are picked on what those before have made.

    Raises
    ------
    InputError
        Naming the handle at fault.
    NumericalError
        When hard handles cannot all be met.
    """
    layers: list[Layer] = []
    for k, handle_set in enumerate(handles.sets):
        surface = Surface(clip.binding.rest, _poses(clip, tuple(layers)), clip.count)
        name = f"sets[{k}]" if len(handles.sets) > 1 else ""
        with _named(name):
            drag = placed(handle_set, surface, settings.place)
            poser = Poser(clip.binding, drag.anchors, settings.alpha, settings.beta, handles.ties)
        layers.append(Layer(drag, poser, settings.rigidity, name))
    return layers


def anchors_of(layers: Sequence[Layer]) -> list[Anchor]:
    """The anchors of all layers, l of them."""
    return [anchor for layer in layers for anchor in layer.drag.anchors]


def acting(layers: Sequence[Layer], frames: Integers) -> NDArray[np.bool_]:
    """Which of all anchors have a part in frames (k,), (k, l): those of layers that change them."""
    strengths = [layer.drag.blend(frames) for layer in layers for _ in layer.drag.anchors]
    return np.stack(strengths, axis=1) > 0


def edited(layers: Sequence[Layer], skin: Skin, frames: Integers, cages: Floats) -> Edit:
    """Lay all layers over the cages (k, n, 3) of frames (k,).

    A frame that no layer changes keeps its cage bit for bit.
    """
    starts, targets = [], []
    for layer in layers:
        found = skin.positions(layer.drag.anchors, cages)
        with _named(layer.name):
            displacements = layer.drag.displacements(frames, found)
        cages = layer.poser.edited(cages, displacements, layer.rigidity)
        starts.append(found)
        targets.append(found + displacements)
    return Edit(cages, np.concatenate(starts, axis=1), np.concatenate(targets, axis=1))


def _named(name: str) -> AbstractContextManager[None]:
    """Put the name of a set in front of what is wrong with it."""
    return located(name) if name else nullcontext()


def _poses(clip: Clip, layers: tuple[Layer, ...]) -> Callable[[int], Floats]:
    """The mesh of a frame, (m, 3), by its number, as the layers leave it."""

    def pose(frame: int) -> Floats:
        cages = clip.cage(frame)[None]
        if layers:
            cages = edited(layers, clip.skin, np.array([frame]), cages).cages
        return np.asarray(clip.skin.meshes(cages)[0])

    return pose


@dataclass(frozen=True, slots=True, eq=False)
class EditedBlock:
    """k frames before and after an edit, with l anchors in all its layers.

    Attributes
    ----------
    frames : (k,) int64
        Their numbers, ascending.
    cages : (k, n, 3) float64
        Before.
    edit : Edit
        What was done.
    meshes, edited : (k, m, 3) float64
        Before and after.
    anchors_before, anchors_after : (k, l, 3) float64
    figures : FrameFigures
        Of the meshes after against those before.
    squares : (k, m) float64
        Of how far each vertex was moved.
    """

    frames: Integers
    cages: Floats
    edit: Edit
    meshes: Floats
    edited: Floats
    anchors_before: Floats
    anchors_after: Floats
    figures: FrameFigures
    squares: Floats


def edited_block(
    layers: Sequence[Layer], clip: Clip, frames: Integers, cages: Floats
) -> EditedBlock:
    """Lay layers over the cages (k, n, 3) of frames (k,), and compare."""
    edit = edited(layers, clip.skin, frames, cages)
    meshes = clip.skin.meshes(cages)
    after = meshes.copy()
    is_changed = (edit.cages != cages).any(axis=(1, 2))
    # What is added is the difference alone: nothing cancels, and where it is zero nothing changes.
    after[is_changed] += rebuilt(clip.binding.weights, (edit.cages - cages)[is_changed])
    measured = measure(clip.binding.rest, meshes, after, slice(None))
    anchors = anchors_of(layers)
    return EditedBlock(
        frames=frames,
        cages=cages,
        edit=edit,
        meshes=meshes,
        edited=after,
        anchors_before=clip.skin.positions(anchors, cages),
        anchors_after=clip.skin.positions(anchors, edit.cages),
        figures=measured.figures,
        squares=measured.squares,
    )
