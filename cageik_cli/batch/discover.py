"""Find the clips under folders: folders of frames, and files that hold clips."""

import glob
import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from os.path import abspath, commonpath, relpath, splitdrive
from pathlib import Path

from cageik_cli.formats.base.files import file_suffix
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.find_files import (
    are_frames,
    clip_suffixes,
    count_names,
    find_series,
    mesh_suffixes,
    sort_naturally,
)
from cageik_cli.formats.open import list_members
from cageik_cli.report.overview import shorten_names
from cageik_cli.store.binding_file import is_binding
from cageik_cli.store.result import is_animation
from cageik_cli.util.errors import FileAccessError, SettingError, join_truncated
from cageik_cli.util.messages import say
from cageik_cli.util.text import make_file_name

NUMBER_PLACE = "\0"
"""Stands for the number in names of frames, and in no other name."""

MAX_RESULT_NAME = 200
"""Bytes of the name of a result, without its suffix; most disks take 255 in all."""


@dataclass(frozen=True, slots=True)
class DiscoveredClip:
    """A clip that was found.

    Attributes
    ----------
    name : str
        Its path under the searched folder, with forward slashes.
    path : Path
        The folder of its frames, or its file, or the file and the name of the clip in it.
    frames : tuple of str
        The argument of `cageik extract`.
    result : str
        The name of the file with its result.
    """

    name: str
    folder: Path
    path: Path
    frames: tuple[str, ...]
    result: str = ""


def walk_folders(root: Path, output: Path) -> Iterator[Path]:
    """Yield a folder and those in it, once, in natural order; not hidden ones, nor `output`."""
    if root.is_file():
        raise FileAccessError(f"{root}: is a file; give its folder, or use cageik extract")
    if not root.is_dir() and glob.has_magic(str(root)):
        raise FileAccessError(f"{root}: is a pattern, not a folder; write it without quotes")
    if not root.is_dir():
        raise FileAccessError(f"{root}: no such folder; give one with animations")
    seen = {output.resolve()}
    waiting = [root]
    while waiting:
        folder = waiting.pop()
        place = folder.resolve()
        if place in seen:
            continue  # the output, or a link to a folder that was searched already
        seen.add(place)
        yield folder
        try:
            inside = [path for path in folder.iterdir() if path.is_dir()]
        except OSError as error:
            raise FileAccessError(
                f"{folder}: cannot be read ({error.strerror or error})"
            ) from error
        visible = [path for path in inside if not path.name.startswith(".")]
        waiting += reversed(sort_naturally(visible))


def discover_clips(
    roots: Sequence[Path],
    *,
    output: Path,
    auxiliary_files: Set[Path] = frozenset(),
    exclude: Sequence[str] = (),
    note: Callable[[str], object] = str,
) -> list[DiscoveredClip]:
    """Find all clips under the folders, in natural order.

    With several folders, the names of clips begin with those of the folders.

    Parameters
    ----------
    output : Path
        The folder of the results, which is not searched.
    auxiliary_files : set of Path
        Cages, rest poses and other files that are not clips; resolved.
    exclude : sequence of str
        Patterns of clips that are left out: of their names, or of what lists show of these.
    note : callable
        Takes a sentence on numbered meshes that are no clip, and on meshes beside frames.
    """
    _check_not_nested(roots)
    found: list[DiscoveredClip] = []
    no_clips: list[str] = []
    beside: list[str] = []
    for root in roots:
        prefix = f"{root.resolve().name}/" if len(roots) > 1 else ""
        series: list[str] = []
        others: list[str] = []
        for folder in walk_folders(root, output):
            for clip in _find_clips_in(folder, root, auxiliary_files, series, others):
                found.append(replace(clip, name=prefix + clip.name))
        no_clips += [prefix + name for name in series]
        beside += [prefix + name for name in others]
    places = ", ".join(map(str, roots))
    left_out = f"numbered meshes whose vertices differ are no clip: {join_truncated(no_clips)}"
    if not found:
        raise FileAccessError(
            f"{places}: no clip found, expected folders of numbered frames "
            f"({', '.join(mesh_suffixes())}) or clip files ({', '.join(_clip_file_suffixes())})"
            + (f"; {left_out}" if no_clips else "")
        )
    if no_clips:
        note(f"left out, as {left_out}")
    if beside:
        note(f"left out, as not numbered as the frames are: {count_names(beside)}")
    found = _make_names_unique(found, roots)
    names = [clip.name for clip in found]
    # Those that are left out count, so that the names of others do not depend on the patterns.
    found = [replace(c, result=r) for c, r in zip(found, name_results(names), strict=True)]
    kept = [
        clip
        for clip, shown in zip(found, shorten_names(names), strict=True)
        if not any(fnmatch(name, pattern) for pattern in exclude for name in (clip.name, shown))
    ]
    if not kept:
        raise SettingError(
            f"{places}: "
            + say("`exclude_clips=` leaves out all ")
            + f"{len(found)} clips; exclude fewer"
        )
    return kept


