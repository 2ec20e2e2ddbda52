"""The folder of a live cage: the data as plain arrays, a script, and an extension of Blender.

Blender has z up and metres, and computes in single precision. So positions are converted and kept
near the origin of their objects, which have the rest of the way, and cages are how far they are
from rest.
"""

import io
import json
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writers import Animation, choose_short_names, to_float32
from cageik_cli.formats.npz import fixed_date_zipinfo
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import SceneHints
from cageik_cli.geometry.attributes import NONE, PLAIN_COLOUR, SurfaceAttributes
from cageik_cli.geometry.parts import split_parts
from cageik_cli.method.weights.binding import Binding, Poses
from cageik_cli.util.arrays import Integers
from cageik_cli.util.outputs import atomic_folder, check_folder_writable
from cageik_cli.util.version import __version__

TEMPLATES = Path(__file__).parent / "templates"

DATA, SCRIPT, EXTENSION = "live_cage.npz", "open_in_blender.py", "cageik_live_cage.zip"
"""The files of the folder."""

LIVE_CAGE_FORMAT = 1
"""Of the data, which the script knows, too."""

BLENDER_SPACE = SceneHints(up_axis="Z", metres_per_unit=1.0)

MAX_DISTANCE = 10
"""A model with coordinates beyond it, in diagonals, is brought near the origin of its object."""

_VERSION_MARK = "VERSION"


def check_live_cage_writable(folder: Path, overwrite: bool) -> None:
    """Refuse, before any work, a folder that cannot be written."""
    check_folder_writable(folder, overwrite, _is_own_name)


