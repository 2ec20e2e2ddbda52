"""A cage animation as a USD skeleton: a joint per cage vertex, cage weights as skin weights."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cageik_cli.formats.base.writer import Animation, AnimationWriter, to_float32
from cageik_cli.formats.usd.errors import USD_SUFFIXES, capture_diagnostics
from cageik_cli.formats.usd.surface_writer import UsdMesh, count_frame_bytes
from cageik_cli.formats.usd.with_model import CageDisplay, define_cage
from cageik_cli.formats.usd.writer import UsdFile
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError

MIN_WEIGHT = 1e-7
"""Smaller weights are dropped: beside a weight of 1, single precision loses them."""

_BLOCK_ROWS = 1 << 14

_JOINT_BYTES = 12 + 16
"""Bytes of a joint in a frame: a translation and a rotation in single precision."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinWeights:
    """The k influences of each of m vertices, the strongest first.

    Attributes
    ----------
    joints : (m, k) int64
        Joints of a row differ.
    values : (m, k) float64
        Not negative, rows sum to one; a row of fewer than k influences ends in zeros.
    """

    joints: Integers
    values: Floats

    def to_dense(self, count: int) -> Floats:
        """Return the weights as a matrix (m, count) over all joints."""
        matrix = np.zeros((len(self.joints), count))
        np.put_along_axis(matrix, self.joints, self.values, axis=1)
        return matrix


def compute_skin_weights(weights: Floats) -> SkinWeights:
    """Compute skin weights from cage weights: negative ones are cut off, the sum scaled to 1.

    Parameters
    ----------
    weights : (m, n)
        Rows sum to one.

    Raises
    ------
    InputError
        When a row has no weight above zero.
    """
    blocks = [slice(row, row + _BLOCK_ROWS) for row in range(0, len(weights), _BLOCK_ROWS)]
    k = max(int((weights[rows] >= MIN_WEIGHT).sum(axis=1).max()) for rows in blocks)
    joints = np.empty((len(weights), k), np.int64)
    values = np.empty((len(weights), k))
    for rows in blocks:
        joints[rows] = np.argsort(-weights[rows], axis=1, kind="stable")[:, :k]
        largest = np.take_along_axis(weights[rows], joints[rows], axis=1)
        values[rows] = np.where(largest >= MIN_WEIGHT, largest, 0.0)
    sums = values.sum(axis=1, keepdims=True)
    if not sums.all():
        raise CageError(
            f"vertex {int(np.argmin(sums))} has no weight above zero; bind the mesh again"
        )
    return SkinWeights(joints, values / sums)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """A mesh with skin weights, and how the whole of it turns.

    Attributes
    ----------
    rest : TriMesh
        m vertices.
    weights : SkinWeights
    rotations : (F, 3, 3) float64
        R of each frame; `points @ R` turns points of the rest pose to it.
    """

    rest: TriMesh
    weights: SkinWeights
    rotations: Floats


