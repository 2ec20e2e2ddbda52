"""The frames that a result was extracted from, or the result of an edit, where they are found.

A result records the names of files and a digest, not where they were. They are looked for in the
folder of the result and in the one that the command runs in, frames of one file each also one
folder below. What is found is the input if its digest is the recorded one, and the cages of the
result are as far from a few of its frames as is recorded.
"""

import hashlib
import json
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.formats.base.files import describe_file
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings, Gaps
from cageik_cli.inputs.reconstruction import Reconstruction
from cageik_cli.method.weights.binding import Binding
from cageik_cli.rigs.joints import JointPoses
from cageik_cli.store.result import Edit, Result, read_animation
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError
from cageik_cli.util.settings import list_settings
from cageik_cli.util.threads import OrderedMap

COMPARED_FRAMES = 3
"""Frames of what was found that are compared with the cages of the result."""

MAX_ERROR_CHANGE = 1e-3
"""The error of such a frame may differ by this share from the recorded one."""


class InputFrames(Reconstruction):
    """The frames of clips in place of what the cages give; filled gaps are as the cages have them.

    Parameters
    ----------
    reconstruction : Reconstruction
        Of the cages.
    places : list of (MeshSequence, int)
        In which clip each frame is, and where.
    jobs : int
        Threads that read frames ahead.
    vertices : (k,) int64, optional
        Those of the frames that are taken; all if absent.
    """

    def __init__(
        self,
        reconstruction: Reconstruction,
        places: list[tuple[MeshSequence, int]],
        jobs: int = 1,
        vertices: Integers | None = None,
    ) -> None:
        super().__init__(reconstruction.binding, reconstruction.cages)
        self._reconstruction, self._places = reconstruction, places
        self._jobs, self._vertices = jobs, vertices

    def take(self, binding: Binding, vertices: Integers) -> "InputFrames":
        """Return the frames of some vertices, (k,), of which `binding` is."""
        reconstruction = Reconstruction(binding, self.cages)
        return InputFrames(reconstruction, self._places, self._jobs, vertices)

    @staticmethod
    def join(clips: "Sequence[InputFrames]", reconstruction: Reconstruction) -> "InputFrames":
        """Return the frames of several clips, one after another, whose cages are joined."""
        places = [place for clip in clips for place in clip._places]
        return InputFrames(reconstruction, places, clips[0]._jobs)

    def read_frame(self, index: int) -> Floats:
        """Return the mesh (m, 3) of a frame that fills no gap."""
        return self._read(int(self.cages.known[index]))

    def describe_sources(self) -> list[Any]:
        """Return what results record of the clips, as they were when frames were last read.

        Raises
        ------
        FileAccessError
            When the file of a clip was written again.
        """
        clips = dict.fromkeys(clip for clip, _ in self._places)
        return [clip.describe_source() for clip in clips]

    def hash_frames(self) -> str:
        """Return a digest of the clips, of the frames and vertices of them, and of the cages."""
        chosen = [] if self._vertices is None else self._vertices.tolist()
        sources = [source["sha256"] for source in self.describe_sources()]
        values = [super().hash_frames(), sources, [place for _, place in self._places], chosen]
        return hashlib.sha256(json.dumps(values).encode()).hexdigest()

    def _read(self, frame: int) -> Floats:
        clip, place = self._places[frame]
        mesh = clip.read_frame(place)
        return mesh if self._vertices is None else mesh[self._vertices]

    def blocks(self, size: int) -> Iterator[JointPoses]:
        """Yield all frames in order, in blocks of at most `size`."""
        is_known = np.isin(np.arange(self.cages.count), self.cages.known)

        def read(frame: int) -> Floats | None:
            return self._read(frame) if is_known[frame] else None

        with OrderedMap(read, range(self.cages.count), self._jobs, 2 * self._jobs) as meshes:
            for block in self._reconstruction.blocks(size):
                found = block.meshes.copy()
                for mesh in found:
                    known = next(meshes)
                    mesh[:] = mesh if known is None else known
                yield JointPoses(block.cages, block.rotations, found)


