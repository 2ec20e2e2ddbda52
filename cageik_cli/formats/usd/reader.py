"""A clip in USD: meshes whose points, transforms or rigs have time samples, and their surfaces."""

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from math import ceil, floor, isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import ClaimedBytes
from cageik_cli.formats.base.mesh_data import Change, LayerReaders, list_layer_readers
from cageik_cli.formats.base.scene_graph import (
    EVEN_STEP_TOL,
    SNAP_TOL,
    LibraryError,
    Polygons,
    SceneMesh,
    SceneReader,
    is_mirroring,
    round_frame_step,
    sample_evenly,
    snap,
    snap_rate,
)
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.formats.usd.library import (
    USD_SUFFIXES,
    capture_diagnostics,
    check_layers,
    list_missing,
    require_usd,
    word_unsound,
)
from cageik_cli.formats.usd.skinning import Rigs, describe_unposed
from cageik_cli.geometry.attributes import (
    LAYERS,
    NONE,
    PLAIN_COLOUR,
    FaceLabels,
    Subdivision,
    SurfaceAttributes,
)
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError, error_context
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.text import format_count, single_line

MAX_TIME_CODES = 100_000
"""Largest number of whole time codes, a frame each, that replace uneven samples."""

MIN_FRAME_RATE, MAX_FRAME_RATE = 12, 240
"""Time codes per second that may be frames; others are a clock, in seconds or parts of them."""

LIBRARY_KEY = "materialLibrary"
"""Where the custom data of a mesh names the file of its materials, as an OBJ file does."""

PART_KEY = "isParentPart"
"""Where the custom data of a mesh states that its parent has the name of the part."""

PRIMVARS = {
    "uvs": ("st",),
    "normal_fans": ("normals",),
    "colours": ("displayColor", "displayOpacity"),
}
"""The primvars of a mesh that hold a layer of numbers."""

_PER_VERTEX, _PER_CORNER, _PER_FACE = ("vertex", "varying"), ("faceVarying",), ("uniform",)


