"""Files as Blender shows them: imported into an empty scene, and evaluated frame by frame."""

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np


class ShownWrongError(Exception):
    """What Blender made of a file cannot be compared; the message says why."""


def shown(case: dict, folder: Path, count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Positions (m, 3) in Blender's space and faces (f, 3), at `count` frames from the first on."""
    path = folder / case["path"]
    if path.is_dir():
        files = sorted(path.iterdir())
        if len(files) != count:
            raise ShownWrongError(f"{len(files)} files, expected {count}")
        for file in files:
            empty_scene(case["fps"])
            IMPORTERS[case["kind"]](filepath=str(file))
            yield evaluated(only_mesh())
        return
    empty_scene(case["fps"])
    if case["on_model"]:
        bpy.ops.wm.obj_import(filepath=str(folder / f"{case['truth']}_rest.obj"))
        if case["is_turned"]:
            bpy.ops.object.transform_apply()
        CACHES[case["kind"]](only_mesh().modifiers, path, case)
    else:
        IMPORTERS[case["kind"]](filepath=str(path))
        refuse_other_range(case["kind"], case["first"], case["first"] + count - 1)
    moving = only_mesh()
    for k in range(count):
        bpy.context.scene.frame_set(case["first"] + k)
        yield evaluated(moving)


def import_alembic(filepath: str) -> None:
    """Import, and come back only then."""
    bpy.ops.wm.alembic_import(filepath=filepath, as_background_job=False)


def import_gltf(filepath: str) -> None:
    """Import, without a mesh that shows the bones."""
    bpy.ops.import_scene.gltf(filepath=filepath, disable_bone_shape=True)


IMPORTERS = {
    "obj": bpy.ops.wm.obj_import,
    "ply": bpy.ops.wm.ply_import,
    "usd": bpy.ops.wm.usd_import,
    "gltf": import_gltf,
    "alembic": import_alembic,
}


def empty_scene(fps: float) -> None:
    """Forget everything; a scene with no object."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = int(fps)


def put_mesh_cache(modifiers: bpy.types.ObjectModifiers, path: Path, case: dict) -> None:
    """Let a point cache move the model, from the scene frame that is said."""
    modifier = modifiers.new("cache", "MESH_CACHE")
    modifier.cache_format = case["kind"].upper()
    modifier.filepath = str(path)
    modifier.frame_start = case["first"]
    if case["is_turned"]:
        modifier.forward_axis, modifier.up_axis = "POS_Z", "NEG_Y"


def put_sequence_cache(modifiers: bpy.types.ObjectModifiers, path: Path, case: dict) -> None:
    """Let a scene file move the model, at its own times."""
    bpy.ops.cachefile.open(filepath=str(path))
    modifier = modifiers.new("cache", "MESH_SEQUENCE_CACHE")
    modifier.cache_file = bpy.data.cache_files[path.name]
    name = case["truth"]
    modifier.object_path = f"/{name}" if case["kind"] == "alembic" else f"/{name}/{name}"


CACHES = {
    "mdd": put_mesh_cache,
    "pc2": put_mesh_cache,
    "usd": put_sequence_cache,
    "alembic": put_sequence_cache,
}


def only_mesh() -> bpy.types.Object:
    """The one mesh of the scene."""
    found = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    if len(found) != 1:
        raise ShownWrongError(f"{len(found)} meshes in the scene, expected 1")
    return found[0]


def refuse_other_range(kind: str, first: float, last: float) -> None:
    """The import sets the scene to the frames of the file, but for glTF, which has an action."""
    if kind == "gltf":
        skinned = only_mesh().parent
        animated = only_mesh().data.shape_keys if skinned is None else skinned
        found = tuple(animated.animation_data.action.frame_range)
    else:
        found = (bpy.context.scene.frame_start, bpy.context.scene.frame_end)
    if not np.allclose(found, (first, last), rtol=0, atol=1e-4):
        raise ShownWrongError(f"frames {found[0]:g} to {found[1]:g}, expected {first} to {last}")


def evaluated(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Positions (m, 3) in Blender's space and triangles (f, 3), after all modifiers."""
    final = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = final.to_mesh()
    points = placed_points(mesh, final)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    if len(corners) != 3 * len(mesh.polygons):
        raise ShownWrongError("faces that are no triangles")
    final.to_mesh_clear()
    return points, corners.reshape(-1, 3)


def evaluated_points(item: bpy.types.Object) -> np.ndarray:
    """Positions (m, 3) in Blender's space, after all modifiers."""
    final = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = placed_points(final.to_mesh(), final)
    final.to_mesh_clear()
    return points


def placed_points(mesh: bpy.types.Mesh, item: bpy.types.Object) -> np.ndarray:
    """Positions (m, 3) of a mesh in Blender's space."""
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    transform = np.array(item.matrix_world)
    return points @ transform[:3, :3].T + transform[:3, 3]
