"""USD: what has a time sample per frame, in single precision.

Meshes have moving points, or a skeleton, with their polygons, UVs, normals, colours, materials,
groups and subdivision. Gaussian splats are a ParticleField3DGaussianSplat, which is in USD from
26.03 on.
"""

import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import ClaimedBytes, require_unicode
from cageik_cli.formats.base.skeleton import CAGE_KEY, PosedSkin, Skeleton, Skin, SkinWeights
from cageik_cli.formats.base.writers import (
    SHAPE_SUFFIX,
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
from cageik_cli.formats.usd.reader import PART_KEY, UsdSceneMesh
from cageik_cli.formats.usd.skinning import Rigs
from cageik_cli.formats.usd.surface import (
    UsdMaterials,
    to_floats,
    to_ints,
    write_layers,
    write_materials,
    write_subsets,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import Part, split_parts
from cageik_cli.geometry.shape import (
    FALLBACK_NORMAL,
    compute_corner_normals,
    has_vertex_normals,
    shade_smoothly,
)
from cageik_cli.method.points.oriented import REST_COUNTS
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import MissingLibraryError, OutputError
from cageik_cli.util.text import number_names

MAX_UNSAVED_BYTES = 1 << 26
"""Bytes of time samples in memory before they are saved; also the limit of a `.usda`, which USD
keeps in memory until the end."""

MAX_USDZ_BYTES = 1 << 32
"""Bytes of a `.usdz`: a zip file without the extension for large files."""

MAX_CHECKED_FRAMES = 16
"""Frames of a skeleton that are read back when it is written, evenly spread, at most."""

MAX_SKIN_CHANGE = 1e-3
"""A skin that USD poses differently is noted above it, in percent of the diagonal."""

JOINT_FRAME_BYTES = 12 + 16
"""Bytes of a joint in a frame: a translation and a rotation in single precision."""

MOTION = "motion"
"""The name of a skeleton's only motion."""

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
            if animation.frame_count:
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

    def __init__(self, stage: Any, path: str, mesh: TriMesh, materials: UsdMaterials) -> None:
        from pxr import UsdGeom

        self.prim = UsdGeom.Mesh.Define(stage, path)
        self.prim.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
        attributes = mesh.polygons
        self.prim.CreateFaceVertexCountsAttr(to_ints(attributes.corner_counts))
        self.prim.CreateFaceVertexIndicesAttr(to_ints(attributes.corners))
        self._shaded = attributes if count_normals(mesh) else None
        subdivision = attributes.subdivision
        # By default, a mesh is subdivided by Catmull and Clark.
        self.prim.CreateSubdivisionSchemeAttr(subdivision.scheme)
        if len(subdivision.crease_lengths):
            self.prim.CreateCreaseIndicesAttr(to_ints(subdivision.crease_vertices))
            self.prim.CreateCreaseLengthsAttr(to_ints(subdivision.crease_lengths))
            self.prim.CreateCreaseSharpnessesAttr(to_floats(subdivision.crease_sharpness))
        if len(subdivision.corner_vertices):
            self.prim.CreateCornerIndicesAttr(to_ints(subdivision.corner_vertices))
            self.prim.CreateCornerSharpnessesAttr(to_floats(subdivision.corner_sharpness))
        write_layers(self.prim, attributes)
        write_materials(self.prim, attributes, materials)
        if attributes.groups is not None:
            write_subsets(self.prim, attributes.groups, "groups")
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
    places = place_meshes(paths)
    prefixes = [list(map(str, Sdf.Path(place).GetPrefixes())) for place in places]
    writer.root = prefixes[0][0]
    stage.SetDefaultPrim(stage.OverridePrim(writer.root))
    overlays = [is_cache and part.name.startswith("/") for part in parts]
    # Nothing can be behind a mesh that is above it.
    is_over_asset = any(overlays) and writer.root not in places
    taken = {prefix for each in prefixes for prefix in each}
    materials = UsdMaterials(stage, writer.root, taken=taken, is_over_asset=is_over_asset)
    meshes = []
    for path, part, (*above, place) in zip(paths, parts, prefixes, strict=True):
        for prefix in above:
            # If a mesh were the default prim, the type of a referencing prim would hide it.
            UsdGeom.Xform.Define(stage, prefix)
        meshes.append(UsdMesh(stage, place, part.own_mesh, materials))
        if place != path:
            meshes[-1].prim.GetPrim().SetCustomDataByKey(PART_KEY, True)
        if part.name == animation.guide:
            meshes[-1].prim.CreatePurposeAttr(UsdGeom.Tokens.guide)
    transforms = {path: part.transform for path, part in zip(paths, parts, strict=True)}
    for path, part, is_overlay in zip(paths, parts, overlays, strict=True):
        prim = UsdGeom.Xformable(stage.GetPrimAtPath(path))
        _place_part(prim, part, transforms, is_overlay=is_overlay)
    return meshes


def place_meshes(paths: Sequence[str]) -> list[str]:
    """Return where the meshes of parts are, which are at these paths.

    USD allows no mesh below another, and skins none there. So a part that others are below is a
    transform, whose mesh is beside them.
    """
    uppers = {upper for path in paths for upper in accumulate(path.split("/")[:-1], "{}/{}".format)}
    moved = [path for path in paths if path in uppers]
    wanted = (f"{path}/{path.rpartition('/')[2]}{SHAPE_SUFFIX}" for path in moved)
    placed = dict(zip(moved, number_names(wanted, uppers.union(paths)), strict=True))
    return [placed.get(path, path) for path in paths]


def _place_part(prim: Any, part: Part, transforms: dict[str, Floats], *, is_overlay: bool) -> None:
    """Give what is at the path of a part, its mesh or what is above that, the part's transform.

    An overlay can be laid over the asset that it came from. It leaves the transforms of what it is
    below, of which the file alone has none, and is no instance. If it is below another
    part, it is moved by that one, because Blender does not know of meshes that leave a transform.

    Parameters
    ----------
    transforms : dict
        Of all parts, by their paths.
    """
    from pxr import Gf, UsdGeom

    *above, own = prim.GetPath().GetPrefixes()
    uppers = [k for k, path in enumerate(above) if str(path) in transforms]
    matrix = part.transform
    if uppers:
        matrix = matrix @ np.linalg.inv(transforms[str(above[uppers[-1]])])
    if is_overlay:
        stage = prim.GetPrim().GetStage()
        for path in (*above[uppers[-1] + 1 :], own) if uppers else ():
            UsdGeom.Xformable(stage.GetPrimAtPath(path)).ClearXformOpOrder()
        for path in above:
            stage.GetPrimAtPath(path).SetInstanceable(False)
    if not np.array_equal(matrix, np.eye(4)):
        prim.MakeMatrixXform().Set(Gf.Matrix4d(matrix))
    if is_overlay and not uppers:
        prim.SetResetXformStack(True)


def choose_prim_paths(names: Sequence[str], root: str) -> list[str]:
    """Return paths that USD accepts, all different, for the parts of these names."""
    from pxr import Tf

    paths = (path.split("/") for path in choose_scene_paths(names, root))
    steps = ([Tf.MakeValidIdentifier(step) for step in path if step] for path in paths)
    return number_names("/" + "/".join(each) for each in steps)


class SkeletonWriter(UsdWriter):
    """Writes the rest mesh, skinned to joints, where `Skeleton` has them.

    If the joints turn, a mesh without normals gets those of a smooth surface. An animation of no
    frames is the mesh and its skeleton at rest, without a motion.
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
        rest = self.prepare(animation, skin, is_extracted)
        parts = nest_parts(rest, animation.name)
        if has_cage:
            names = [part.name for part in parts]
            name = f"{name_root(names, animation.name)}/{animation.name}"
            whole = slice(0, len(animation.rest.vertices))
            parts.append(Part(name, animation.rest, whole, np.eye(4)))
            animation = replace(animation, guide=name if animation.guide else "")
        moving = count_frame_bytes(animation.rest) if has_cage else 0
        self.open_stage(target, animation, moving + JOINT_FRAME_BYTES * len(self.skeleton.names))
        with capture_diagnostics(OSError):
            meshes = define_parts(self, animation, parts, is_cache=False)
            self._cage_mesh = meshes.pop() if has_cage else None
            self._define_skeleton(moves=animation.frame_count > 0)
            if animation.frame_count:
                self.define_motion()
            self.places: list[tuple[str, slice]] = []
            for mesh, part in zip(meshes, parts, strict=False):
                mesh.write_positions(part.mesh.vertices)
                self._bind_mesh(mesh.prim, skin.weights, part.vertices)
                self.places.append((str(mesh.prim.GetPath()), part.vertices))

    def prepare(self, animation: Animation, skin: Skin, is_extracted: bool) -> TriMesh:
        """Make the tree of joints, and choose the frames that are read back; return the rest."""
        rest = skin.rest.move(skin.rest.vertices - np.array(animation.origin))
        if skin.turns is not None:
            rest = shade_smoothly(rest)
        to_float32(rest.vertices)  # refused before anything is written
        self._skin = replace(skin, rest=rest)
        self.skeleton = Skeleton(
            animation.rest.vertices,
            self._skin,
            up_axis=animation.scene.up_axis,
            is_extracted=is_extracted,
        )
        count = animation.frame_count
        self._checked = set(np.linspace(0, count - 1, min(count, MAX_CHECKED_FRAMES)).astype(int))
        self._moves: list[tuple[float, Floats, Floats]] = []
        return rest

    def append(self, frames: Floats) -> None:
        """Write the cages of the next k frames, (k, n, 3)."""
        from pxr import Vt

        turns = np.zeros((len(self.skeleton.names), 4), np.float32)
        turns[:, 3] = 1
        for cage, (places, found) in zip(frames, self.skeleton.advance(frames), strict=True):
            time, translations = self.begin_frame(), to_float32(places)
            if self._frame_count - 1 in self._checked:
                self._moves.append((time, places, found.copy()))
            turns[: len(found)] = found
            with capture_diagnostics(OSError):
                self._translations.Set(Vt.Vec3fArray.FromNumpy(translations), time)
                self._turns.Set(Vt.QuatfArray.FromNumpy(turns), time)
                if self._cage_mesh is not None:
                    self._cage_mesh.write_positions(cage, time)

    def complete(self) -> None:
        """Close the file, and note how far USD's own skinning of it is from what was given."""
        super().complete()
        rest, weights = self._skin.rest, self._skin.weights
        tree, used = self.skeleton, rest.used_vertices
        bound = tree.bind_places[tree.lead :]
        exact = PosedSkin(rest.vertices, weights.to_sparse(len(bound)), bound, tree)
        squares = largest = 0.0
        if not self._moves:
            return
        for (_, places, turns), found in zip(self._moves, self._read_written(), strict=True):
            apart = found - exact.pose(places[None], turns[None])[0]
            distances = np.square(apart[used]).sum(axis=1)
            squares += float(distances.mean()) / len(self._moves)
            largest = max(largest, float(distances.max()))
        rms, largest = (100 * float(np.sqrt(each)) / rest.diagonal for each in (squares, largest))
        if largest > MAX_SKIN_CHANGE:
            note = (
                f"as USD poses the file, vertices are off by an rms of {rms:.2g} % of the "
                f"diagonal, {largest:.2g} % at most"
            )
            if self._skin.error is not None:
                note += f"; against the input, the rms is at most {self._skin.error + rms:.2g} %"
            self.notes += (note,)

    def _read_written(self) -> Iterator[Floats]:
        """Yield the mesh (m, 3) of the frames that are checked, as USD poses them in the file."""
        from pxr import Usd

        with capture_diagnostics(OSError):
            stage = Usd.Stage.Open(str(self._target))
            claimed = ClaimedBytes(self._target.stat().st_size)
            rigs = Rigs()
            meshes = [
                UsdSceneMesh(stage.GetPrimAtPath(place), claimed, rigs) for place, _ in self.places
            ]
            for time, _, _ in self._moves:
                found = np.empty_like(self._skin.rest.vertices)
                for mesh, (_, vertices) in zip(meshes, self.places, strict=True):
                    found[vertices] = mesh.read_moved(time)
                yield found

    def _define_skeleton(self, moves: bool) -> None:
        """Define the joints, which are named by the paths to them, and the prim of a motion."""
        from pxr import UsdSkel, Vt

        stage, root, tree = self.stage, self.root, self.skeleton
        UsdSkel.Root.Define(stage, root)
        self.place = f"{root}/skeleton"
        while stage.GetPrimAtPath(self.place):  # a part of that name
            self.place += "_"
        skeleton = UsdSkel.Skeleton.Define(stage, self.place)
        if moves:
            UsdSkel.Animation.Define(stage, f"{self.place}/{MOTION}")
        self.joints: list[str] = []
        for name, parent in zip(tree.names, tree.parents, strict=True):
            self.joints.append(name if parent < 0 else f"{self.joints[parent]}/{name}")
        bind, rest = tree.bind_places, tree.rest_translations
        skeleton.CreateJointsAttr(self.joints)
        skeleton.GetPrim().SetCustomDataByKey(CAGE_KEY, Vt.StringArray(tree.aliases))
        skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray.FromNumpy(_make_translations(bind)))
        skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray.FromNumpy(_make_translations(rest)))
        UsdSkel.BindingAPI.Apply(skeleton.GetPrim())

    def define_motion(self, name: str = MOTION) -> None:
        """Define what moves the joints, of this name, and bind the skeleton to it."""
        from pxr import UsdSkel, Vt

        stage, joints = self.stage, self.joints
        animation = UsdSkel.Animation.Define(stage, f"{self.place}/{name}")
        binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(self.place))
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
        binding.CreateSkeletonRel().SetTargets([self.place])
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
        joints = binding.CreateJointIndicesPrimvar(False, influences)
        numbers = (weights.joints[vertices] + self.skeleton.lead).astype(np.int32)
        joints.Set(Vt.IntArray.FromNumpy(numbers.ravel()))
        values = binding.CreateJointWeightsPrimvar(False, influences)
        values.Set(Vt.FloatArray.FromNumpy(weights.values[vertices].astype(np.float32).ravel()))


def nest_parts(mesh: TriMesh, root: str) -> list[Part]:
    """Return the parts of a skin, in the space of the scene and below one root."""
    parts = [replace(part, transform=np.eye(4)) for part in split_parts(mesh)]
    names = nest_names([part.name or "mesh" for part in parts], root)
    return [replace(part, name=name) for part, name in zip(parts, names, strict=True)]


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