class Reader(SceneReader):
    """Frames of the meshes of a stage; times are time codes."""

    suffixes = USD_SUFFIXES
    library = "usd-core"
    winding_note = "left-handed faces turned"
    _said_missing: Mapping[str, str] = MappingProxyType({})

    def check_file(self, path: Path) -> None:
        """Refuse what cannot be read without usd-core, which opens the layers itself."""
        require_usd(f"reading {path.suffix.lower()}")

    @contextmanager
    def guard(self) -> Iterator[list[Said]]:
        """Convert errors, and collect warnings but those on what is missing."""
        with capture_diagnostics(lambda cause: LibraryError(word_unsound(cause))) as warnings:
            yield warnings
        known = self._said_missing
        warnings[:] = [said for said in warnings if not any(one in str(said) for one in known)]

    def list_meshes(self, path: Path) -> tuple[dict[str, Any], dict[str, str]]:
        """Open the stage, whose files are checked first."""
        from pxr import Usd, UsdGeom

        _ = check_layers(path)  # held, so that they are not read twice
        self._stage = Usd.Stage.Open(str(path))
        self._said_missing = list_missing(self._stage, path)
        self.lacking = list(self._said_missing.values())
        prims = list(Usd.PrimRange.Stage(self._stage, Usd.TraverseInstanceProxies()))
        self.claimed = ClaimedBytes(sum(file.stat().st_size for file in self.files))
        self._rigs = Rigs()
        self._names = _name_parts(prims)
        meshes = {name: self._stage.GetPrimAtPath(path) for path, name in self._names.items()}
        scattered = _list_scattered(prims)
        reasons = {
            name: _find_scattered_reason(prim, scattered) or _find_hidden_reason(prim)
            for name, prim in meshes.items()
        }
        self.others = {
            str(prim.GetPath()): str(prim.GetTypeName())
            for prim in prims
            if prim.IsA(UsdGeom.Gprim)
            and not prim.IsA(UsdGeom.Mesh)
            and not (_find_scattered_reason(prim, scattered) or _find_hidden_reason(prim))
        }
        return meshes, {name: why for name, why in reasons.items() if why}

    def find_top(self, member: str | None) -> str | None:
        """Return the part of a mesh that is named by its own path."""
        return self._names.get(member, member) if member else member

    def open_mesh(self, found: Any) -> "UsdSceneMesh":
        """Open a prim, and find the rig that poses it."""
        return UsdSceneMesh(found, self.claimed, self._rigs)

    def is_empty(self, found: Any) -> bool:
        """Return whether a prim states that it has no points, or no faces, at any time.

        One that states nothing may lack a layer, and is refused.
        """
        from pxr import Usd, UsdGeom

        mesh = UsdGeom.Mesh(found)
        # What is no array, such as a value of a type that USD does not know, is refused later.
        return any(
            held.HasAuthoredValue()
            and not any(
                (value := held.Get(time)) is not None
                and (not isinstance(value, Sized) or len(value) > 0)
                for time in held.GetTimeSamples() or [Usd.TimeCode.Default()]
            )
            for held in (mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr())
        )

    def replace_uneven(self, times: Floats) -> tuple[Floats, str]:
        """Return the whole time codes in place of uneven samples."""
        begin, end = float(times[0]), float(times[-1])
        first, last = ceil(begin - SNAP_TOL), floor(end + SNAP_TOL)
        count = last - first + 1
        if not 1 <= count <= MAX_TIME_CODES:
            raise FormatError(
                f"its {len(times)} time samples from {begin:g} to {end:g} are not evenly spaced "
                f"and span {max(count, 0)} whole time codes, expected 1 to {MAX_TIME_CODES}; bake "
                "it to one sample per frame"
            )
        return np.arange(first, last + 1, dtype=np.float64), (
            f"its {len(times)} time samples are not evenly spaced; frames are at the whole time "
            f"codes {first} to {last}"
        )

    def sample_keys(
        self, times: Floats, step: float | None, fps: float | None
    ) -> tuple[Floats, Note] | None:
        """Return the frames of the stage's range where transforms or rigs have few keys.

        Without a range, or in one that is too long, they are between the keys; but rigs, which
        programs bake, have a frame at each of even samples.
        """
        own = self._find_frame_codes()
        if not self.has_keyed_motion() or (step is not None and step <= own * (1 + EVEN_STEP_TOL)):
            return None
        found = f"its motion has {len(times)} keys from {times[0]:g} to {times[-1]:g}"
        start, end = (_read_number(self._stage, f"{name}TimeCode") for name in ("start", "end"))
        why = "it states no range"
        if start is not None and end is not None and max(start, times[0]) < min(end, times[-1]):
            if end - start < MAX_TIME_CODES * own:
                first, last = snap(start), snap(end)
                text = (
                    f"{found}: frames are those of its range, {first:g} to {last:g}, in steps of "
                )
                return sample_evenly(first, last, own, MAX_TIME_CODES), Note(f"{text}{own:g}")
            why = f"its range, {start:.15g} to {end:.15g}, is too long"
        is_moved = any(mesh.has_moving_transform() for mesh in self._usd_meshes)
        if step is not None and not is_moved:
            return None
        first, last = (
            own * ceil(times[0] / own - EVEN_STEP_TOL),
            own * floor(times[-1] / own + EVEN_STEP_TOL),
        )
        if last <= first:
            return None
        codes = "the whole time codes" if own == 1 else f"every {own:g} time codes from"
        text = f"{found}, and {why}: frames are at {codes} {first:g} to {last:g}"
        chosen = say("; choose others by `selection=`")
        return sample_evenly(first, last, own, MAX_TIME_CODES), Note(text + chosen, "warning")

    def _find_frame_codes(self) -> float:
        """Return the time codes of a frame: at least one, unless they are of a clock.

        A clock without a rate of frames has that which USD takes.
        """
        codes, rate = map(self._read_rate, ("timeCodesPerSecond", "framesPerSecond"))
        if codes is None or codes < 1:  # such codes are longer than any frame
            return 1.0
        is_clock = not MIN_FRAME_RATE <= codes <= MAX_FRAME_RATE
        found = codes / (rate or (Scene().fps if is_clock else codes))
        return found if codes < MIN_FRAME_RATE else max(1.0, found)

    def has_keyed_motion(self) -> bool:
        """Return whether transforms or rigs alone move the meshes."""
        is_rig = any(mesh.is_moved_by_rig for mesh in self._usd_meshes)
        return super().has_keyed_motion() or (is_rig and not self._has_baked_points())

    def describe_step(self, step: float | None) -> list[Note]:
        """Return a note if a rig is sampled more rarely than at each time code."""
        is_rig = any(mesh.is_moved_by_rig for mesh in self._usd_meshes)
        if step is None or step <= 1 + EVEN_STEP_TOL or not is_rig:
            return []
        text = (
            f"its rig has samples {step:.6g} time codes apart, and a frame at each of them; export "
            "it with one at each time code for the frames between"
        )
        return [Note(text, "warning")]

    @property
    def _usd_meshes(self) -> list["UsdSceneMesh"]:
        return [mesh for mesh in self._meshes.values() if isinstance(mesh, UsdSceneMesh)]

    def describe_scene(self, times: Floats, step: float | None) -> SceneHints:
        """Return what the stage states."""
        from pxr import UsdGeom

        stage = self._stage
        codes = self._read_rate("timeCodesPerSecond")
        if codes is None:
            codes = self._read_rate("framesPerSecond")
        unit = _read_number(stage, "metersPerUnit")
        has_axis = stage.HasAuthoredMetadata("upAxis")
        return SceneHints(
            fps=codes,
            start=snap(float(times[0])),
            frame_step=round_frame_step(step),
            up_axis=str(UsdGeom.GetStageUpAxis(stage)) if has_axis else None,
            metres_per_unit=unit if unit is not None and unit > 0 else None,
        )

    def _read_rate(self, name: str) -> float | None:
        """Return a rate that the stage states, above zero, without the rounding of its type."""
        found = _read_number(self._stage, name)
        return snap_rate(found) if found is not None and found > 0 else None

    def list_times(self, meshes: Sequence[SceneMesh]) -> set[float]:
        """List when the meshes are sampled: of samples that are the same frame, the last one."""
        times = sorted(super().list_times(meshes))
        return set({snap(time): time for time in times}.values())

    @cached_property
    def files(self) -> list[Path]:
        """All files that the stage is composed of, its own first."""
        from pxr import Ar

        layers = [layer.realPath for layer in self._stage.GetUsedLayers() if layer.realPath]
        files = {Ar.SplitPackageRelativePathOuter(layer)[0] for layer in layers}
        return [self.path, *(Path(file) for file in sorted(files - {str(self.path.resolve())}))]


