"""HDF5 files from any source, and surfaces in them: what they announce is checked before use."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.files import check_unpacked_array
from cageik_cli.geometry.attributes import (
    LABEL_NAMES,
    LAYERS,
    MAX_NAME_LENGTH,
    FaceLabels,
    Parts,
    Subdivision,
    SurfaceAttributes,
    UvMap,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import FileAccessError, FormatError, OutputError, error_context
from cageik_cli.util.files import open_content, repeat_if_interrupted
from cageik_cli.util.messages import Said

MAX_ATTRIBUTE_VALUES = 16
"""Numbers in an attribute, such as a position or a matrix."""

MAX_TEXT_BYTES = 1 << 28
"""Bytes of texts that are read together; many texts may be one and the same in the file."""

HDF5_SUFFIXES = (".h5", ".hdf5")

DATASETS = {
    "normal_fans": ("normal_fans",),
    "colours": ("colours",),
    "material_colours": ("material_colours",),
    "uvs": ("uvs", "uv_indices"),
    **{name: (f"{name}/index", f"{name}/name") for name in LABEL_NAMES},
}
"""What holds a layer of a surface, in the order in which they are written."""

_SUBDIVISION_PARTS = tuple(part.name for part in fields(Subdivision) if "scheme" not in part.name)


def check_hdf5_suffix(
    path: Path, remedy: Said = "cageik export writes cages in other formats"
) -> None:
    """Refuse to write HDF5 to a file with the suffix of another format.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    if path.suffix.lower() not in HDF5_SUFFIXES:
        raise OutputError(
            f"{path}: the output is an HDF5 file, expected a name that ends in "
            f"{' or '.join(HDF5_SUFFIXES)}; " + remedy
        )


def open_file(path: Path) -> h5py.File:
    """Open a file for reading, to be closed by the caller."""
    if not path.exists():
        raise FileAccessError("no such file; check the path")
    open_content(path).close()
    try:
        return repeat_if_interrupted(lambda: h5py.File(path, "r"))
    except OSError as error:
        if error.errno is None and not h5py.is_hdf5(path):
            raise FormatError("is not an HDF5 file; give one, or write it again") from error
        raise


@contextmanager
def open_checked(path: Path) -> Iterator[h5py.File]:
    """Open a file for reading; errors inside name it."""
    with wrap_hdf5_errors(path), open_file(path) as file:
        yield file


@contextmanager
def wrap_hdf5_errors(path: Path) -> Iterator[None]:
    """Turn what HDF5 raises inside into an InputError that names the file."""
    with error_context(path):
        try:
            yield
        except OSError as error:
            if error.errno is not None:
                raise FileAccessError(f"cannot be read: {os.strerror(error.errno)}") from error
            raise _make_damaged_error(error) from error
        except (RuntimeError, KeyError, TypeError, ValueError, MemoryError) as error:
            raise _make_damaged_error(error) from error


def _make_damaged_error(error: Exception) -> FormatError:
    return FormatError(f"is not a sound HDF5 file ({error}); it may be cut short, write it again")


def is_inside(file: h5py.File, name: str) -> bool:
    """Return whether there is something of this name, and it is in this file and no other."""
    parent = ""
    for part in name.split("/"):
        parent = f"{parent}/{part}"
        if not isinstance(file.get(parent, getlink=True), h5py.HardLink):
            return False
    return True


def get_dataset(
    file: h5py.File, name: str, kinds: str, shape: tuple[int | None, ...]
) -> h5py.Dataset:
    """Return a dataset of the expected type and shape.

    Parameters
    ----------
    name : str
        Path within the file.
    kinds : str
        Numpy's kind letters that are accepted: "f", "iu", or "O" for text.
    shape : tuple
        Expected lengths; None is any above zero.

    Raises
    ------
    InputError
        When it is missing, is in another file, or has another type, shape or size.
    """
    if not is_inside(file, name):
        raise FormatError(f"has no dataset `{name}`")
    found = file[name]
    if not isinstance(found, h5py.Dataset) or found.is_virtual or found.external:
        raise FormatError(f"`{name}` is not a dataset in this file")
    if found.dtype.kind not in kinds:
        nouns = {"f": "floating-point numbers", "iu": "integers", "O": "text"}
        raise FormatError(f"`{name}` holds {found.dtype} values, expected {nouns[kinds]}")
    fits = found.shape is not None and len(found.shape) == len(shape)
    if not fits or any(
        n == 0 or e not in (None, n) for n, e in zip(found.shape, shape, strict=True)
    ):
        wanted = " x ".join("any" if length is None else str(length) for length in shape)
        raise FormatError(f"`{name}` has shape {found.shape}, expected {wanted}")
    with error_context(f"`{name}`"):
        check_unpacked_array(found.shape, found.dtype, found.id.get_storage_size())
    return found


