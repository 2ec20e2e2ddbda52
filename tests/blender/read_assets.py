"""Import every file of `write_assets.py` into Blender, and compare polygons, UVs and materials.

    python read_assets.py FOLDER

Runs in a Python that has bpy and no cageik. Prints a table to stderr; exit code 1 when a row fails.
Each file is also held against expectations that are wrong, which must be found out.
"""

import json
import re
import sys
from pathlib import Path

import bpy
import numpy as np
from importing import IMPORTERS, empty_scene, only_mesh

ROW = "{:<30} {:<10} {}"
UV_TOLERANCE = 1e-6


def main(folder: Path) -> int:
    """Print the table and return the exit code."""
    rows = []
    with np.load(folder / "ASSET.npz") as file:
        truth = dict(file)
    for name, (kind, parts) in json.loads((folder / "assets.json").read_text()).items():
        found = import_asset(kind, folder / name)
        for part in parts:
            expected = truth | ({"materials": shown_names(truth)} if kind == "usd" else {})
            is_kept = agrees(part, found, expected)
            is_sharp = not agrees(part, found, spoil(expected))
            verdict = "pass" if is_kept and is_sharp else "FAIL" if is_sharp else "FAIL: takes all"
            rows.append((name, part, verdict))
    failed = [row for row in rows if row[-1] != "pass"]
    lines = [ROW.format(*row) for row in (("file", "part", "verdict"), *rows)]
    done = f"{len(rows) - len(failed)} of {len(rows)} parts of assets as they were written"
    print(*lines, done, sep="\n", file=sys.stderr)
    return 1 if failed else 0


def shown_names(truth: dict) -> np.ndarray:
    """The names of materials as Blender has those of USD: of prims, with letters USD accepts."""
    return np.array([re.sub(r"\W", "_", name) for name in truth["materials"]])


def import_asset(kind: str, path: Path) -> dict:
    """Polygons, UVs of their corners and their materials, as Blender has them."""
    empty_scene(24)
    IMPORTERS[kind](filepath=str(path))
    mesh: bpy.types.Mesh = only_mesh().data
    counts = np.array([polygon.loop_total for polygon in mesh.polygons])
    corners = np.array([loop.vertex_index for loop in mesh.loops])
    layer = mesh.uv_layers.active
    uvs = None if layer is None else np.array([tuple(held.uv) for held in layer.data])
    names = [slot.name if slot is not None else "" for slot in mesh.materials] or [""]
    materials = np.array([names[polygon.material_index] for polygon in mesh.polygons])
    return {"counts": counts, "corners": corners, "uvs": uvs, "materials": materials}


def agrees(part: str, found: dict, truth: dict) -> bool:
    """Whether Blender has what was written; polygons may begin at another corner."""
    if part == "materials":
        return list(found["materials"]) == list(truth["materials"])
    if not np.array_equal(found["counts"], truth["counts"]):
        return False
    ends = np.cumsum(truth["counts"])[:-1]
    rings, wanted = (np.split(held["corners"], ends) for held in (found, truth))
    steps = [find_turn(ring, other) for ring, other in zip(rings, wanted, strict=True)]
    if None in steps:
        return False
    if part == "polygons":
        return True
    if found["uvs"] is None:
        return False
    pairs = zip(np.split(found["uvs"], ends), np.split(truth["uvs"], ends), steps, strict=True)
    return all(np.abs(np.roll(uv, -step, axis=0) - other).max() < UV_TOLERANCE
               for uv, other, step in pairs)  # fmt: skip


def find_turn(ring: np.ndarray, other: np.ndarray) -> int | None:
    """By how many corners a polygon begins later than another one; None if it is not the same."""
    turns = (k for k in range(len(ring)) if np.array_equal(np.roll(ring, -k), other))
    return next(turns, None)


def spoil(truth: dict) -> dict:
    """Expectations that are wrong in every part: one polygon, one UV, one material."""
    wrong = {name: values.copy() for name, values in truth.items()}
    wrong["corners"][[0, 1]] = wrong["corners"][[1, 0]]
    wrong["uvs"][7] += 0.01
    wrong["materials"][3] = "other"
    return wrong


if __name__ == "__main__":
    code = main(Path(sys.argv[1]))
    sys.stdout.flush()
    sys.exit(code)
