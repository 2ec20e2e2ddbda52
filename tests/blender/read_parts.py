"""Import every file of `write_parts.py` into Blender, and compare the parts.

    python read_parts.py FOLDER

Runs in a Python that has bpy and no cageik. Prints a table to stderr; exit code 1 when a row fails.
Each file is also held against expectations that are wrong, which must be found out.
"""

import copy
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from comparing import in_file_axes
from importing import IMPORTERS, empty_scene, evaluated_points

ROW = "{:<24} {:<10} {:>10}  {}"
LIMIT = 1e-6
"""Largest difference of a position, relative to the diagonal, and of a UV and of a colour."""

Parts = dict[str, dict]
"""What each part is, by its name, as `write_parts.py` describes it."""


def main(folder: Path) -> int:
    """Print the table and return the exit code."""
    truth, rows = read_truth(folder / "PARTS.npz"), []
    for pattern, (kind, words, up_axis) in json.loads((folder / "parts.json").read_text()).items():
        frames = len(next(iter(truth.values()))["frames"])
        found = import_parts(kind, folder / pattern, frames, up_axis)
        for word in words:
            off, wrong = (CHECKS[word](found, each) for each in (truth, spoil(truth, word)))
            verdict = "FAIL" if not off <= LIMIT else "pass" if wrong > LIMIT else "FAIL: takes all"
            rows.append((pattern, word, f"{off:.1e}", verdict))
    failed = [row for row in rows if row[-1] != "pass"]
    lines = [ROW.format(*row) for row in (("file", "of parts", "difference", "verdict"), *rows)]
    done = f"{len(rows) - len(failed)} of {len(rows)} things of parts as they were written"
    print(*lines, done, sep="\n", file=sys.stderr)
    return 1 if failed else 0


def read_truth(path: Path) -> Parts:
    """What was written, by part."""
    truth: Parts = {}
    with np.load(path) as file:
        for key, value in file.items():
            name, _, word = key.rpartition(".")
            truth.setdefault(name, {})[word] = value
    return truth


def import_parts(kind: str, path: Path, frames: int, up_axis: str) -> Parts:
    """The meshes of a file, or of a folder of one file per frame, as Blender shows them."""
    empty_scene(24)
    files = sorted(path.parent.glob(path.name.replace("####", "*")))
    IMPORTERS[kind](filepath=str(files[0]))
    first = 0 if kind == "gltf" else 1  # glTF begins at 0 s
    bpy.context.scene.frame_set(first)
    parts = {item.name: describe(item, up_axis) for item in list_meshes()}
    shown: dict = {name: [] for name in parts}
    for k in range(frames):
        if len(files) > 1:
            empty_scene(24)
            IMPORTERS[kind](filepath=str(files[k]))
        bpy.context.scene.frame_set(first + k)
        for item in list_meshes():
            shown[item.name].append(in_file_axes(evaluated_points(item), up_axis, 1.0))
    return {name: part | {"frames": np.array(shown[name])} for name, part in parts.items()}


def list_meshes() -> list[bpy.types.Object]:
    """The meshes of the scene."""
    return [item for item in bpy.context.scene.objects if item.type == "MESH"]


def describe(item: bpy.types.Object, up_axis: str) -> dict:
    """Polygons, UVs of their corners, material and origin of a mesh."""
    mesh: bpy.types.Mesh = item.data
    (material,) = mesh.materials
    shaders = [] if material.node_tree is None else material.node_tree.nodes
    colours = [node.inputs["Base Color"] for node in shaders if node.type == "BSDF_PRINCIPLED"]
    return {
        "counts": np.array([polygon.loop_total for polygon in mesh.polygons]),
        "corners": np.array([loop.vertex_index for loop in mesh.loops]),
        "uvs": np.array([tuple(held.uv) for held in mesh.uv_layers.active.data]),
        "material": np.array(material.name),
        "colour": np.array([tuple(colour.default_value)[:3] for colour in colours]),
        "origin": in_file_axes(np.array(item.matrix_world)[:3, 3], up_axis, 1.0),
    }


# --- how far each thing is from what was written: 0 or infinity for names and numbers


def compare_names(found: Parts, truth: Parts) -> float:
    return 0.0 if sorted(found) == sorted(truth) else np.inf


def compare_counts(found: Parts, truth: Parts) -> float:
    """Of vertices, without those that are split at seams of UVs."""
    pairs = list(pair_parts(found, truth))
    same = (len(set(number_vertices(a, b))) == b["frames"].shape[1] for a, b in pairs)
    return 0.0 if pairs and all(same) else np.inf


