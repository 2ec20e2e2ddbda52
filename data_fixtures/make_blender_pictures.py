"""Draw the pictures of docs/blender.md: a cage that moves its model live, one that is edited, and
what comes back.

python data_fixtures/make_blender_pictures.py LIVE SCENE.usdc EDITED.usdc MESH.usdc [OUT_FOLDER]

Needs Blender as a module (bpy, Python 3.11); the page has the commands that write the folder and
the three files. Cycles draws on the processor, so the pictures depend on it, and no test compares
their bytes.
"""

import math
import runpy
import sys
from pathlib import Path

import bpy
from mathutils import Vector

PICTURES = Path(__file__).resolve().parent / "pictures"

FRAME = 26
SIZE = (340, 400)
"""Pixels across and down."""
CLAY, BLUE = (0.72, 0.62, 0.5, 1), (0.02, 0.13, 0.5, 1)


LIFTED, LIFT = (44, 45, 46, 47), (0.1, 0, 0.45)
"""Vertices of the cage around the left hand, and how far a hook moves them, metres."""


def main(live: str, scene: str, edited: str, mesh: str, folder: str = str(PICTURES)) -> None:
    """Draw the live cage with a hook, the scene as imported, with the edited cage, and the model
    that came back.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    runpy.run_path(str(Path(live) / "open_in_blender.py"), run_name="__main__")
    lift_hand(bpy.data.objects["cage"])
    wires = bpy.data.objects["cage"].copy()  # of which the wires would be no cage
    wires.visible_camera = True
    bpy.context.scene.collection.objects.link(wires)
    show(wires, "cage")
    show(bpy.data.objects[Path(live).name], "model")
    draw(Path(folder) / "blender_live.webp")
    pictures = {
        "blender_import.webp": {scene: ("cage", "model")},
        "blender_edited.webp": {edited: ("cage",), scene: ("model",)},
        "blender_back.webp": {edited: ("cage",), mesh: ("mesh",)},
    }
    for name, files in pictures.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        for path, kept in files.items():
            import_objects(path, kept)
        draw(Path(folder) / name)


def lift_hand(cage: bpy.types.Object) -> None:
    """Hook the cage around the left hand to an empty, and move that."""
    bpy.context.view_layer.objects.active = cage
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")  # where vertices can be selected by number
    for number in LIFTED:
        cage.data.vertices[number].select = True
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.object.hook_add_newob()
    bpy.ops.object.mode_set(mode="OBJECT")
    empty = next(item for item in bpy.data.objects if item.type == "EMPTY")
    empty.location += Vector(LIFT)


def import_objects(path: str, kept: tuple[str, ...]) -> None:
    """Import a file, and keep the meshes that are wanted of it."""
    known = set(bpy.data.objects)
    bpy.ops.wm.usd_import(filepath=path)
    for item in set(bpy.data.objects) - known:
        if item.type != "MESH":
            continue
        name = item.name.split(".")[0]
        if name in kept:
            show(item, name)
        else:
            bpy.data.objects.remove(item)


def show(item: bpy.types.Object, name: str) -> None:
    """Show a mesh: a cage as wires."""
    if name == "cage":
        item.modifiers.new("wire", "WIREFRAME").thickness = 0.012
    else:
        item.modifiers.new("smooth", "SUBSURF").render_levels = 1
        item.data.shade_smooth()
    item.data.materials.clear()
    item.data.materials.append(make_material(name, BLUE if name == "cage" else CLAY))


def make_material(name: str, colour: tuple[float, ...]) -> bpy.types.Material:
    """Make a dull material."""
    material = bpy.data.materials.new(name)
    surface = material.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = colour
    surface.inputs["Roughness"].default_value = 0.8
    return material


def draw(path: Path) -> None:
    """Draw the scene in a frame, from the figure's front left."""
    scene = bpy.context.scene
    scene.frame_set(FRAME)
    place = Vector((2.6, -4.0, 1.7))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.45
    camera.location = find_centre(scene) + place
    camera.rotation_euler = (-place).to_track_quat("-Z", "Y").to_euler()
    light = bpy.data.objects.new("light", bpy.data.lights.new("light", "SUN"))
    light.data.energy, light.data.angle = 1.7, 0.3
    light.rotation_euler = (math.radians(40), math.radians(-15), math.radians(10))
    for item in (camera, light):
        scene.collection.objects.link(item)
    scene.world = bpy.data.worlds.new("world")
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.9, 0.9, 0.9, 1)
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 48, False
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.image_settings.file_format = "WEBP"
    scene.render.image_settings.quality = 85
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def find_centre(scene: bpy.types.Scene) -> Vector:
    """Return the middle of the figure across, at half its height."""
    graph = bpy.context.evaluated_depsgraph_get()
    figure = next(item for item in scene.objects if item.type == "MESH" and "cage" not in item.name)
    vertices = figure.evaluated_get(graph).data.vertices
    points = [figure.matrix_world @ vertex.co for vertex in vertices]
    middle = sum(points, Vector()) / len(points)
    return Vector((middle.x, middle.y, 0.98))


if __name__ == "__main__":
    if not 5 <= len(sys.argv) <= 6:
        sys.exit(__doc__)
    main(*sys.argv[1:])