def name_results(names: Sequence[str]) -> list[str]:
    """Return the names of the files with the results of clips, whose own names all differ.

    All results are in one folder, so that those of several clips can be copied together. A name
    that one before has, on some disks at least, gets a digest of the clip's whole name.
    """
    taken: set[str] = set()
    results: list[str] = []
    for name in names:
        results.append(make_result_name(name, taken))
        taken.add(results[-1].casefold())
    return results


def make_result_name(name: str, taken: Set[str] = frozenset()) -> str:
    """Return the name of the file with the result of a clip.

    A name that is too long for a disk is cut at its beginning, and gets a digest of the whole, as
    one does that is `taken`, whether its letters are large or small.
    """
    flat = name.replace("/", "_")
    if len(flat.encode()) > MAX_RESULT_NAME or f"{flat}.h5".casefold() in taken:
        flat = (
            f"{_make_digest(name)}_{flat.encode()[9 - MAX_RESULT_NAME :].decode(errors='ignore')}"
        )
    return f"{flat}.h5"


def _make_names_unique(
    clips: Sequence[DiscoveredClip], roots: Sequence[Path]
) -> list[DiscoveredClip]:
    """Give clips whose name one before has, in folders of one name, a digest of their path.

    The path is that below what all folders share, so that a moved project keeps its names.
    """
    above = commonpath(map(_find_place, roots))
    taken: set[str] = set()
    named: list[DiscoveredClip] = []
    for clip in clips:
        name = clip.name
        if name in taken:
            folder, _, last = name.rpartition("/")
            place = Path(relpath(_find_place(clip.frames[0]), above)).as_posix()
            name = f"{folder}/{_make_digest(place)}_{last}".lstrip("/")
        taken.add(name)
        named.append(replace(clip, name=name))
    return named


def _find_place(path: str | Path) -> str:
    """Return an absolute path without its drive, which need not be that of another."""
    return splitdrive(abspath(path))[1]


def _make_digest(text: str) -> str:
    return hashlib.sha256(os.fsencode(text)).hexdigest()[:8]


def _check_not_nested(roots: Sequence[Path]) -> None:
    """Refuse folders that would be searched twice."""
    places = [root.resolve() for root in roots]
    for k, place in enumerate(places):
        for other in places[:k] + places[k + 1 :]:
            if other == place or other in place.parents:
                raise SettingError(
                    f"{place}: would be searched twice; give either it or {other}, once"
                )


def _find_clips_in(
    folder: Path,
    root: Path,
    auxiliary_files: Set[Path],
    no_clips: list[str],
    beside: list[str],
) -> Iterator[DiscoveredClip]:
    """Yield the clips of a folder: of its numbered mesh files, and in its clip files.

    Numbered meshes that are no frames of one another are added to `no_clips`, and other meshes that
    are beside frames to `beside`.
    """
    files = [path for path in folder.iterdir() if path.is_file() and path.name[0] != "."]
    files = sort_naturally([path for path in files if path.resolve() not in auxiliary_files])
    # A single file is a rest pose, a cage or a prop.
    series = find_series(files)
    stems = Counter(one.name_around(NUMBER_PLACE) for one in series)
    clips = {}
    for one in series:
        stem, kind = one.name_around(NUMBER_PLACE), file_suffix(one.paths[0])
        clips[stem + (kind if stems[stem] > 1 else "")] = sort_naturally(one.paths)
    for stem in [stem for stem, frames in clips.items() if not are_frames(frames)]:
        no_clips.append(str(folder.relative_to(root) / stem.replace(NUMBER_PLACE, "*")))
        del clips[stem]
    numbered = {path for one in series for path in one.paths}
    left = [path for path in files if file_suffix(path) in mesh_suffixes()] if clips else []
    beside += [str(path.relative_to(root)) for path in left if path not in numbered]
    for stem, frames in clips.items():
        name, place = _make_clip_name(folder, root), folder
        if len(clips) > 1:
            text = stem.replace(NUMBER_PLACE, "").strip("._- ")
            label = make_file_name(text) if stem != NUMBER_PLACE else "frames"
            name, place = f"{name}/{label}", folder / label
        yield DiscoveredClip(name, folder, place, tuple(map(str, frames)))
    for path in files:
        if file_suffix(path) not in _clip_file_suffixes() or _is_cageik_file(path):
            continue
        name, members = _make_clip_name(path, root), list_members(path)
        if not members:
            yield DiscoveredClip(name, folder, path, (str(path),))
        for member in members:
            plain = make_file_name(member)
            yield DiscoveredClip(f"{name}/{plain}", folder, path / plain, (f"{path}::{member}",))


def _is_cageik_file(path: Path) -> bool:
    """Return whether it is a result, an edit or a binding of cageik, which may lie beside clips."""
    if path.suffix.lower() not in HDF5_SUFFIXES:
        return False
    try:
        return is_animation(path) or is_binding(path)
    except Exception:  # whatever is in the file: opening the clip reports it
        return False


def _clip_file_suffixes() -> list[str]:
    return [suffix for suffix in clip_suffixes() if suffix not in mesh_suffixes()]


def _make_clip_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).parts or (root.resolve().name or "clip",)
    return "/".join(make_file_name(part) for part in parts)
