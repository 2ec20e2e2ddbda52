"""A clip in USD: a mesh whose points, or whose transforms, have time samples."""

import hashlib
from functools import cached_property, partial
from math import ceil, floor
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.clip_file import ClipFile, digest_of, only
from cageik_cli.formats.base.polygons import unfolded
from cageik_cli.formats.base.scene_graph import (
    Polygons,
    Sampling,
    mirrors,
    moved,
    picked,
    rate,
    transform_notes,
    unchanging,
)
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.scene import SceneHints
from cageik_cli.formats.usd.errors import SUFFIXES, need_usd, quiet
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, located

LARGEST_SPAN = 100_000
"""Most whole time codes that are taken, a frame each, between samples that are not even."""


class Reader(ClipFile):
    """Frames of one mesh in the space of its stage, evaluated when they are asked for."""

    suffixes = SUFFIXES
    has_members = True

    def __init__(self, request: ClipRequest) -> None:
        path = only(request.paths)
        with located(path):
            need_usd(f"reading {path.suffix.lower()}")
            with quiet(_unsound) as warnings:
                notes = self._open(path, request)
            said = [f"USD warns: {warning}" for warning in warnings]
        self.notes = tuple(f"{path.name}: {note}" for note in [*notes, *said])

    def positions(self, index: int) -> Floats:
        """Vertices of one frame."""
        with located(self.place(index)), quiet(_unsound):
            return self._placed(self._times[index])

    def source(self) -> dict[str, Any]:
        """Name of the file, how many files it is composed of, and a digest over all of them."""
        count = len(self._files)
        return super().source() | ({"files": count} if count > 1 else {})

    def _open(self, path: Path, request: ClipRequest) -> list[str]:
        """Find the mesh and its frames; what was changed is returned."""
        from pxr import Usd, UsdGeom

        self._stage = Usd.Stage.Open(str(path))
        stage_range = Usd.PrimRange.Stage(self._stage, Usd.TraverseInstanceProxies())
        meshes = {str(prim.GetPath()): prim for prim in stage_range if prim.IsA(UsdGeom.Mesh)}
        prim = meshes[picked(list(meshes), request.member)]
        _refuse_skinned(prim)
        self._mesh = UsdGeom.Mesh(prim)
        moving = _transform_times(prim)
        sampling, notes = _frames({*self._mesh.GetPointsAttr().GetTimeSamples(), *moving})
        self.take(request, len(sampling.times), _hints(self._stage, sampling))
        self._times = sampling.times[list(self.numbers)].tolist()
        matrix = self._matrix(self._times[0])
        is_left = self._mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
        mesh = self._polygons().mesh(
            self._placed(self._times[0]), turned=is_left != mirrors(matrix)
        )
        self._fanned = mesh.fanned
        self.first = unfolded(self._fanned, mesh.sizes)
        notes += ["left-handed faces turned"] if is_left else []
        return [*notes, *transform_notes(matrix, bool(moving)), *mesh.notes]

    def _placed(self, time: float) -> Floats:
        points = _values(self._mesh.GetPointsAttr(), time, "f", (3,))
        if len(points) == 0:
            raise InputError(f"the mesh has no points at time {time:g}; export it again")
        return moved(points, self._matrix(time))

    def _matrix(self, time: float) -> Floats:
        return np.array(self._mesh.ComputeLocalToWorldTransform(time), np.float64)

    def _polygons(self) -> Polygons:
        """The faces, which must be the same at all times."""
        attributes = (
            self._mesh.GetFaceVertexCountsAttr(),
            self._mesh.GetFaceVertexIndicesAttr(),
        )
        sampled = {time for attribute in attributes for time in attribute.GetTimeSamples()}
        return unchanging(partial(_polygons_at, attributes), sorted(sampled or {self._times[0]}))

    @cached_property
    def _files(self) -> list[Path]:
        """All files that the stage is composed of, its own first."""
        from pxr import Ar

        layers = [layer.realPath for layer in self._stage.GetUsedLayers() if layer.realPath]
        files = {Ar.SplitPackageRelativePathOuter(layer)[0] for layer in layers}
        return [self.path, *(Path(file) for file in sorted(files - {str(self.path.resolve())}))]

    @cached_property
    def _digest(self) -> bytes:
        digests = [digest_of(file) for file in self._files]
        return digests[0] if len(digests) == 1 else hashlib.sha256(b"".join(digests)).digest()


def _polygons_at(attributes: tuple[Any, Any], time: float) -> Polygons:
    counts, corners = (_values(attribute, time, "i", ()) for attribute in attributes)
    return Polygons(counts, corners)


def _values(attribute: Any, time: float, kind: str, shape: tuple[int, ...]) -> np.ndarray:
    """An array attribute at a time, empty without a value; a layer may give it any type."""
    value = attribute.Get(time)
    array = np.zeros((0, *shape), kind) if value is None else np.asarray(value)
    if array.dtype.kind != kind or array.ndim != 1 + len(shape) or array.shape[1:] != shape:
        raise InputError(
            f"`{attribute.GetName()}` is not of type {attribute.GetTypeName()} at time {time:g}; "
            "export it again"
        )
    return array


def _unsound(cause: str) -> InputError:
    return InputError(f"is not a sound USD file ({cause}); export it again")


def _refuse_skinned(prim: Any) -> None:
    from pxr import UsdSkel

    binding = UsdSkel.BindingAPI(prim)
    is_bound = binding.GetInheritedSkeleton() or binding.GetBlendShapesAttr().HasAuthoredValue()
    if is_bound and UsdSkel.Root.Find(prim):
        raise InputError(
            f"the mesh {prim.GetPath()} is moved by a skeleton or blend shapes, which are not "
            "evaluated here; bake it to points first"
        )


def _transform_times(prim: Any) -> set[float]:
    """Time samples of the transforms that move a prim."""
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


def _frames(samples: set[float]) -> tuple[Sampling, list[str]]:
    """When the frames are: at the samples, or at whole time codes where these are not even."""
    sampling = Sampling.of(samples)
    if not sampling.is_uneven:
        return sampling, []
    first, last = (float(sampling.times[k]) for k in (0, -1))
    count = floor(last) - ceil(first) + 1
    if not 1 <= count <= LARGEST_SPAN:
        raise InputError(
            f"its {len(samples)} time samples from {first:g} to {last:g} are not evenly spaced and "
            f"span {max(count, 0)} whole time codes, expected 1 to {LARGEST_SPAN}; bake it to one "
            "sample a frame"
        )
    whole = {float(ceil(first) + k) for k in range(count)}
    return Sampling.of(whole), [
        f"its {len(samples)} time samples are not evenly spaced; taken at the whole time codes "
        f"{ceil(first)} to {floor(last)}"
    ]


def _hints(stage: Any, sampling: Sampling) -> SceneHints:
    from pxr import UsdGeom

    codes = stage.GetTimeCodesPerSecond()
    is_timed = any(map(stage.HasAuthoredMetadata, ("timeCodesPerSecond", "framesPerSecond")))
    return SceneHints(
        fps=rate((sampling.step or 1) / codes) if is_timed and codes > 0 else None,
        start=float(sampling.times[0]),
        up_axis=str(UsdGeom.GetStageUpAxis(stage)) if stage.HasAuthoredMetadata("upAxis") else None,
        metres_per_unit=UsdGeom.GetStageMetersPerUnit(stage)
        if UsdGeom.StageHasAuthoredMetersPerUnit(stage)
        else None,
    )