def write_live_cage(
    folder: Path,
    overwrite: bool,
    animation: Animation,
    *,
    binding: Binding,
    poses: Iterable[Poses],
    update: Callable[[int, int], None],
) -> None:
    """Write the folder.

    Parameters
    ----------
    animation : Animation
        That of the model, at rest as the rest cage gives it.
    binding : Binding
        Of the model, in the space of the animation.
    poses : iterable of Poses
        All frames in order, in blocks.
    update : callable
        Called with the number of frames written, and of all.
    """
    conversion = SceneConversion.of_output(animation.scene, BLENDER_SPACE)
    animation = conversion.convert_animation(animation)
    if np.abs(animation.rest.vertices).max() > MAX_DISTANCE * animation.rest.diagonal:
        animation = animation.recentre()
    with atomic_folder(folder, overwrite, _is_own_name) as unfinished:
        with zipfile.ZipFile(unfinished / DATA, "w") as archive:
            arrays = _list_arrays(animation, binding, conversion)
            arrays["about"] = np.array(json.dumps(_describe(animation)))
            for name, array in arrays.items():
                with _open_member(archive, name) as stream:
                    np.lib.format.write_array(stream, array, allow_pickle=False)
            with _open_member(archive, "moves") as stream:
                count, done = animation.frame_count, 0
                shape = (count, len(binding.cage.vertices) + 3, 3)
                header = {"descr": "<f4", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(stream, header)
                for block in poses:
                    stream.write(_list_moves(block, binding, conversion).data)
                    done += len(block)
                    update(done, count)
        (unfinished / SCRIPT).write_bytes(_read_template(SCRIPT))
        (unfinished / EXTENSION).write_bytes(make_extension())


def _is_own_name(name: str) -> bool:
    return name in (DATA, SCRIPT, EXTENSION)


def make_extension() -> bytes:
    """Return the extension, a `.zip` as Blender installs it: the script, and what it is."""
    manifest = _read_template("blender_manifest.toml").decode()
    files = {
        "__init__.py": _read_template(SCRIPT),
        "blender_manifest.toml": manifest.replace(_VERSION_MARK, __version__).encode(),
    }
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, data in files.items():
            archive.writestr(fixed_date_zipinfo(name), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _read_template(name: str) -> bytes:
    return (TEMPLATES / name).read_bytes()


def _describe(animation: Animation) -> dict[str, Any]:
    """Return all that is no array: time, place, and the parts with their materials."""
    scene, parts = animation.scene, animation.split()
    names = choose_short_names([part.name for part in parts])
    return {
        "format": LIVE_CAGE_FORMAT,
        "name": animation.name,
        "fps": scene.fps,
        "start": scene.start,
        "frame_step": scene.frame_step,
        "frame_count": animation.frame_count,
        "origin": animation.origin,
        "parts": [
            {
                "name": name,
                "vertex_count": len(part.mesh.vertices),
                "materials": _list_materials(part.mesh.polygons),
            }
            for name, part in zip(names, parts, strict=True)
        ],
    }


def _list_arrays(
    animation: Animation, binding: Binding, conversion: SceneConversion
) -> dict[str, NDArray[Any]]:
    """Return all arrays but those of the frames: the animation is in the space of Blender."""
    cage = conversion.convert_mesh(binding.cage)
    offsets = np.zeros_like(binding.rest.vertices) if binding.offsets is None else binding.offsets
    arrays: dict[str, NDArray[Any]] = {
        "rest": to_float32(animation.rest.vertices),
        "offsets": to_float32(conversion.apply(offsets)),
        "weights": to_float32(binding.weights.T),
        "cage": to_float32(cage.vertices - np.array(animation.origin)),
        **_list_surface("cage", cage.polygons),
    }
    for number, part in enumerate(split_parts(animation.rest)):
        arrays |= _list_surface(str(number), part.mesh.polygons)
    return arrays


@contextmanager
def _open_member(archive: zipfile.ZipFile, name: str) -> Iterator[IO[bytes]]:
    with archive.open(fixed_date_zipinfo(f"{name}.npy"), "w", force_zip64=True) as stream:
        yield stream


def _list_moves(poses: Poses, binding: Binding, conversion: SceneConversion) -> NDArray[np.float32]:
    """Return how far the cages of k frames are from rest, then R - 1 of each, (k, n + 3, 3)."""
    moves = conversion.apply(poses.cages - binding.cage.vertices)
    turns = np.zeros((len(poses), 3, 3))
    if binding.has_offsets:
        assert poses.rotations is not None
        turns = conversion.turn.T @ poses.rotations @ conversion.turn - np.eye(3)
    return to_float32(np.concatenate([moves, turns], axis=1)).astype("<f4", copy=False)


def _list_surface(key: str, surface: SurfaceAttributes) -> dict[str, NDArray[Any]]:
    """Return the polygons of a mesh, and what else Blender takes of a surface, by their names."""
    found: dict[str, NDArray[Any]] = {
        "counts": surface.corner_counts.astype("<i4"),
        "corners": surface.corners.astype("<i4"),
        "sharp": find_sharp_edges(surface).astype("<i4"),
    }
    if surface.uvs is not None:
        values, indices = surface.uvs.complete()
        found["uvs"] = to_float32(values[indices])
    if surface.colours is not None:
        colours = np.ones((len(surface.colours), 4))
        colours[:, : surface.colours.shape[1]] = surface.colours
        found["colours"] = to_float32(colours)
    if surface.materials is not None:
        indices = surface.materials.indices
        found["materials"] = np.where(
            indices == NONE, len(surface.materials.names), indices
        ).astype("<i4")
    return {f"{key}_{name}": array for name, array in found.items()}


def _list_materials(surface: SurfaceAttributes) -> list[tuple[str | None, list[float]]]:
    """Return name and colour of each material; at the end one without, if faces have none."""
    materials, colours = surface.materials, surface.material_colours
    if materials is None:
        return []
    named: list[tuple[str | None, list[float]]] = [
        (name, list(PLAIN_COLOUR) if colours is None else colours[number].tolist())
        for number, name in enumerate(materials.names)
    ]
    return [*named, (None, list(PLAIN_COLOUR))] if NONE in materials.indices else named


def find_sharp_edges(surface: SurfaceAttributes) -> Integers:
    """Find the edges at which faces have normals of their own, (e, 2) vertices; none if smooth."""
    fans = surface.normal_fans
    if fans is None:
        return np.empty((0, 2), np.int64)
    starts, counts = surface.starts, surface.corner_counts
    following = np.arange(1, len(surface.corners) + 1)
    following[starts + counts - 1] = starts
    ends = np.stack([surface.corners, surface.corners[following]], axis=1)
    pairs = np.stack([fans, fans[following]], axis=1)
    is_turned = ends[:, 0] > ends[:, 1]
    ends[is_turned], pairs[is_turned] = ends[is_turned, ::-1], pairs[is_turned, ::-1]
    edges, owners = np.unique(ends, axis=0, return_inverse=True)
    first = np.empty_like(edges)
    first[owners] = pairs
    is_sharp = np.zeros(len(edges), bool)
    np.logical_or.at(is_sharp, owners, (pairs != first[owners]).any(axis=1))
    return np.asarray(edges[is_sharp])
