"""Clips in HDF5 files, in the layouts of SPLOCS and of D-FAUST."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.hdf5 import lone_attributes, numbers, open_file, opened, sound
from cageik_cli.scene import SceneHints, sound_hints
from cageik_cli.sequence.clip import ClipRequest
from cageik_cli.sequence.clip_file import ClipFile, only, refuse_counted_from_one
from cageik_cli.sequence.hdf5_layouts import Hdf5Frames, chosen, clips_of
from cageik_cli.util.text import printable


class Reader(ClipFile):
    """Frames of one clip in an HDF5 file, which stays open."""

    suffixes = (".h5", ".hdf5")
    has_members = True

    def __init__(self, request: ClipRequest) -> None:
        path = only(request.paths)
        with sound(path), ExitStack() as stack:
            file = stack.enter_context(open_file(path))
            layout, names = clips_of(file)
            self._frames = Hdf5Frames(file, chosen(names, request.member), layout)
            faces = numbers(file, layout.faces, "iu", (None, 3))
            hints, notes = sound_hints(lone_attributes(file, SceneHints.__slots__))
            self.take(request, self._frames.count, hints)
            self.notes = tuple(f"{printable(path.name)}: {note}" for note in notes)
            refuse_counted_from_one(faces, self._frames.vertices)
            self.first = TriMesh(self._frames.frame(self.numbers[0]), faces)
            stack.pop_all()  # open from here on

    @classmethod
    def members(cls, path: Path) -> list[str]:
        """The clips of a file that holds several."""
        with opened(path) as file:
            _, names = clips_of(file)
        return names if len(names) > 1 else []

    @classmethod
    def outline(cls, request: ClipRequest) -> list[tuple[str, str]]:
        """The clips of a file that holds several, if none of them is asked for."""
        path = only(request.paths)
        with opened(path) as file:
            layout, names = clips_of(file)
            if len(names) == 1 or request.member is not None:
                return []
            clips = [(name, Hdf5Frames(file, name, layout)) for name in names]
            return [
                ("holds", f"{len(names)} clips, each named as FILE::CLIP"),
                *(
                    ("clip", f"{printable(name)}, {clip.count} frames of {clip.vertices} vertices")
                    for name, clip in clips
                ),
            ]

    def positions(self, index: int) -> np.ndarray:
        """Vertices of one frame."""
        with sound(self.path):
            return self._frames.frame(self.numbers[index])
