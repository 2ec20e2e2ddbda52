"""Open the live cages of `write_live.py` in Blender, and compare how they move, by themselves and
when their cages are edited; then try the extension.

    python read_live.py FOLDER

`FOLDER/live/back.usdc` and `back.abc` then have edited cages as Blender exports them, and
`FOLDER/live/back.npz` the model in all `frames` (F, m, 3).

Runs in a Python that has bpy and no cageik. Prints a table to stderr; exit code 1 when a row fails.
Expectations that are wrong must be found out.
"""

import contextlib
import json
import os
import runpy
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

# Before Blender begins: what is installed goes there.
os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp()

import bpy
import numpy as np
from importing import empty_scene, evaluated_points

ROW = "{:<14} {:<34} {:>10}  {}"
LIMIT = 1e-6
"""Largest difference of a coordinate from `deform`, relative to the diagonal of the first frame.
Blender works in single precision; 5e-7 is the most that was seen."""

KINDS = ("fitted", "few", "ranked", "centimetres", "parts", "edited")
"""The live cages that are played."""

Rows = Iterator[tuple[str, str, str]]
"""What was done, how far it is off, and the verdict."""


class Live:
    """A live cage in an empty scene, and what is expected of it, in metres with z up."""

    def __init__(self, folder: Path) -> None:
        empty_scene(24)
        runpy.run_path(str(folder / "open_in_blender.py"), run_name="__main__")
        self.collection = bpy.data.collections[folder.name]
        self.cage = self.collection.objects["cage"]
        self.parts = [item for item in self.collection.objects if item != self.cage]
        with np.load(folder.with_suffix(".npz")) as file:
            self.frames, self.cages = file["frames"], file["cages"]
            self.weights, self.stops = file["weights"], file["stops"].tolist()
            self.start, self.step = float(file["start"]), float(file["step"])
        self.diagonal = np.linalg.norm(np.ptp(self.frames[0], axis=0))

    def show(self, frame: int) -> np.ndarray:
        """Positions (m, 3) of the model in a frame of the clip."""
        bpy.context.scene.frame_set(int(self.start + frame * self.step))
        parts = [evaluated_points(item) for item in self.parts]
        if np.cumsum([len(part) for part in parts]).tolist() != self.stops:
            raise ValueError(f"parts of {[len(part) for part in parts]} vertices")
        return np.concatenate(parts)

    def play(self) -> np.ndarray:
        """Positions (F, m, 3) in all frames."""
        return np.array([self.show(frame) for frame in range(len(self.frames))])

    def compare(self, found: np.ndarray, expected: np.ndarray) -> float:
        """How far positions are off."""
        return float(np.abs(found - expected).max() / self.diagonal)

    def measure_edit(self, frame: int, vertices: list[int], move: np.ndarray) -> float:
        """How far a frame is off in which `vertices` of the cage alone are moved by `move`."""
        model, moves = self.show(frame), evaluated_points(self.cage) - self.cages[frame]
        expected = np.zeros_like(moves)
        expected[vertices] = move
        off = self.compare(moves, expected)
        return max(off, self.compare(model, self.frames[frame] + self.weights @ expected))


def main(folder: Path) -> int:
    """Print the table and return the exit code."""
    live, rows = folder / "live", []
    for name in KINDS:
        rows += [(name, *row) for row in try_playing(live / name)]
    for name, check in CHECKS.items():
        rows += [(name, *row) for row in check(live)]
    failed = [row for row in rows if row[-1] != "pass"]
    lines = [ROW.format(*row) for row in (("live cage", "what", "off", "verdict"), *rows)]
    done = f"{len(rows) - len(failed)} of {len(rows)} checks of live cages"
    print(*lines, done, sep="\n", file=sys.stderr)
    return 1 if failed else 0


def judge(what: str, off: float, wrong: float = np.inf) -> tuple[str, str, str]:
    """Make a row; `wrong` is how far what is wrong is off."""
    verdict = "FAIL" if not off <= LIMIT else "pass" if wrong > LIMIT else "FAIL: takes all"
    return what, f"{off:.1e}", verdict


def tell(what: str, is_right: bool) -> tuple[str, str, str]:
    """Make a row of what is right or not."""
    return what, "", "pass" if is_right else "FAIL"


