"""A rig in USD under construction, and what it does by the formulas, in other code than USD."""

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt
from scipy.spatial.transform import Rotation

from tests.shapes import octahedron

MESH = octahedron()
POINTS = MESH.vertices.astype("f4")
TIMES = (1, 2, 3, 4)
NAMES = ("hip", "hip/spine", "hip/spine/head")
RANDOM = np.random.default_rng(7)
REST = np.array([[0, 0, 0], [0, 0, 0.8], [0, 0.1, 0.6]], "f4")
TURNS = Rotation.from_rotvec(RANDOM.normal(0, 0.6, (len(TIMES), 3, 3)).reshape(-1, 3))
QUATERNIONS = TURNS.as_quat().reshape(len(TIMES), 3, 4).astype("f4")
MOVES = (REST + RANDOM.normal(0, 0.2, (len(TIMES), 3, 3))).astype("f4")
SCALES = np.array([[1, 1, 1], [1, 1.5, 1], [0.5, 1, 1]], "f2")
WEIGHTS = RANDOM.dirichlet(np.ones(3), len(POINTS)).astype("f4")
GEOM_BIND = np.eye(4)
GEOM_BIND[:3, :3] = Rotation.from_rotvec([0.2, 0.1, 0.4]).as_matrix()
GEOM_BIND[3, :3] = [0, 0, 0.3]
ROOT = np.eye(4)
ROOT[:3, :3] = Rotation.from_rotvec([0, 0, 0.5]).as_matrix()
ROOT[3, :3] = [1, 2, 3]
SMILE, SMILE_POINTS = np.array([[0.3, 0, 0], [0, 0.2, 0.1]], "f4"), (1, 4)
FROWN = RANDOM.normal(0, 0.2, POINTS.shape).astype("f4")
HALF_FROWN = RANDOM.normal(0, 0.2, POINTS.shape).astype("f4")
SHAPE_WEIGHTS = np.array([[0.0, 1.0], [0.4, 0.25], [1.0, 0.5], [1.3, 0.75]], "f4")


