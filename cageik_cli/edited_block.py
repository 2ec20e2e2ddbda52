"""Frames before and after an edit, compared."""

from collections.abc import Sequence
from dataclasses import dataclass

from cageik_cli.coordinates.binding import rebuilt
from cageik_cli.layers import Clip, Edit, Layer, anchors_of, edited
from cageik_cli.solver.metrics import FrameFigures, measure
from cageik_cli.util.arrays import Floats, Integers


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


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """One frame before and after an edit, to be drawn.

    Attributes
    ----------
    frame : str
        Its name; "" for a single pose.
    layers : sequence of Layer
        Of the edit.
    block : EditedBlock
        Of this frame alone.
    clip : Clip
    """

    frame: str
    layers: Sequence[Layer]
    block: EditedBlock
    clip: Clip
