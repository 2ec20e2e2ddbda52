"""A numpy `.npz`: `vertices` (F, m, 3), `faces` (t, 3), and the scene settings."""

import zipfile
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import numpy as np

from cageik_cli.formats.base.writer import Animation, AnimationWriter
from cageik_cli.util.arrays import Floats

_FIXED_DATE = (1980, 1, 1, 0, 0, 0)


def fixed_date_zipinfo(name: str) -> zipfile.ZipInfo:
    """Return a member with the first date of zip: the same bytes at any time."""
    return zipfile.ZipInfo(name, _FIXED_DATE)


class Writer(AnimationWriter):
    """Writes frames in double precision, uncompressed, so that each can be read alone."""

    suffixes = (".npz",)

    def __init__(self, target: Path, animation: Animation) -> None:
        with ExitStack() as stack:
            self._archive = stack.enter_context(zipfile.ZipFile(target, "w"))
            self._write_static_arrays(animation)
            self._frames = stack.enter_context(self._open_member("vertices"))
            shape = (animation.frame_count, *animation.rest.vertices.shape)
            header = {"descr": "<f8", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(self._frames, header)
            self._open_files = stack.pop_all()

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        self._frames.write(np.ascontiguousarray(frames, "<f8").data)

    def complete(self) -> None:
        """Write the archive's directory."""
        self._open_files.close()

    def abandon(self) -> None:
        """Close the file."""
        self._open_files.close()  # nothing is left to close if `complete` failed

    def _write_static_arrays(self, animation: Animation) -> None:
        scene = animation.scene
        for name, value in (
            ("faces", animation.rest.faces.astype(np.int32)),
            ("fps", np.float64(scene.fps)),
            ("start", np.float64(scene.start)),
            ("up_axis", np.str_(scene.up_axis)),
            ("metres_per_unit", np.float64(scene.metres_per_unit)),
            ("frame_step", np.float64(scene.frame_step)),
        ):
            with self._open_member(name) as stream:
                np.lib.format.write_array(stream, np.asarray(value), allow_pickle=False)

    def _open_member(self, name: str) -> IO[bytes]:
        return self._archive.open(fixed_date_zipinfo(f"{name}.npy"), "w", force_zip64=True)
