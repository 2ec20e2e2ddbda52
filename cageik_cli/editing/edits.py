"""Layers of edits on a pose or a cage animation: each starts from the result of those before it."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cageik_cli.editing.cage_edits import CageEditLayer, EditFiles, MirrorImage
from cageik_cli.editing.handles.model import Handles, PosedSurface
from cageik_cli.editing.handles.placement import place_handles
from cageik_cli.editing.handles.schedule import HandleSchedule
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.timeline import Timeline
from cageik_cli.geometry.surface_distance import SurfaceDistances
from cageik_cli.method.pose.anchors import Anchor, anchor_matrix, anchor_positions
from cageik_cli.method.pose.constraints import CageConstraints, require_mirror
from cageik_cli.method.pose.local_axes import LocalAxes
from cageik_cli.method.pose.poser import Poser
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.solve.metrics import FrameMetrics, measure
from cageik_cli.method.weights.binding import Binding, reconstruct
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import HandlesError, error_context
from cageik_cli.util.messages import say


@dataclass(frozen=True, slots=True, eq=False)
class EditTarget:
    """The pose or the animation that layers are applied to, and the meshes of its cages.

    A cage gives the mesh `base_mesh + weights @ (cage - base_cage)`. Of a binding that has offsets,
    the base mesh turns with each frame of an animation.

    Attributes
    ----------
    cage_at : callable
        The cage of a frame, (n, 3), by its index.
    base_cage : (n, 3) float64
    base_mesh : (m, 3) float64
        The mesh that `base_cage` gives exactly, whatever `weights @ base_cage` is. If both are
        zeros, meshes are `weights @ cages`.
    rotations : (F, 3, 3) float64, optional
        Of the rest pose to each frame: `points @ R`. None for frames that do not turn.
    frame_names : sequence of str, optional
        None for a single pose, whose only frame is 0.
    up_axis : str
        "Y" or "Z", for drawings.
    timeline : Timeline, optional
        The numbers of the frames, which are counted from 0 here; None for a single pose.
    """

    binding: Binding
    cage_at: Callable[[int], Floats]
    base_cage: Floats
    base_mesh: Floats
    rotations: Floats | None = None
    frame_names: Sequence[str] | None = None
    up_axis: str = "Y"
    timeline: Timeline | None = None

    @classmethod
    def of_model(cls, binding: Binding) -> "EditTarget":
        """Return the rest pose of a model, which the rest cage gives bit for bit."""
        cage = binding.cage.vertices
        return cls(binding, lambda _: cage, cage, binding.rest.vertices)

    @classmethod
    def of_animation(
        cls,
        binding: Binding,
        cage_at: Callable[[int], Floats],
        frame_names: Sequence[str],
        rotations: Floats | None = None,
        scene: Scene | None = None,
    ) -> "EditTarget":
        """Return an animation whose meshes are the reconstructions of a result, `weights @ cages`.

        With the rotations of its frames, (F, 3, 3), they have the offsets of the binding, too, and
        mirror planes turn with them.
        """
        m, n = binding.weights.shape
        base = np.zeros((m, 3)) if binding.offsets is None else binding.offsets
        scene = scene or Scene()
        timeline = scene.make_timeline(len(frame_names))
        still = np.zeros((n, 3))
        return cls(binding, cage_at, still, base, rotations, frame_names, scene.up_axis, timeline)

    def name_frame(self, frame: int) -> str:
        """Return the name of a frame; "" for a single pose."""
        return self.frame_names[frame] if self.frame_names else ""

    def deform(self, frames: Integers, cages: Floats) -> Floats:
        """Return the meshes (k, m, 3) of the cages (k, n, 3) of frames (k,)."""
        meshes = reconstruct(self.binding.weights, cages - self.base_cage)
        meshes += self._turn(self.base_mesh, frames)
        return meshes

    def anchor_positions(
        self, anchors: Sequence[Anchor], frames: Integers, cages: Floats
    ) -> Floats:
        """Return the positions of anchors on the meshes of the cages of frames, as (k, l, 3)."""
        rows = anchor_matrix(anchors, self.binding.weights)
        base = self._turn(anchor_positions(anchors, self.base_mesh), frames)
        return np.asarray(base + rows @ (cages - self.base_cage))

    def find_turns(self, axes: LocalAxes, frames: Integers, cages: Floats) -> Floats:
        """Return the turns of the surface around a point in the cages of frames, (k, 3, 3)."""
        return axes.find_turns(cages - self.base_cage, self._turn(axes.base, frames))

    def _turn(self, points: Floats, frames: Integers) -> Floats:
        """Return points of the base mesh, (p, 3), in each frame: (k, p, 3), or as they are."""
        if self.rotations is None or self.binding.offsets is None:
            return points
        return np.asarray(points @ self.rotations[frames])


class Layer:
    """One set of handles, placed and ready to be applied.

    Attributes
    ----------
    name : str
        Its place in the handles file, such as "sets[1]"; "" for the only layer.
    schedule : HandleSchedule
        The targets of its l anchors.
    poser : Poser
        For its anchors.
    is_beyond : (m,) bool
        Vertices beyond the radii of its handles; none if the rest is not held.
    """

    def __init__(
        self,
        name: str,
        schedule: HandleSchedule,
        target: EditTarget,
        constraints: CageConstraints,
        settings: PosingSettings,
        hold: bool,
    ) -> None:
        self.name, self.schedule = name, schedule
        binding = target.binding
        anchors = [
            anchor if anchor.radius is not None else replace(anchor, radius=settings.radius)
            for anchor in schedule.anchors
        ]
        self.poser = Poser(
            binding, anchors, settings.alpha, settings.beta, constraints, settings.hold and hold
        )
        self.is_beyond = np.zeros(len(binding.rest.vertices), bool)
        if self.poser.reaches:
            reached = [reach.strength > 0 for reach in self.poser.reaches]
            self.is_beyond = ~np.any(reached, axis=0)
        turning = {k: one for k, one in enumerate(schedule.scheduled) if one.turns}
        distances = SurfaceDistances(binding.rest) if turning else None
        self._axes = {
            k: LocalAxes(
                one.anchor.point, binding.rest, binding.weights, target.base_mesh, distances
            )
            for k, one in turning.items()
            if distances is not None
        }
        self._rigidity = settings.rigidity

    def apply(
        self, target: EditTarget, frames: Integers, cages: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the edited cages of frames, and where its anchors start and are to go.

        Shapes are those of `LayeredEdit.apply`, for the anchors of this layer.
        """
        starts = target.anchor_positions(self.schedule.anchors, frames, cages)
        rotations = {k: target.find_turns(axes, frames, cages) for k, axes in self._axes.items()}
        with _set_context(self.name):
            moves = self.schedule.displacements(frames, starts, rotations)
        turns = None
        if target.rotations is not None and self.poser.constraints.mirror is not None:
            turns = target.rotations[frames]
        edited = self._edit(cages, moves, turns)
        return edited, starts, starts + moves

    def _edit(self, cages: Floats, moves: Floats, turns: Floats | None) -> Floats:
        """Return cages (k, n, 3) whose anchors move, (k, l, 3).

        With turns of the rest pose to each, (k, 3, 3), its mirror plane turns along.
        """
        if turns is None:
            return self.poser.edit_cages(cages, moves, self._rigidity)
        back = turns.transpose(0, 2, 1)
        local = cages @ back
        edited = self.poser.edit_cages(local, moves @ back, self._rigidity)
        is_moved = (edited != local).any(axis=(1, 2), keepdims=True)
        return np.where(is_moved, cages + (edited - local) @ turns, cages)