def read_array(file: h5py.File, name: str, kinds: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """Read a whole dataset, checked as by `get_dataset`."""
    return np.asarray(get_dataset(file, name, kinds, shape)[()])


def read_texts(file: h5py.File, name: str, count: int) -> tuple[str, ...]:
    """Read a dataset of `count` texts.

    Raises
    ------
    InputError
        When it is not that, or the texts take more bytes than the file has.
    """
    found = get_dataset(file, name, "O", (count,))
    if h5py.check_string_dtype(found.dtype) is None:
        raise FormatError(f"`{name}` does not hold text; write it again")
    size = file.id.get_filesize()
    step, left, texts = max(1, MAX_TEXT_BYTES // size), size, []
    for start in range(0, count, step):
        part = found[start : start + step]
        left -= sum(map(len, part))
        if left < 0:
            raise FormatError(f"`{name}` holds more text than the file has; write it again")
        texts += [text.decode(errors="replace") for text in part]
    return tuple(texts)


def read_attribute(holder: Any, name: str, default: Any = None) -> Any:
    """Read an attribute of a file or a dataset: one text, or a few numbers.

    Raises
    ------
    FormatError
        When it is something else. Each of many texts may be one and the same in the file, which
        would fill the memory.
    """
    if name not in holder.attrs:
        return default
    if not _is_plain_attribute(holder, name):
        raise FormatError(f"attribute `{name}` is not one text or a few numbers; write it again")
    return holder.attrs[name]


def has_text_attribute(holder: Any, name: str, text: str) -> bool:
    """Return whether an attribute is this text; it may hold anything."""
    if name not in holder.attrs or not _is_plain_attribute(holder, name):
        return False
    value = holder.attrs[name]
    return isinstance(value, str) and value == text


def _is_plain_attribute(holder: Any, name: str) -> bool:
    """Return whether an attribute is one text, or at most `MAX_ATTRIBUTE_VALUES` numbers."""
    found = holder.attrs.get_id(name)
    if found.shape is None:
        return False
    if h5py.check_string_dtype(found.dtype) is not None:
        return bool(found.shape == ())
    return found.dtype.kind in "fiub" and prod(found.shape) <= MAX_ATTRIBUTE_VALUES


def scalar_attributes(file: h5py.File, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the attributes of these names that are single values."""
    held = [name for name in names if name in file.attrs and _is_plain_attribute(file, name)]
    return {name: file.attrs[name] for name in held if file.attrs.get_id(name).shape == ()}


def write_surface(file: h5py.File, group: str, mesh: TriMesh) -> None:
    """Write the attributes of a mesh into a group; nothing if it has none."""
    attributes = mesh.attributes
    if attributes is None:
        return
    place = file.create_group(group)
    for name, array in _list_arrays(attributes):
        place[name] = array
    for name, texts in _list_texts(attributes):
        place.create_dataset(name, data=texts, dtype=h5py.string_dtype())
    place.attrs["subdivision"] = attributes.subdivision.scheme
    if attributes.material_library:
        place.attrs["material_library"] = attributes.material_library
    place.attrs["sha256"] = compute_digest(attributes)


def read_surface(file: h5py.File, group: str, mesh: TriMesh) -> TriMesh:
    """Return a mesh with the attributes in a group; the mesh itself if there is no such group.

    Raises
    ------
    FormatError
        When they are damaged, or those of another mesh.
    """
    if not is_inside(file, group):
        return mesh
    with error_context(f"`{group}`"):
        held = file[group]
        if not isinstance(held, h5py.Group):
            raise FormatError("is not a group; write it again")
        try:
            attributes = _read_attributes(file, group, mesh)
            complete = replace(mesh, attributes=attributes)
            attributes.check_cut(mesh.faces)
        except FormatError as error:
            remedy = "" if "; " in str(error) else "; write it again"
            raise FormatError(f"{error}{remedy}") from error
        if _read_text(held, "sha256") != compute_digest(attributes):
            raise FormatError("is not what its digest says; write it again")
        return complete


def compute_digest(attributes: SurfaceAttributes) -> str:
    """Return the SHA-256 digest of all attributes."""
    digest = hashlib.sha256()
    texts = dict(_list_texts(attributes)) | {
        "subdivision": [attributes.subdivision.scheme],
        "material_library": [attributes.material_library],
    }
    for name, array in _list_arrays(attributes):
        digest.update(f"{name} {array.shape} {array.dtype.str}\n".encode() + array.tobytes())
    for name, lines in texts.items():
        digest.update("\n".join([name, str(len(lines)), *lines, ""]).encode())
    return digest.hexdigest()


def _list_arrays(attributes: SurfaceAttributes) -> list[tuple[str, np.ndarray]]:
    """Return the datasets of numbers; those that are empty are left out."""
    subdivision = attributes.subdivision
    integers = {"corner_counts": attributes.corner_counts, "corners": attributes.corners}
    floats = {}
    for name, places in DATASETS.items():
        held = getattr(attributes, name)
        if isinstance(held, UvMap):
            floats[places[0]], integers[places[1]] = held.values, held.indices
        elif isinstance(held, FaceLabels):
            integers[places[0]] = held.indices
        elif held is not None:
            (integers if held.ndim == 1 else floats)[places[0]] = held
    for name in _SUBDIVISION_PARTS:
        (floats if name.endswith("sharpness") else integers)[name] = getattr(subdivision, name)
    parts = attributes.parts
    if parts is not None:
        integers["parts/vertex_counts"] = parts.vertex_counts
        integers["parts/polygon_counts"] = parts.polygon_counts
        floats["parts/transforms"] = parts.transforms
    return [
        (name, values.astype(dtype))
        for group, dtype in ((integers, "<i4"), (floats, "<f8"))
        for name, values in group.items()
        if len(values)
    ]


def _list_texts(attributes: SurfaceAttributes) -> list[tuple[str, tuple[str, ...]]]:
    """Return the datasets of names."""
    held = [(DATASETS[name][1], getattr(attributes, name)) for name in LABEL_NAMES]
    texts = [(place, labels.names) for place, labels in held if labels is not None]
    if attributes.parts is not None:
        texts += [("parts/name", attributes.parts.names)]
    if attributes.subdivision.part_schemes:
        texts += [("parts/subdivision", attributes.subdivision.part_schemes)]
    return texts


def _read_attributes(file: h5py.File, group: str, mesh: TriMesh) -> SurfaceAttributes:
    """Read all datasets of a group, with their shapes and ranges checked."""
    place, vertices = file[group], len(mesh.vertices)

    def read(name: str, kinds: str, shape: tuple[int | None, ...]) -> Any:
        return read_array(file, f"{group}/{name}", kinds, shape) if name in place else None

    corners = read_array(file, f"{group}/corners", "iu", (None,))
    counts = read_array(file, f"{group}/corner_counts", "iu", (None,))
    layers: dict[str, Any] = {}
    for name, (first, *others) in DATASETS.items():
        domain = "" if name not in LAYERS else LAYERS[name].domain
        if domain == "face":
            layers[name] = _read_labels(file, f"{group}/{name}", len(counts))
        elif domain == "vertex" and first in place:
            width = get_dataset(file, f"{group}/{first}", "f", (vertices, None)).shape[1]
            layers[name] = read(first, "f", (vertices, width))
        elif domain == "corner" and not others:
            layers[name] = read(first, "iu", corners.shape)
        elif domain == "corner" and first in place:
            values = read(first, "f", (None, LAYERS[name].width))
            layers[name] = UvMap(values, read(others[0], "iu", corners.shape))
    found = {
        name: read(name, "f" if "sharpness" in name else "iu", (None,))
        for name in _SUBDIVISION_PARTS
    }
    scheme = _read_text(place, "subdivision")
    parts = _read_parts(file, f"{group}/parts")
    schemes: tuple[str, ...] = ()
    if parts is not None and "subdivision" in file[f"{group}/parts"]:
        schemes = read_texts(file, f"{group}/parts/subdivision", len(parts.names))
    sharp = {name: values for name, values in found.items() if values is not None}
    return SurfaceAttributes(
        corner_counts=counts,
        corners=corners,
        material_colours=read("material_colours", "f", (None, 4)),
        material_library=_read_text(place, "material_library"),
        subdivision=Subdivision(scheme, **sharp, part_schemes=schemes),
        parts=parts,
        **layers,
    )


def _read_parts(file: h5py.File, group: str) -> Parts | None:
    if group not in file:
        return None
    count = len(get_dataset(file, f"{group}/name", "O", (None,)))
    return Parts(
        read_texts(file, f"{group}/name", count),
        read_array(file, f"{group}/vertex_counts", "iu", (count,)),
        read_array(file, f"{group}/polygon_counts", "iu", (count,)),
        read_array(file, f"{group}/transforms", "f", (count, 4, 4)),
    )


def _read_labels(file: h5py.File, group: str, polygons: int) -> FaceLabels | None:
    if group not in file:
        return None
    count = len(get_dataset(file, f"{group}/name", "O", (None,)))
    names = read_texts(file, f"{group}/name", count)
    return FaceLabels(names, read_array(file, f"{group}/index", "iu", (polygons,)))


def _read_text(place: h5py.Group, name: str) -> str:
    """Read an attribute of text; empty if it is missing."""
    text = read_attribute(place, name, "")
    if not isinstance(text, str) or len(text) > MAX_NAME_LENGTH:
        raise FormatError(f"attribute `{name}` is not text; write it again")
    return text
