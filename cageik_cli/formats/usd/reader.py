"""A clip in USD: a mesh whose points, or whose transforms, have time samples."""

import hashlib
from functools import cached_property, partial
from math import ceil, floor
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.files import check_unpacked_size, hash_file
from cageik_cli.formats.base.readers import ClipFile, single_path
from cageik_cli.formats.base.scene_graph import (
    Polygons,
    Sampling,
    choose_mesh,
    describe_transform,
    is_mirroring,
    read_constant_polygons,
    round_frame_step,
    transform_points,
)
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.settings import SceneHints
from cageik_cli.formats.usd.library import (
    USD_SUFFIXES,
    capture_diagnostics,
    check_layers,
    require_usd,
)
from cageik_cli.formats.usd.surface_reader import read_surface
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, error_context

MAX_TIME_CODES = 100_000
"""Largest number of whole time codes, a frame each, that replace uneven samples."""


class Reader(ClipFile):
    """Frames of one mesh in the space of its stage, evaluated on demand."""

    suffixes = USD_SUFFIXES
    has_members = True

    def __init__(self, request: ClipRequest) -> None:
        path = single_path(request.paths)
        with error_context(path):
            require_usd(f"reading {path.suffix.lower()}")
            with capture_diagnostics(_make_unsound_error) as warnings:
                notes = self._open_mesh(path, request)
            notes += [f"USD warns: {warning}" for warning in warnings]
        self.notes = tuple(f"{path.name}: {note}" for note in notes)

    def read_positions(self, index: int) -> Floats:
        """Read the vertices of one frame."""
        with error_context(self.location(index)), capture_diagnostics(_make_unsound_error):
            return self._read_points(self._times[index])

    def describe_source(self) -> dict[str, Any]:
        """Return the file's name, how many files it is composed of, and a digest over all."""
        count = len(self._composed_files)
        return super().describe_source() | ({"files": count} if count > 1 else {})

    def _open_mesh(self, path: Path, request: ClipRequest) -> list[str]:
        """Find the mesh and its frames; return notes on what was changed."""
        from pxr import Usd, UsdGeom

        _ = check_layers(path)  # held, so that they are not read twice
        self._stage = Usd.Stage.Open(str(path))
        stage_range = Usd.PrimRange.Stage(self._stage, Usd.TraverseInstanceProxies())
        meshes = {str(prim.GetPath()): prim for prim in stage_range if prim.IsA(UsdGeom.Mesh)}
        prim = meshes[choose_mesh(list(meshes), request.member)]
        _check_not_skinned(prim)
        self._mesh = UsdGeom.Mesh(prim)
        moving = _find_transform_times(prim)
        sampling, notes = _choose_sampling({*self._mesh.GetPointsAttr().GetTimeSamples(), *moving})
        self.set_frames(request, len(sampling.times), _make_scene_hints(self._stage, sampling))
        self._times = sampling.times[list(self.frame_indices)].tolist()
        matrix = self._world_matrix(self._times[0])
        is_left = self._mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
        points = request.complete_first(self._read_points(self._times[0]))
        mesh = self._read_polygons().make_mesh(
            points,
            is_clockwise=is_left != is_mirroring(matrix),
            read_surface=lambda found: read_surface(self._mesh, found, len(points), self._times[0]),
        )
        self.first = mesh.make_mesh()
        notes += ["left-handed faces turned"] if is_left else []
        return [*notes, *describe_transform(matrix, bool(moving)), *mesh.notes]

    def _read_points(self, time: float) -> Floats:
        points = _read_array(self._mesh.GetPointsAttr(), time, "f", (3,))
        if len(points) == 0:
            raise FormatError(f"the mesh has no points at time {time:g}; export it again")
        return transform_points(points, self._world_matrix(time))

    def _world_matrix(self, time: float) -> Floats:
        return np.array(self._mesh.ComputeLocalToWorldTransform(time), np.float64)

    def _read_polygons(self) -> Polygons:
        """Read the faces, which must never change."""
        attributes = (
            self._mesh.GetFaceVertexCountsAttr(),
            self._mesh.GetFaceVertexIndicesAttr(),
        )
        sampled = {time for attribute in attributes for time in attribute.GetTimeSamples()}
        size = sum(file.stat().st_size for file in self._composed_files)
        return read_constant_polygons(
            partial(_read_polygons_at, attributes, size), sorted(sampled or {self._times[0]})
        )

    @cached_property
    def _composed_files(self) -> list[Path]:
        """All files that the stage is composed of, its own first."""
        from pxr import Ar

        layers = [layer.realPath for layer in self._stage.GetUsedLayers() if layer.realPath]
        files = {Ar.SplitPackageRelativePathOuter(layer)[0] for layer in layers}
        return [self.path, *(Path(file) for file in sorted(files - {str(self.path.resolve())}))]

    @cached_property
    def _digest(self) -> bytes:
        digests = [hash_file(file) for file in self._composed_files]
        return digests[0] if len(digests) == 1 else hashlib.sha256(b"".join(digests)).digest()