class SkeletonWriter(AnimationWriter):
    """Writes the rest mesh X, skinned to joints that translate below a root that also turns.

    The root is in the mean of the cage's vertices. Its children are where the cage's vertices are,
    and turn with it. So a skin of weights S gives

        S c + (X − S C) R,

    with c the cage of the frame, C the rest cage and R the rotation of the frame. If S are all the
    weights of a binding, this is `weights @ cage`, whatever R is.
    """

    suffixes = USD_SUFFIXES
    is_single = True

    def __init__(
        self, target: Path, animation: Animation, skin: Skin, cage: CageDisplay | None = None
    ) -> None:
        """Start writing to `target`, whose suffix is one of `suffixes`.

        Parameters
        ----------
        target : Path
        animation : Animation
            Of the cage: its `rest` is the rest cage.
        skin : Skin
        cage : CageDisplay, optional
            How the cage is shown beside the mesh; it is not in the file if absent.

        Raises
        ------
        InputError
            When usd-core is not installed, or the format cannot hold the animation.
        """
        points = skin.rest.vertices - np.array(animation.origin)
        to_float32(points)  # refused before anything is written
        self._cage, self._rotations = animation.rest.vertices, skin.rotations
        self._last_turn = np.array([0.0, 0.0, 0.0, 1.0])
        self._done = 0
        size = 0 if cage is None else count_frame_bytes(animation.rest)
        self._file = UsdFile(target, animation, size + _JOINT_BYTES * (len(self._cage) + 1))
        with capture_diagnostics(OSError):
            self._define_skeleton()
            mesh = UsdMesh(self._file.stage, f"{self._file.root}/mesh", skin.rest)
            mesh.write_positions(points)
            self._bind_mesh(mesh.prim, skin.weights)
            self._cage_mesh = None if cage is None else define_cage(self._file, animation, cage)

    def append(self, frames: Floats) -> None:
        """Write the cages of the next k frames, (k, n, 3)."""
        from pxr import Vt

        rotations = self._rotations[self._done : self._done + len(frames)]
        centres = frames.mean(axis=1)
        places = (frames - centres[:, None]) @ rotations.swapaxes(1, 2)
        joints = to_float32(np.concatenate([centres[:, None], places], axis=1))
        for cage, translations, rotation in zip(frames, joints, rotations, strict=True):
            time, turns = self._file.begin_frame(), self._list_turns(rotation)
            with capture_diagnostics(OSError):
                self._translations.Set(Vt.Vec3fArray.FromNumpy(translations), time)
                self._turns.Set(Vt.QuatfArray.FromNumpy(turns), time)
                if self._cage_mesh is not None:
                    self._cage_mesh.write_positions(cage, time)
        self._done += len(frames)

    def complete(self) -> None:
        """Save the file."""
        self._file.complete()

    def abandon(self) -> None:
        """Close the file."""
        self._file.abandon()

    def _list_turns(self, rotation: Floats) -> NDArray[np.float32]:
        """Return the quaternions of all joints, (n + 1, 4), the real part last.

        That of the root has the sign that is nearer to the frame before, so that programs which
        interpolate take the short way.
        """
        turn = Rotation.from_matrix(rotation.T).as_quat()
        self._last_turn = -turn if turn @ self._last_turn < 0 else turn
        turns = np.zeros((len(self._cage) + 1, 4), np.float32)
        turns[:, 3] = 1
        turns[0] = self._last_turn
        return turns

    def _define_skeleton(self) -> None:
        """Define the root joint, and below it a joint per cage vertex."""
        from pxr import UsdSkel, Vt

        stage, root, count = self._file.stage, self._file.root, len(self._cage)
        UsdSkel.Root.Define(stage, root)
        skeleton = UsdSkel.Skeleton.Define(stage, f"{root}/skeleton")
        motion = UsdSkel.Animation.Define(stage, f"{root}/skeleton/motion")
        digits = max(3, len(str(count - 1)))
        joints = ["root", *(f"root/cage_{k:0{digits}}" for k in range(count))]
        centre = self._cage.mean(axis=0)
        bind, rest = np.vstack([centre, self._cage]), np.vstack([centre, self._cage - centre])
        skeleton.CreateJointsAttr(joints)
        skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray.FromNumpy(_make_translations(bind)))
        skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray.FromNumpy(_make_translations(rest)))
        binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([motion.GetPath()])
        motion.CreateJointsAttr(joints)
        motion.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(np.ones((count + 1, 3), np.float16)))
        self._turns: Any = motion.CreateRotationsAttr()
        self._translations: Any = motion.CreateTranslationsAttr()

    def _bind_mesh(self, mesh: Any, weights: SkinWeights) -> None:
        """Bind a mesh to the skeleton."""
        from pxr import Gf, UsdSkel, Vt

        influences = weights.joints.shape[1]
        binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateSkeletonRel().SetTargets([f"{self._file.root}/skeleton"])
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
        joints = binding.CreateJointIndicesPrimvar(False, influences)
        joints.Set(Vt.IntArray.FromNumpy((weights.joints + 1).astype(np.int32).ravel()))
        values = binding.CreateJointWeightsPrimvar(False, influences)
        values.Set(Vt.FloatArray.FromNumpy(weights.values.astype(np.float32).ravel()))


def _make_translations(points: Floats) -> Floats:
    """Return matrices (n, 4, 4) that move the origin to each point; they multiply rows."""
    matrices = np.tile(np.eye(4), (len(points), 1, 1))
    matrices[:, 3, :3] = points
    return matrices