class UsdSceneMesh(SceneMesh):
    """A mesh prim; times are time codes."""

    def __init__(self, prim: Any, claimed: ClaimedBytes, rigs: Rigs) -> None:
        from pxr import UsdGeom

        self._mesh = UsdGeom.Mesh(prim)
        self._claimed = claimed.distinguish(_find_source(self._mesh))
        self._pose = rigs.find_pose(self._mesh, self._claimed)
        self._transform_times = _find_transform_times(self._pose.placed_by if self._pose else prim)
        self.is_clockwise = self._mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded

    @property
    def is_moved_by_rig(self) -> bool:
        """Whether joints or blend shapes have time samples."""
        return self._pose is not None and bool(self._pose.list_times())

    def list_times(self) -> set[float]:
        """List the time samples of points, of transforms and of the rig."""
        posed = set() if self._pose is None else self._pose.list_times()
        return {*self._mesh.GetPointsAttr().GetTimeSamples(), *self._transform_times, *posed}

    def list_point_times(self) -> set[float]:
        """List the time samples of the points."""
        return set(self._mesh.GetPointsAttr().GetTimeSamples())

    def compute_matrix(self, time: float) -> Floats:
        """Return the transform of the prim into the stage."""
        return np.array(self._mesh.ComputeLocalToWorldTransform(time), np.float64)

    def has_moving_transform(self) -> bool:
        """Return whether a transform has time samples."""
        return bool(self._transform_times)

    def read_points(self, time: float) -> np.ndarray:
        """Read the points, of which there must be some."""
        points = _read_array(self._mesh.GetPointsAttr(), time, "f", (3,))
        if len(points) == 0:
            raise FormatError(f"the mesh has no points at time {time:g}; export it again")
        return points

    def read_moved(self, time: float) -> Floats:
        """Read the points in the space of the stage, posed by the rig if there is one."""
        if self._pose is None:
            return super().read_moved(time)
        return self._pose.move(self.read_points(time), time)

    def is_mirrored(self, time: float) -> bool:
        """Return whether the prim, or what places it in its rig instead, mirrors the surface."""
        if self._pose is None:
            return super().is_mirrored(time)
        return is_mirroring(self._pose.compute_matrix(time))

    def describe_transform(self, time: float) -> list[str | Change]:
        """Return notes on what has moved the mesh, and when it is not seen."""
        prim = self._mesh.GetPrim()
        moved: list[str | Change]
        if self._pose is not None:
            moved = self._pose.describe()
        else:
            moved = [*super().describe_transform(time), *describe_unposed(prim)]
        hidden = [each for each in _list_visibility_times(prim) if not _is_visible(prim, each)]
        return moved + [
            Change("invisible at {}, but read in all frames", "time", names=(f"{each:g}",))
            for each in hidden[:1]
        ]

    def list_polygon_times(self) -> list[float]:
        """List the time samples of the faces."""
        attributes = self._polygon_attributes
        return sorted({time for attribute in attributes for time in attribute.GetTimeSamples()})

    def read_polygons(self, time: float) -> Polygons:
        """Read the faces, whose numbers the files may hold compressed, or once for many meshes."""
        found = []
        for attribute in self._polygon_attributes:
            found.append(_read_array(attribute, time, "i", ()))
            with error_context(f"`{attribute.GetName()}`"):
                self._claimed.claim(found[-1].nbytes)
        counts, corners = found
        return counts, corners

    def list_surface_layers(self, vertex_count: int, time: float) -> LayerReaders:
        """Return what reads UVs, normals, colours, materials, groups and subdivision."""
        self._claimed.claim(12 * vertex_count)
        return SurfaceReader(self._mesh, vertex_count, time, claimed=self._claimed).list_layers()

    @property
    def _polygon_attributes(self) -> tuple[Any, Any]:
        return self._mesh.GetFaceVertexCountsAttr(), self._mesh.GetFaceVertexIndicesAttr()


