"""USD: what has a time sample per frame, in single precision.

Meshes have moving points, or a skeleton, with their polygons, UVs, normals, colours, materials,
groups and subdivision. Gaussian splats are a ParticleField3DGaussianSplat, which is in USD from
26.03 on.
"""

import zipfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import require_unicode
from cageik_cli.formats.base.skeleton import CAGE_KEY, Skeleton, Skin, SkinWeights
from cageik_cli.formats.base.writers import (
    Animation,
    AnimationWriter,
    choose_scene_paths,
    name_root,
    nest_names,
    to_float32,
)
from cageik_cli.formats.npz import fixed_date_zipinfo
from cageik_cli.formats.ply_points import COLOURS, SCALES, TURNS, PointFile, rest_names
from cageik_cli.formats.usd.library import USD_SUFFIXES, capture_diagnostics, require_usd
from cageik_cli.formats.usd.reader import LIBRARY_KEY, PRIMVARS
from cageik_cli.geometry.attributes import LAYERS, NONE, FaceLabels, SurfaceAttributes, UvMap
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import Part, split_parts
from cageik_cli.geometry.shape import (
    FALLBACK_NORMAL,
    compute_corner_normals,
    has_vertex_normals,
    shade_smoothly,
)
from cageik_cli.method.points.oriented import REST_COUNTS
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import MissingLibraryError, OutputError
from cageik_cli.util.text import number_names

MAX_UNSAVED_BYTES = 1 << 26
"""Bytes of time samples in memory before they are saved; also the limit of a `.usda`, which USD
keeps in memory until the end."""

MAX_USDZ_BYTES = 1 << 32
"""Bytes of a `.usdz`: a zip file without the extension for large files."""

SPLAT_SCHEMA = "ParticleField3DGaussianSplat"


