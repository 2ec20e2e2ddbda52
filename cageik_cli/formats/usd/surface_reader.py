"""UVs, normals, colours, materials, groups and subdivision of a mesh in USD."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import ClaimedBytes
from cageik_cli.formats.base.mesh_data import share_normals
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.geometry.surface_parts import NONE, PLAIN_COLOUR, FaceLabels, Subdivision, UvMap
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import single_line

LIBRARY_KEY = "materialLibrary"
"""Where the custom data of a mesh names the file of its materials, as an OBJ file does."""

UV_NAME = "st"

_PER_VERTEX, _PER_CORNER, _PER_FACE = ("vertex", "varying"), ("faceVarying",), ("uniform",)


class SurfaceReader:
    """Reads the layers of the surface of one mesh, at a time."""

    def __init__(self, mesh: Any, vertex_count: int, time: float, *, claimed: ClaimedBytes) -> None:
        from pxr import UsdGeom

        self._mesh, self._vertex_count, self._time = mesh, vertex_count, time
        self._primvars, self._claimed = UsdGeom.PrimvarsAPI(mesh), claimed

    def list_layers(self) -> dict[str, Callable[[SurfaceAttributes], SurfaceAttributes]]:
        """Return what reads each layer, for `FileMesh.read_layers`."""
        return {
            "its texture coordinates": self.read_uvs,
            "its normals": self.read_normals,
            "its colours": self.read_colours,
            "its materials and groups": self.read_labels,
            "its subdivision": self.read_subdivision,
        }

    def read_uvs(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the primvar `st`, or else the first that holds texture coordinates."""
        primvar = self._find_uvs()
        if primvar is None:
            return attributes
        values = self._to_array(primvar.Get(self._time), 2)
        numbers = self._read_indices(primvar, len(values))
        indices = numbers[_locate(primvar.GetInterpolation(), attributes, len(numbers))]
        absent = primvar.GetUnauthoredValuesIndex()
        if absent >= 0:
            indices = np.where(indices == absent, NONE, indices)
            values = values[:absent] if absent == len(values) - 1 else values
        return replace(attributes, uvs=UvMap(values, indices))

    def read_normals(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read which corners share a normal."""
        primvar = self._primvars.GetPrimvar("normals")
        if primvar and primvar.HasAuthoredValue():
            values = self._to_array(primvar.Get(self._time), 3)
            numbers = self._read_indices(primvar, len(values))
            interpolation = primvar.GetInterpolation()
        else:
            found = self._mesh.GetNormalsAttr().Get(self._time)
            if not found:
                return attributes
            values = self._to_array(found, 3)
            numbers, interpolation = np.arange(len(values)), self._mesh.GetNormalsInterpolation()
        places = _locate(interpolation, attributes, len(numbers))
        return share_normals(attributes, values, numbers[places])

    def read_colours(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the colours of vertices."""
        columns = []
        for name, width in (("displayColor", 3), ("displayOpacity", 1)):
            primvar = self._primvars.GetPrimvar(name)
            if not primvar or not primvar.HasAuthoredValue():
                break
            if primvar.GetInterpolation() not in _PER_VERTEX:
                if width == 1:
                    break
                raise FormatError(f"they are {primvar.GetInterpolation()}, expected vertex")
            values = self._to_array(primvar.Get(self._time), width)
            indices = self._read_indices(primvar, len(values))
            _check_places(np.arange(self._vertex_count), len(indices))
            columns.append(values[indices[: self._vertex_count]])
        return replace(attributes, colours=np.hstack(columns)) if columns else attributes

    def read_labels(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the subsets of faces: those that bind materials, and others, which are groups."""
        from pxr import UsdGeom, UsdShade

        count = len(attributes.corner_counts)
        everywhere = UsdShade.MaterialBindingAPI(self._mesh).ComputeBoundMaterial()[0]
        bound = {_name(everywhere.GetPrim()): everywhere} if everywhere else {}
        materials: list[tuple[str, Integers | slice]] = [(name, slice(None)) for name in bound]
        groups: list[tuple[str, Integers | slice]] = []
        for subset in UsdGeom.Subset.GetAllGeomSubsets(self._mesh):
            if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
                continue
            faces = self._to_list(subset.GetIndicesAttr().Get(self._time), "iu")
            is_of_mesh = not len(faces) or 0 <= faces.min() <= faces.max() < count
            if not is_of_mesh or len(faces) > count:
                raise FormatError(
                    f"`{subset.GetPrim().GetName()}` names faces that are not there, or twice"
                )
            binds = subset.GetFamilyNameAttr().Get() == UsdShade.Tokens.materialBind
            name = _name_material(subset) if binds else _name(subset.GetPrim())
            material = UsdShade.MaterialBindingAPI(subset).GetDirectBinding().GetMaterial()
            if binds and material:
                bound[name] = material
            (materials if binds else groups).append((name, faces))
        library = self._mesh.GetPrim().GetCustomDataByKey(LIBRARY_KEY)
        labels = FaceLabels.from_members(count, materials)
        return replace(
            attributes,
            materials=labels,
            material_colours=None if labels is None else _list_colours(labels.names, bound),
            groups=FaceLabels.from_members(count, groups),
            material_library=single_line(library) if isinstance(library, str) else "",
        )

    def read_subdivision(self, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read the scheme, the creases and the sharp vertices."""
        mesh = self._mesh
        creases, lengths, sharpness, corners, sharp = (
            self._to_list(attribute.Get(self._time), kinds)
            for attribute, kinds in (
                (mesh.GetCreaseIndicesAttr(), "iu"),
                (mesh.GetCreaseLengthsAttr(), "iu"),
                (mesh.GetCreaseSharpnessesAttr(), "f"),
                (mesh.GetCornerIndicesAttr(), "iu"),
                (mesh.GetCornerSharpnessesAttr(), "f"),
            )
        )
        scheme = str(mesh.GetSubdivisionSchemeAttr().Get())
        subdivision = Subdivision(scheme, creases, lengths, sharpness, corners, sharp)
        named = np.concatenate([subdivision.crease_vertices, subdivision.corner_vertices])
        if named.max(initial=-1) >= self._vertex_count:
            raise FormatError(f"it names vertex {named.max()} of {self._vertex_count}")
        return replace(attributes, subdivision=subdivision)

    def _find_uvs(self) -> Any | None:
        """Return the primvar of the texture coordinates."""
        from pxr import Sdf

        names = (Sdf.ValueTypeNames.TexCoord2fArray, Sdf.ValueTypeNames.Float2Array)
        usual = self._primvars.GetPrimvar(UV_NAME)
        found = [usual, *self._primvars.GetPrimvarsWithAuthoredValues()]
        return next((each for each in found if each and each.GetTypeName() in names), None)

    def _read_indices(self, primvar: Any, count: int) -> Integers:
        """Return the indices into `count` values; one after the other if there are none."""
        if not primvar.IsIndexed():
            return np.arange(count)
        indices = self._to_list(primvar.GetIndices(self._time), "iu")
        _check_places(indices, count)
        return indices

    def _to_list(self, value: Any, kinds: str) -> NDArray[Any]:
        """Return a list of numbers of some kinds, (k,); empty without a value."""
        array = np.zeros(0, np.int64) if value is None else np.asarray(value)
        if array.ndim != 1 or (array.size and array.dtype.kind not in kinds):
            raise FormatError(f"they are {array.dtype} of shape {array.shape}, expected a list")
        self._claimed.claim(array.nbytes)
        return array.astype(np.float64 if kinds == "f" else np.int64)

    def _to_array(self, value: Any, width: int) -> Floats:
        """Return lists of `width` numbers each, (k, width)."""
        array = np.zeros(0) if value is None else np.asarray(value)
        if array.size == 0:
            raise FormatError("they have no values")
        if array.dtype.kind != "f" or array.ndim not in (1, 2) or array.size != len(array) * width:
            raise FormatError(f"they are {array.dtype} of shape {array.shape}")
        self._claimed.claim(array.nbytes)
        with np.errstate(over="ignore", invalid="ignore"):
            return array.reshape(-1, width).astype(np.float64)


def _locate(interpolation: str, attributes: SurfaceAttributes, count: int) -> Integers:
    """Return the place of the value of each corner among the `count` of a primvar."""
    if interpolation in _PER_VERTEX:
        places = attributes.corners
    elif interpolation in _PER_CORNER:
        places = np.arange(len(attributes.corners))
    elif interpolation in _PER_FACE:
        places = np.repeat(np.arange(len(attributes.corner_counts)), attributes.corner_counts)
    else:
        raise FormatError(f"they are {interpolation}")
    _check_places(places, count)
    return places


def _check_places(places: Integers, count: int) -> None:
    if len(places) and not 0 <= places.min() <= places.max() < count:
        raise FormatError(f"they need value {places.max()} of {count}")


def _list_colours(names: tuple[str, ...], materials: dict[str, Any]) -> Floats | None:
    """Return linear red, green, blue and opacity of materials, (k, 4); None if none is known."""
    found = [_read_colour(materials[name]) if name in materials else None for name in names]
    if all(colour is None for colour in found):
        return None
    return np.array([PLAIN_COLOUR if colour is None else colour for colour in found])


def _read_colour(material: Any) -> list[float] | None:
    """Return the constant colour of a material's surface, and its opacity; None without."""
    shader = material.ComputeSurfaceSource()[0]
    if not shader:
        return None
    values: list[float] = []
    for name, default in (("diffuseColor", PLAIN_COLOUR[:3]), ("opacity", PLAIN_COLOUR[3])):
        held = shader.GetInput(name)
        value = held.Get() if held and not held.HasConnectedSource() else None
        values += np.ravel(default if value is None else value).tolist()
    is_colour = len(values) == len(PLAIN_COLOUR) and np.isfinite(values).all()
    return np.clip(values, 0, 1).tolist() if is_colour else None


def _name_material(subset: Any) -> str:
    """Return the name of the material that is bound to a subset, or that of the subset."""
    from pxr import UsdShade

    path = UsdShade.MaterialBindingAPI(subset).GetDirectBinding().GetMaterialPath()
    prim = subset.GetPrim().GetStage().GetPrimAtPath(path) if path else None
    if prim:
        return _name(prim)
    return str(path.name) if path else _name(subset.GetPrim())


def _name(prim: Any) -> str:
    """Return the name of a prim, as people see it."""
    return single_line(prim.GetDisplayName() or prim.GetName())