def _read_number(stage: Any, name: str) -> float | None:
    """Return a finite number that a stage states, of whatever type; None if it does not.

    Some programs have stated numbers in single precision, which USD itself refuses to return.
    """
    for layer in (stage.GetSessionLayer(), stage.GetRootLayer()):
        value = layer.pseudoRoot.GetInfo(name) if layer.pseudoRoot.HasInfo(name) else None
        if isinstance(value, int | float) and isfinite(value):
            with np.errstate(over="ignore"):
                single = np.float32(value)
            return float(str(single)) if float(single) == value else float(value)
    return None


def _read_array(attribute: Any, time: float, dtype_kind: str, shape: tuple[int, ...]) -> np.ndarray:
    """Read an array attribute at a time, empty without a value; its type is checked."""
    value = attribute.Get(time)
    array = np.zeros((0, *shape), dtype_kind) if value is None else np.asarray(value)
    if array.dtype.kind != dtype_kind or array.ndim != 1 + len(shape) or array.shape[1:] != shape:
        raise FormatError(
            f"`{attribute.GetName()}` is not of type {attribute.GetTypeName()} at time {time:g}; "
            "export it again"
        )
    return array


def _find_source(mesh: Any) -> Hashable:
    """Return where the faces of a mesh are stated: instances have them from one place."""
    attributes = (mesh.GetPointsAttr(), mesh.GetFaceVertexIndicesAttr())
    specs = [spec for each in attributes for spec in each.GetPropertyStack()]
    return tuple((spec.layer.identifier, str(spec.path)) for spec in specs) or str(mesh.GetPath())