class UsdWriter(AnimationWriter):
    """Writes a stage whose default prim has the name of the animation; it is saved as it grows.

    USD reads saved samples of binary files from the disk on demand, and keeps only unsaved ones in
    memory. Formats define the default prim, whose path is `root`.
    """

    suffixes = USD_SUFFIXES
    is_single = True
    keeps_parts = True
    states_unit = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without usd-core."""
        require_usd("writing USD")

    def open_stage(self, target: Path, animation: Animation, frame_bytes: int) -> None:
        """Start a file of `frame_bytes` per frame."""
        suffix = target.suffix.lower()
        require_usd(f"writing {target.suffix}")
        from pxr import Sdf, Usd, UsdGeom

        _check_size_limit(suffix, animation.frame_count * frame_bytes)
        self._target, self._frame_bytes, self._unsaved_bytes = target, frame_bytes, 0
        self._frame_count, self._scene = 0, animation.scene
        self._folder: TemporaryDirectory[str] | None = None
        self._path, self._member = target, f"{animation.name}.usdc"
        if suffix == ".usdz":
            self._folder = TemporaryDirectory(dir=target.parent, prefix=f"{target.stem}.")
            self._path = Path(self._folder.name) / self._member
        binary = {"format": "usdc"} if suffix == ".usd" else {}
        with ExitStack() as stack, capture_diagnostics(OSError):
            stack.callback(self.abandon)
            layer = Sdf.Layer.CreateNew(require_unicode(self._path), args=binary)
            self.stage = Usd.Stage.Open(layer)
            scene = animation.scene
            UsdGeom.SetStageUpAxis(self.stage, scene.up_axis)
            UsdGeom.SetStageMetersPerUnit(self.stage, scene.metres_per_unit)
            self.stage.SetTimeCodesPerSecond(scene.fps)
            self.stage.SetFramesPerSecond(scene.fps)
            self.stage.SetStartTimeCode(scene.start)
            self.stage.SetEndTimeCode(scene.frame_number(animation.frame_count - 1))
            self.root = f"/{animation.name}"
            self.stage.SetDefaultPrim(self.stage.OverridePrim(self.root))
            stack.pop_all()  # open from here on

    def begin_frame(self) -> float:
        """Return the time code of the next frame; samples before it may be saved."""
        with capture_diagnostics(OSError):
            if self._unsaved_bytes + self._frame_bytes > MAX_UNSAVED_BYTES:
                self.stage.GetRootLayer().Save()
                self._unsaved_bytes = 0
        self._unsaved_bytes += self._frame_bytes
        self._frame_count += 1
        return self._scene.frame_number(self._frame_count - 1)

    def complete(self) -> None:
        """Save what is left, and close the file."""
        with capture_diagnostics(OSError):
            self.stage.GetRootLayer().Save()
        del self.stage
        if self._folder is not None:
            _write_usdz(self._path, self._target, self._member)
            self._folder.cleanup()

    def abandon(self) -> None:
        """Close the file."""
        self.__dict__.pop("stage", None)
        if self._folder is not None:
            self._folder.cleanup()


def _check_size_limit(suffix: str, size: int) -> None:
    limit = {".usda": MAX_UNSAVED_BYTES, ".usdz": MAX_USDZ_BYTES}.get(suffix)
    if limit is not None and size > limit:
        raise OutputError(
            f"{size >> 20} MiB of positions, but a {suffix} holds at most {limit >> 20} MiB; write "
            ".usdc instead"
        )


def _write_usdz(path: Path, target: Path, name: str) -> None:
    """Write a `.usdz` of one file: uncompressed, its bytes from a multiple of 64 on.

    USD's own packager would write the time.
    """
    member = fixed_date_zipinfo(name)
    header = 30 + len(name.encode()) + 4
    padding = -header % 64
    member.extra = b"\x86\x19" + padding.to_bytes(2, "little") + bytes(padding)
    with zipfile.ZipFile(target, "w") as archive, path.open("rb") as stream:
        member.file_size = path.stat().st_size
        with archive.open(member, "w") as file:
            while block := stream.read(1 << 24):
                file.write(block)


class Writer(UsdWriter):
    """Writes each frame at the time code of its number: each part at its path, in its own space.

    A mesh that came as one is `/NAME/NAME`: Blender names the object after the mesh, other programs
    after its parent.
    """

    def __init__(self, target: Path, animation: Animation) -> None:
        self._parts = animation.split()
        size = sum(count_frame_bytes(part.mesh) for part in self._parts)
        self.open_stage(target, animation, size)
        with capture_diagnostics(OSError):
            self._meshes = define_parts(self, animation, self._parts, is_cache=True)

    def append(self, frames: Floats) -> None:
        """Write the next frames."""
        for positions in frames:
            time = self.begin_frame()
            with capture_diagnostics(OSError):
                for mesh, part in zip(self._meshes, self._parts, strict=True):
                    mesh.write_positions(part.select(positions), time)


class UsdMesh:
    """A mesh prim with the faces and the attributes of a mesh, and no points yet."""

    def __init__(self, stage: Any, path: str, mesh: TriMesh, materials: "UsdMaterials") -> None:
        from pxr import UsdGeom

        self.prim = UsdGeom.Mesh.Define(stage, path)
        self.prim.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
        attributes = mesh.polygons
        self.prim.CreateFaceVertexCountsAttr(_to_ints(attributes.corner_counts))
        self.prim.CreateFaceVertexIndicesAttr(_to_ints(attributes.corners))
        self._shaded = attributes if count_normals(mesh) else None
        subdivision = attributes.subdivision
        # By default, a mesh is subdivided by Catmull and Clark.
        self.prim.CreateSubdivisionSchemeAttr(subdivision.scheme)
        if len(subdivision.crease_lengths):
            self.prim.CreateCreaseIndicesAttr(_to_ints(subdivision.crease_vertices))
            self.prim.CreateCreaseLengthsAttr(_to_ints(subdivision.crease_lengths))
            self.prim.CreateCreaseSharpnessesAttr(_to_floats(subdivision.crease_sharpness))
        if len(subdivision.corner_vertices):
            self.prim.CreateCornerIndicesAttr(_to_ints(subdivision.corner_vertices))
            self.prim.CreateCornerSharpnessesAttr(_to_floats(subdivision.corner_sharpness))
        _write_layers(self.prim, attributes)
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
            normals = compute_corner_normals(self._shaded, positions)
            if self._is_by_vertex:
                by_vertex = np.tile(FALLBACK_NORMAL, (len(positions), 1))
                by_vertex[self._shaded.corners] = normals
                normals = by_vertex
            values = Vt.Vec3fArray.FromNumpy(to_float32(normals))
            self.prim.CreateNormalsAttr().Set(values, *time)


def define_parts(
    writer: UsdWriter, animation: Animation, parts: list[Part], *, is_cache: bool
) -> list[UsdMesh]:
    """Define a mesh for each part, at its path and with its transform, and what it is below.

    Parts of a scene in a cache can be laid over the asset that they came from.
    """
    from pxr import Sdf, UsdGeom

    stage, paths = writer.stage, choose_prim_paths([part.name for part in parts], animation.name)
    writer.root = str(Sdf.Path(paths[0]).GetPrefixes()[0])
    stage.SetDefaultPrim(stage.OverridePrim(writer.root))
    overlays = [is_cache and part.name.startswith("/") for part in parts]
    # Nothing can be behind a mesh that is above it.
    is_over_asset = any(overlays) and writer.root not in paths
    materials = UsdMaterials(stage, writer.root, taken=paths, is_over_asset=is_over_asset)
    meshes = []
    for path, part in zip(paths, parts, strict=True):
        for above in Sdf.Path(path).GetPrefixes()[:-1]:
            # If a mesh were the default prim, the type of a referencing prim would hide it.
            if str(above) not in paths:
                UsdGeom.Xform.Define(stage, above)
        meshes.append(UsdMesh(stage, path, part.own_mesh, materials))
        if part.name == animation.guide:
            meshes[-1].prim.CreatePurposeAttr(UsdGeom.Tokens.guide)
    transforms = {path: part.transform for path, part in zip(paths, parts, strict=True)}
    for mesh, part, is_overlay in zip(meshes, parts, overlays, strict=True):
        _place_part(mesh.prim, part, transforms, is_overlay=is_overlay)
    return meshes


def _place_part(mesh: Any, part: Part, transforms: dict[str, Floats], *, is_overlay: bool) -> None:
    """Give a mesh the transform of its part.

    An overlay can be laid over the asset that it came from. It leaves the transforms of what it is
    below, of which the file alone has none, and is no instance. If it is below another
    part, it is moved by that one, because Blender does not know of meshes that leave a transform.

    Parameters
    ----------
    transforms : dict
        Of all parts, by their paths.
    """
    from pxr import Gf, UsdGeom

    *above, own = mesh.GetPath().GetPrefixes()
    uppers = [k for k, path in enumerate(above) if str(path) in transforms]
    matrix = part.transform
    if uppers:
        matrix = matrix @ np.linalg.inv(transforms[str(above[uppers[-1]])])
    if is_overlay:
        stage = mesh.GetPrim().GetStage()
        for path in (*above[uppers[-1] + 1 :], own) if uppers else ():
            UsdGeom.Xformable(stage.GetPrimAtPath(path)).ClearXformOpOrder()
        for path in above:
            stage.GetPrimAtPath(path).SetInstanceable(False)
    if not np.array_equal(matrix, np.eye(4)):
        mesh.MakeMatrixXform().Set(Gf.Matrix4d(matrix))
    if is_overlay and not uppers:
        mesh.SetResetXformStack(True)


def choose_prim_paths(names: Sequence[str], root: str) -> list[str]:
    """Return paths that USD accepts, all different, for the parts of these names."""
    from pxr import Tf

    paths = (path.split("/") for path in choose_scene_paths(names, root))
    steps = ([Tf.MakeValidIdentifier(step) for step in path if step] for path in paths)
    return number_names("/" + "/".join(each) for each in steps)


class SkeletonWriter(UsdWriter):
    """Writes the rest mesh, skinned to joints, where `Skeleton` has them.

    If the joints turn, a mesh without normals gets those of a smooth surface.
    """

    def __init__(
        self,
        target: Path,
        animation: Animation,
        skin: Skin,
        *,
        has_cage: bool = False,
        is_extracted: bool = False,
    ) -> None:
        """Start writing the animation of joints, whose `rest` has them at rest, to `target`.

        With `has_cage`, they are vertices of a cage, which is beside the mesh. The root is as
        `Skeleton` has it.
        """
        rest = skin.rest.move(skin.rest.vertices - np.array(animation.origin))
        if skin.turns is not None:
            rest = shade_smoothly(rest)
        to_float32(rest.vertices)  # refused before anything is written
        self._skeleton = Skeleton(
            animation.rest.vertices,
            replace(skin, rest=rest),
            up_axis=animation.scene.up_axis,
            is_extracted=is_extracted,
        )
        parts = [replace(part, transform=np.eye(4)) for part in split_parts(rest)]
        names = nest_names([part.name or "mesh" for part in parts], animation.name)
        parts = [replace(part, name=name) for part, name in zip(parts, names, strict=True)]
        if has_cage:
            name = f"{name_root(names, animation.name)}/{animation.name}"
            whole = slice(0, len(animation.rest.vertices))
            parts.append(Part(name, animation.rest, whole, np.eye(4)))
            animation = replace(animation, guide=name if animation.guide else "")
        moving = count_frame_bytes(animation.rest) if has_cage else 0
        joint_bytes = 12 + 16  # a translation and a rotation in single precision
        self.open_stage(target, animation, moving + joint_bytes * len(self._skeleton.names))
        with capture_diagnostics(OSError):
            meshes = define_parts(self, animation, parts, is_cache=False)
            self._cage_mesh = meshes.pop() if has_cage else None
            self._define_skeleton()
            for mesh, part in zip(meshes, parts, strict=False):
                mesh.write_positions(part.mesh.vertices)
                self._bind_mesh(mesh.prim, skin.weights, part.vertices)

    def append(self, frames: Floats) -> None:
        """Write the cages of the next k frames, (k, n, 3)."""
        from pxr import Vt

        turns = np.zeros((len(self._skeleton.names), 4), np.float32)
        turns[:, 3] = 1
        for cage, (places, found) in zip(frames, self._skeleton.advance(frames), strict=True):
            time, translations = self.begin_frame(), to_float32(places)
            turns[: len(found)] = found
            with capture_diagnostics(OSError):
                self._translations.Set(Vt.Vec3fArray.FromNumpy(translations), time)
                self._turns.Set(Vt.QuatfArray.FromNumpy(turns), time)
                if self._cage_mesh is not None:
                    self._cage_mesh.write_positions(cage, time)

    def _define_skeleton(self) -> None:
        """Define the joints, which are named by the paths to them."""
        from pxr import UsdSkel, Vt

        stage, root, tree = self.stage, self.root, self._skeleton
        UsdSkel.Root.Define(stage, root)
        self._place = f"{root}/skeleton"
        while stage.GetPrimAtPath(self._place):  # a part of that name
            self._place += "_"
        skeleton = UsdSkel.Skeleton.Define(stage, self._place)
        animation = UsdSkel.Animation.Define(stage, f"{self._place}/motion")
        joints: list[str] = []
        for name, parent in zip(tree.names, tree.parents, strict=True):
            joints.append(name if parent < 0 else f"{joints[parent]}/{name}")
        bind, rest = tree.bind_places, tree.rest_translations
        skeleton.CreateJointsAttr(joints)
        skeleton.GetPrim().SetCustomDataByKey(CAGE_KEY, Vt.StringArray(tree.aliases))
        skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray.FromNumpy(_make_translations(bind)))
        skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray.FromNumpy(_make_translations(rest)))
        binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
        animation.CreateJointsAttr(joints)
        animation.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(np.ones((len(joints), 3), np.float16)))
        self._turns: Any = animation.CreateRotationsAttr()
        self._translations: Any = animation.CreateTranslationsAttr()

    def _bind_mesh(self, mesh: Any, weights: SkinWeights, vertices: slice) -> None:
        """Bind a mesh, of some of the vertices that have weights, to the skeleton."""
        from pxr import Gf, UsdSkel, Vt

        influences = weights.joints.shape[1]
        binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateSkeletonRel().SetTargets([self._place])
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
        joints = binding.CreateJointIndicesPrimvar(False, influences)
        numbers = (weights.joints[vertices] + self._skeleton.lead).astype(np.int32)
        joints.Set(Vt.IntArray.FromNumpy(numbers.ravel()))
        values = binding.CreateJointWeightsPrimvar(False, influences)
        values.Set(Vt.FloatArray.FromNumpy(weights.values[vertices].astype(np.float32).ravel()))


def _make_translations(points: Floats) -> Floats:
    """Return matrices (n, 4, 4) that move the origin to each point; they multiply rows."""
    matrices = np.tile(np.eye(4), (len(points), 1, 1))
    matrices[:, 3, :3] = points
    return matrices


def count_frame_bytes(mesh: TriMesh) -> int:
    """Return the bytes of a frame of a mesh: its points, and its normals, of corners at most."""
    return 12 * (len(mesh.vertices) + count_normals(mesh))


def count_normals(mesh: TriMesh) -> int:
    """Return how many normals a mesh has in each frame: at most one per corner.

    A surface that is subdivided has none, for its normals are those of its limit.
    """
    shaded = mesh.shaded
    is_limit = shaded is not None and shaded.subdivision.scheme != "none"
    return 0 if shaded is None or is_limit else len(shaded.corners)


def _to_ints(values: Integers) -> Any:
    from pxr import Vt

    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))


def _to_floats(values: Floats) -> Any:
    from pxr import Vt

    return Vt.FloatArray.FromNumpy(to_float32(values))


def _write_layers(prim: Any, attributes: SurfaceAttributes) -> None:
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
            primvar.SetIndices(_to_ints(indices))
        elif held is not None and LAYERS[name].domain == "vertex":
            colours = Vt.Vec3fArray.FromNumpy(to_float32(held[:, :3]))
            prim.CreateDisplayColorPrimvar(tokens.vertex).Set(colours)
            if held.shape[1] == LAYERS[name].width:
                prim.CreateDisplayOpacityPrimvar(tokens.vertex).Set(_to_floats(held[:, 3]))


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


class UsdSplatWriter(UsdWriter):
    """Writes rows of splats at the time code of each frame, of the prim `/NAME/NAME`.

    Standard deviations and opacities are written as themselves, not as logarithms and logits, and
    the constant coefficients of a colour before the others.
    """

    def __init__(self, target: Path, animation: Animation, points: PointFile) -> None:
        require_usd("writing USD")
        from pxr import UsdVol

        if not hasattr(UsdVol, SPLAT_SCHEMA):
            raise MissingLibraryError(
                "writing splats as USD needs usd-core 26.3 or newer: pip install -U usd-core"
            )
        self._rest = rest_names(points)
        self._splat_count = len(points.rows)
        coefficients = 1 + len(self._rest) // 3
        moving = 12 + 16 + 12 + (12 * coefficients if self._rest else 0)
        self.open_stage(target, animation, moving * self._splat_count)
        from pxr import UsdGeom, UsdVol

        with capture_diagnostics(OSError):
            stage, root = self.stage, self.root
            UsdGeom.Xform.Define(stage, root)
            prim = getattr(UsdVol, SPLAT_SCHEMA).Define(stage, f"{root}/{animation.name}").GetPrim()
            self._attributes = {name: prim.GetAttribute(name) for name in prim.GetPropertyNames()}
            degree = REST_COUNTS[coefficients - 1]
            self._attributes["radiance:sphericalHarmonicsDegree"].Set(degree)
            with np.errstate(over="ignore"):  # rows have the logits
                opacities = 1 / (1 + np.exp(-points.rows["opacity"].astype(np.float64)))
            self._set("opacities", opacities.astype(np.float32))
            if not self._rest:
                self._set_colours(points.rows)

    def append(self, frames: NDArray[Any]) -> None:
        """Write the next frames, rows (k, m)."""
        for rows in frames:
            time = self.begin_frame()
            positions = _stack_columns(rows, ("x", "y", "z"))
            with np.errstate(over="ignore"):
                scales = np.exp(_stack_columns(rows, SCALES))
            if not (np.isfinite(positions).all() and np.isfinite(scales).all()):
                raise OutputError(
                    "a coordinate is too large for the single precision of this format; scale "
                    "the animation, or write .ply"
                )
            with capture_diagnostics(OSError):
                self._set("positions", positions, time)
                self._set("scales", scales, time)
                self._set("orientations", _stack_columns(rows, TURNS), time)
                # Each splat is taken to three of its largest standard deviation.
                radii = 3.0 * scales.max(axis=1, keepdims=True)
                self._attributes["extent"].Set(
                    compute_extent(np.concatenate([positions - radii, positions + radii])), time
                )
                if self._rest:
                    self._set_colours(rows, time)

    def _set_colours(self, rows: NDArray[Any], time: float | None = None) -> None:
        """Write all coefficients of each splat together: the constant ones, then the bands."""
        colours = _stack_columns(rows, self._rest).reshape(self._splat_count, 3, -1)
        constant = _stack_columns(rows, COLOURS)[:, :, None]
        grouped = np.concatenate([constant, colours], axis=2).transpose(0, 2, 1)
        self._set("radiance:sphericalHarmonicsCoefficients", grouped.reshape(-1, 3), time)

    def _set(self, name: str, values: NDArray[np.float32], time: float | None = None) -> None:
        from pxr import Usd, Vt

        kinds = {1: Vt.FloatArray, 3: Vt.Vec3fArray, 4: Vt.QuatfArray}
        kind = kinds[1 if values.ndim == 1 else values.shape[1]]
        if kind is Vt.QuatfArray:
            values = np.roll(values, -1, axis=1)  # arrays of USD have the real part last
        array = kind.FromNumpy(np.ascontiguousarray(values))
        self._attributes[name].Set(array, Usd.TimeCode.Default() if time is None else time)


def _stack_columns(rows: NDArray[Any], names: tuple[str, ...]) -> NDArray[np.float32]:
    """Return some properties as float32, (m, count)."""
    found = np.empty((len(rows), len(names)), np.float32)
    with np.errstate(over="ignore"):  # positions are checked, the others are never as large
        for k, name in enumerate(names):
            found[:, k] = rows[name]
    return found
