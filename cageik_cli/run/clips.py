"""Several results as the clips of one rig: what they must share, their names and their frames."""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.inputs.input_frames import InputFrames, find_input, is_clean
from cageik_cli.inputs.reconstruction import CageFrames, Reconstruction
from cageik_cli.method.weights.binding import Binding
from cageik_cli.run.rig import measure_input_rms
from cageik_cli.store.result import Result, StoredAnimation
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint, Text, join_texts
from cageik_cli.util.text import number_names

SHARED_BINDING = "shared_binding.h5"
"""The binding that results are advised to share."""


def read_clips(results: Sequence[StoredAnimation], need: str) -> list[Reconstruction]:
    """Read the mesh animations of results, which have one binding.

    Parameters
    ----------
    need : str
        What needs their weights.

    Raises
    ------
    SettingError
        When a result has no weights, or the rest poses, cages or weights differ.
    """
    first = CagedModel.of_file(results[0].path, results[0]).read_reconstruction(need)
    clips = [first]
    for result in results[1:]:
        binding = CagedModel.of_file(result.path, result).read_binding(need)
        _check_shared(results, result, (first.binding, binding))
        clips.append(Reconstruction(first.binding, CageFrames.from_result(result, first.binding)))
    return clips


def join_clips(clips: Sequence[Reconstruction]) -> Reconstruction:
    """Return the mesh animations of one binding as one: the clips one after another."""
    if len(clips) == 1:
        return clips[0]
    joined = Reconstruction(clips[0].binding, CageFrames.join([clip.cages for clip in clips]))
    inputs = [clip for clip in clips if isinstance(clip, InputFrames)]
    return joined if len(inputs) < len(clips) else InputFrames.join(inputs, joined)


def find_inputs(
    results: Sequence[StoredAnimation],
    clips: Sequence[Reconstruction],
    name: str,
    jobs: int,
) -> tuple[Sequence[Reconstruction], str]:
    """Return the frames that clean results were extracted from, or the clips if one is not there.

    Beside them is a note that one is not there, or "". `name` is what the note is about.
    """
    found: list[Reconstruction] = []
    for result, clip in zip(results, clips, strict=True):
        if not (isinstance(result, Result) and is_clean(result)):
            return clips, ""
        frames = find_input(result, clip, jobs)
        if frames is None:
            return clips, (
                f"{name}: the skin follows what the cages give; put the input of "
                f"{result.path.name} beside it, and it follows that"
            )
        found.append(frames)
    return found, ""


def measure_rms(results: Sequence[StoredAnimation]) -> float | None:
    """Return the rms of all results as of `measure_input_rms`; None if that of one is unknown."""
    known = [measure_input_rms(result) for result in results]
    squares = [rms**2 for rms in known if rms is not None]
    if len(squares) < len(known):
        return None
    return float(np.sqrt(np.average(squares, weights=[len(one.frames) for one in results])))


def name_clips(results: Sequence[StoredAnimation]) -> list[str]:
    """Name the clips: as in a file of several clips, else as the file of the result; all differ.

    A batch names that after the file of the clip, whose suffix is left out.
    """
    names = []
    for result in results:
        file, _, inside = _get_source(result).partition("::")
        member, stem = inside.partition("::")[0], result.path.stem
        is_name = bool(member) and not member.isdigit() and not member.startswith("/")
        suffix = Path(file).suffix if file and stem.endswith(file) else ""
        names.append(member if is_name else stem.removesuffix(suffix))
    return number_names(names)


def _get_source(result: StoredAnimation) -> str:
    """Return what a result was extracted from, as it records it; "" where it does not."""
    source = result.sources.get("frames")
    return "" if source is None else str(source.get("name", ""))


def _check_shared(
    results: Sequence[StoredAnimation], result: StoredAnimation, bindings: tuple[Binding, Binding]
) -> None:
    """Refuse a result whose binding, the second, is not that of the first result."""
    first, own = bindings
    differs = {
        "another rest pose": not np.array_equal(first.rest.faces, own.rest.faces)
        or not np.array_equal(first.rest.vertices, own.rest.vertices),
        "another cage": not np.array_equal(first.cage.faces, own.cage.faces)
        or not np.array_equal(first.cage.vertices, own.cage.vertices),
        "other weights": not np.array_equal(first.weights, own.weights),
        "another up axis or unit": results[0].scene.space != result.scene.space,
    }
    for what, is_other in differs.items():
        if is_other:
            raise SettingError(
                f"{result.path}: has {what} than {results[0].path}, and one skeleton needs one of "
                "all; fit weights to all clips by "
                + _advise_bind(results)
                + ", then extract each again by "
                + join_texts(", ", (_advise_extract(result) for result in results))
            )


def _advise_bind(results: Sequence[StoredAnimation]) -> Text:
    """Return the command that fits weights to the clips of all results."""
    first = _quote(results[0].path)
    fits = [Hint("fit", _name_input(result)) for result in results]
    words = [Hint("rest", first), Hint("cage", first), *fits, Hint("output", SHARED_BINDING)]
    return "cageik bind " + join_texts(" ", words)


def _advise_extract(result: StoredAnimation) -> Text:
    words = [Hint("rest", SHARED_BINDING), Hint("binding", SHARED_BINDING)]
    words += [Hint("output", _quote(result.path)), Hint("overwrite", True)]
    return f"cageik extract {_name_input(result)} " + join_texts(" ", words)


def _name_input(result: StoredAnimation) -> str:
    """Return what names the clip of a result on a command line; frames of one file each, a glob."""
    first, _, last = _get_source(result).partition(" ... ")
    if not first:
        return "CLIP"
    return _quote(re.sub(r"\d+(?=\D*$)", "*", first) if last else first)


def _quote(name: str | Path) -> str:
    return shlex.quote(str(name))