def _name_parts(prims: list[Any]) -> dict[str, str]:
    """Return the names of parts by the paths of their meshes: these paths, or those of parents.

    A mesh may state that its parent has the name of the part; no other has that name. Parts are in
    the order of the prims that have their names.
    """
    from pxr import UsdGeom

    places = {str(prim.GetPath()): k for k, prim in enumerate(prims)}
    names = {str(prim.GetPath()): str(prim.GetPath()) for prim in prims if prim.IsA(UsdGeom.Mesh)}
    stating = [path for path in names if prims[places[path]].GetCustomDataByKey(PART_KEY) is True]
    parents = {path: path.rpartition("/")[0] for path in stating}
    counts = Counter([*names, *parents.values()])
    names |= {
        path: parent for path, parent in parents.items() if counts[parent] == 1 and parent in places
    }
    return dict(sorted(names.items(), key=lambda item: places[item[1]]))


def _list_scattered(prims: list[Any]) -> dict[str, str]:
    """Return why meshes are not seen that are at or below the prototypes of point instancers."""
    from pxr import Usd, UsdGeom

    reasons: dict[str, str] = {}
    for prim in prims:
        if prim.IsA(UsdGeom.PointInstancer):
            scatter = UsdGeom.PointInstancer(prim)
            count = len(scatter.GetProtoIndicesAttr().Get(Usd.TimeCode.EarliestTime()) or ())
            reason = (
                f"of the point instancer {prim.GetPath()}, whose {format_count(count, 'instance')} "
                "are not read: make them meshes"
            )
            targets = scatter.GetPrototypesRel().GetForwardedTargets()
            reasons |= {str(path): reason for path in (prim.GetPath(), *targets)}
    return reasons


def _find_scattered_reason(prim: Any, scattered: dict[str, str]) -> str:
    """Return the reason of a prim, or of one above it; empty if there is none."""
    if not scattered:
        return ""
    above = map(str, prim.GetPath().GetPrefixes())
    return next((scattered[path] for path in above if path in scattered), "")


def _find_hidden_reason(prim: Any) -> str:
    """Return why a renderer does not show a mesh at its first time; empty if it does."""
    from pxr import Usd, UsdGeom

    purpose = UsdGeom.Imageable(prim).ComputePurpose()
    if purpose not in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render):
        return f"purpose {purpose}"
    times = _list_visibility_times(prim)
    if _is_visible(prim, times[0] if times else Usd.TimeCode.EarliestTime()):
        return ""
    later = next((time for time in times if _is_visible(prim, time)), None)
    return "invisible" if later is None else f"invisible until time {later:g}"


def _list_visibility_times(prim: Any) -> list[float]:
    """List the time samples of the visibility of a prim and of those above it, in order."""
    from pxr import UsdGeom

    times: set[float] = set()
    while not prim.IsPseudoRoot():
        shown = UsdGeom.Imageable(prim)
        if shown:
            times.update(shown.GetVisibilityAttr().GetTimeSamples())
        prim = prim.GetParent()
    return sorted(times)


def _is_visible(prim: Any, time: Any) -> bool:
    from pxr import UsdGeom

    return bool(UsdGeom.Imageable(prim).ComputeVisibility(time) != UsdGeom.Tokens.invisible)


def _find_transform_times(prim: Any) -> set[float]:
    """Return the time samples of the transforms that move a prim."""
    from pxr import UsdGeom

    times: set[float] = set()
    while not prim.IsPseudoRoot():
        transform = UsdGeom.Xformable(prim)
        if transform:
            times.update(transform.GetTimeSamples())
            if transform.GetResetXformStack():
                break
        prim = prim.GetParent()
    return times


