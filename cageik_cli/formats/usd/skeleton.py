"""A cage animation as a USD skeleton: a joint per cage vertex, cage weights as skin weights."""

from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.skin import JointMotion, Skin, SkinWeights
from cageik_cli.formats.base.writer import Animation, AnimationWriter, to_float32
from cageik_cli.formats.usd.errors import USD_SUFFIXES, capture_diagnostics
from cageik_cli.formats.usd.writer import UsdFile, compute_extent, define_mesh
from cageik_cli.util.arrays import Floats

_JOINT_BYTES = 12 + 16
"""Bytes of a joint in a frame: a translation and a rotation in single precision."""


class SkeletonWriter(AnimationWriter):
    """Writes the rest mesh, skinned to joints that translate below a root that also turns.

    `JointMotion` says where they are.
    """

    suffixes = USD_SUFFIXES
    is_single = True

    def __init__(self, target: Path, animation: Animation, skin: Skin) -> None:
        """Start writing to `target`, whose suffix is one of `suffixes`.

        Parameters
        ----------
        target : Path
        animation : Animation
            Of the cage: its `rest` is the rest cage.
        skin : Skin

        Raises
        ------
        InputError
            When usd-core is not installed, or the format cannot hold the animation.
        """
        points = to_float32(skin.rest.vertices - np.array(animation.origin))
        self._motion = JointMotion(animation.rest, skin.rotations)
        self._file = UsdFile(target, animation, _JOINT_BYTES * len(self._motion.names))
        from pxr import Vt

        with capture_diagnostics(OSError):
            self._define_skeleton()
            mesh = define_mesh(self._file.stage, f"{self._file.root}/mesh", skin.rest)
            mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
            mesh.CreateExtentAttr(compute_extent(points))
            self._bind_mesh(mesh, skin.weights)

    def append(self, frames: Floats) -> None:
        """Write the cages of the next k frames, (k, n, 3)."""
        from pxr import Vt

        turns = np.zeros((len(self._motion.names), 4), np.float32)
        turns[:, 3] = 1
        for places, turn in self._motion.advance(frames):
            time, translations = self._file.begin_frame(), to_float32(places)
            turns[0] = turn
            with capture_diagnostics(OSError):
                self._translations.Set(Vt.Vec3fArray.FromNumpy(translations), time)
                self._turns.Set(Vt.QuatfArray.FromNumpy(turns), time)

    def complete(self) -> None:
        """Save the file."""
        self._file.complete()

    def abandon(self) -> None:
        """Close the file."""
        self._file.abandon()

    def _define_skeleton(self) -> None:
        """Define the root joint, and below it a joint per cage vertex."""
        from pxr import UsdSkel, Vt

        stage, root, motion = self._file.stage, self._file.root, self._motion
        UsdSkel.Root.Define(stage, root)
        skeleton = UsdSkel.Skeleton.Define(stage, f"{root}/skeleton")
        animation = UsdSkel.Animation.Define(stage, f"{root}/skeleton/motion")
        joints = [name if k == 0 else f"root/{name}" for k, name in enumerate(motion.names)]
        bind, rest = motion.bind_places, motion.rest_translations
        skeleton.CreateJointsAttr(joints)
        skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray.FromNumpy(_make_translations(bind)))
        skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray.FromNumpy(_make_translations(rest)))
        binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
        animation.CreateJointsAttr(joints)
        animation.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(np.ones((len(joints), 3), np.float16)))
        self._turns: Any = animation.CreateRotationsAttr()
        self._translations: Any = animation.CreateTranslationsAttr()

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
