"""What an edit has done: the summary of its frames, and one frame for pictures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.editing.edits import EditedFrames, LayeredEdit
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers


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
    acceleration, acceleration_before : float, optional
        Largest second difference of its position, |p(k+1) − 2 p(k) + p(k−1)|, over three
        consecutive frames one of which is changed, after and before the edit; None if there are
        none.
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
    acceleration: float | None
    acceleration_before: float | None


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
    condition_number : float, optional
        Largest condition number of the layers' systems; None without handles.
    rigidity : int
        Rounds of rigid rotations.
    changed : tuple of str, optional
        First and last frame that are changed.
    beyond_moved, beyond_moved_percent : float, optional
        Largest distance that a vertex beyond the radii of all layers moved, file units and percent
        of the diagonal; None if there is no such vertex, or a layer has no radii.
    acceleration_vertex : int, optional
        The vertex of the mesh whose acceleration the edit raises most; None if it raises none.
    acceleration, acceleration_before : float, optional
        Its largest second difference, as of an anchor.
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
    changed: tuple[str, str] | None
    beyond_moved: float | None = None
    beyond_moved_percent: float | None = None
    acceleration_vertex: int | None = None
    acceleration: float | None = None
    acceleration_before: float | None = None
    has_surface: bool = True
    cage_edits: tuple[CageEditSummary, ...] = ()


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
        Of the pose, or of the frame that was moved most.
    """

    summary: PoseSummary
    snapshot: PoseSnapshot


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
