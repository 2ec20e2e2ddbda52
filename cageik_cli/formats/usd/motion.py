"""The motion of a skeleton in a file of its own, over another file with the mesh at rest.

A skeleton is bound to one motion (`skel:animationSource`), and programs read that one only. So each
clip is a file, which has the skeleton's file as its sublayer and binds it to its motion: whatever
opens it shows the mesh, in the range and at the rate of the clip.
"""

from pathlib import Path

from cageik_cli.formats.base.files import require_unicode
from cageik_cli.formats.base.skeleton import Skin
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.usd.library import capture_diagnostics
from cageik_cli.formats.usd.writer import (
    JOINT_FRAME_BYTES,
    SkeletonWriter,
    choose_prim_paths,
    nest_parts,
    place_meshes,
)


class MotionWriter(SkeletonWriter):
    """Writes the motion of a skin whose mesh and skeleton are in the file `layer`, beside it.

    Blender names the action after the motion, which has the name of the `clip` therefore.
    """

    states_unit = False  # the layer does

    def __init__(
        self,
        target: Path,
        animation: Animation,
        skin: Skin,
        *,
        layer: Path,
        clip: str,
        is_extracted: bool,
    ) -> None:
        parts = nest_parts(self.prepare(animation, skin, is_extracted), animation.name)
        self.open_stage(target, animation, JOINT_FRAME_BYTES * len(self.skeleton.names))
        self._cage_mesh = None
        with capture_diagnostics(OSError):
            from pxr import Sdf, Tf, UsdSkel

            held = Sdf.Layer.Find(require_unicode(layer.resolve()))
            if held is not None:  # someone has it open, as it was before it was written now
                held.Reload()
            self.stage.GetRootLayer().subLayerPaths.append(f"./{require_unicode(Path(layer.name))}")
            meshes = place_meshes(choose_prim_paths([part.name for part in parts], animation.name))
            slices = [part.vertices for part in parts]
            self.places = list(zip(meshes, slices, strict=True))
            binding = UsdSkel.BindingAPI(self.stage.GetPrimAtPath(meshes[0]))
            skeleton = binding.GetSkeleton()
            self.place, self.joints = str(skeleton.GetPath()), list(skeleton.GetJointsAttr().Get())
            self.stage.RemovePrim(self.root)  # that of the layer is another
            self.root = str(skeleton.GetPath().GetPrefixes()[0])
            self.stage.SetDefaultPrim(self.stage.OverridePrim(self.root))
            self.define_motion(Tf.MakeValidIdentifier(clip))
