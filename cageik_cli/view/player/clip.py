"""The record of what a player shows, and how to read it from a result."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.timeline import Timeline
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Binding
from cageik_cli.report.render.model_views import FRAME_LABELS, VIEW_TURN, choose_turn
from cageik_cli.store.result import (
    Edit,
    KeyFrames,
    StoredAnimation,
    make_weights_error,
    read_binding,
    read_cages,
    read_key_frames,
    read_rotations,
)
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.text import single_line, to_unicode
from cageik_cli.view.player.compression import MAX_LEVEL

UNNAMED_CAGE = "CAGE.obj"
"""Stands for a cage that is in no file."""

UNCOLOURED = 0.7
"""Linear grey of faces that have no material."""

MAX_CAGE_NUMBERS = 1 << 24
"""Coordinates of cages that a page holds at most; the last frames of longer clips are left out."""

MAX_GROUND_FRAMES = 64
"""The ground of a clip is below the model in so many of its frames."""


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
    frame_rms : (F,) float64, optional
        Error of each frame, percent of the diagonal; nan where it was skipped.
    vertex_rms : (m,) float64, optional
        Error of each vertex over the clip, percent of the diagonal; nan for missing data.
    held : dict of int to (str, (m, 3) float64)
        The frames whose input is known: why it is, such as "worst", and its errors v − v̂, in
        diagonals of the rest model; 0 where v is missing.
    original : str
        What they are errors of: "input", or "unedited" for a mesh before an edit.
    before : tuple of str
        What of these the page can ask its server for, in all frames.
    focus : dict, optional
        Where the worst region is: its `frame` and `vertex`; `extent`, half the width of a view of
        it, in diagonals; and `turn`, from how many degrees right of the front it is seen.
    title : str
        What the page calls it: the name of a file, on one line; "" if it is in none.
    target : str
        What `cageik pose` is given to pose, as it is typed: the name of a file, and options.
    left_out : int
        Number of frames at the end of the clip that are not shown.
    max_level : int
        Largest integer that a weight is rounded to.
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
    frame_rms: Floats | None = None
    vertex_rms: Floats | None = None
    held: dict[int, tuple[str, Floats]] = field(default_factory=dict)
    original: str = "input"
    before: tuple[str, ...] = ()
    focus: dict[str, Any] | None = None
    title: str = ""
    target: str = ""
    left_out: int = 0
    max_level: int = MAX_LEVEL


def make_single_pose(
    binding: Binding, words: Sequence[str] = (), *, up_axis: str = "Y"
) -> PlayerClip:
    """Make the clip of a model in its rest pose, to be posed.

    `words` are what `cageik pose` is given to pose: the name of a file, and options; none for a
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


def require_player_clip(result: StoredAnimation, user: str) -> PlayerClip:
    """Load what a player shows of a result, which `user` needs.

    Raises
    ------
    SettingError
        When the result was written without weights.
    """
    clip = load_player_clip(result)
    if clip is None:
        raise make_weights_error(result.path, user)
    return clip


def load_player_clip(result: StoredAnimation) -> PlayerClip | None:
    """Load what a player shows of a result; None if it was written without weights."""
    binding = read_binding(result)
    if binding is None:
        return None
    count = min(len(result.frames), max(1, MAX_CAGE_NUMBERS // binding.cage.vertices.size))
    key_frames = read_key_frames(result, binding)
    focus = _find_focus(result, key_frames)
    return PlayerClip(
        binding=binding,
        base=binding.rebuilt_rest,
        cages=next(read_cages(result, count)),
        rotations=read_rotations(result)[:count],
        frames=result.frames[:count],
        timeline=result.scene.make_timeline(count),
        fps=result.scene.fps,
        up_axis=result.scene.up_axis,
        skipped=tuple(frame for frame in result.skipped if frame < count),
        frame_rms=100 * result.metrics.rms[:count] / (result.rest.diagonal or 1.0),
        vertex_rms=100 * result.vertex_rms / (result.rest.diagonal or 1.0),
        held=_collect_input_frames(key_frames, count),
        original="unedited" if isinstance(result, Edit) else "input",
        focus=focus if focus["frame"] < count else None,
        title=_make_line(result.path.name),
        target=_make_line(shlex.join([result.path.name])),
        left_out=len(result.frames) - count,
    )


def _collect_input_frames(key_frames: KeyFrames, count: int) -> dict[int, tuple[str, Floats]]:
    """Collect those of the first frames that are kept in full; one may be for several reasons."""
    labels = (*FRAME_LABELS, "worst region")
    held: dict[int, tuple[str, Floats]] = {}
    for frame, label, errors in zip(
        key_frames.indices.tolist(), labels, key_frames.errors, strict=False
    ):
        if frame < count:
            held.setdefault(frame, (label, np.nan_to_num(errors, nan=0.0)))
    return held


def _find_focus(result: StoredAnimation, key_frames: KeyFrames) -> dict[str, Any]:
    """Find the worst region; if there is none, the largest deviation of the clip."""
    min_extent = 0.15  # of the view of a single vertex, diagonals
    held, poses = key_frames.indices.tolist(), key_frames.reconstructed
    region = result.worst_region
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


def find_ground(clip: PlayerClip) -> float:
    """Find how low the model goes along the axis that is up, in the units of the file.

    Long clips are looked at in `MAX_GROUND_FRAMES` frames.
    """
    axis, cage = "XYZ".index(clip.up_axis), clip.binding.cage.vertices
    frames = spread_evenly(len(clip.cages), MAX_GROUND_FRAMES)
    turns = clip.rotations[frames, :, axis].T
    moves = clip.cages[frames, :, axis].T - cage @ turns
    heights = clip.base @ turns + clip.binding.weights @ moves
    return float(heights.min())


def find_base_colours(mesh: TriMesh) -> NDArray[np.uint8] | None:
    """Find the colours of the vertices, (m, 3), 0 to 255; None if the file has none.

    They are those of the vertices, else the mean of those of the materials around each.
    """
    attributes = mesh.attributes
    if attributes is None:
        return None
    if attributes.colours is not None:
        return _to_levels(attributes.colours[:, :3])
    if attributes.materials is None or attributes.material_colours is None:
        return None
    # The last is that of faces without a material, whose number is -1.
    known = np.vstack([attributes.material_colours[:, :3], np.full(3, UNCOLOURED)])
    ours = known[attributes.materials.indices[attributes.triangle_polygons]]
    corners, sums = mesh.faces.ravel(), np.repeat(ours, 3, axis=0)
    totals = [np.bincount(corners, axis, len(mesh.vertices)) for axis in sums.T]
    counts = np.bincount(corners, minlength=len(mesh.vertices))
    linear = np.clip(np.stack(totals, axis=1) / np.maximum(counts, 1)[:, None], 0, 1)
    # As IEC 61966-2-1 encodes linear light.
    curve = 1.055 * linear ** (1 / 2.4) - 0.055
    return _to_levels(np.where(linear > 0.0031308, curve, 12.92 * linear))


def _to_levels(colours: Floats) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(np.nan_to_num(colours), 0, 1)).astype(np.uint8)