def _read_polygons_at(attributes: tuple[Any, Any], file_size: int, time: float) -> Polygons:
    """Read the polygons, whose numbers a file of `file_size` bytes may hold compressed."""
    found = []
    for attribute in attributes:
        found.append(_read_array(attribute, time, "i", ()))
        with error_context(f"`{attribute.GetName()}`"):
            check_unpacked_size(found[-1].nbytes, file_size)
    return Polygons(*found)


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


def _make_unsound_error(cause: str) -> FormatError:
    return FormatError(f"is not a sound USD file ({cause}); export it again")


def _check_not_skinned(prim: Any) -> None:
    from pxr import UsdSkel

    binding = UsdSkel.BindingAPI(prim)
    is_bound = binding.GetInheritedSkeleton() or binding.GetBlendShapesAttr().HasAuthoredValue()
    if is_bound and UsdSkel.Root.Find(prim):
        raise FormatError(
            f"the mesh {prim.GetPath()} is moved by a skeleton or blend shapes, which cageik "
            "does not evaluate; bake it to points first"
        )


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


def _choose_sampling(samples: set[float]) -> tuple[Sampling, list[str]]:
    """Return the times of the frames: the samples, or whole time codes if these are uneven."""
    sampling = Sampling.from_times(samples)
    if not sampling.is_uneven:
        return sampling, []
    first, last = (float(sampling.times[k]) for k in (0, -1))
    count = floor(last) - ceil(first) + 1
    if not 1 <= count <= MAX_TIME_CODES:
        raise FormatError(
            f"its {len(samples)} time samples from {first:g} to {last:g} are not evenly spaced and "
            f"span {max(count, 0)} whole time codes, expected 1 to {MAX_TIME_CODES}; bake it to "
            "one sample per frame"
        )
    whole = {float(ceil(first) + k) for k in range(count)}
    return Sampling.from_times(whole), [
        f"its {len(samples)} time samples are not evenly spaced; frames are at the whole "
        f"time codes {ceil(first)} to {floor(last)}"
    ]


def _make_scene_hints(stage: Any, sampling: Sampling) -> SceneHints:
    from pxr import UsdGeom

    codes = stage.GetTimeCodesPerSecond()
    is_timed = any(map(stage.HasAuthoredMetadata, ("timeCodesPerSecond", "framesPerSecond")))
    return SceneHints(
        fps=codes if is_timed and codes > 0 else None,
        start=float(sampling.times[0]),
        frame_step=round_frame_step(sampling.step),
        up_axis=str(UsdGeom.GetStageUpAxis(stage)) if stage.HasAuthoredMetadata("upAxis") else None,
        metres_per_unit=UsdGeom.GetStageMetersPerUnit(stage)
        if UsdGeom.StageHasAuthoredMetersPerUnit(stage)
        else None,
    )
