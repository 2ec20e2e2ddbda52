"""Edit an animated cage in Blender: hook some of its vertices to an empty with keys, and export it.

blender --background --python edit_cage.py -- SCENE.usdc EDITED.usdc

`SCENE.usdc` is what `cageik export RESULT SCENE.usdc --with-model` writes. Without Blender,
`pip install bpy` (Python 3.11) and `python edit_cage.py SCENE.usdc EDITED.usdc` do the same.
Change the lines in capitals to your edit. This one lifts the left hand of the walking figure.
"""

import sys

import bpy

VERTICES = [44, 45, 46, 47]
"""Vertices of the cage, as edit mode numbers them (Overlays > Indices)."""
KEYS = {12: (0, 0, 0), 24: (0.1, 0, 0.45), 30: (0.1, 0, 0.45), 42: (0, 0, 0)}
"""How far they are moved, by frame: right, back and up, in metres."""


def open_scene(path):
    """Import the cage and the model into an empty scene, and return the object of the cage."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=path)  # takes the frame range, not the frames per second
    return bpy.context.scene.objects["cage"]


def hook(cage, vertices):
    """Hook vertices to a new empty, after the cache that moves the cage; return the empty.

    They are named by a group: after a cache, Blender 5.0 moves other vertices than those of Ctrl-H.
    """
    group = cage.vertex_groups.new(name="edited")
    group.add(vertices, 1, "REPLACE")
    empty = bpy.data.objects.new("Empty", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.location = cage.matrix_world @ cage.data.vertices[vertices[0]].co
    bpy.context.view_layer.update()
    modifier = cage.modifiers.new("Hook", "HOOK")
    modifier.object, modifier.vertex_group = empty, group.name
    return empty


def key(empty, moves):
    """Give the empty a key per frame."""
    start = empty.location.copy()
    for frame, move in moves.items():
        empty.location = [value + by for value, by in zip(start, move, strict=True)]
        empty.keyframe_insert("location", frame=frame)


def export(cage, path):
    """Write the cage alone, with all frames."""
    bpy.ops.object.select_all(action="DESELECT")
    cage.select_set(True)
    bpy.ops.wm.usd_export(filepath=path, selected_objects_only=True, export_animation=True)


def main(source, target):
    """Edit the cage of one file, and write it to another."""
    cage = open_scene(source)
    key(hook(cage, VERTICES), KEYS)
    export(cage, target)


if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if len(words) != 2:
        sys.exit(__doc__)
    main(*words)
