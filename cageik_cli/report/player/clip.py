"""The record of what a player shows, and how to read it from a result."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.timeline import Timeline
from cageik_cli.report.render.model_views import FRAME_LABELS, VIEW_TURN, choose_turn
from cageik_cli.store.result import (
    KeyFrames,
    Result,
    read_binding,
    read_cages,
    read_key_frames,
    read_rotations,
)
from cageik_cli.util.arrays import Floats
from cageik_cli.util.text import single_line, to_unicode

UNNAMED_CAGE = "CAGE.obj"
"""Stands for a cage that is in no file."""

MAX_CAGE_NUMBERS = 1 << 24
"""Coordinates of cages that a page holds at most; the last frames of longer clips are left out."""


@dataclass(frozen=True, slots=True, eq=False)
class PlayerClip:
    """What a player shows: a model, its cage, and the cages of frames.

    The mesh of frame k is `base @ R_k + weights @ (cages[k] - cage @ R_k)`. So `base` is the mesh
    that the rest cage gives: `weights @ cage`, or the rest pose where weights have offsets or a
    single model is posed.

    Attributes
    ----------
    base : (m, 3) float64
    cages : (F, n, 3) float64
    rotations : (F, 3, 3) float64
        Of the rest pose to each frame; `points @ R` turns points.
    frames : tuple of str
        Names of the F frames. Empty for a single pose, which has one cage.
    timeline : Timeline, optional
        The numbers of the frames; None for a single pose.
    up_axis : str
        "Y" or "Z".
    skipped : tuple of int
        Frames without data, whose cages are interpolated.
    vertex_rms : (m,) float64, optional
        Error of each vertex over the clip, percent of the diagonal; nan for missing data.
    held : dict of int to (str, (m, 3) float64)
        The frames whose input is known: why it is, such as "worst", and its errors v − v̂, in
        diagonals of the rest model; 0 where v is missing.
    focus : dict, optional
        Where the worst region is: its `frame` and `vertex`; `extent`, half the width of a view of
        it, in diagonals; and `turn`, from how many degrees right of the front it is seen.
    title : str
        What the page calls it: the name of a file, on one line; "" if it is in none.
    target : str
        What `cageik pose` is told to pose, as it is typed: the name of a file, and options.
    left_out : int
        Number of frames at the end of the clip that are not shown.
    """

    binding: Binding
    base: Floats
    cages: Floats
    rotations: Floats
    frames: tuple[str, ...] = ()
    timeline: Timeline | None = None
    fps: float = 24.0
    up_axis: str = "Y"
    skipped: tuple[int, ...] = ()
    vertex_rms: Floats | None = None
    held: dict[int, tuple[str, Floats]] = field(default_factory=dict)
    focus: dict[str, Any] | None = None
    title: str = ""
    target: str = ""
    left_out: int = 0


def make_single_pose(
    binding: Binding, words: Sequence[str] = (), *, up_axis: str = "Y"
) -> PlayerClip:
    """Make the clip of a model in its rest pose, to be posed.

    `words` are what `cageik pose` is told to pose: the name of a file, and options; none for a
    model that is in no file.
    """
    unnamed = ("MODEL.obj", "--cage", UNNAMED_CAGE)
    return PlayerClip(
        binding=binding,
        base=binding.rest.vertices,
        cages=binding.cage.vertices[None],
        rotations=np.eye(3)[None],
        up_axis=up_axis,
        title=_make_line(words[0]) if words else "",
        target=_make_line(shlex.join(words or unnamed)),
    )


def _make_line(text: str) -> str:
    return single_line(to_unicode(text))


def load_player_clip(result: Result) -> PlayerClip | None:
    """Load what a player shows of a result; None if it was written without weights."""
    binding = read_binding(result)
    if binding is None:
        return None
    base = result.rest.vertices
    if not binding.has_offsets:
        base = binding.weights @ binding.cage.vertices
    count = min(len(result.frames), max(1, MAX_CAGE_NUMBERS // binding.cage.vertices.size))
    key_frames = read_key_frames(result, binding)
    focus = _find_focus(result, key_frames)
    return PlayerClip(
        binding=binding,
        base=base,
        cages=_read_first_cages(result, count),
        rotations=read_rotations(result)[:count],
        frames=result.frames[:count],
        timeline=result.scene.make_timeline(count),
        fps=result.scene.fps,
        up_axis=result.scene.up_axis,
        skipped=tuple(frame for frame in result.skipped if frame < count),
        vertex_rms=100 * result.vertex_rms / (result.rest.diagonal or 1.0),
        held=_collect_held_frames(key_frames, count),
        focus=focus if focus["frame"] < count else None,
        title=_make_line(result.path.name),
        target=_make_line(shlex.join([result.path.name])),
        left_out=len(result.frames) - count,
    )


def _read_first_cages(result: Result, count: int) -> Floats:
    blocks, read = [], 0
    for block in read_cages(result, 64):
        blocks.append(block)
        read += len(block)
        if read >= count:
            break
    return np.concatenate(blocks)[:count]


def _collect_held_frames(key_frames: KeyFrames, count: int) -> dict[int, tuple[str, Floats]]:
    """Collect those of the first frames that are kept in full; one may be for several reasons."""
    labels = (*FRAME_LABELS, "worst region")
    held: dict[int, tuple[str, Floats]] = {}
    for frame, label, errors in zip(
        key_frames.indices.tolist(), labels, key_frames.errors, strict=False
    ):
        if frame < count:
            held.setdefault(frame, (label, np.nan_to_num(errors, nan=0.0)))
    return held


def _find_focus(result: Result, key_frames: KeyFrames) -> dict[str, Any]:
    """Find the worst region; if there is none, the largest deviation of the clip."""
    min_extent = 0.15  # of the view of a single vertex, diagonals
    held, poses = key_frames.indices.tolist(), key_frames.reconstructed
    region = next(iter(result.regions or ()), None)
    diagonal = result.rest.diagonal or 1.0
    if region is None:
        frame = int(np.nanargmax(result.metrics.max_deviation))
        vertex = int(result.metrics.worst_vertex[frame])
        extent = min_extent
    else:
        frame, vertex = region.frame, region.worst_vertex
        extent = max(region.size / diagonal, min_extent)
    turn = VIEW_TURN
    if frame in held:
        pose, rest = poses[held.index(frame)], result.rest.vertices
        is_near = np.linalg.norm(rest - rest[vertex], axis=1) <= extent * diagonal / 3
        turn = choose_turn(pose, result.rest.faces, is_near, result.scene.up_axis)
    return {"frame": frame, "vertex": vertex, "extent": extent, "turn": turn}
