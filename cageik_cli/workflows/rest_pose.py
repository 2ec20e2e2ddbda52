"""The rest pose of a clip: a file, or the frame in which least touches; and its vertex weights."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.files import hash_file
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.open import (
    find_rest_index,
    load_rest_frame,
    open_clip_and_rest,
    open_sequence,
)
from cageik_cli.formats.settings import AUTO, ClipSettings, RestFrame
from cageik_cli.formats.timeline import Timeline
from cageik_cli.formats.vertex_weights import (
    FrameWeightsFile,
    open_frame_weights,
    read_vertex_weights,
)
from cageik_cli.solver.vertex_weights import make_vertex_weights
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.errors import InputError, error_context
from cageik_cli.util.text import to_unicode
from cageik_cli.workflows.common_scene import CommonScene
from cageik_cli.workflows.mesh_source import load_rest

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
) -> tuple[MeshSequence, LoadedMesh, int | None]:
    """Open a clip, whose scene rules, and its rest pose, which is brought into it.

    Returns
    -------
    sequence : MeshSequence
    rest : LoadedMesh
        With a note on why it was chosen, if it was.
    index : int or None
        Which frame of the clip the rest pose is, from 0; None for a file.
    """
    if rest is not None or rest_frame != AUTO:
        given = None if rest is None else load_rest(rest, settings.exclude)
        sequence, loaded = open_clip_and_rest(frames, settings, given, rest_frame)
        scene.state(sequence.scene)
        if rest is None:
            return sequence, loaded, find_rest_index(sequence, rest_frame)
        with error_context(rest):
            return sequence, scene.check_rest(scene.place(loaded), loaded.scene, sequence), None
    sequence = open_sequence(list(frames), settings)
    scene.state(sequence.scene)
    index, reason = choose_rest_frame(sequence)
    loaded = load_rest_frame(sequence, index)
    return sequence, replace(loaded, notes=(*loaded.notes, reason)), index


def choose_rest_frame(sequence: MeshSequence) -> tuple[int, str]:
    """Choose the frame in which the least of the surface touches another part, and say why.

    Frames that cannot be read are not compared; the run reports them.
    """
    from cageik_cli.cages.self_contact import make_contact_meter

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
        f"{percents[k]:.1f} % in frame {timeline.number_frame(k)}"
        for k in dict.fromkeys((first, most))
        if k != best
    ]
    compared = f"{timeline.count} frames"
    if len(percents) < timeline.count:
        compared = f"{len(percents)} of {compared}"
    beside = f" ({', '.join(others)})" if others else ""
    return (
        f"frame {timeline.number_frame(best)} is the rest pose: {percents[best]:.1f} % of its "
        f"surface is near another part, the least of {compared}{beside}"
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
        every = np.full(count, rows.largest / rows.mean)
        return VertexWeights(every, rows, {"vertex_weights": source})
    values, source = read_vertex_weights(given)
    with error_context(given):
        return VertexWeights(
            make_vertex_weights(values, rest.mesh), sources={"vertex_weights": source}
        )