def _set_context(place: Path | str | None) -> AbstractContextManager[None]:
    """Put a file, or the name of a set, in front of error messages, if there is one."""
    return error_context(place) if place else nullcontext()


@dataclass(frozen=True, slots=True, eq=False)
class EditedFrames:
    """k frames before and after an edit with l anchors in all layers.

    Attributes
    ----------
    frames : (k,) int64
        Ascending.
    cages_before, cages_after : (k, n, 3) float64
    starts, targets : (k, l, 3) float64
        As of `LayeredEdit.apply`.
    meshes_before, meshes_after : (k, m, 3) float64
    anchors_before, anchors_after : (k, l, 3) float64
    metrics : FrameMetrics
        Differences of the meshes after from those before.
    squared_displacements : (k, m) float64
        |v' − v|² of each vertex.
    """

    frames: Integers
    cages_before: Floats
    cages_after: Floats
    starts: Floats
    targets: Floats
    meshes_before: Floats
    meshes_after: Floats
    anchors_before: Floats
    anchors_after: Floats
    metrics: FrameMetrics
    squared_displacements: Floats


class LayeredEdit:
    """The layers of an edit, and the pose or the animation that they are applied to.

    Parameters
    ----------
    files : EditFiles
        Cage edits come first, and add up. Then come the sets of handles; points are picked on the
        result of the layers before theirs.

    Attributes
    ----------
    mirror : Mirror, optional
        The plane about which the settings mirror the edit.
    cage_layers : list of CageEditLayer
    layers : list of Layer
        Those of handles.
    rigidity : int
        Rounds of rigid rotations.

    Raises
    ------
    HandlesError
        When a handle or a cage edit cannot be placed; the message names its file and it. When the
        edit is to be mirrored, and the cage is not its own mirror image.
    NumericalError
        When hard handles conflict.
    """

    def __init__(self, files: EditFiles, target: EditTarget, settings: PosingSettings) -> None:
        self.target, self.rigidity = target, settings.rigidity
        self.layers: list[Layer] = []
        self.mirror = require_mirror(target.binding.cage) if settings.mirror else None
        image = None
        if self.mirror is not None:
            image = MirrorImage(self.mirror, target.binding.cage, target.rotations)
        cage, timeline = target.binding.cage, target.timeline
        edits, handles = files.cage_edits, files.handles
        self._edits_path = None if edits is None else edits.path
        self._handles_path = None if handles is None else handles.path
        with _set_context(self._edits_path):
            self.cage_layers = [
                CageEditLayer(one, cage, timeline, image) for one in (edits.edits if edits else ())
            ]
        with _set_context(self._handles_path):
            if handles is not None:
                self._place_handles(handles, settings)

    def _place_handles(self, handles: Handles, settings: PosingSettings) -> None:
        binding, constraints = self.target.binding, handles.constraints
        constraints = replace(constraints, mirror=constraints.mirror or self.mirror)
        if settings.radius is not None and not any(one.hold for one in handles.sets):
            raise HandlesError(
                say("hold: is false, and `radius=` needs a rest that is held; leave out one")
            )
        surface = PosedSurface(binding.rest, self._pose_at, self.target.timeline)
        for k, handle_set in enumerate(handles.sets):
            name = f"sets[{k}]" if len(handles.sets) > 1 else ""
            with _set_context(name):
                schedule = place_handles(
                    handle_set,
                    surface,
                    snap=settings.snap,
                    allow_conflicts=settings.allow_conflicts,
                    hard=settings.hard,
                )
                layer = Layer(name, schedule, self.target, constraints, settings, handle_set.hold)
            self.layers.append(layer)

    @property
    def anchors(self) -> list[Anchor]:
        """The anchors of all layers, l of them."""
        return [anchor for layer in self.layers for anchor in layer.schedule.anchors]

    @property
    def notes(self) -> list[str]:
        """Notes for the user on how the handles were placed."""
        return [note for layer in self.layers for note in layer.schedule.notes]

    @property
    def hold(self) -> bool:
        """Whether the rest is held in all layers of handles, if there are any."""
        return bool(self.layers) and all(layer.poser.reaches for layer in self.layers)

    @property
    def is_beyond(self) -> NDArray[np.bool_]:
        """Which vertices, (m,), are beyond the reach of all layers; none if cage edits are."""
        if not self.layers or self.cage_layers:
            return np.zeros(len(self.target.binding.rest.vertices), bool)
        return np.asarray(np.all([layer.is_beyond for layer in self.layers], axis=0))

    def find_active(self, frames: Integers) -> NDArray[np.bool_]:
        """Return which anchors act in frames (k,), as (k, l): those of layers that change it."""
        strengths = [
            layer.schedule.blend(frames) for layer in self.layers for _ in layer.schedule.anchors
        ]
        none = np.zeros((len(frames), 0))
        return np.stack(strengths, axis=1) > 0 if strengths else none > 0

    def find_deciding(self, frame: int) -> list[int]:
        """Return the numbers of the anchors that decide a frame, ascending.

        Layers that do not change the frame are left out; of several anchors at one point, the last
        one decides.
        """
        is_active = self.find_active(np.array([frame]))[0]
        points = [anchor.point for anchor in self.anchors]
        keys = [(point.corners.tobytes(), point.barycentric.tobytes()) for point in points]
        last = {key: k for k, key in enumerate(keys) if is_active[k]}
        return sorted(last.values())

    def apply(self, frames: Integers, cages: Floats) -> tuple[Floats, Floats, Floats]:
        """Apply all layers to the cages (k, n, 3) of frames (k,).

        A frame that no layer changes keeps its cage bit for bit.

        Returns
        -------
        cages : (k, n, 3) float64
        starts : (k, l, 3) float64
            Positions of the anchors of all layers, each before its own layer.
        targets : (k, l, 3) float64
            Their targets, at the strength that their layer has in each frame.
        """
        starts = targets = [np.zeros((len(frames), 0, 3))]
        with _set_context(self._edits_path):
            for cage_layer in self.cage_layers:
                cages = cage_layer.apply(frames, cages)
        with _set_context(self._handles_path):
            for layer in self.layers:
                cages, start, target = layer.apply(self.target, frames, cages)
                starts, targets = [*starts, start], [*targets, target]
        return cages, np.concatenate(starts, axis=1), np.concatenate(targets, axis=1)

    def edit_frames(self, frames: Integers, cages: Floats) -> EditedFrames:
        """Apply all layers to the cages (k, n, 3) of frames (k,), and measure the changes."""
        edited, starts, targets = self.apply(frames, cages)
        meshes = self.target.deform(frames, cages)
        after = meshes.copy()
        is_changed = (edited != cages).any(axis=(1, 2))
        # Only the difference is added: nothing cancels, and unchanged frames stay bit for bit.
        after[is_changed] += reconstruct(self.target.binding.weights, (edited - cages)[is_changed])
        rest = self.target.binding.rest
        metrics, squares = measure(rest, meshes, after, rest.used_vertices)
        return EditedFrames(
            frames=frames,
            cages_before=cages,
            cages_after=edited,
            starts=starts,
            targets=targets,
            meshes_before=meshes,
            meshes_after=after,
            anchors_before=self.target.anchor_positions(self.anchors, frames, cages),
            anchors_after=self.target.anchor_positions(self.anchors, frames, edited),
            metrics=metrics,
            squared_displacements=squares,
        )

    def _pose_at(self, frame: int) -> Floats:
        """Return the mesh of a frame, (m, 3), after the layers so far."""
        frames, cages = np.array([frame]), self.target.cage_at(frame)[None]
        cages, _, _ = self.apply(frames, cages)
        return np.asarray(self.target.deform(frames, cages)[0])
