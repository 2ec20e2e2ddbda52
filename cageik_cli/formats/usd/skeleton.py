"""A cage animation as a USD skeleton: a joint per cage vertex, cage weights as skin weights."""

from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.skin import JointMotion, Skin, SkinWeights
from cageik_cli.formats.base.writer import Animation, AnimationWriter, to_float32
from cageik_cli.formats.usd.errors import USD_SUFFIXES, capture_diagnostics
from cageik_cli.formats.usd.surface_writer import UsdMesh, count_frame_bytes
from cageik_cli.formats.usd.with_model import CageDisplay, define_cage
from cageik_cli.formats.usd.writer import UsdFile
from cageik_cli.util.arrays import Floats

_JOINT_BYTES = 12 + 16
"""Bytes of a joint in a frame: a translation and a rotation in single precision."""


class SkeletonWriter(AnimationWriter):
    """Writes the rest mesh, skinned to joints that translate below a root that also turns.

    `JointMotion` says where they are.
    """

    suffixes = USD_SUFFIXES
    is_single = True

    def __init__(
        self, target: Path, animation: Animation, skin: Skin, cage: CageDisplay | None = None
    ) -> None:
        """Start writing to `target`, whose suffix is one of `suffixes`.

        Parameters
        ----------
        animation : Animation
            Of the cage: its `rest` is the rest cage.
        cage : CageDisplay, optional
            How the cage is shown beside the mesh; it is not in the file if absent.

        Raises
        ------
        InputError
            When usd-core is not installed, or the format cannot hold the animation.
        """
        points = skin.rest.vertices - np.array(animation.origin)
        to_float32(points)  # refused before anything is written
        self._motion = JointMotion(animation.rest, skin.rotations)
        size = 0 if cage is None else count_frame_bytes(animation.rest)
        self._file = UsdFile(target, animation, size + _JOINT_BYTES * len(self._motion.names))
        with capture_diagnostics(OSError):
            self._define_skeleton()
            mesh = UsdMesh(self._file.stage, f"{self._file.root}/mesh", skin.rest)
            mesh.write_positions(points)
            self._bind_mesh(mesh.prim, skin.weights)
            self._cage_mesh = None if cage is None else define_cage(self._file, animation, cage)

    def append(self, frames: Floats) -> None:
        """Write the cages of the next k frames, (k, n, 3)."""
        from pxr import Vt

        turns = np.zeros((len(self._motion.names), 4), np.float32)
        turns[:, 3] = 1
        for cage, (places, turn) in zip(frames, self._motion.advance(frames), strict=True):
            time, translations = self._file.begin_frame(), to_float32(places)
            turns[0] = turn
            with capture_diagnostics(OSError):
                self._translations.Set(Vt.Vec3fArray.FromNumpy(translations), time)
                self._turns.Set(Vt.QuatfArray.FromNumpy(turns), time)
                if self._cage_mesh is not None:
                    self._cage_mesh.write_positions(cage, time)

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
