"""A cage animation as a USD skeleton: a joint per cage vertex, cage weights as skin weights."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.writer import Animation, AnimationWriter, to_float32
from cageik_cli.formats.usd.errors import USD_SUFFIXES, capture_diagnostics
from cageik_cli.formats.usd.writer import UsdFile, compute_extent, define_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError

MIN_WEIGHT = 1e-7
"""Smaller weights are dropped: beside a weight of 1, single precision loses them."""

_BLOCK_ROWS = 1 << 14


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


def compute_skin_weights(weights: Floats, max_influences: int | None = None) -> SkinWeights:
    """Compute skin weights from cage weights: negative ones are cut off, the sum scaled to 1.

    Parameters
    ----------
    weights : (m, n)
        Rows sum to one.
    max_influences : int, optional
        Only the `max_influences` largest of each row are kept, 1 or more; all if absent.

    Raises
    ------
    InputError
        When a row has no weight above zero.
    """
    blocks = [slice(row, row + _BLOCK_ROWS) for row in range(0, len(weights), _BLOCK_ROWS)]
    counts = [int((weights[rows] >= MIN_WEIGHT).sum(axis=1).max()) for rows in blocks]
    k = min(max_influences or max(counts), max(counts))
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


def measure_skinning_error(offsets: Floats, weight_differences: Floats, moves: Floats) -> float:
    """Return the largest distance between a skinned mesh and `H c`, over k frames.

    A skin of weights S takes a rest vertex p to p + S (c − c_rest); less H c, that is
    (p − H c_rest) + (S − H) (c − c_rest).

    Parameters
    ----------
    offsets : (m, 3)
        p − H c_rest.
    weight_differences : (m, n)
        S − H.
    moves : (k, n, 3)
        c − c_rest of each frame.
    """
    columns = moves.transpose(1, 0, 2).reshape(weight_differences.shape[1], -1)
    apart = (weight_differences @ columns).reshape(len(offsets), -1, 3) + offsets[:, None]
    return float(np.linalg.norm(apart, axis=2).max())


_COMPARE_BYTES = 1 << 26
"""Bytes of frames that are compared at once."""


class SkeletonWriter(AnimationWriter):
    """Writes the rest mesh, skinned to joints that only translate.

    A skin moves a rest vertex p to p + Σ_k w_k (c_k − rest c_k). That is `H c` if the skin weights
    are those of H and H reproduces the rest pose. Skin weights cannot be negative, see
    `compute_skin_weights`.

    Attributes
    ----------
    influences : int
        The largest number of joints that move one vertex; known from the beginning.
    max_skinning_error : float
        Largest distance of a skinned vertex from `H c` over the rest pose and the frames appended
        so far, file units.
    """

    suffixes = USD_SUFFIXES
    influences: int
    max_skinning_error: float

    def __init__(
        self,
        target: Path,
        animation: Animation,
        rest: TriMesh,
        weights: Floats,
        max_influences: int | None = None,
    ) -> None:
        """Start writing to `target`, whose suffix is one of `suffixes`.

        Parameters
        ----------
        target : Path
        animation : Animation
            Of the cage: its `rest` is the rest cage.
        rest : TriMesh
            The mesh that is bound, m vertices.
        weights : (m, n) float64
            H, rows summing to one; read, never changed.
        max_influences : int, optional
            Largest number of joints that move one vertex; all if absent.

        Raises
        ------
        InputError
            When usd-core is not installed, or the format cannot hold the animation.
        """
        points, skin = to_float32(rest.vertices), compute_skin_weights(weights, max_influences)
        self.influences = skin.joints.shape[1]
        self._cage, self._diagonal = animation.rest.vertices, rest.diagonal
        self._offsets = rest.vertices - weights @ self._cage
        self._weight_differences = skin.to_dense(len(self._cage)) - weights
        self.max_skinning_error = float(np.linalg.norm(self._offsets, axis=1).max())
        self._file = UsdFile(target, animation, 12 * len(self._cage))
        from pxr import Vt

        with capture_diagnostics(OSError):
            self._define_skeleton()
            mesh = define_mesh(self._file.stage, f"{self._file.root}/mesh", rest)
            mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
            mesh.CreateExtentAttr(compute_extent(points))
            self._bind_mesh(mesh, skin)

    def append(self, frames: Floats) -> None:
        """Write the cages of the next k frames, (k, n, 3)."""
        from pxr import Vt

        for cage in map(to_float32, frames):
            time = self._file.begin_frame()
            with capture_diagnostics(OSError):
                self._translations.Set(Vt.Vec3fArray.FromNumpy(cage), time)
        size = max(1, _COMPARE_BYTES // self._offsets.nbytes)
        for start in range(0, len(frames), size):
            moves = frames[start : start + size] - self._cage
            self.max_skinning_error = max(
                self.max_skinning_error,
                measure_skinning_error(self._offsets, self._weight_differences, moves),
            )

    def complete(self) -> None:
        """Save the file, and note the error of the skin weights."""
        self._file.complete()
        self.notes = (
            f"up to {self.influences} influences per vertex; largest error against full weights "
            f"{100 * self.max_skinning_error / self._diagonal:.2g} % of the diagonal",
        )

    def abandon(self) -> None:
        """Close the file."""
        self._file.abandon()

    def _define_skeleton(self) -> None:
        """Define a joint per cage vertex, none the parent of another, that only translates."""
        from pxr import Gf, UsdSkel, Vt

        stage, root, count = self._file.stage, self._file.root, len(self._cage)
        UsdSkel.Root.Define(stage, root)
        skeleton = UsdSkel.Skeleton.Define(stage, f"{root}/skeleton")
        motion = UsdSkel.Animation.Define(stage, f"{root}/skeleton/motion")
        digits = max(3, len(str(count - 1)))
        joints = [f"cage_{k:0{digits}}" for k in range(count)]
        places = Vt.Matrix4dArray.FromNumpy(_make_translations(self._cage))
        skeleton.CreateJointsAttr(joints)
        skeleton.CreateBindTransformsAttr(places)
        skeleton.CreateRestTransformsAttr(places)
        binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([motion.GetPath()])
        motion.CreateJointsAttr(joints)
        motion.CreateRotationsAttr(Vt.QuatfArray(count, Gf.Quatf(1)))
        motion.CreateScalesAttr(Vt.Vec3hArray(count, Gf.Vec3h(1)))
        self._translations: Any = motion.CreateTranslationsAttr()

    def _bind_mesh(self, mesh: Any, skin: SkinWeights) -> None:
        """Bind a mesh to the skeleton."""
        from pxr import Gf, UsdSkel, Vt

        binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateSkeletonRel().SetTargets([f"{self._file.root}/skeleton"])
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
        joints = binding.CreateJointIndicesPrimvar(False, self.influences)
        joints.Set(Vt.IntArray.FromNumpy(skin.joints.astype(np.int32).ravel()))
        values = binding.CreateJointWeightsPrimvar(False, self.influences)
        values.Set(Vt.FloatArray.FromNumpy(skin.values.astype(np.float32).ravel()))


def _make_translations(points: Floats) -> Floats:
    """Return matrices (n, 4, 4) that move the origin to each point; they multiply rows."""
    matrices = np.tile(np.eye(4), (len(points), 1, 1))
    matrices[:, 3, :3] = points
    return matrices
