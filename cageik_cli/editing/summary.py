"""What an edit has done: the summary of its frames, and one frame for pictures.

Statistics of anchors, motion and volume are gathered block by block.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.editing.edits import EditedFrames, LayeredEdit
from cageik_cli.editing.handles.placement import describe_place
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.messages import Note

MIN_MOTION = 0.005
"""A vertex moves if it does by more than this, in diagonals: a centimetre of a person."""


@dataclass(frozen=True, slots=True)
class AnchorSummary:
    """The motion and the residual of an anchor over the frames that its layer changes.

    Attributes
    ----------
    layer : str
        Its layer's name; "" for the only layer.
    vertex, face : int, optional
        One of them: the vertex that it is at, or the face that it is on.
    barycentric : tuple of float, optional
        Where on the face: the share of each corner.
    moved : float
        Largest distance from its position before the edit, file units.
    residual, residual_percent : float
        Largest distance from its target after all layers, file units and percent of the diagonal.
    frame : str
        The frame of the largest residual; "" for a single pose.
    """

    name: str
    layer: str
    vertex: int | None
    face: int | None
    barycentric: tuple[float, ...] | None
    moved: float
    residual: float
    residual_percent: float
    frame: str


@dataclass(frozen=True, slots=True)
class CageEditSummary:
    """What a cage edit does by itself.

    Attributes
    ----------
    vertices : int
        Cage vertices that it names.
    moved : float
        Largest distance that it moves one of them, file units.
    vertex : int
        The cage vertex that it moves so far.
    frame : str
        The frame in which it does; "" for a single pose.
    """

    name: str
    vertices: int
    moved: float
    vertex: int
    frame: str


@dataclass(frozen=True, slots=True)
class PoseSummary:
    """Summary of a pose or an edited animation; lengths in file units.

    Attributes
    ----------
    diagonal : float
        Diagonal of the rest model.
    rms, rms_percent : float
        Motion of the mesh: sqrt(mean |v' − v|²) over vertices and frames.
    moved : float
        Largest distance that a vertex moved.
    moved_least : float
        Smallest distance that a vertex moved in the same frame.
    vertex : int
        The vertex that moved most.
    frame : str
        The frame in which it did; "" for a single pose.
    cage_moved : float
        Largest distance that a cage vertex moved.
    volume_change_percent : float, optional
        Change of largest size against the frame before the edit; None for an open model, and for
        points.
    volume_frame : str
        The frame in which it is; "" for a single pose.
    moved_share_percent : float
        Largest share of the vertices of a frame that move by more than `MIN_MOTION` of the
        diagonal.
    share_frame : str
        The frame in which it is; "" for a single pose.
    condition_number : float, optional
        Largest condition number of the layers' systems; None without handles.
    rigidity : int
        Rounds of rigid rotations.
    hold : bool
        Whether the rest of the model is held in all layers of handles.
    changed : tuple of str, optional
        First and last frame that are changed.
    beyond_moved, beyond_moved_percent : float, optional
        Largest distance that a vertex beyond the radii of all layers moved, file units and percent
        of the diagonal; None if there is no such vertex, or a layer has no radii.
    has_surface : bool
        Whether the model has faces; points have none.
    cage_edits : tuple of CageEditSummary
        Those that came before the handles.
    """

    diagonal: float
    anchors: tuple[AnchorSummary, ...]
    rms: float
    rms_percent: float
    moved: float
    moved_least: float
    vertex: int
    frame: str
    cage_moved: float
    cage_vertex: int
    volume_change_percent: float | None
    condition_number: float | None
    rigidity: int
    hold: bool
    changed: tuple[str, str] | None
    beyond_moved: float | None = None
    beyond_moved_percent: float | None = None
    has_surface: bool = True
    cage_edits: tuple[CageEditSummary, ...] = ()
    volume_frame: str = ""
    moved_share_percent: float = 0.0
    share_frame: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PoseSnapshot:
    """One frame before and after an edit, with the anchors that decide it.

    Attributes
    ----------
    frame : str
        Its name; "" for a single pose.
    faces : (t, 3) int64
    cage : TriMesh
        The rest cage.
    before, after : (m, 3) float64
        The model.
    cage_before, cage_after : (n, 3) float64
    starts, targets, ends : (l, 3) float64
        Positions of the anchors before, of their targets, and of the anchors after.
    pinned : (l,) bool
        Whether an anchor has to stay.
    up_axis : str
        "Y" or "Z".
    rms_percent : float
        Of the motion of the mesh over all frames, percent of the diagonal.
    max_residual_percent : float
        Largest distance of these anchors from their targets over all frames, percent of the
        diagonal.
    """

    frame: str
    faces: Integers
    cage: TriMesh
    before: Floats
    after: Floats
    cage_before: Floats
    cage_after: Floats
    starts: Floats
    targets: Floats
    ends: Floats
    names: tuple[str, ...]
    pinned: NDArray[np.bool_]
    up_axis: str
    rms_percent: float
    max_residual_percent: float


@dataclass(frozen=True, slots=True, eq=False)
class PoseResult:
    """The outcome of posing a model or editing an animation.

    Attributes
    ----------
    snapshot : PoseSnapshot
        Of the pose, or of the frame that was moved most: `before` and `after` are (m, 3).
    notes : tuple of Note
        What was found on the way. Runs of the command line show them, and leave them out here.

    Examples
    --------
    >>> from cageik_cli import pose_to_file
    >>> walker = "data_fixtures/walker"
    >>> posed = pose_to_file(
    ...     f"{walker}/frames/walker_1.obj",
    ...     f"{walker}/handles.json",
    ...     "posed.obj",
    ...     cage=f"{walker}/cage.obj",
    ...     accuracy="preview",
    ... )
    >>> [anchor.name for anchor in posed.summary.anchors][:3]
    ['left hand', 'left elbow', 'right hand']
    """

    summary: PoseSummary
    snapshot: PoseSnapshot
    notes: tuple[Note, ...] = ()


def take_snapshot(edit: LayeredEdit, block: EditedFrames, summary: PoseSummary) -> PoseSnapshot:
    """Return the first frame of a block as a snapshot, with the summary of all frames."""
    frame, target = int(block.frames[0]), edit.target
    binding, anchors, chosen = target.binding, edit.anchors, edit.find_deciding(frame)
    starts, targets = block.starts[0, chosen], block.targets[0, chosen]
    residuals = [summary.anchors[k].residual_percent for k in chosen]
    return PoseSnapshot(
        frame=target.name_frame(frame),
        faces=binding.rest.faces,
        cage=binding.cage,
        before=block.meshes_before[0],
        after=block.meshes_after[0],
        cage_before=block.cages_before[0],
        cage_after=block.cages_after[0],
        starts=block.anchors_before[0, chosen],
        targets=targets,
        ends=block.anchors_after[0, chosen],
        names=tuple(anchors[k].name for k in chosen),
        pinned=(targets == starts).all(axis=1),
        up_axis=target.up_axis,
        rms_percent=summary.rms_percent,
        max_residual_percent=max(residuals, default=0.0),
    )


class PoseStatistics:
    """Running statistics of an edit, updated block by block."""

    def __init__(self, edit: LayeredEdit) -> None:
        self._edit, self._rest = edit, edit.target.binding.rest
        self._anchors = edit.anchors
        self._layer_names = [layer.name for layer in edit.layers for _ in layer.schedule.anchors]
        self._moved, self._residual = np.zeros((2, len(self._anchors)))
        self._residual_frame = np.zeros(len(self._anchors), np.int64)
        self._squares, self._frame_count = 0.0, 0
        self._farthest, self._vertex, self._frame = 0.0, 0, 0
        self._smallest_motion = 0.0
        self._cage_farthest, self._cage_vertex = 0.0, 0
        self._is_beyond = edit.is_beyond
        self._beyond_moved = 0.0
        self._volume_change: float | None = None
        self._volume_frame = 0
        self._moved_share, self._share_frame = 0.0, 0
        self._changed: list[int] = []
        # By cage edit: how far, which vertex, in which frame.
        self._cage_edits = [(0.0, int(layer.vertices[0]), 0) for layer in edit.cage_layers]

    def update(self, block: EditedFrames) -> None:
        """Add the next frames, if there are any."""
        if not len(block.frames):
            return
        acts = self._edit.find_active(block.frames)
        distances = np.linalg.norm(block.anchors_after - block.anchors_before, axis=2) * acts
        self._moved = np.maximum(self._moved, distances.max(axis=0))
        residuals = np.linalg.norm(block.anchors_after - block.targets, axis=2) * acts
        worst, largest = residuals.argmax(axis=0), residuals.max(axis=0)
        is_worse = largest > self._residual
        self._residual_frame[is_worse] = block.frames[worst[is_worse]]
        self._residual = np.maximum(self._residual, largest)
        is_changed = (block.cages_after != block.cages_before).any(axis=(1, 2))
        self._update_meshes(block)
        self._update_cage_edits(block.frames)
        if is_changed.any():
            numbers = block.frames[is_changed]
            self._changed = [*self._changed[:1], int(numbers[0]), int(numbers[-1])]

    def _update_meshes(self, block: EditedFrames) -> None:
        metrics = block.metrics
        self._squares += float(metrics.rms @ metrics.rms)
        self._frame_count += len(block.frames)
        worst = int(metrics.max_deviation.argmax())
        if metrics.max_deviation[worst] > self._farthest:
            self._farthest = float(metrics.max_deviation[worst])
            self._vertex = int(metrics.worst_vertex[worst])
            self._frame = int(block.frames[worst])
            self._smallest_motion = float(np.sqrt(np.nanmin(block.squared_displacements[worst])))
        if self._is_beyond.any():
            beyond = np.nan_to_num(block.squared_displacements[:, self._is_beyond])
            self._beyond_moved = max(self._beyond_moved, float(np.sqrt(beyond.max())))
        distances = np.linalg.norm(block.cages_after - block.cages_before, axis=2).max(axis=0)
        if distances.max() > self._cage_farthest:
            self._cage_farthest, self._cage_vertex = float(distances.max()), int(distances.argmax())
        with np.errstate(divide="ignore", invalid="ignore"):
            changes = 100 * (metrics.volume_reconstructed / metrics.volume - 1)
        known = np.flatnonzero(np.isfinite(changes))
        if len(known):
            at = known[np.abs(changes[known]).argmax()]
            if self._volume_change is None or abs(changes[at]) > abs(self._volume_change):
                self._volume_change = float(changes[at])
                self._volume_frame = int(block.frames[at])
        is_moved = block.squared_displacements > (MIN_MOTION * self._rest.diagonal) ** 2
        shares = is_moved[:, self._rest.used_vertices].mean(axis=1)
        if shares.max() > self._moved_share:
            self._moved_share = float(shares.max())
            self._share_frame = int(block.frames[shares.argmax()])

    def _update_cage_edits(self, frames: Integers) -> None:
        for k, layer in enumerate(self._edit.cage_layers):
            distances = np.linalg.norm(layer.displacements(frames), axis=2)
            frame, place = np.unravel_index(distances.argmax(), distances.shape)
            moved = float(distances[frame, place])
            if moved > self._cage_edits[k][0]:
                self._cage_edits[k] = moved, int(layer.vertices[place]), int(frames[frame])

    def summarize(self) -> PoseSummary:
        """Return the summary of the frames so far."""
        name = self._edit.target.name_frame
        rms = float(np.sqrt(self._squares / max(1, self._frame_count)))
        conditions = [layer.poser.condition_number for layer in self._edit.layers]
        edits = zip(self._edit.cage_layers, self._cage_edits, strict=True)
        beyond = self._beyond_moved if self._is_beyond.any() else None
        return PoseSummary(
            diagonal=self._rest.diagonal,
            anchors=tuple(map(self._summarize_anchor, range(len(self._anchors)))),
            rms=rms,
            rms_percent=100 * rms / self._rest.diagonal,
            moved=self._farthest,
            moved_least=self._smallest_motion,
            vertex=self._vertex,
            frame=name(self._frame),
            cage_moved=self._cage_farthest,
            cage_vertex=self._cage_vertex,
            volume_change_percent=self._volume_change,
            condition_number=max(conditions, default=None),
            rigidity=self._edit.rigidity,
            hold=self._edit.hold,
            changed=(name(self._changed[0]), name(self._changed[-1])) if self._changed else None,
            beyond_moved=beyond,
            beyond_moved_percent=None if beyond is None else 100 * beyond / self._rest.diagonal,
            has_surface=len(self._rest.faces) > 0,
            volume_frame=name(self._volume_frame),
            moved_share_percent=100 * self._moved_share,
            share_frame=name(self._share_frame),
            cage_edits=tuple(
                CageEditSummary(layer.name, len(layer.vertices), moved, vertex, name(frame))
                for layer, (moved, vertex, frame) in edits
            ),
        )

    def _summarize_anchor(self, k: int) -> AnchorSummary:
        place = describe_place(self._rest, self._anchors[k].point)
        is_vertex = place.kind == "vertex"
        return AnchorSummary(
            name=self._anchors[k].name,
            layer=self._layer_names[k],
            vertex=place.number if is_vertex else None,
            face=None if is_vertex else place.number,
            barycentric=None if place.values is None else tuple(place.values.tolist()),
            moved=float(self._moved[k]),
            residual=float(self._residual[k]),
            residual_percent=float(100 * self._residual[k] / self._rest.diagonal),
            frame=self._edit.target.name_frame(int(self._residual_frame[k])),
        )