class SurfaceReader:
    """Reads the layers of the surface of one mesh, at a time."""

    def __init__(self, mesh: Any, vertex_count: int, time: float, *, claimed: ClaimedBytes) -> None:
        from pxr import UsdGeom

        self._mesh, self._vertex_count, self._time = mesh, vertex_count, time
        self._primvars, self._claimed = UsdGeom.PrimvarsAPI(mesh), claimed

    def list_layers(self) -> LayerReaders:
        """Return what reads each layer, for `FileMesh.read_layers`."""
        return {
            **list_layer_readers(PRIMVARS, self._read_layer),
            "its materials and groups": self.read_labels,
            "its subdivision": self.read_subdivision,
        }

    def _read_layer(self, name: str, attributes: SurfaceAttributes) -> SurfaceAttributes:
        """Read a layer of numbers from its primvars; normals may be in an attribute instead."""
        width = LAYERS[name].width
        if LAYERS[name].domain == "vertex":
            columns = self._read_vertex_columns(name)
            return attributes.add_layer(name, np.hstack(columns)) if columns else attributes
        primvar = self._find_primvar(name)
        if primvar:
            values, numbers = self._read_primvar(primvar, width)
            interpolation = primvar.GetInterpolation()
        else:
            found = self._mesh.GetNormalsAttr().Get(self._time) if name == "normal_fans" else None
            if not found:
                return attributes
            values = self._to_array(found, width)
            numbers, interpolation = np.arange(len(values)), self._mesh.GetNormalsInterpolation()
        indices = numbers[_locate(interpolation, attributes, len(numbers))]
        absent = primvar.GetUnauthoredValuesIndex() if primvar else -1
        if absent >= 0:
            indices = np.where(indices == absent, NONE, indices)
            values = values[:absent] if absent == len(values) - 1 else values
        return attributes.add_layer(name, values, indices)

    def _find_primvar(self, name: str) -> Any:
        """Find the primvar of a layer of corners: of UVs, else the first that holds some."""
        from pxr import Sdf

        primvar = self._primvars.GetPrimvar(PRIMVARS[name][0])
        if name != "uvs":
            return primvar if primvar and primvar.HasAuthoredValue() else None
        kinds = (Sdf.ValueTypeNames.TexCoord2fArray, Sdf.ValueTypeNames.Float2Array)
        found = [primvar, *self._primvars.GetPrimvarsWithAuthoredValues()]
        return next((each for each in found if each and each.GetTypeName() in kinds), None)

    def _read_vertex_columns(self, name: str) -> list[Floats]:
        """Read the primvars of a layer of vertices, (n, 3) and perhaps (n, 1)."""
        columns: list[Floats] = []
        for place, width in zip(PRIMVARS[name], (3, 1), strict=True):
            primvar = self._primvars.GetPrimvar(place)
            if not primvar or not primvar.HasAuthoredValue():
                break
            if primvar.GetInterpolation() not in _PER_VERTEX:
                if columns:
                    break
                raise FormatError(f"they are {primvar.GetInterpolation()}, expected vertex")
            values, indices = self._read_primvar(primvar, width)
            _check_places(np.arange(self._vertex_count), len(indices))
            columns.append(values[indices[: self._vertex_count]])
        return columns

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
        labels, colours = FaceLabels.from_members(count, materials), None
        names = () if labels is None else labels.names
        looks = [_read_colour(bound[name]) if name in bound else None for name in names]
        if any(look is not None for look in looks):
            colours = np.array([PLAIN_COLOUR if look is None else look for look in looks])
        return replace(
            attributes,
            materials=labels,
            material_colours=colours,
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

    def _read_primvar(self, primvar: Any, width: int) -> tuple[Floats, Integers]:
        """Return the values, (k, width), and the number of that of each place."""
        values = self._to_array(primvar.Get(self._time), width)
        if not primvar.IsIndexed():
            return values, np.arange(len(values))
        indices = self._to_list(primvar.GetIndices(self._time), "iu")
        _check_places(indices, len(values))
        return values, indices

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
        places = attributes.corner_polygons
    else:
        raise FormatError(f"they are {interpolation}")
    _check_places(places, count)
    return places


def _check_places(places: Integers, count: int) -> None:
    if len(places) and not 0 <= places.min() <= places.max() < count:
        raise FormatError(f"they need value {places.max()} of {count}")


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
