"""The rest pose of a clip: a file, a frame by its number, or the frame in which least touches."""

from dataclasses import dataclass, replace
from pathlib import Path

from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.open import load_rest_frame, open_clip_and_rest, open_sequence
from cageik_cli.formats.settings import AUTO, ClipSettings, RestFrame
from cageik_cli.util.arrays import spread_evenly
from cageik_cli.util.errors import InputError

MAX_COMPARED_FRAMES = 200
"""Frames of a clip that are compared, at most; of longer clips they are spread evenly."""

PERCENT_DECIMALS = 1
"""Frames are equal whose contact is the same, in percent of the surface, to so many decimals."""


@dataclass(frozen=True, slots=True)
class RestFrameChoice:
    """The frame in which the least of the surface touches another part.

    Attributes
    ----------
    index : int
        The first of the best frames, from 0.
    reason : str
        Why it was chosen, in a sentence.
    """

    index: int
    reason: str


def open_clip_and_choose_rest(
    frames: tuple[str, ...], settings: ClipSettings, rest: Path | None, rest_frame: RestFrame
) -> tuple[MeshSequence, LoadedMesh, int | None]:
    """Open a clip and its rest pose.

    Returns
    -------
    sequence : MeshSequence
    rest : LoadedMesh
        With a note on why it was chosen, if it was.
    index : int or None
        The number of the rest pose in the clip; None for a file.

    Raises
    ------
    InputError
        When one of them cannot be read, or has other faces.
    """
    if rest is not None or rest_frame != AUTO:
        index = 0 if rest_frame == AUTO else int(rest_frame)
        return *open_clip_and_rest(frames, settings, rest, index), None if rest else index
    sequence = open_sequence(list(frames), settings)
    choice = choose_rest_frame(sequence)
    loaded = load_rest_frame(sequence, choice.index)
    return sequence, replace(loaded, notes=(*loaded.notes, choice.reason)), choice.index


def choose_rest_frame(sequence: MeshSequence) -> RestFrameChoice:
    """Choose the frame in which the least of the surface touches another part.

    Frames that cannot be read are not compared; the run reports them.
    """
    from cageik_cli.cages.self_contact import make_contact_meter

    indices = spread_evenly(len(sequence), MAX_COMPARED_FRAMES)
    meter = make_contact_meter(sequence.first)
    if meter is None:
        return RestFrameChoice(0, "taken as the rest pose, as the model has no area to compare")
    percents: dict[int, float] = {}
    for index in indices.tolist():
        try:
            frame = sequence.read_frame(index)
        except InputError:
            continue
        percents[index] = round(100 * meter.measure(frame), PERCENT_DECIMALS)
    if not percents:
        return RestFrameChoice(0, "taken as the rest pose, as no other frame can be read")
    best = min(percents, key=lambda index: (percents[index], index))
    return RestFrameChoice(best, _explain_choice(best, percents, len(sequence)))


def _explain_choice(best: int, percents: dict[int, float], count: int) -> str:
    """Say how much of the frame touches, beside the first frame and the worst one."""
    first, most = next(iter(percents)), max(percents, key=lambda index: percents[index])
    others = [
        f"{percents[k]:.{PERCENT_DECIMALS}f} % in frame {k}"
        for k in dict.fromkeys((first, most))
        if k != best
    ]
    compared = f"{count} frames" if len(percents) == count else f"{len(percents)} of {count} frames"
    beside = f" ({', '.join(others)})" if others else ""
    return (
        f"frame {best} is the rest pose: {percents[best]:.{PERCENT_DECIMALS}f} % of its surface is "
        f"near another part, the least of {compared}{beside}"
    )
