"""A clip and the mesh that it moves, in one scene; and the weights of its vertices.

The rest pose is a file, which follows the order of the clip, or a frame: the one in which least
touches. A clip of a mesh that has weights already follows the order of that mesh.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.formats.base.choose_parts import check_part_order
from cageik_cli.formats.base.files import hash_file
from cageik_cli.formats.base.mesh_data import LoadedMesh, check_connectivity, check_vertex_order
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.npz import (
    FrameWeightsFile,
    open_frame_weights,
    read_vertex_weights,
)
from cageik_cli.formats.open import (
    find_rest_index,
    load_rest_frame,
    open_clip_and_rest,
    open_sequence,
)
from cageik_cli.formats.settings import AUTO, ClipSettings, RestFrame
from cageik_cli.formats.timeline import Timeline
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.source import load_rest
from cageik_cli.method.solve.vertex_weights import make_vertex_weights
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.errors import InputError, SettingError, error_context
from cageik_cli.util.messages import Note
from cageik_cli.util.progress import ProgressListener, note_all
from cageik_cli.util.text import format_decimals, to_unicode

if TYPE_CHECKING:  # what it imports takes long
    from cageik_cli.inputs.reconstruction import CageFrames

MAX_COMPARED_FRAMES = 200
"""Frames of a clip that are compared, at most; of longer clips they are spread evenly."""


@dataclass(frozen=True, slots=True, eq=False)
class VertexWeights:
    """Weights of vertices, and where they came from.

    Attributes
    ----------
    vertices : (m,) float64, optional
        Of mean one; all are equal if each frame has its own. None if all vertices count alike.
    frames : FrameWeightsFile, optional
        What these are multiplied by in each frame.
    sources : dict
        Under `vertex_weights`, `name` and `sha256` of the file; empty if there is none.
    """

    vertices: Floats | None
    frames: FrameWeightsFile | None = None
    sources: dict[str, dict[str, str]] = field(default_factory=dict)


def open_clip_and_choose_rest(
    frames: tuple[str, ...],
    settings: ClipSettings,
    rest: Path | None,
    rest_frame: RestFrame,
    scene: CommonScene,
    *,
    has_cage: bool = False,
) -> tuple[MeshSequence, LoadedMesh, int | None]:
    """Open a clip, whose scene rules, and its rest pose, which is brought into it.

    A frame is named by its number in the whole clip, also where only some of its frames are taken,
    or by its index among these. For a cage that is given, an index counts in the whole clip, too,
    as the cage was made for the first frame, whatever is taken.

    Parameters
    ----------
    has_cage : bool
        Whether a cage, or a binding, is given.

    Returns
    -------
    sequence : MeshSequence
    rest : LoadedMesh
        With a note on why it was chosen, if it was.
    index : int or None
        Which of the frames that are taken the rest pose is, from 0; None if it is none of them.
    """
    if rest is not None:
        sequence, loaded = open_clip_and_rest(frames, settings, load_rest(rest, settings.exclude))
        scene.state(sequence.scene)
        with error_context(rest):
            return sequence, scene.place_rest(loaded, sequence), None
    sequence = open_sequence(frames, settings)
    scene.state(sequence.scene)
    if rest_frame == AUTO:
        index, reason = choose_rest_frame(sequence)
        loaded = load_rest_frame(sequence, index)
        return sequence, replace(loaded, notes=(*loaded.notes, Note(reason))), index
    if has_cage or isinstance(rest_frame, str):
        return sequence, *_load_frame_of_full_clip(frames, settings, sequence, rest_frame)
    index = find_rest_index(sequence, rest_frame)
    return sequence, load_rest_frame(sequence, index), index


def _load_frame_of_full_clip(
    frames: tuple[str, ...], settings: ClipSettings, taken: MeshSequence, rest_frame: RestFrame
) -> tuple[LoadedMesh, int | None]:
    """Load a frame of a whole clip as the rest pose, and find it among those that are taken."""
    is_whole = settings.selection == slice(None)
    every = replace(settings, selection=slice(None))
    whole = taken if is_whole else open_sequence(frames, every)
    index = find_rest_index(whole, rest_frame)
    number = whole.timeline.number_frame(index)
    if is_whole:
        return load_rest_frame(whole, index), index
    with suppress(SettingError):
        own = find_rest_index(taken, number)
        return load_rest_frame(taken, own), own
    loaded = load_rest_frame(whole, index)
    with error_context(whole.location(index)):
        faces = whole.first.fan_triangulated.faces
        expected = taken.first.fan_triangulated
        check_connectivity(len(loaded.mesh.vertices), faces, expected, "the first frame taken")
    reason = f"frame {number} is the rest pose, though it is none of the frames that are taken"
    # Polygons are cut as in the frames that are taken.
    mesh = taken.first.move(loaded.mesh.vertices)
    return replace(loaded, mesh=mesh, notes=(*loaded.notes, Note(reason))), None


def open_clip_of(
    mesh: LoadedMesh,
    frames: Sequence[str],
    settings: ClipSettings,
    scene: CommonScene,
    progress: ProgressListener,
    *,
    called: str,
    beside: str = "",
    other: str = "",
    edited: "CageFrames | None" = None,
    follows: bool = True,
) -> tuple[MeshSequence, LoadedMesh]:
    """Open a clip of a mesh, whose scene rules, and note what was changed in it.

    Parameters
    ----------
    called, beside, other : str
        What messages call the mesh, what its edges are of, and what it is of; alike by default.
    edited : CageFrames, optional
        What the frames of the clip are edits of, if it has as many.
    follows : bool
        Whether the clip must have the order of the mesh. If not, the mesh is put in that of the
        clip.

    Returns
    -------
    clip : MeshSequence
    mesh : LoadedMesh
        In the order of the clip, unless that follows.

    Raises
    ------
    ConnectivityError, FormatError
        When it is a clip of another mesh, has another order, or is in another scene.
    """
    if follows:
        clip = open_sequence(frames, settings, mesh)
    else:
        clip, mesh = open_clip_and_rest(frames, settings, mesh)
    place = " ".join(frames)
    with error_context(place):
        if follows:
            check_part_order(clip.first, mesh.mesh, called)
            check_vertex_order(clip.first, mesh.mesh.fan_triangulated, called)
        is_edit = edited is not None and edited.count == len(clip)
        clip = scene.match_clip(
            clip,
            Path(place).name,
            mesh.mesh,
            beside=f"those of {f'{called}s' if is_edit else beside or called}",
            other=other or called,
            read_expected=edited.read if edited is not None and is_edit else None,
        )
    note_all(progress, clip.notes)
    return clip, mesh


def choose_rest_frame(sequence: MeshSequence) -> tuple[int, str]:
    """Choose the frame in which the least of the surface touches another part, and say why.

    Frames that cannot be read are not compared; the run reports them.
    """
    from cageik_cli.cages.check.self_contact import make_contact_meter

    indices = spread_evenly(len(sequence), MAX_COMPARED_FRAMES)
    meter = make_contact_meter(sequence.first)
    if meter is None:
        return 0, "taken as the rest pose, as the model has no area to compare"
    percents: dict[int, float] = {}
    for index in indices.tolist():
        try:
            frame = sequence.read_frame(index)
        except InputError:
            continue
        percents[index] = round(100 * meter.measure(frame), 1)  # frames that look equal are
    if not percents:
        return 0, "taken as the rest pose, as no other frame can be read"
    best = min(percents, key=lambda index: (percents[index], index))
    return best, _explain_choice(best, percents, sequence.timeline)


def _explain_choice(best: int, percents: dict[int, float], timeline: Timeline) -> str:
    """Say how much of the frame touches, beside the first frame and the worst one."""
    first, most = next(iter(percents)), max(percents, key=lambda index: percents[index])
    others = [
        f"{format_decimals(percents[k], 1)} % in frame {timeline.number_frame(k)}"
        for k in dict.fromkeys((first, most))
        if k != best
    ]
    compared = f"{timeline.count} frames"
    if len(percents) < timeline.count:
        compared = f"{len(percents)} of {compared}"
    beside = f" ({', '.join(others)})" if others else ""
    return (
        f"frame {timeline.number_frame(best)} is the rest pose: "
        f"{format_decimals(percents[best], 1)} % of its surface is near another part, the least "
        f"of {compared}{beside}"
    )


def load_vertex_weights(
    given: Path | str | None, rest: LoadedMesh, frames: int | None = None
) -> VertexWeights:
    """Load or compute weights for the vertices of a rest pose.

    Parameters
    ----------
    frames : int, optional
        How many frames there are; then the file may also hold weights of each frame.
    """
    if not isinstance(given, Path):
        with error_context(rest.source["name"]):
            return VertexWeights(make_vertex_weights(given, rest.mesh))
    count = len(rest.mesh.vertices)
    rows = None if frames is None else open_frame_weights(given, frames, count)
    if rows is not None:
        source = {"name": to_unicode(given.name), "sha256": hash_file(given).hex()}
        every = np.full(count, 1 / rows.mean_share)
        return VertexWeights(every, rows, {"vertex_weights": source})
    values, source = read_vertex_weights(given)
    with error_context(given):
        return VertexWeights(
            make_vertex_weights(values, rest.mesh), sources={"vertex_weights": source}
        )