def try_playing(folder: Path) -> Rows:
    """Play all frames, twice between them, and from a file that was saved."""
    live = Live(folder)
    found = live.play()
    late = live.compare(np.roll(found, 1, axis=0), live.frames)
    yield judge("all frames", live.compare(found, live.frames), late)
    scene = bpy.context.scene
    last = live.start + (len(live.frames) - 1) * live.step
    yield tell("frame range", (scene.frame_start, scene.frame_end) == (live.start, last))
    between = live.start + 2.5 * live.step
    scene.frame_set(int(between), subframe=between % 1)
    points = np.concatenate([evaluated_points(item) for item in live.parts])
    middle = live.frames[2:4].mean(axis=0)
    yield judge("between two frames", live.compare(points, middle))
    scene.frame_set(int(last) + 9)
    points = np.concatenate([evaluated_points(item) for item in live.parts])
    yield judge("after the last frame", live.compare(points, live.frames[-1]))
    weights = live.parts[0].data.attributes["cage_weight_3"].data
    weights[0].vector.x += 1e-3
    live.parts[0].data.update()
    yield tell("a wrong weight is seen", live.compare(live.play(), live.frames) > LIMIT)
    weights[0].vector.x -= 1e-3
    path = folder.with_suffix(".blend")
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    live.cage = bpy.data.objects["cage"]
    live.parts = [item for item in bpy.data.collections[folder.name].objects if item != live.cage]
    yield judge("saved and opened", live.compare(live.play(), live.frames))


