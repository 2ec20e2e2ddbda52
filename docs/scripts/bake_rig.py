"""Bake the meshes of a rig, as they move, into an Alembic file, which `cageik extract` reads.

With Blender (4.5 or newer), or with Blender as a module of Python (pip install bpy):

    blender --background --python bake_rig.py -- hero.fbx hero.abc
    python bake_rig.py hero.fbx hero.abc

Reads .fbx, .glb, .gltf, .usd (also .usda, .usdc, .usdz), .abc and .blend. Frames are those of the
longest animation, or --start and --end; their rate is that of the file, or --fps.
"""

import argparse
import sys
from pathlib import Path

import bpy

IMPORTERS = {
    ".fbx": lambda path: bpy.ops.wm.fbx_import(filepath=path),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".gltf": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".usd": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usda": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usdz": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".abc": lambda path: bpy.ops.wm.alembic_import(filepath=path, as_background_job=False),
}


def read_options() -> argparse.Namespace:
    """Read the words behind `--`, or all of them if Blender is a module."""
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(prog="bake_rig.py", description=__doc__.splitlines()[0])
    parser.add_argument("rig", type=Path)
    parser.add_argument("output", type=Path, help="an .abc file")
    parser.add_argument("--start", type=int, help="first frame")
    parser.add_argument("--end", type=int, help="last frame")
    parser.add_argument("--fps", type=int, help="frames per second, where the file states none")
    return parser.parse_args(words)


def open_rig(path: Path, fps: int | None) -> None:
    """Open a scene of Blender, or import a file of another program into an empty one."""
    suffix = path.suffix.lower()
    if not path.is_file():
        sys.exit(f"{path}: no such file")
    if suffix == ".blend":
        bpy.ops.wm.open_mainfile(filepath=str(path))
        return
    if suffix not in IMPORTERS:
        sys.exit(f"{path}: expected .blend, {', '.join(IMPORTERS)}")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if fps is not None:  # before the import, which places keys by it
        bpy.context.scene.render.fps = fps
    IMPORTERS[suffix](str(path))


def find_range(path: Path) -> tuple[int, int]:
    """Return the first and the last frame of all actions; of the scene for .blend, or without."""
    scene = bpy.context.scene
    ends = [action.frame_range for action in bpy.data.actions if action.frame_range[1]]
    if path.suffix.lower() in (".blend", ".abc") or not ends:
        return scene.frame_start, scene.frame_end
    return round(min(first for first, _ in ends)), round(max(last for _, last in ends))


def main() -> None:
    """Bake the rig."""
    options = read_options()
    open_rig(options.rig, options.fps)
    count = sum(item.type == "MESH" for item in bpy.context.scene.objects)
    if not count:
        sys.exit(f"{options.rig}: holds no mesh")
    start, end = find_range(options.rig)
    start = start if options.start is None else options.start
    end = end if options.end is None else options.end
    bpy.ops.wm.alembic_export(
        filepath=str(options.output.absolute()),
        start=start,
        end=end,
        evaluation_mode="VIEWPORT",
        use_instancing=False,
        face_sets=True,  # which keep the materials
        export_hair=False,
        export_particles=False,
        as_background_job=False,
    )
    fps = bpy.context.scene.render.fps / bpy.context.scene.render.fps_base
    print(f"wrote {options.output}: {count} meshes, frames {start} to {end}, {fps:g} per second")


if __name__ == "__main__":
    main()
    sys.stdout.flush()
