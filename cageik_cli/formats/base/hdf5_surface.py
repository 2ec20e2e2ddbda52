"""The attributes of a surface in an HDF5 file, checked by a digest."""

import hashlib
from dataclasses import fields, replace
from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import (
    get_dataset,
    is_inside,
    read_array,
    read_attribute,
    read_texts,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface_attributes import LABEL_NAMES, SurfaceAttributes
from cageik_cli.geometry.surface_parts import (
    MAX_NAME_LENGTH,
    FaceLabels,
    Parts,
    Subdivision,
    UvMap,
)
from cageik_cli.util.errors import FormatError, error_context

_SUBDIVISION_PARTS = tuple(part.name for part in fields(Subdivision) if "scheme" not in part.name)


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
    integers: dict[str, Any] = {
        "corner_counts": attributes.corner_counts,
        "corners": attributes.corners,
        "normal_fans": attributes.normal_fans,
    }
    floats: dict[str, Any] = {
        "colours": attributes.colours,
        "material_colours": attributes.material_colours,
    }
    if attributes.uvs is not None:
        integers["uv_indices"], floats["uvs"] = attributes.uvs.indices, attributes.uvs.values
    for name in LABEL_NAMES:
        labels = getattr(attributes, name)
        integers[f"{name}/index"] = None if labels is None else labels.indices
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
        if values is not None and len(values)
    ]


def _list_texts(attributes: SurfaceAttributes) -> list[tuple[str, tuple[str, ...]]]:
    """Return the datasets of names."""
    held = [(name, getattr(attributes, name)) for name in LABEL_NAMES]
    texts = [(f"{name}/name", labels.names) for name, labels in held if labels is not None]
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
    uvs = read("uvs", "f", (None, 2))
    colours = None
    if "colours" in place:
        width = get_dataset(file, f"{group}/colours", "f", (vertices, None)).shape[1]
        colours = read("colours", "f", (vertices, width))
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
        uvs=None if uvs is None else UvMap(uvs, read("uv_indices", "iu", corners.shape)),
        normal_fans=read("normal_fans", "iu", corners.shape),
        colours=colours,
        material_colours=read("material_colours", "f", (None, 4)),
        material_library=_read_text(place, "material_library"),
        subdivision=Subdivision(scheme, **sharp, part_schemes=schemes),
        parts=parts,
        **{name: _read_labels(file, f"{group}/{name}", len(counts)) for name in LABEL_NAMES},
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