def try_edits(folder: Path) -> Rows:
    """Move the cage by all that Blender has."""
    live = Live(folder / "fitted")
    with in_edit_mode(live.cage, [3, 5, 7]):
        bpy.ops.object.hook_add_newob()
    empty = next(item for item in bpy.data.objects if item.type == "EMPTY")
    for frame, lift in ((10, 0.0), (20, 0.3)):
        empty.location.z += lift
        empty.keyframe_insert("location", frame=frame)
    up, hooked = np.array([0, 0, 1]), [3, 5, 7]
    for frame, lift in ((9, 0.0), (14, 0.15), (19, 0.3)):
        off, wrong = (live.measure_edit(frame, hooked, up * z) for z in (lift, lift + 1e-4))
        yield judge(f"a keyed hook, frame {frame + 1}", off, wrong)
    bpy.data.objects.remove(empty)
    live = Live(folder / "fitted")
    with in_edit_mode(live.cage, [11]):
        bpy.ops.transform.translate(value=(0.2, 0, 0))
        yield judge("in edit mode", live.measure_edit(4, [11], np.array([0.2, 0, 0])))
    yield judge("after edit mode", live.measure_edit(7, [11], np.array([0.2, 0, 0])))
    live = Live(folder / "few")
    live.cage.shape_key_add(name="Basis")
    key = live.cage.shape_key_add(name="Fix")
    key.data[30].co.y += 0.1
    for frame, value in ((1, 0.0), (11, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    for frame, move in ((0, 0.0), (10, 0.1)):
        off = live.measure_edit(frame, [30], np.array([0, move, 0]))
        yield judge(f"a keyed shape, frame {frame + 1}", off)
    export_back(live, folder)


def export_back(live: Live, folder: Path) -> None:
    """Export the cage alone, with its animation and its edit, and keep how the model moves."""
    np.savez(folder / "back.npz", frames=live.play())
    bpy.ops.object.select_all(action="DESELECT")
    live.cage.select_set(True)
    words = {"selected_objects_only": True, "export_animation": True, "export_shapekeys": False}
    bpy.ops.wm.usd_export(filepath=str(folder / "back.usdc"), **words)
    bpy.ops.wm.alembic_export(filepath=str(folder / "back.abc"), selected=True)


def try_moving_objects(folder: Path) -> Rows:
    """Move the object of the cage, which takes the model along, and that of the model."""
    live = Live(folder / "fitted")
    live.cage.location, live.cage.rotation_euler.z = (1, 2, 3), 0.5
    turn = np.array([[np.cos(0.5), np.sin(0.5), 0], [-np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    expected = live.frames[5] @ turn + [1, 2, 3]
    yield judge("the cage is moved and turned", live.compare(live.show(5), expected))
    live.parts[0].location = (0, 5, 0)  # weights are those of places: the cage says where
    yield judge("the model is moved, too", live.compare(live.show(5), expected))


def try_other_vertices(folder: Path) -> Rows:
    """Remove a vertex of the cage: the model stands still, and both say why."""
    live = Live(folder / "fitted")
    rest = np.load(folder / "fitted" / "live_cage.npz")["rest"]
    with in_edit_mode(live.cage, [0]):
        bpy.ops.mesh.delete(type="VERT")
    yield judge("the model is at rest", live.compare(live.show(5), rest))
    for item in (live.cage, live.parts[0]):
        said = [warning.message for warning in item.modifiers[0].node_warnings]
        yield tell(f"{item.name} says why", len(said) == 1 and "other vertices" in said[0])


def try_surfaces(folder: Path) -> Rows:
    """Look at the parts of the character."""
    live = Live(folder / "parts")
    with np.load(folder / "parts" / "live_cage.npz") as file:
        arrays = dict(file)
    about = json.loads(str(arrays["about"]))
    for number, item in enumerate(live.parts):
        mesh = item.data
        corners, uvs = np.empty(len(mesh.loops), np.int32), np.empty((len(mesh.loops), 2))
        mesh.loops.foreach_get("vertex_index", corners)
        mesh.uv_layers[0].uv.foreach_get("vector", uvs.ravel())
        is_right = np.array_equal(corners, arrays[f"{number}_corners"])
        yield tell(f"polygons of {item.name}", is_right)
        yield judge(f"UVs of {item.name}", np.abs(uvs - arrays[f"{number}_uvs"]).max())
        (name, colour), *more = about["parts"][number]["materials"]
        (material,) = mesh.materials
        surface = material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value
        is_right = material.name == name and np.allclose(surface, colour) and not more
        yield tell(f"material of {item.name}", is_right)


def try_subdividing(folder: Path) -> Rows:
    """Cut the edges of the model: new vertices move as the middles of the old ones."""
    live = Live(folder / "fitted")
    with in_edit_mode(live.parts[0], []):
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.subdivide()
    bpy.context.scene.frame_set(int(live.start) + 20)
    mesh, old = live.parts[0].data, len(live.weights)
    found, ends = evaluated_points(live.parts[0]), np.zeros((len(mesh.vertices), 2), int)
    counts = np.zeros(len(ends), int)
    for edge in mesh.edges:  # each edge that was cut is two now, from its middle to its ends
        one, middle = sorted(edge.vertices)
        if one < old <= middle:
            ends[middle, counts[middle]] = one
            counts[middle] += 1
    halves = found[:old][ends[old:]].mean(axis=1)
    yield tell("all edges are cut", bool((counts[old:] == 2).all() and len(ends) > old))
    yield judge("old vertices", live.compare(found[:old], live.frames[20]))
    yield judge("new vertices", live.compare(found[old:], halves))


def try_two(folder: Path) -> Rows:
    """Open two folders in one scene, which share nodes and materials."""
    live = Live(folder / "fitted")
    runpy.run_path(str(folder / "few" / "open_in_blender.py"), run_name="__main__")
    trees = [tree.name for tree in bpy.data.node_groups]
    yield tell("nodes are there once", sorted(trees) == ["Cage Animation", "Cage Deform"])
    yield judge("the first moves as before", live.compare(live.play(), live.frames))


def try_text_editor(folder: Path) -> Rows:
    """Run the script as a text, which is no file for Python."""
    bpy.ops.wm.read_factory_settings()
    text = bpy.data.texts.load(str(folder / "fitted" / "open_in_blender.py"))
    window = bpy.context.window_manager.windows[0]
    area = window.screen.areas[0]
    area.type = "TEXT_EDITOR"
    area.spaces.active.text = text
    with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
        done = bpy.ops.text.run_script()
    yield tell("the script in the text editor", done == {"FINISHED"} and has_live("fitted"))


def has_live(name: str) -> bool:
    """Whether the file holds a live cage."""
    return name in bpy.data.collections and "cage" in bpy.data.collections[name].objects


def try_extension(folder: Path) -> Rows:
    """Check, install and use the extension, then remove it."""
    package = folder / "fitted" / "cageik_live_cage.zip"
    tool = Path(bpy.utils.script_paths(subdir="addons_core")[0], "bl_pkg/cli/blender_ext.py")
    words = [sys.executable, str(tool), "validate"]
    wrong = folder / "wrong.zip"
    for path, is_right in ((package, True), (spoil_manifest(package, wrong), False)):
        done = subprocess.run([*words, str(path)], capture_output=True)
        yield tell(
            f"{path.name} is {'' if is_right else 'not '}valid", (not done.returncode) == is_right
        )
    bpy.ops.wm.read_factory_settings(use_empty=True)
    words = {"filepath": str(package), "repo": "user_default", "enable_on_install": True}
    bpy.ops.extensions.package_install_files(**words)
    is_there = "bl_ext.user_default.cageik_live_cage" in bpy.context.preferences.addons
    yield tell("it is installed", is_there)
    data = folder / "fitted" / "live_cage.npz"
    bpy.ops.import_scene.cageik_live_cage(filepath=str(data))
    yield tell("it imports", has_live("fitted") and bpy.context.scene.frame_end == 48)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module="bl_ext.user_default.cageik_live_cage")
    bpy.ops.import_scene.cageik_live_cage(filepath=str(data), sets_time=False)
    yield tell("it leaves the time as it is", bpy.context.scene.frame_end == 250)
    for name, says in write_wrong(data, folder / "wrong").items():
        said = ""
        try:
            bpy.ops.import_scene.cageik_live_cage(filepath=name)
        except RuntimeError as error:
            said = str(error)
        yield tell(f"{Path(name).name} is refused", says in said and "Traceback" not in said)
    bpy.ops.preferences.addon_disable(module="bl_ext.user_default.cageik_live_cage")
    yield tell("it ends", not hasattr(bpy.types, "IMPORT_SCENE_OT_cageik_live_cage"))


def spoil_manifest(package: Path, target: Path) -> Path:
    """Write an extension whose version is none."""
    with zipfile.ZipFile(package) as archive, zipfile.ZipFile(target, "w") as copy:
        for name in archive.namelist():
            copy.writestr(name, archive.read(name).replace(b'version = "0', b'version = "x'))
    return target


def write_wrong(data: Path, folder: Path) -> dict[str, str]:
    """Write files that are no live cages, and return what is said of each."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    with np.load(data) as file:
        arrays = dict(file)
    about = str(arrays["about"])
    changes = {
        "newer": {"about": np.array(about.replace('"format": 1', '"format": 2'))},
        "fewer_frames": {"moves": arrays["moves"][1:]},
        "corners": {"0_corners": arrays["0_corners"] + 9999},
        "words": {"about": np.array("[]")},
        "pickled": {"about": np.array([{}], object)},
        "parts": {"about": np.array(about.replace('"vertex_count": 1570', '"vertex_count": 1'))},
    }
    says = {str(folder / "missing.npz"): "does not exist"}
    for name, change in changes.items():
        path = folder / f"{name}.npz"
        np.savez(path, **arrays | change)
        says[str(path)] = "version 2, expected 1" if name == "newer" else "is not a sound live cage"
    for name, content in (("cut", data.read_bytes()[:5000]), ("text", b"a text")):
        path = folder / f"{name}.npz"
        path.write_bytes(content)
        says[str(path)] = "is not a sound live cage"
    np.savez(folder / "less.npz", **{k: v for k, v in arrays.items() if k != "weights"})
    return says | {str(folder / "less.npz"): "is not a sound live cage"}


def try_wrong_folder(folder: Path) -> Rows:
    """Run the script without its data: it ends with a sentence."""
    alone = folder / "alone"
    alone.mkdir(exist_ok=True)
    shutil.copy(folder / "fitted" / "open_in_blender.py", alone)
    words = [sys.executable, str(alone / "open_in_blender.py")]
    done = subprocess.run(words, capture_output=True, text=True)
    said = done.stderr.strip().splitlines()
    is_right = done.returncode == 1 and "live_cage.npz: does not exist; keep" in said[-1]
    yield tell("the script alone says why", is_right and "Traceback" not in done.stderr)


@contextlib.contextmanager
def in_edit_mode(cage: bpy.types.Object, selected: list[int]) -> Iterator[None]:
    """Edit a cage of which some vertices are selected."""
    bpy.context.view_layer.objects.active = cage
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")  # where vertices can be selected by number
    for number in selected:
        cage.data.vertices[number].select = True
    bpy.ops.object.mode_set(mode="EDIT")
    yield
    bpy.ops.object.mode_set(mode="OBJECT")


CHECKS: dict[str, Callable[[Path], Rows]] = {
    "edits": try_edits,
    "objects": try_moving_objects,
    "other vertices": try_other_vertices,
    "surfaces": try_surfaces,
    "subdivided": try_subdividing,
    "two": try_two,
    "text editor": try_text_editor,
    "extension": try_extension,
    "no data": try_wrong_folder,
}

if __name__ == "__main__":
    code = main(Path(sys.argv[1]))
    sys.stdout.flush()
    sys.exit(code)
