"""What a run of `cageik pose` came to, as a picture shows it."""

from cageik_cli.posing_run import Posed
from cageik_cli.report.figures import percent_text
from cageik_cli.report.pose_picture import PoseView
from cageik_cli.report.pose_text import miss_text


def view_of(posed: Posed, up_axis: str) -> PoseView:
    """The pose, or the frame that was moved most, with the handles of all layers."""
    snapshot, figures = posed.snapshot, posed.figures
    block, binding = snapshot.block, snapshot.clip.binding
    missed = max(anchor.residual_percent for anchor in figures.anchors)
    place = f"{snapshot.frame}, " if snapshot.frame else ""
    return PoseView(
        faces=binding.rest.faces,
        cage_faces=binding.cage.faces,
        before=block.meshes[0],
        after=block.edited[0],
        cage_before=block.cages[0],
        cage_after=block.edit.cages[0],
        starts=block.anchors_before[0],
        targets=block.edit.targets[0],
        ends=block.anchors_after[0],
        names=snapshot.names,
        pinned=(block.edit.targets == block.edit.starts)[0].all(axis=1),
        up_axis=up_axis,
        title_before=f"{place}before",
        title_after=f"after: mesh moved {percent_text(figures.rms_percent)} %, "
        f"handles met within {miss_text(missed)} %",
    )