class Rig:
    """A mesh below a root that is moved, and a skeleton beside it that is moved, too."""

    def __init__(self, folder, name="rig.usda", root="/hero"):
        self.path, self.at = folder / name, root
        self.stage = Usd.Stage.CreateNew(str(self.path))
        self.stage.SetTimeCodesPerSecond(24)
        self.root = UsdSkel.Root.Define(self.stage, root)
        UsdGeom.Xformable(self.root).AddTransformOp().Set(Gf.Matrix4d(ROOT))
        self.skeleton = UsdSkel.Skeleton.Define(self.stage, f"{root}/rig")
        UsdGeom.Xformable(self.skeleton).AddTranslateOp().Set(Gf.Vec3d(0, 0.5, 0))
        self.skeleton.CreateJointsAttr(list(NAMES))
        locals_ = np.tile(np.eye(4), (3, 1, 1))
        locals_[:, 3, :3] = REST
        self.skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray.FromNumpy(locals_))
        self.skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray.FromNumpy(bind_matrices()))
        self.mesh = UsdGeom.Mesh.Define(self.stage, f"{root}/mesh")
        self.mesh.AddTranslateOp().Set(Gf.Vec3d(7, 0, 0))  # a skinned mesh is not placed by it
        self.mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(POINTS))
        self.mesh.CreateFaceVertexCountsAttr([3] * len(MESH.faces))
        self.mesh.CreateFaceVertexIndicesAttr(MESH.faces.ravel().tolist())
        self.binding = UsdSkel.BindingAPI.Apply(self.mesh.GetPrim())
        self.binding.CreateSkeletonRel().SetTargets([self.skeleton.GetPath()])

    def skin(self, indices=(0, 1, 2), weights=WEIGHTS, method=None):
        """Bind all points to joints of the skeleton, by weights (m, k)."""
        count = len(indices)
        self.binding.CreateGeomBindTransformAttr(Gf.Matrix4d(GEOM_BIND))
        joints = np.tile(np.array(indices, "i4"), len(weights))
        places = self.binding.CreateJointIndicesPrimvar(False, count)
        places.Set(Vt.IntArray.FromNumpy(joints))
        values = self.binding.CreateJointWeightsPrimvar(False, count)
        values.Set(Vt.FloatArray.FromNumpy(weights.ravel()))
        if method:
            self.binding.CreateSkinningMethodAttr(method)

    def animate(self, scales=SCALES, times=TIMES):
        """Give the skeleton the motion of the module."""
        motion = self.motion()
        motion.CreateJointsAttr(list(NAMES))
        motion.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(scales))
        for k, time in enumerate(times):
            motion.CreateTranslationsAttr().Set(Vt.Vec3fArray.FromNumpy(MOVES[k]), time)
            motion.CreateRotationsAttr().Set(Vt.QuatfArray.FromNumpy(QUATERNIONS[k]), time)
        return motion

    def shape(self, names=("frown", "smile")):
        """Give the mesh two blend shapes, of which one has a shape between."""
        motion = self.motion()
        motion.CreateBlendShapesAttr(list(names))
        for time, weights in zip(TIMES, SHAPE_WEIGHTS, strict=True):
            motion.CreateBlendShapeWeightsAttr().Set(weights[::-1].tolist(), time)
        smile = UsdSkel.BlendShape.Define(self.stage, f"{self.at}/mesh/smile")
        smile.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(SMILE))
        smile.CreatePointIndicesAttr(list(SMILE_POINTS))
        frown = UsdSkel.BlendShape.Define(self.stage, f"{self.at}/mesh/frown")
        frown.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(FROWN))
        between = frown.CreateInbetween("half")
        between.SetWeight(0.5)
        between.SetOffsets(Vt.Vec3fArray.FromNumpy(HALF_FROWN))
        self.binding.CreateBlendShapesAttr(["smile", "frown"])
        targets = [smile.GetPath(), frown.GetPath()]
        self.binding.CreateBlendShapeTargetsRel().SetTargets(targets)

    def motion(self):
        """The animation of the skeleton."""
        motion = UsdSkel.Animation.Define(self.stage, f"{self.at}/rig/motion")
        binding = UsdSkel.BindingAPI.Apply(self.skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([motion.GetPath()])
        return motion

    def save(self):
        self.stage.GetRootLayer().Save()
        return self.path


def bind_matrices():
    """Where the joints are bound: those of the rest pose, one after another, and turned."""
    matrices = np.tile(np.eye(4), (3, 1, 1))
    matrices[:, 3, :3] = REST.cumsum(axis=0)
    matrices[2, :3, :3] = Rotation.from_rotvec([0.3, 0, 0]).as_matrix()
    return matrices


def joint_matrices(k, scales=SCALES):
    """What moves the points of each joint in frame k, (3, 4, 4), for rows."""
    above, moved = np.eye(4), []
    for j in range(3):
        local = np.eye(4)
        turn = Rotation.from_quat(QUATERNIONS[k, j]).as_matrix()
        local[:3, :3] = np.diag(scales[j].astype(float)) @ turn.T
        local[3, :3] = MOVES[k, j]
        above = local @ above
        moved.append(above)
    return np.linalg.inv(bind_matrices()) @ np.array(moved)


def transform(points, matrix):
    return points @ matrix[:3, :3] + matrix[3, :3]


def place(points):
    """From the space of the skeleton into that of the stage."""
    return transform(points + np.array([0, 0.5, 0]), ROOT)


def expect_linear(k, points=POINTS, weights=WEIGHTS, joints=(0, 1, 2)):
    """Points that are blended linearly in frame k."""
    bound = transform(points.astype(float), GEOM_BIND)
    moved = np.array([transform(bound, matrix) for matrix in joint_matrices(k)[list(joints)]])
    return place(np.einsum("mj,jmc->mc", weights.astype(float), moved))


def expect_dual(k):
    """Points that are blended by dual quaternions in frame k, of joints without scales."""
    matrices = joint_matrices(k, np.ones((3, 3)))
    real = Rotation.from_matrix(matrices[:, :3, :3].transpose(0, 2, 1)).as_quat()
    real *= np.where(real @ real[0] < 0, -1, 1)[:, None]
    x, w = real[:, :3], real[:, 3:]
    moves = matrices[:, 3, :3]
    dual = 0.5 * np.hstack(
        [w * moves + np.cross(moves, x), -np.einsum("jc,jc->j", moves, x)[:, None]]
    )
    real, dual = (WEIGHTS.astype(float) @ each for each in (real, dual))
    length = np.linalg.norm(real, axis=1, keepdims=True)
    real, dual = real / length, dual / length
    x, w, a, b = real[:, :3], real[:, 3:], dual[:, :3], dual[:, 3:]
    bound = transform(POINTS.astype(float), GEOM_BIND)
    moved = Rotation.from_quat(real).apply(bound) + 2 * (w * a - b * x + np.cross(x, a))
    return place(moved)


def expect_shaped(k):
    """Points in the space of the mesh, shaped in frame k."""
    points = POINTS.astype(float)
    smile, frown = SHAPE_WEIGHTS[k].astype(float)
    points[list(SMILE_POINTS)] += smile * SMILE
    half = max(0.0, 1 - abs(frown - 0.5) / 0.5)
    return points + half * HALF_FROWN + max(0.0, 2 * frown - 1) * FROWN
