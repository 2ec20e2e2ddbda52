"""Clips in numpy files: an array of positions, and in a `.npz` perhaps one of faces."""

import zipfile
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import numpy as np

from cageik_cli.formats.base.binary_frames import StoredFrames
from cageik_cli.formats.base.readers import ArrayClip, ArrayClipFile, check_zero_based
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.base.writers import Animation, AnimationWriter
from cageik_cli.formats.npz_archive import FileArray, NpzArchive, open_npy
from cageik_cli.formats.settings import LAYOUTS, SceneHints, parse_scene_metadata
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, SettingError


def list_layouts(shape: tuple[int, ...], layout: str | None) -> list[str]:
    """List the orders that the axes of an array may have; only `layout` if it is given."""
    asked = LAYOUTS if layout is None else (layout,)
    found = [order for order in asked if len(shape) == 3 and shape[order.index("x")] == 3]
    if not found or min(shape) < 1:
        axes = {"f": "frames", "v": "vertices", "x": "3"}
        expected = " or ".join(f"({', '.join(axes[axis] for axis in order)})" for order in asked)
        raise FormatError(f"positions have shape {shape}, expected {expected}")
    return found


def choose_layout(layouts: list[str], shape: tuple[int, ...], expected_vertices: int | None) -> str:
    """Return the only possible or the only likely order of the axes of an array.

    An order with as many vertices as the faces name is preferred to one with more; one with fewer
    is impossible.
    """
    if len(layouts) == 1:
        return layouts[0]
    counts = {order: shape[order.index("v")] for order in layouts}
    least = expected_vertices or 0
    exact = [order for order, count in counts.items() if count == expected_vertices]
    larger = [order for order, count in counts.items() if count > least]
    best = exact or larger or layouts
    if len(best) > 1:
        texts = (
            f"{order} ({shape[order.index('f')]} frames of {counts[order]} vertices)"
            for order in best
        )
        raise SettingError(f"positions can be read as {' or '.join(texts)}; choose with `layout=`")
    return best[0]


VERTEX_NAMES = ("vertices", "verts", "V", "v")
FACE_NAMES = ("faces", "tris", "F", "f")


class Reader(ArrayClipFile):
    """Frames of one `.npz` or `.npy`, whose axes may be in any order of `LAYOUTS`."""

    suffixes = (".npz", ".npy")
    has_layout = True

    @classmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Find the arrays, and which axis is which."""
        path = request.path
        if path.suffix.lower() == ".npy":
            return ArrayClip(_open_frames(open_npy(path), None, request))
        archive = NpzArchive(path)
        if not archive.names.intersection(VERTEX_NAMES) and "poses" in archive.names:
            raise FormatError(
                "holds body parameters (AMASS or SMPL: poses, betas, trans), not vertices; "
                "evaluate the body model and write its vertices"
            )
        positions, faces = _find_array(archive, VERTEX_NAMES), None
        if archive.names.intersection(FACE_NAMES):
            faces = _read_faces(_find_array(archive, FACE_NAMES))
        metadata = {name: archive.read_scalar(name) for name in SceneHints.__slots__}
        return ArrayClip(
            _open_frames(positions, faces, request), faces, *parse_scene_metadata(metadata)
        )


def _find_array(archive: NpzArchive, names: tuple[str, ...]) -> FileArray:
    found = [name for name in names if name in archive.names]
    if len(found) != 1:
        held = ", ".join(found) or "none"
        raise FormatError(f"holds {held} of the arrays {', '.join(names)}, expected exactly one")
    return archive.open_array(found[0])


def _read_faces(array: FileArray) -> np.ndarray:
    if array.dtype.kind not in "iu" or len(array.shape) != 2 or array.shape[1] != 3:
        raise FormatError(
            f"faces are {array.dtype} of shape {array.shape}, expected integers of shape (count, 3)"
        )
    faces = array.read()
    if not faces.size:
        raise FormatError("there are 0 faces, expected at least 1")
    return faces


def _open_frames(array: FileArray, faces: np.ndarray | None, request: ClipRequest) -> StoredFrames:
    """Open the frames of an array of positions, in the most likely order of its axes."""
    if array.dtype.kind != "f":
        raise FormatError(
            f"positions are {array.dtype} of shape {array.shape}, expected floating-point numbers"
        )
    layouts = list_layouts(array.shape, request.settings.layout)
    expected_vertices = None
    if faces is not None:
        for layout in layouts:
            check_zero_based(faces, array.shape[layout.index("v")])
        expected_vertices = int(faces.max()) + 1
    elif request.rest is not None:
        expected_vertices = len(request.rest.mesh.vertices)
    layout = choose_layout(layouts, array.shape, expected_vertices)
    return StoredFrames(
        array.file,
        array.offset,
        array.dtype,
        frame_count=array.shape[layout.index("f")],
        vertex_count=array.shape[layout.index("v")],
        axis_order=layout[::-1] if array.is_fortran_order else layout,
    )


def fixed_date_zipinfo(name: str) -> zipfile.ZipInfo:
    """Return a member with the first date of zip: the same bytes at any time."""
    return zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))


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
