"""UVs, normals and materials of a polygon mesh in Alembic."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import ClaimedBytes
from cageik_cli.formats.base.mesh_data import share_normals
from cageik_cli.formats.base.writers import to_float32
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.normals import compute_corner_normals
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.geometry.surface_parts import NONE, FaceLabels, UvMap
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import single_line


def list_layers(
    schema: Any, claimed: ClaimedBytes
) -> dict[str, Callable[[SurfaceAttributes], SurfaceAttributes]]:
    """Return what reads the layers of a surface in its first sample, for `FileMesh.read_layers`."""
    surface = _SurfaceReader(schema, claimed)
    return {
        "its texture coordinates": partial(_read_safely, surface.read_uvs),
        "its normals": partial(_read_safely, surface.read_normals),
        "its face sets": partial(_read_safely, surface.read_face_sets),
    }


def _read_safely(
    read: Callable[[SurfaceAttributes], SurfaceAttributes], attributes: SurfaceAttributes
) -> SurfaceAttributes:
    """Turn what the library raises while a part is read into a FormatError."""
    try:
        return read(attributes)
    except (FormatError, RuntimeError, IndexError, TypeError, ValueError) as error:
        raise FormatError(single_line(find_cause(error))) from error


def find_cause(error: Exception) -> str:
    """Return what the innermost of exceptions says that are wrapped in one another."""
    return " ".join(str(error).rpartition("EXCEPTION:")[2].split())


def read_sample(sampled: Any, index: int, size: int) -> Any:
    """Read one array of a file of some size.

    A missing one, which has no digest, would crash the library.
    """
    name = f"sample {index} of `{sampled.getName()}`"
    if not sampled.getKey(index):
        raise FormatError(f"{name} is missing; export it again")
    needed = sampled.getDimension(index).numPoints() * sampled.getDataType().getNumBytes()
    if needed > size:
        raise FormatError(f"{name} takes {needed} bytes of a file of {size}; export it again")
    return sampled.getValue(index)


class _SurfaceReader:
    """Reads the layers of the surface of one mesh, in its first sample."""

    def __init__(self, schema: Any, claimed: ClaimedBytes) -> None:
        self._schema, self._claimed = schema, claimed

    def read_uvs(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the texture coordinates."""
        parameter = self._schema.getUVsParam()
        if not parameter.valid() or not parameter.getNumSamples():
            return attributes
        values = self._read_first(parameter.getValueProperty(), np.float64)
        places = self._locate(parameter, attributes, len(values))
        return replace(attributes, uvs=UvMap(values.reshape(-1, 2), places))

    def read_normals(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read which corners share a normal."""
        parameter = self._schema.getNormalsParam()
        if not parameter.valid() or not parameter.getNumSamples():
            return attributes
        values = self._read_first(parameter.getValueProperty(), np.float64).reshape(-1, 3)
        if not np.isfinite(values).all():
            raise FormatError("they are not finite")
        places = self._locate(parameter, attributes, len(values))
        return share_normals(attributes, values, places)

    def read_face_sets(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the face sets as materials, as other programs do."""
        count = len(attributes.corner_counts)
        materials = FaceLabels.from_members(count, self._list_face_sets(count))
        return replace(attributes, materials=materials)

    def _list_face_sets(self, count: int) -> Iterator[tuple[str, Integers]]:
        """Yield the names of the face sets, with their faces, of `count`."""
        for name in self._schema.getFaceSetNames():
            sampled = self._schema.getFaceSet(name).getSchema().getFacesProperty()
            if not sampled.getNumSamples():
                continue
            faces = self._read_first(sampled, np.int64)
            if len(faces) and not 0 <= faces.min() <= faces.max() < count:
                raise FormatError(f"`{name}` names faces that are not there")
            yield single_line(name), faces

    def _read_first(self, sampled: Any, kind: type[np.float64 | np.int64]) -> NDArray[Any]:
        values = read_sample(sampled, 0, self._claimed.packed)
        self._claimed.claim(len(values) * sampled.getDataType().getNumBytes())
        with np.errstate(invalid="ignore"):  # a signalling nan is refused with the others
            return np.array(values, kind)

    def _locate(self, parameter: Any, attributes: SurfaceAttributes, count: int) -> Integers:
        """Return the place of the value of each corner among `count` values."""
        from alembic3d.AbcGeom import GeometryScope

        scope, places = parameter.getScope(), np.arange(count)
        if parameter.isIndexed():
            places = self._read_first(parameter.getIndexProperty(), np.int64)
        if scope in (GeometryScope.kVertexScope, GeometryScope.kVaryingScope):
            corners = attributes.corners
        elif scope == GeometryScope.kFacevaryingScope:
            corners = np.arange(len(attributes.corners))
        else:
            raise FormatError("they are not those of corners or vertices")
        if corners.max(initial=-1) >= len(places):
            raise FormatError(f"{len(places)} values, expected {corners.max() + 1}")
        found = places[corners]
        if len(found) and not 0 <= found.min() <= found.max() < count:
            raise FormatError(f"they name value {found.max()} of {count}")
        return np.asarray(found, np.int64)


class AlembicSurface:
    """The faces of a mesh as Alembic has them, clockwise, with their UVs and normals."""

    def __init__(self, mesh: TriMesh) -> None:
        from imath import IntArrayFromBuffer

        attributes = mesh.attributes
        if attributes is None:
            counts, corners = np.full(len(mesh.faces), 3), mesh.faces[:, ::-1].ravel()
        else:
            attributes = attributes.reverse(keeps_first=False)
            counts, corners = attributes.corner_counts, attributes.corners
        self._attributes = attributes
        self._faces = tuple(
            IntArrayFromBuffer(np.ascontiguousarray(part, np.int32)) for part in (corners, counts)
        )
        self._uvs = None if attributes is None else _make_uvs(attributes)

    def make_sample(self, positions: Floats) -> Any:
        """Return the sample of a frame, (m, 3)."""
        from alembic3d.AbcGeom import (
            GeometryScope,
            ON3fGeomParamSample,
            OPolyMeshSchemaSample,
            OV2fGeomParamSample,
        )
        from imath import V3fArrayFromBuffer

        points = V3fArrayFromBuffer(to_float32(positions))
        attributes = self._attributes
        if attributes is None or (attributes.normal_fans is None and self._uvs is None):
            return OPolyMeshSchemaSample(points, *self._faces)
        uvs = self._uvs or OV2fGeomParamSample()
        if attributes.normal_fans is None:
            return OPolyMeshSchemaSample(points, *self._faces, uvs)
        # Of faces that are turned, they point inward.
        normals = V3fArrayFromBuffer(to_float32(-compute_corner_normals(attributes, positions)))
        sample = ON3fGeomParamSample(normals, GeometryScope.kFacevaryingScope)
        return OPolyMeshSchemaSample(points, *self._faces, uvs, sample)

    def write_face_sets(self, schema: Any) -> None:
        """Write a face set for each material, which other programs take as such."""
        from alembic3d.AbcGeom import OFaceSetSchemaSample
        from imath import IntArrayFromBuffer

        labels = None if self._attributes is None else self._attributes.materials
        taken: set[str] = set()
        for name, polygons in labels.list_members() if labels is not None else ():
            name = name.replace("/", "_")  # a slash would be a path
            while name in taken:
                name += "_"
            taken.add(name)
            faces = IntArrayFromBuffer(np.ascontiguousarray(polygons, np.int32))
            schema.createFaceSet(name).getSchema().set(OFaceSetSchemaSample(faces))


def _make_uvs(attributes: SurfaceAttributes) -> Any | None:
    """Return the UVs of corners; those without are at zero."""
    from alembic3d.AbcGeom import GeometryScope, OV2fGeomParamSample
    from imath import UnsignedIntArray, V2fArrayFromBuffer

    if attributes.uvs is None:
        return None
    values, indices = attributes.uvs.values, attributes.uvs.indices
    if (indices == NONE).any():
        indices = np.where(indices == NONE, len(values), indices)
        values = np.concatenate([values, np.zeros((1, 2))])
    numbers = UnsignedIntArray(len(indices))
    for place, index in enumerate(indices.tolist()):
        numbers[place] = index
    table = V2fArrayFromBuffer(to_float32(values))
    return OV2fGeomParamSample(table, numbers, GeometryScope.kFacevaryingScope)