def compare_positions(found: Parts, truth: Parts) -> float:
    """In all frames; glTF splits vertices, of which each is compared with its own."""
    points = np.concatenate([part["frames"][0] for part in truth.values()])
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    return max(
        float(np.abs(a["frames"] - b["frames"][:, number_vertices(a, b)]).max() / diagonal)
        for a, b in pair_parts(found, truth)
    )


def compare_polygons(found: Parts, truth: Parts) -> float:
    """Vertices in order and polygons by their corners, whatever corner each begins with."""
    same = (
        a["frames"].shape == b["frames"].shape and list_rings(a) == list_rings(b)
        for a, b in pair_parts(found, truth)
    )
    return 0.0 if all(same) else np.inf


def compare_uvs(found: Parts, truth: Parts) -> float:
    """At each vertex the same coordinates, in whatever order of corners."""
    return max(
        max(find_furthest(*rows), find_furthest(*rows[::-1]))
        for rows in (
            (list_uvs(a, number_vertices(a, b)), list_uvs(b, np.arange(b["frames"].shape[1])))
            for a, b in pair_parts(found, truth)
        )
    )


def compare_materials(found: Parts, truth: Parts) -> float:
    same = (str(a["material"]) == str(b["material"]) for a, b in pair_parts(found, truth))
    return 0.0 if all(same) else np.inf


def compare_colours(found: Parts, truth: Parts) -> float:
    return max(
        float(np.abs(a["colour"] - b["colour"]).max(initial=0 if len(a["colour"]) else np.inf))
        for a, b in pair_parts(found, truth)
    )


def compare_origins(found: Parts, truth: Parts) -> float:
    return max(float(np.abs(a["origin"] - b["origin"]).max()) for a, b in pair_parts(found, truth))


CHECKS = {
    "names": compare_names,
    "counts": compare_counts,
    "positions": compare_positions,
    "polygons": compare_polygons,
    "uvs": compare_uvs,
    "materials": compare_materials,
    "colours": compare_colours,
    "origins": compare_origins,
}


def pair_parts(found: Parts, truth: Parts) -> Iterator[tuple[dict, dict]]:
    """Each part that was found, beside what was written; names are compared by themselves."""
    return ((found[name], part) for name, part in truth.items() if name in found)


def number_vertices(found: dict, truth: dict) -> np.ndarray:
    """Which vertex of the truth each vertex is, by its place in the last frame."""
    gaps = np.linalg.norm(found["frames"][-1][:, None] - truth["frames"][-1][None], axis=2)
    return gaps.argmin(axis=1)


def list_rings(part: dict) -> list[tuple[int, ...]]:
    """The corners of each polygon, from its smallest on."""
    rings = np.split(part["corners"], np.cumsum(part["counts"])[:-1])
    return [tuple(np.roll(ring, -ring.argmin()).tolist()) for ring in rings]


def list_uvs(part: dict, numbers: np.ndarray) -> np.ndarray:
    """The vertex and the coordinates of each corner, (c, 3)."""
    return np.column_stack([numbers[part["corners"]], part["uvs"]])


def find_furthest(rows: np.ndarray, others: np.ndarray) -> float:
    """How far the row that is furthest from all others is from them."""
    return float(np.abs(rows[:, None] - others[None]).max(axis=2).min(axis=1).max())


def spoil(truth: Parts, word: str) -> Parts:
    """Expectations that are wrong in one thing of one part."""
    wrong = copy.deepcopy(truth)
    jacket = wrong["jacket"]
    if word == "names":
        wrong["eye_r"] = wrong.pop("eye_R")
    elif word == "counts":
        jacket["frames"] = np.append(jacket["frames"], jacket["frames"][:, :1] + 1, axis=1)
    elif word == "polygons":
        jacket["corners"][[0, 1]] = jacket["corners"][[1, 0]]
    elif word == "materials":
        jacket["material"] = np.array("other")
    else:
        values, where = WRONG[word]
        jacket[values][where] += 1e-4
    return wrong


WRONG = {
    "positions": ("frames", (2, 5, 1)),
    "uvs": ("uvs", 7),
    "colours": ("colour", 1),
    "origins": ("origin", 2),
}
"""Where a number is changed: a vertex in one frame, a corner, a channel, a coordinate."""


if __name__ == "__main__":
    code = main(Path(sys.argv[1]))
    sys.stdout.flush()
    sys.exit(code)
