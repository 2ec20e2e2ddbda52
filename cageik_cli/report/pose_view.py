"""What a run of `cageik pose` came to, as a picture shows it."""

from collections.abc import Sequence

import numpy as np

from cageik_cli.posing.edits import Layer, acting, anchors_of
from cageik_cli.posing.summary import Posed
from cageik_cli.report.figures import percent_text
from cageik_cli.report.pose_picture import PoseView
from cageik_cli.report.pose_text import miss_text


def view_of(posed: Posed, up_axis: str) -> PoseView:
    """The pose, or the frame that was moved most, with the handles that act in it."""
    snapshot, figures = posed.snapshot, posed.figures
    block, binding = snapshot.block, snapshot.clip.binding
    anchors, chosen = anchors_of(snapshot.layers), _deciding(snapshot.layers, int(block.frames[0]))
    starts, targets = block.edit.starts[0, chosen], block.edit.targets[0, chosen]
    missed = max((figures.anchors[k].residual_percent for k in chosen), default=0.0)
    place = f"{snapshot.frame}, " if snapshot.frame else ""
    return PoseView(
        faces=binding.rest.faces,
        cage_faces=binding.cage.faces,
        before=block.meshes[0],
        after=block.edited[0],
        cage_before=block.cages[0],
        cage_after=block.edit.cages[0],
        starts=block.anchors_before[0, chosen],
        targets=targets,
        ends=block.anchors_after[0, chosen],
        names=tuple(anchors[k].name for k in chosen),
        pinned=(targets == starts).all(axis=1),
        up_axis=up_axis,
        title_before=f"{place}before",
        title_after=f"after: mesh moved {percent_text(figures.rms_percent)} %, "
        f"handles met within {miss_text(missed)} %",
    )


def _deciding(layers: Sequence[Layer], frame: int) -> list[int]:
    """Numbers of the anchors that decide a frame, ascending.

    Those of layers that change nothing in it do not, and of several at one point the last does.
    """
    acts = acting(layers, np.array([frame]))[0]
    points = [anchor.point for anchor in anchors_of(layers)]
    keys = [(point.corners.tobytes(), point.barycentric.tobytes()) for point in points]
    last = {key: k for k, key in enumerate(keys) if acts[k]}
    return sorted(last.values())
