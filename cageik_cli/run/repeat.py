"""A result extracted again: its own clip with the settings that it records, in another cage.

A result records the names of its files and their digests, not where they were. What is found is
refused unless it is exactly what the result was extracted from.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.formats.base.files import hash_file
from cageik_cli.formats.find_files import Source, list_input_files
from cageik_cli.formats.settings import ClipSettings, RestFrame, SceneHints
from cageik_cli.formats.timeline import FrameRange, Timeline
from cageik_cli.inputs.input_frames import list_candidates
from cageik_cli.method.solve.settings import AREA, SolveSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.extraction import Extraction
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.hdf5_fields import SourceRecord
from cageik_cli.store.result import Result, has_weights
from cageik_cli.util.errors import FileAccessError, InputError, SettingError
from cageik_cli.util.messages import say
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.settings import restore_settings


def extract_again(
    result: Result,
    cage: Path,
    output: Path,
    progress: ProgressListener,
    *,
    clip: str | None = None,
    cache: Path | None = None,
    jobs: int = 1,
) -> None:
    """Extract the clip of a result in another cage, with the settings that it records.

    Parameters
    ----------
    cage : Path
        A mesh in the unit and axes of the result.
    output : Path
        The new result; nothing is replaced.
    clip : str, optional
        Where the clip is: a folder, a glob or a file. By default it is looked for in the folder of
        the result and the current one, frames of one file each also one folder below.

    Raises
    ------
    FileAccessError
        When the clip, or a file beside it, is not there or has changed.
    SettingError
        When the result does not record all that the run needs.
    InputError
        As of an extraction.
    """
    settings = _find_settings(result, cage, output, clip, cache, jobs)
    with progress.stage("open"):
        settings = _check_is_input(result, settings)
    Extraction(settings, progress).run()


def find_clip(result: Result, clip: str | None = None) -> tuple[str, ...]:
    """Find what names the clip of a result; its digest is not compared.

    Raises
    ------
    FileAccessError
        When it is not there.
    """
    absent = _list_absent(result)
    if clip is None:
        found = next(list_candidates(result, absent), None)
        if found is None:
            raise FileAccessError(
                f"{_name_clip(result)}: not found in {_name_folders(result)}, nor in a folder "
                "there; " + say("start cageik view there, or name it by `clip=`")
            )
        return tuple(found)
    source = Source.parse(clip)
    if source.file.is_file():
        return (clip,)
    wanted = set(result.frames) - absent
    files = [path for path in list_input_files([str(source.file)]) if path.name in wanted]
    if {path.name for path in files} != wanted:
        raise FileAccessError(
            f"{clip}: has not all frames of {_name_clip(result)}; name the folder or the file "
            "that the result was extracted from"
        )
    return tuple(map(str, files))


def _list_absent(result: Result) -> set[str]:
    """List the skipped frames, if some had no file when the result was extracted."""
    count = dict(result.sources.get("frames", {})).get("files", len(result.frames))
    return {result.frames[k] for k in result.skipped} if count != len(result.frames) else set()


def _name_clip(result: Result) -> str:
    return str(dict(result.sources.get("frames", {})).get("name", "the clip"))


def _name_folders(result: Result) -> str:
    folders = dict.fromkeys([str(result.path.parent), "."])
    return " or ".join("the current folder" if name == "." else name for name in folders)


def _find_settings(
    result: Result, cage: Path, output: Path, clip: str | None, cache: Path | None, jobs: int
) -> ExtractSettings:
    """Return the settings of the run, as far as files and records give them."""
    recorded = result.settings
    _check_own_fit(result)
    frames = find_clip(result, clip)
    folders = [Path(Source.parse(frames[0]).file).parent, result.path.parent, Path()]
    rest, given_in = _find_rest(result, folders)
    if rest is not None and given_in:
        raise SettingError(
            f"{result.path}: was extracted with files in another unit or other axes ({given_in}), "
            "which cannot be repeated here; save the cage, and extract again by the command"
        )
    weights: Path | str | None = None
    if recorded.get("vertex_weights") == AREA:
        weights = AREA
    elif recorded.get("vertex_weights"):
        weights = _find_file(result.sources.get("vertex_weights"), folders, "the vertex weights")
    selection = _find_selection(result, frames)
    return ExtractSettings(
        frames,
        cage,
        output=output,
        cache=cache,
        rest=rest,
        rest_frame=_find_rest_frame(result, selection) if rest is None else 0,
        bind=restore_settings(BindSettings, recorded),
        solve=restore_settings(SolveSettings, recorded),
        fit=result.fit.settings if result.fit is not None else False,
        vertex_weights=weights,
        capture=restore_settings(CaptureSettings, recorded),
        clip=_restore_clip(result, selection),
        on_bad_frame="skip" if result.skipped else "stop",
        keep_weights=has_weights(result),
        jobs=jobs,
    )


def _check_own_fit(result: Result) -> None:
    """Refuse weights that were fitted to other clips: the new cage has no such fit."""
    if result.fit is None:
        return
    digest = dict(result.sources.get("frames", {})).get("sha256")
    if [one.sha256 for one in result.fit.clips] != [digest]:
        names = ", ".join(one.name for one in result.fit.clips)
        raise SettingError(
            f"{result.path}: its weights were fitted to other clips ({names}), which cannot be "
            "repeated here; save the cage, bind and fit it by cageik bind, and extract with that"
        )


def _find_rest(result: Result, folders: Sequence[Path]) -> tuple[Path | None, str]:
    """Find the file of the rest pose, unless it is a frame, and in what it was given."""
    source = result.sources.get("rest")
    if result.settings.get("rest_frame") is not None or source is None:
        return None, ""
    return _find_file(source, folders, "the rest pose"), str(result.settings.get("given_in", ""))


def _find_file(source: SourceRecord | None, folders: Sequence[Path], what: str) -> Path:
    """Find a file of a name and a digest in one of some folders."""
    name = str(dict(source or {}).get("name", ""))
    if not name:
        raise SettingError(f"{what}: came from no file, so that the run cannot be repeated")
    is_there = False
    for folder in dict.fromkeys(folders):
        path = folder / name
        with suppress(OSError, InputError):
            if Path(name).name == name and path.is_file():
                is_there = True
                if dict(source or {}).get("sha256") in (None, hash_file(path).hex()):
                    return path
    found = "has changed since the extraction" if is_there else "is not beside the result"
    raise FileAccessError(f"{name}: {what} {found}; put it back as it was, beside the result")


def _find_selection(result: Result, frames: tuple[str, ...]) -> slice | FrameRange:
    """Return which frames of a file were taken, by their numbers; all of files of one frame."""
    found = [re.search(r"\[(-?[\d.]+)\]$", name) for name in result.frames]
    numbers = [float(one[1]) for one in found if one is not None]
    if len(frames) != 1 or len(numbers) != len(found):
        return slice(None)
    step = (numbers[-1] - numbers[0]) / max(len(numbers) - 1, 1)
    return FrameRange(numbers[0], numbers[-1], step or None)


def _find_rest_frame(result: Result, selection: slice | FrameRange) -> RestFrame:
    """Return which frame is the rest pose: by its number where only some are taken."""
    index = int(result.settings.get("rest_frame") or 0)
    if isinstance(selection, slice):
        return index
    start, step = selection.first or 0.0, selection.step or 1.0
    return Timeline(len(result.frames), start, step).number_frame(index)


def _restore_clip(result: Result, selection: slice | FrameRange) -> ClipSettings:
    restored: ClipSettings = restore_settings(ClipSettings, result.settings)
    return ClipSettings(
        selection=selection,
        gaps="keep" if _list_absent(result) else "close",
        missing=restored.missing,
        exclude=restored.exclude,
    )


def _check_is_input(result: Result, settings: ExtractSettings) -> ExtractSettings:
    """Refuse a clip, or a rest pose, that is not what the result was extracted from.

    The scene is stated only where the clip does not state the same.
    """
    where = _name_clip(result)
    extraction = Extraction(settings)
    extraction.open()
    if extraction.scene != result.scene:
        stated = {name: getattr(result.scene, name) for name in SceneHints.__slots__}
        settings = replace(settings, scene=SceneHints(**stated))
        extraction = Extraction(settings)
        extraction.open()
    clip, rest = extraction.sequence, extraction.rest.mesh
    if clip.describe_source()["sha256"] != dict(result.sources["frames"]).get("sha256"):
        raise FileAccessError(
            f"{where}: has changed since {result.path.name} was extracted; put it back as it was, "
            "or extract the changed clip by the command"
        )
    if clip.names != result.frames or extraction.scene != result.scene:
        raise SettingError(
            f"{where}: is taken with other frames, or in another scene, than {result.path.name} "
            "records; save the cage, and extract again by the command"
        )
    same = np.array_equal(rest.vertices, result.rest.vertices)
    if not (same and np.array_equal(rest.faces, result.rest.faces)):
        raise SettingError(
            f"{extraction.rest.source['name']}: is not the rest pose of {result.path.name}; save "
            "the cage, and extract again by the command"
        )
    return settings
