"""What USD has of the surface of a mesh besides its points: layers, materials and groups."""

from typing import Any

import numpy as np

from cageik_cli.formats.base.writers import to_float32
from cageik_cli.formats.usd.reader import LIBRARY_KEY, PRIMVARS
from cageik_cli.geometry.attributes import LAYERS, NONE, FaceLabels, SurfaceAttributes, UvMap
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.text import number_names


def to_ints(values: Integers) -> Any:
    """Return whole numbers as USD stores them, of 32 bits."""
    from pxr import Vt

    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))


def to_floats(values: Floats) -> Any:
    """Return numbers as USD stores them, in single precision."""
    from pxr import Vt

    return Vt.FloatArray.FromNumpy(to_float32(values))


def write_layers(prim: Any, attributes: SurfaceAttributes) -> None:
    """Write UVs and colours; normals move with the points."""
    from pxr import Sdf, UsdGeom, Vt

    primvars, tokens = UsdGeom.PrimvarsAPI(prim), UsdGeom.Tokens
    for name, places in PRIMVARS.items():
        held = getattr(attributes, name)
        if isinstance(held, UvMap):
            kind, (values, indices) = Sdf.ValueTypeNames.TexCoord2fArray, held.complete()
            primvar = primvars.CreatePrimvar(places[0], kind, tokens.faceVarying)
            if len(values) > len(held.values):
                # USD knows no corner without a value: the last value stands for that.
                primvar.SetUnauthoredValuesIndex(len(held.values))
            primvar.Set(Vt.Vec2fArray.FromNumpy(to_float32(values)))
            primvar.SetIndices(to_ints(indices))
        elif held is not None and LAYERS[name].domain == "vertex":
            colours = Vt.Vec3fArray.FromNumpy(to_float32(held[:, :3]))
            prim.CreateDisplayColorPrimvar(tokens.vertex).Set(colours)
            if held.shape[1] == LAYERS[name].width:
                prim.CreateDisplayOpacityPrimvar(tokens.vertex).Set(to_floats(held[:, 3]))


class UsdMaterials:
    """The materials of a stage, below a scope: the same for all parts that name it alike.

    Parameters
    ----------
    root : str
        Path of the prim that the scope is in.
    taken : set of str
        Paths that the scope must not have.
    is_over_asset : bool
        Whether the file may lie over the asset that the parts came from, which knows its materials
        better.
    """

    def __init__(
        self, stage: Any, root: str, *, taken: set[str], is_over_asset: bool = False
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


def write_materials(prim: Any, attributes: SurfaceAttributes, defined: UsdMaterials) -> None:
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
    for name, subset in write_subsets(prim, labels, UsdShade.Tokens.materialBind).items():
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


def write_subsets(prim: Any, labels: FaceLabels, family: str) -> dict[str, Any]:
    """Define a subset of faces for each name; a face is in one at most."""
    from pxr import UsdGeom

    subsets, members = {}, dict(labels.list_members())
    for name, path in _choose_paths(prim.GetPrim(), list(members)):
        subset = UsdGeom.Subset.Define(prim.GetPrim().GetStage(), path)
        subset.CreateElementTypeAttr(UsdGeom.Tokens.face)
        subset.CreateFamilyNameAttr(family)
        subset.CreateIndicesAttr(to_ints(members[name]))
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
