"""One frame before and after an edit, for pictures of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.posing.edits import EditedFrames, LayeredEdit
from cageik_cli.posing.summary import PoseSummary
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class PoseSnapshot:
    """One frame before and after an edit, with the anchors that decide it.

    Attributes
    ----------
    frame : str
        Its name; "" for a single pose.
    faces, cage_faces : (t, 3) and (f, 3) int64
    before, after : (m, 3) float64
        The model.
    cage_before, cage_after : (n, 3) float64
    starts, targets, ends : (l, 3) float64
        Positions of the anchors before, of their targets, and of the anchors after.
    names : tuple of str
        Names of the l anchors.
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
    cage_faces: Integers
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
        cage_faces=binding.cage.faces,
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
