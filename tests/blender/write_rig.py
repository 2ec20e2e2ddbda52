"""Make a rig in Blender, write it as FBX, and bake that with the script of the documents.

    python write_rig.py FOLDER SCRIPT

Runs in a Python that has bpy and no cageik. `FOLDER/RIG.npz` has the positions (F, m, 3) of each
mesh as Blender shows them, in metres with y up, before the rig is written.
"""

import math
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np

FRAMES = 12


def main(folder: Path, script: Path) -> None:
    """Write the rig, the truth, and the file that is baked from it."""
    folder.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = 24
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, FRAMES
    bones = make_bones()
    make_tube(bones)
    make_hat(bones)
    np.savez(folder / "RIG.npz", **record())
    bpy.ops.export_scene.fbx(
        filepath=str(folder / "rig.fbx"), add_leaf_bones=False, bake_anim_simplify_factor=0
    )
    words = [sys.executable, script, folder / "rig.fbx", folder / "rig.abc"]
    subprocess.run([*map(str, words)], check=True)


def make_bones() -> bpy.types.Object:
    """Three bones above each other, which turn."""
    bpy.ops.object.armature_add()
    armature = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    bones.remove(bones[0])
    for k in range(3):
        bone = bones.new(f"bone_{k}")
        bone.head, bone.tail = (0, 0, k), (0, 0, k + 1)
        bone.parent = bones.get(f"bone_{k - 1}")
    bpy.ops.object.mode_set(mode="POSE")
    for frame in range(1, FRAMES + 1):
        for k, bone in enumerate(armature.pose.bones):
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = (0.1 * k, 0.05 * frame, 0.4 * math.sin(frame / 3 + k))
            bone.keyframe_insert("rotation_euler", frame=frame)
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def make_tube(bones: bpy.types.Object) -> None:
    """A tube that the bones bend, with a shape that comes and goes."""
    bpy.ops.mesh.primitive_cylinder_add(vertices=12, radius=0.4, depth=3, location=(0, 0, 1.5))
    tube = bpy.context.object
    tube.name = "tube"
    bpy.ops.object.transform_apply()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=2)
    bpy.ops.object.mode_set(mode="OBJECT")
    for k in range(3):
        group = tube.vertex_groups.new(name=f"bone_{k}")
        for vertex in tube.data.vertices:
            share = max(0.0, 1 - abs(vertex.co.z - k - 0.5))
            ends = (k == 0 and vertex.co.z < 0.5) or (k == 2 and vertex.co.z > 2.5)
            group.add([vertex.index], 1.0 if ends else share, "REPLACE")
    tube.shape_key_add(name="rest")
    wide = tube.shape_key_add(name="wide")
    for point in wide.data:
        point.co.x *= 1.5
    for frame in range(1, FRAMES + 1):
        wide.value = 0.5 + 0.5 * math.sin(frame)
        wide.keyframe_insert("value", frame=frame)
    tube.parent = bones
    tube.modifiers.new("bones", "ARMATURE").object = bones


def make_hat(bones: bpy.types.Object) -> None:
    """A cube that is fixed to the last bone."""
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0, 0.3, 0))
    hat = bpy.context.object
    hat.name = "hat"
    hat.parent, hat.parent_type, hat.parent_bone = bones, "BONE", "bone_2"


def record() -> dict:
    """The positions of each mesh in all frames, metres with y up."""
    found: dict = {"tube": [], "hat": []}
    for frame in range(1, FRAMES + 1):
        bpy.context.scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        for name, frames in found.items():
            item = bpy.data.objects[name].evaluated_get(graph)
            world = np.array(item.matrix_world)
            points = np.array([tuple(vertex.co) for vertex in item.to_mesh().vertices])
            x, y, z = (points @ world[:3, :3].T + world[:3, 3]).T
            frames.append(np.stack([x, z, -y], axis=1))
            item.to_mesh_clear()
    return {name: np.array(frames) for name, frames in found.items()}


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
    sys.stdout.flush()
