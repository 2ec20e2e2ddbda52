"""A mesh in USD: polygons, UVs, normals, colours, materials, groups and subdivision."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writers import to_float32
from cageik_cli.formats.usd.surface_reader import LIBRARY_KEY, UV_NAME
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.normals import FALLBACK_NORMAL, compute_corner_normals, has_vertex_normals
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.geometry.surface_parts import NONE, FaceLabels
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.text import number_names


class UsdMesh:
    """A mesh prim with the faces and the attributes of a mesh, and no points yet."""

    def __init__(self, stage: Any, path: str, mesh: TriMesh, materials: "UsdMaterials") -> None:
        from pxr import UsdGeom

        self.prim = UsdGeom.Mesh.Define(stage, path)
        self.prim.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
        attributes = mesh.attributes
        counts = np.full(len(mesh.faces), 3) if attributes is None else attributes.corner_counts
        corners = mesh.faces.ravel() if attributes is None else attributes.corners
        self.prim.CreateFaceVertexCountsAttr(_to_ints(counts))
        self.prim.CreateFaceVertexIndicesAttr(_to_ints(corners))
        self._shaded = attributes if count_normals(mesh) else None
        if attributes is None:
            # By default, a mesh is subdivided by Catmull and Clark.
            self.prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
            return
        _write_subdivision(self.prim, attributes)
        _write_uvs(self.prim, attributes)
        _write_colours(self.prim, attributes)
        _write_materials(self.prim, attributes, materials)
        if attributes.groups is not None:
            _write_subsets(self.prim, attributes.groups, "groups")
        if self._shaded is not None:
            self._is_by_vertex = has_vertex_normals(attributes)
            tokens = UsdGeom.Tokens
            self.prim.SetNormalsInterpolation(
                tokens.vertex if self._is_by_vertex else tokens.faceVarying
            )

    def write_positions(self, positions: Floats, *time: float) -> None:
        """Write points (m, 3), their extent and normals, at a time or for all times."""
        from pxr import Vt

        points = to_float32(positions)
        self.prim.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), *time)
        self.prim.CreateExtentAttr().Set(compute_extent(points), *time)
        if self._shaded is not None:
            normals = to_float32(self._compute_normals(self._shaded, positions))
            self.prim.CreateNormalsAttr().Set(Vt.Vec3fArray.FromNumpy(normals), *time)

    def _compute_normals(self, attributes: SurfaceAttributes, positions: Floats) -> Floats:
        """Return the normals of the vertices, or of the corners if these have several."""
        by_corner = compute_corner_normals(attributes, positions)
        if not self._is_by_vertex:
            return by_corner
        normals = np.tile(FALLBACK_NORMAL, (len(positions), 1))
        normals[attributes.corners] = by_corner
        return normals


def count_frame_bytes(mesh: TriMesh) -> int:
    """Return the bytes of a frame of a mesh: its points, and its normals, of corners at most."""
    return 12 * (len(mesh.vertices) + count_normals(mesh))


def count_normals(mesh: TriMesh) -> int:
    """Return how many normals a mesh has in each frame: at most one per corner.

    A surface that is subdivided has none, for its normals are those of its limit.
    """
    attributes = mesh.attributes
    if attributes is None or attributes.normal_fans is None:
        return 0
    return len(attributes.corners) if attributes.subdivision.scheme == "none" else 0


def _to_ints(values: Integers) -> Any:
    from pxr import Vt

    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))


def _to_floats(values: Floats) -> Any:
    from pxr import Vt

    return Vt.FloatArray.FromNumpy(to_float32(values))


def _write_subdivision(prim: Any, attributes: SurfaceAttributes) -> None:
    subdivision = attributes.subdivision
    prim.CreateSubdivisionSchemeAttr(subdivision.scheme)
    if len(subdivision.crease_lengths):
        prim.CreateCreaseIndicesAttr(_to_ints(subdivision.crease_vertices))
        prim.CreateCreaseLengthsAttr(_to_ints(subdivision.crease_lengths))
        prim.CreateCreaseSharpnessesAttr(_to_floats(subdivision.crease_sharpness))
    if len(subdivision.corner_vertices):
        prim.CreateCornerIndicesAttr(_to_ints(subdivision.corner_vertices))
        prim.CreateCornerSharpnessesAttr(_to_floats(subdivision.corner_sharpness))


def _write_uvs(prim: Any, attributes: SurfaceAttributes) -> None:
    from pxr import Sdf, UsdGeom, Vt

    if attributes.uvs is None:
        return
    values, indices = attributes.uvs.values, attributes.uvs.indices
    kind = Sdf.ValueTypeNames.TexCoord2fArray
    primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(UV_NAME, kind, UsdGeom.Tokens.faceVarying)
    if (indices == NONE).any():
        # USD knows no corner without a value: the last value stands for that.
        primvar.SetUnauthoredValuesIndex(len(values))
        indices = np.where(indices == NONE, len(values), indices)
        values = np.concatenate([values, np.zeros((1, 2))])
    primvar.Set(Vt.Vec2fArray.FromNumpy(to_float32(values)))
    primvar.SetIndices(_to_ints(indices))


def _write_colours(prim: Any, attributes: SurfaceAttributes) -> None:
    from pxr import UsdGeom, Vt

    if attributes.colours is None:
        return
    colours = to_float32(attributes.colours[:, :3])
    prim.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(Vt.Vec3fArray.FromNumpy(colours))
    if attributes.colours.shape[1] == 4:
        opacity = _to_floats(attributes.colours[:, 3])
        prim.CreateDisplayOpacityPrimvar(UsdGeom.Tokens.vertex).Set(opacity)


class UsdMaterials:
    """The materials of a stage, below a scope: the same for all parts that name it alike.

    Parameters
    ----------
    root : str
        Path of the prim that the scope is in.
    taken : list of str
        Paths that the scope must not have.
    is_over_asset : bool
        Whether the file may lie over the asset that the parts came from, which knows its materials
        better.
    """

    def __init__(
        self, stage: Any, root: str, *, taken: list[str], is_over_asset: bool = False
    ) -> None:
        self._stage, self._is_over_asset = stage, is_over_asset
        self._path = f"{root}/cache_materials" if is_over_asset else f"{root}/materials"
        while self._path in taken:
            self._path += "_"
        self._defined: dict[tuple[str, bytes], Any] = {}
        self._bound_count = 0

    def choose_bound(self, mesh: Any) -> Any:
        """Return what the materials of a mesh are bound to: the mesh, or a class behind it.

        A mesh that specializes a class has its materials, but those of an asset are stronger.
        """
        from pxr import Sdf, UsdGeom

        if not self._is_over_asset:
            return mesh
        UsdGeom.Scope.Define(self._stage, self._path)
        behind = UsdGeom.Mesh.Define(self._stage, f"{self._path}/bound_{self._bound_count}")
        behind.GetPrim().SetSpecifier(Sdf.SpecifierClass)
        mesh.GetPrim().GetSpecializes().AddSpecialize(behind.GetPath())
        self._bound_count += 1
        return behind

    def define(self, names: list[str], colours: list[Floats | None]) -> dict[str, Any]:
        """Define materials, with their colours if those are known, by their names."""
        from pxr import UsdGeom, UsdShade

        scope = UsdGeom.Scope.Define(self._stage, self._path).GetPrim()
        keys = [
            (name, b"" if colour is None else colour.tobytes())
            for name, colour in zip(names, colours, strict=True)
        ]
        new = {name: k for k, name in enumerate(names) if keys[k] not in self._defined}
        for name, path in _choose_paths(scope, list(new)):
            material, colour = UsdShade.Material.Define(self._stage, path), colours[new[name]]
            _show_name(material.GetPrim(), name)
            if colour is not None:
                _write_colour(material, colour)
            self._defined[keys[new[name]]] = material
        return {name: self._defined[key] for name, key in zip(names, keys, strict=True)}


def _write_materials(prim: Any, attributes: SurfaceAttributes, defined: UsdMaterials) -> None:
    """Define the materials, and bind them."""
    from pxr import UsdShade

    if attributes.material_library:
        prim.GetPrim().SetCustomDataByKey(LIBRARY_KEY, attributes.material_library)
    labels, colours = attributes.materials, attributes.material_colours
    if labels is None:
        return
    bound = dict(labels.list_members())
    rows = [None if colours is None else colours[labels.names.index(name)] for name in bound]
    materials = defined.define(list(bound), rows)
    prim = defined.choose_bound(prim)
    if len(bound) == 1 and len(bound[labels.names[labels.indices[0]]]) == len(labels.indices):
        UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(*materials.values())
        return
    for name, subset in _write_subsets(prim, labels, UsdShade.Tokens.materialBind).items():
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[name])


def _write_colour(material: Any, colour: Floats) -> None:
    """Give a material a shader of one colour, (4,): linear red, green, blue and opacity."""
    from pxr import Gf, Sdf, UsdShade

    path = material.GetPath().AppendChild("surface")
    shader = UsdShade.Shader.Define(material.GetPrim().GetStage(), path)
    shader.CreateIdAttr("UsdPreviewSurface")  # all programs show it
    red, green, blue, opacity = colour.clip(0, 1).tolist()
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(red, green, blue))
    shader.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(opacity)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")


def _write_subsets(prim: Any, labels: FaceLabels, family: str) -> dict[str, Any]:
    """Define a subset of faces for each name; a face is in one at most."""
    from pxr import UsdGeom

    subsets, members = {}, dict(labels.list_members())
    for name, path in _choose_paths(prim.GetPrim(), list(members)):
        subset = UsdGeom.Subset.Define(prim.GetPrim().GetStage(), path)
        subset.CreateElementTypeAttr(UsdGeom.Tokens.face)
        subset.CreateFamilyNameAttr(family)
        subset.CreateIndicesAttr(_to_ints(members[name]))
        _show_name(subset.GetPrim(), name)
        subsets[name] = subset
    tokens = UsdGeom.Tokens
    whole = tokens.nonOverlapping if (labels.indices == NONE).any() else tokens.partition
    UsdGeom.Subset.SetFamilyType(prim, family, whole)
    return subsets


def _choose_paths(parent: Any, names: list[str]) -> list[tuple[str, Any]]:
    """Return names with paths for children, in letters that USD accepts and each not yet taken."""
    from pxr import Tf

    taken = [child.GetName() for child in parent.GetAllChildren()]
    chosen = number_names(map(Tf.MakeValidIdentifier, names), taken)
    return [(n, parent.GetPath().AppendChild(c)) for n, c in zip(names, chosen, strict=True)]


def _show_name(prim: Any, name: str) -> None:
    """Keep the name as it is, where that of the prim is another."""
    if prim.GetName() != name:
        prim.SetDisplayName(name)


def compute_extent(points: NDArray[np.float32]) -> Any:
    """Return the bounding box of points (m, 3), as USD stores it."""
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)]))