def is_clean(result: Result) -> bool:
    """Return whether all of the input is data that counts alike: a skin may follow it.

    Where vertices are missing, rejected or weighted, the cages know better than the input.
    """
    names = {setting.name for _, setting in list_settings(CaptureSettings)} | {"missing"}
    is_weighted = bool(result.settings.get("vertex_weights"))
    is_whole = bool(np.isfinite(result.vertex_rms).all())
    return is_whole and not is_weighted and names.isdisjoint(result.settings)


def find_input(result: Result, reconstruction: Reconstruction, jobs: int = 1) -> InputFrames | None:
    """Find the frames that a result was extracted from; None if they are not there."""
    for arguments in list_candidates(result):
        with suppress(InputError):
            exclude = tuple(result.settings.get("exclude", ()))
            gaps: Gaps = "keep" if result.skipped else "close"
            settings = ClipSettings(gaps=gaps, exclude=exclude, fps=result.scene.fps)
            clip = open_sequence(arguments, settings)
            numbers = {name: number for number, name in enumerate(clip.names)}
            is_input = clip.describe_source() == result.sources.get("frames")
            if is_input and all(name in numbers for name in result.frames):
                places = [(clip, numbers[name]) for name in result.frames]
                found = InputFrames(reconstruction, places, jobs)
                if _is_as_far(result, reconstruction, found):
                    return found
    return None


def find_edited(edit: Edit) -> Result | Edit | None:
    """Find what an edit was made from, beside it or in this folder; None if it is not there."""
    source = edit.sources.get("result")
    if source is None:
        return None
    for folder in dict.fromkeys([edit.path.parent, Path()]):
        with suppress(InputError):
            if _is_in(folder, source["name"]) and describe_file(folder / source["name"]) == source:
                found = read_animation(folder / source["name"])
                if len(found.frames) == len(edit.frames):
                    return found
    return None


def list_candidates(result: Result, left_out: Collection[str] = ()) -> Iterator[list[str]]:
    """Yield what may name the input: a file, or a file of each frame but those `left_out`.

    Frames that were skipped may have no file.

    A name that leads elsewhere, as a result from a stranger may have, is left alone.
    """
    frames = [frame for frame in result.frames if frame not in left_out]
    may_be_absent = {result.frames[number] for number in result.skipped}
    name, _, member = str((result.sources.get("frames") or {"name": ""}).get("name", "")).partition(
        "::"
    )
    suffix = f"::{member}" if member else ""
    for folder in dict.fromkeys([result.path.parent, Path()]):
        if _is_in(folder, name):
            yield [f"{folder / name}{suffix}"]
        for inside in (folder, *_list_folders(folder)):
            found = [frame for frame in frames if _is_in(inside, frame)]
            if found and may_be_absent.union(found).issuperset(frames):
                yield [f"{inside / frame}{suffix}" for frame in found]


def _list_folders(folder: Path) -> list[Path]:
    """List the folders in a folder; none in one that may not be listed."""
    found = []
    with suppress(OSError):
        for path in folder.iterdir():
            with suppress(OSError):
                found += [path] if path.is_dir() else []
    return sorted(found)


def _is_in(folder: Path, name: str) -> bool:
    """Return whether a folder itself has a file of this name; not if it may not be entered."""
    try:
        return Path(name).name == name and (folder / name).is_file()
    except OSError:
        return False


def _is_as_far(result: Result, reconstruction: Reconstruction, found: InputFrames) -> bool:
    """Return whether some frames are as far from what the cages give as is recorded."""
    used, known = reconstruction.binding.rest.used_vertices, reconstruction.cages.known
    for index in np.linspace(0, len(known) - 1, COMPARED_FRAMES).astype(int).tolist():
        offsets = found.read_frame(index) - reconstruction.read_frame(index)
        rms = np.sqrt(np.square(offsets[used]).sum(axis=1).mean())
        noise = 1e-7 * result.rest.diagonal
        recorded = result.metrics.rms[known[index]]
        if not np.isclose(rms, recorded, rtol=MAX_ERROR_CHANGE, atol=noise):
            return False
    return True
