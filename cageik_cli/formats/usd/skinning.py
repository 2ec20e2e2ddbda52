"""Skins and blend shapes of USD: usd-core poses the points of a mesh, one time after another."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import ClaimedBytes
from cageik_cli.formats.base.mesh_data import Change
from cageik_cli.formats.base.scene_graph import transform_points
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import ConnectivityError, FormatError, error_context
from cageik_cli.util.text import format_count, group_digits

MAX_JOINTS = 100_000
"""Joints of a skeleton; USD takes seconds per frame for ten times as many."""

MAX_JOINT_DEPTH = 500
"""Joints above each other; the time that USD takes grows with the cube of their number."""


class Rigs:
    """Finds what poses the meshes of a stage; each skeleton root is looked through once."""

    def __init__(self) -> None:
        self._caches: list[Any] = []  # held, for queries refer to them
        self._poses: dict[str, dict[str, tuple[Any, Any, Any]]] = {}

    def find_pose(self, mesh: Any, claimed: ClaimedBytes) -> "MeshPose | None":
        """Return what poses a mesh, if it is below a root and bound to a skeleton.

        Raises
        ------
        FormatError
            When the skeleton, the weights or the blend shapes do not fit together.
        """
        from pxr import UsdSkel

        root = UsdSkel.Root.Find(mesh.GetPrim())
        if not root:
            return None
        path = str(root.GetPath())
        if path not in self._poses:
            self._poses[path] = self._list_bound(root)
        bound = self._poses[path].get(str(mesh.GetPath()))
        return None if bound is None else MeshPose(mesh, *bound, claimed=claimed)

    def _list_bound(self, root: Any) -> dict[str, tuple[Any, Any, Any]]:
        """Return the skeleton, its query and the query of the skin of each bound mesh."""
        from pxr import Usd, UsdSkel

        instances = Usd.TraverseInstanceProxies()
        for prim in Usd.PrimRange(root.GetPrim(), instances):
            if prim.IsA(UsdSkel.Skeleton):
                with error_context(str(prim.GetPath())):
                    names = UsdSkel.Skeleton(prim).GetJointsAttr().Get() or ()
                    if len(names) > MAX_JOINTS:
                        raise FormatError(f"has {len(names)} joints, expected at most {MAX_JOINTS}")
                    depth = max((str(name).count("/") + 1 for name in names), default=0)
                    if depth > MAX_JOINT_DEPTH:
                        raise FormatError(
                            f"is a chain of {depth} joints, expected at most {MAX_JOINT_DEPTH}"
                        )
        cache = UsdSkel.Cache()
        cache.Populate(root, instances)
        self._caches.append(cache)
        bound = {}
        for binding in cache.ComputeSkelBindings(root, instances):
            skeleton = binding.GetSkeleton()
            query = cache.GetSkelQuery(skeleton)
            for skin in binding.GetSkinningTargets():
                bound[str(skin.GetPrim().GetPath())] = skeleton, query, skin
        return bound


class MeshPose:
    """What moves the points of a mesh: blend shapes first, then joints."""

    def __init__(
        self, mesh: Any, skeleton: Any, query: Any, skin: Any, *, claimed: ClaimedBytes
    ) -> None:
        from pxr import Usd

        self._mesh, self._skeleton, self._query, self._skin = mesh, skeleton, query, skin
        if not query:
            raise FormatError(
                f"the joints of {skeleton.GetPath()} make no skeleton (each must be named after "
                "its parent); export the rig again, or bake the mesh to points"
            )
        self._motion = query.GetAnimQuery()
        self.has_joints = skin.HasJointInfluences()
        points = mesh.GetPointsAttr()
        times = points.GetTimeSamples()
        self._count = len(points.Get(times[0] if times else Usd.TimeCode.Default()) or ())
        self._is_unchecked = True
        self._check_binding()
        if self.has_joints:
            with error_context(str(skeleton.GetPath())):
                self._check_skeleton()
        self._shapes = None
        if skin.HasBlendShapes():
            self._shapes = BlendShapes(skin, self._motion, self._count, claimed=claimed)

    @property
    def placed_by(self) -> Any:
        """The prim whose transform places the posed points: the skeleton, or the mesh."""
        return self._skeleton.GetPrim() if self.has_joints else self._mesh.GetPrim()

    def list_times(self) -> set[float]:
        """List the time samples of joints, of weights of blend shapes, and of the skin."""
        from pxr import UsdSkel

        times: set[float] = set()
        if self.has_joints:
            # The query fails to list them for a mesh without a bind transform.
            values = self._skin.GetJointIndicesPrimvar(), self._skin.GetJointWeightsPrimvar()
            attributes = [*values, UsdSkel.BindingAPI(self._mesh).GetGeomBindTransformAttr()]
            times.update(*(each.GetTimeSamples() for each in attributes if each))
        if self.has_joints and self._motion:
            times.update(self._motion.GetJointTransformTimeSamples())
        if self._shapes is not None and self._motion:
            times.update(self._motion.GetBlendShapeWeightTimeSamples())
        return times

    def describe(self) -> list[str | Change]:
        """Return notes on what poses the mesh."""
        notes: list[str | Change] = []
        if self.has_joints:
            path = str(self._skeleton.GetPath())
            notes.append(Change("posed by the {}", "skeleton", names=(path,)))
        return notes + (["shaped by its blend shapes"] if self._shapes is not None else [])

    def compute_matrix(self, time: float) -> Floats:
        """Return what moves the mesh into the stage while joints are as they were bound, (4, 4)."""
        placed = self._compute_placement(time)
        if not self.has_joints:
            return placed
        return np.array(self._skin.GetGeomBindTransform(), np.float64) @ placed

    def move(self, points: NDArray[np.floating], time: float) -> Floats:
        """Return the posed points (m, 3) in the space of the stage."""
        from pxr import Vt

        if len(points) != self._count:
            raise ConnectivityError(
                f"{group_digits(len(points))} vertices at time {time:g}, but its rig is for "
                f"{group_digits(self._count)}; all "
                "must share one connectivity"
            )
        posed = Vt.Vec3fArray.FromNumpy(np.array(points, np.float32))  # of our own: changed
        if self._shapes is not None:
            self._shapes.add_offsets(posed, time)
        if self.has_joints:
            self._skin_points(posed, time)
        return transform_points(np.asarray(posed), self._compute_placement(time))

    def _compute_placement(self, time: float) -> Floats:
        """Return the transform of what places the posed points, (4, 4)."""
        from pxr import UsdGeom

        placed = UsdGeom.Xformable(self.placed_by).ComputeLocalToWorldTransform(time)
        return np.array(placed, np.float64)

    def _skin_points(self, points: Any, time: float) -> None:
        """Move points, in place, from the space of the mesh into that of the skeleton."""
        if self._is_unchecked:
            self._check_influences(time)
            primvars = (self._skin.GetJointIndicesPrimvar(), self._skin.GetJointWeightsPrimvar())
            self._is_unchecked = any(primvar.ValueMightBeTimeVarying() for primvar in primvars)
        if self._motion and self._motion.GetJointOrder():
            self._check_motion(time)
        joints = self._query.ComputeSkinningTransforms(time)
        if not self._skin.ComputeSkinnedPoints(joints, points, time):
            raise FormatError(f"USD cannot skin it at time {time:g}; bake the mesh to points")

    def _check_binding(self) -> None:
        """Refuse joints of a mesh that USD leaves out, for it would not be posed."""
        from pxr import UsdSkel

        binding = UsdSkel.BindingAPI(self._mesh.GetPrim())
        values = [binding.GetJointIndicesAttr(), binding.GetJointWeightsAttr()]
        if not self.has_joints and any(attribute.HasAuthoredValue() for attribute in values):
            raise FormatError(
                "its joint indices and joint weights do not belong together (both, of one element "
                "size, constant or per vertex); bind it again"
            )
        unknown = set(self._skin.GetJointOrder() or ()) - set(self._query.GetJointOrder() or ())
        if self.has_joints and unknown:
            raise FormatError(
                f"{self._skeleton.GetPath()} has no joint {min(unknown)}; bind it again"
            )

    def _check_skeleton(self) -> None:
        """Refuse a skeleton that places no joints."""
        count = len(self._skeleton.GetJointsAttr().Get() or ())
        for attribute, holds in (
            (self._skeleton.GetBindTransformsAttr(), "bind transforms"),
            (self._skeleton.GetRestTransformsAttr(), "rest transforms"),
        ):
            found = len(attribute.Get() or ())
            is_needed = attribute.GetName() == "bindTransforms" or not self._motion
            if found != count and (found or is_needed):
                raise FormatError(
                    f"{found} {holds} for {format_count(count, 'joint')}; export the rig "
                    "again, or bake the mesh to points"
                )

    def _check_motion(self, time: float) -> None:
        """Refuse an animation that does not place all its joints: USD would take the rest pose."""
        from pxr import UsdSkel

        motion = UsdSkel.Animation(self._motion.GetPrim())
        count = len(self._motion.GetJointOrder())
        for attribute in (
            motion.GetTranslationsAttr(),
            motion.GetRotationsAttr(),
            motion.GetScalesAttr(),
        ):
            found = len(attribute.Get(time) or ())
            if found != count:
                raise FormatError(
                    f"{motion.GetPath()} has {found} {attribute.GetName()} at time {time:g} for "
                    f"{format_count(count, 'joint')}; export it again"
                )

    def _check_influences(self, time: float) -> None:
        """Refuse weights that USD cannot skin with: it reads beyond arrays that are too short."""
        indices = np.asarray(self._skin.GetJointIndicesPrimvar().ComputeFlattened(time) or ())
        weights = np.asarray(self._skin.GetJointWeightsPrimvar().ComputeFlattened(time) or ())
        order = self._skin.GetJointOrder()
        count = len(order if order else self._query.GetJointOrder())
        width = self._skin.GetNumInfluencesPerComponent()
        expected = width * (1 if self._skin.IsRigidlyDeformed() else self._count)
        if len(indices) != expected or len(weights) != expected:
            raise FormatError(
                f"{len(indices)} joint indices and {len(weights)} joint weights at time {time:g}, "
                f"expected {expected}; bind the mesh again"
            )
        if not np.isfinite(weights).all():
            raise FormatError(f"a joint weight is not finite at time {time:g}; bind it again")
        if len(indices) and not 0 <= indices.min() <= indices.max() < count:
            number = indices.max() if indices.min() >= 0 else indices.min()
            raise FormatError(
                f"a joint index is {number} at time {time:g}, but there are "
                f"{format_count(count, 'joint')}; bind the mesh again"
            )


class BlendShapes:
    """Blend shapes of a mesh, whose offsets are read once."""

    def __init__(self, skin: Any, motion: Any, point_count: int, *, claimed: ClaimedBytes) -> None:
        from pxr import UsdSkel

        self._motion, self._path = motion, skin.GetPrim().GetPath()
        self._names = list(motion.GetBlendShapeOrder() or ()) if motion else []
        self._order = list(skin.GetBlendShapeOrder() or ())
        self._check_shapes(skin, point_count, claimed)
        self._query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(skin.GetPrim()))
        self._places = self._query.ComputeBlendShapePointIndices()
        self._offsets = self._query.ComputeSubShapePointOffsets()

    def add_offsets(self, points: Any, time: float) -> None:
        """Add the offsets at a time to points, in place."""
        from pxr import Vt

        if not self._names:
            return
        held = self._motion.ComputeBlendShapeWeights(time)
        weights = np.asarray(held if held is not None else (), np.float32)
        if len(weights) != len(self._names) or not np.isfinite(weights).all():
            raise FormatError(
                f"{self._motion.GetPrim().GetPath()}: {len(weights)} weights of blend shapes at "
                f"time {time:g}, expected {len(self._names)} finite numbers; export them again"
            )
        named = dict(zip(self._names, weights.tolist(), strict=True))
        ordered = Vt.FloatArray([named.get(name, 0.0) for name in self._order])
        shares = self._query.ComputeSubShapeWeights(ordered)
        if not self._query.ComputeDeformedPoints(*shares, self._places, self._offsets, points):
            raise FormatError(f"USD cannot shape it at time {time:g}; bake the mesh to points")

    def _check_shapes(self, skin: Any, point_count: int, claimed: ClaimedBytes) -> None:
        """Refuse shapes that are missing, or whose offsets are not of points of the mesh."""
        from pxr import UsdSkel

        targets = skin.GetBlendShapeTargetsRel().GetTargets()
        if len(targets) != len(self._order):
            raise FormatError(
                f"{format_count(len(self._order), 'name')} of blend shapes and "
                f"{len(targets)} targets; export them again"
            )
        stage = skin.GetPrim().GetStage()
        for path in targets:
            shape = UsdSkel.BlendShape(stage.GetPrimAtPath(path))
            if not shape:
                raise FormatError(f"there is no blend shape {path}; export it again")
            with error_context(str(path)):
                _check_offsets(shape, point_count, claimed)


def describe_unposed(prim: Any) -> list[str]:
    """Return a note on a mesh that has a skin or blend shapes, but is below no skeleton root."""
    from pxr import UsdSkel

    binding = UsdSkel.BindingAPI(prim)
    skin = (binding.GetJointIndicesAttr(), binding.GetBlendShapesAttr())
    if UsdSkel.Root.Find(prim) or not any(each.HasAuthoredValue() for each in skin):
        return []
    return ["bound to a rig, but below no SkelRoot: it is not posed, as USD has it"]


def _check_offsets(shape: Any, point_count: int, claimed: ClaimedBytes) -> None:
    """Refuse offsets of a blend shape that are not one per point that it names."""
    held = shape.GetPointIndicesAttr().Get() or ()
    claimed.claim(8 * len(held))
    places = np.asarray(held, np.int64)
    if len(places) and not 0 <= places.min() <= places.max() < point_count:
        raise FormatError(
            f"it moves point {places.max() if places.min() >= 0 else places.min()}, but there are "
            f"{point_count}; export it again"
        )
    expected = len(places) or point_count
    for each in (shape, *shape.GetInbetweens()):
        attribute = each.GetOffsetsAttr() if each is shape else each.GetAttr()
        count = len(attribute.Get() or ())
        claimed.claim(12 * count)
        if count not in (0, expected):  # a shape that moves nothing
            raise FormatError(
                f"`{attribute.GetName()}` has {format_count(count, 'offset')} for {expected} "
                "points; export it again"
            )
