"""Import the rigs of `write_posed.py` into Blender, and compare how they move.

    python read_posed.py FOLDER

Runs in a Python that has bpy and no cageik. Prints a table to stderr; exit code 1 when a row fails.
Each file is also held against expectations that are wrong, which must be found out.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np
from comparing import in_file_axes
from importing import IMPORTERS, empty_scene, evaluated_points

ROW = "{:<24} {:>6} {:>10}  {}"
LIMIT = 1e-6
"""Largest difference of a coordinate, relative to the diagonal of the first frame. Blender
works in single precision; 6.4e-7 is the most that was seen."""


def main(folder: Path) -> int:
    """Print the table and return the exit code."""
    rows = []
    with np.load(folder / "POSED.npz") as file:
        truth = dict(file)
    for name, up_axis in json.loads((folder / "posed.json").read_text()).items():
        expected = truth[name]
        found = show(folder / name, up_axis, len(expected))
        off = compare(found, expected)
        takes = [word for word, wrong in spoil(expected) if compare(found, wrong) <= LIMIT]
        verdict = "FAIL" if not off <= LIMIT else f"FAIL: takes {takes}" if takes else "pass"
        rows.append((name, len(expected), f"{off:.1e}", verdict))
    failed = [row for row in rows if row[-1] != "pass"]
    lines = [ROW.format(*row) for row in (("file", "frames", "difference", "verdict"), *rows)]
    done = f"{len(rows) - len(failed)} of {len(rows)} rigs as cageik reads them"
    print(*lines, done, sep="\n", file=sys.stderr)
    return 1 if failed else 0


def show(path: Path, up_axis: str, count: int) -> np.ndarray:
    """Positions (F, m, 3) of all meshes in frames 1 to `count`, in the axes of the file."""
    empty_scene(24)
    IMPORTERS["gltf" if path.suffix == ".glb" else "usd"](filepath=str(path))
    meshes = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    for key in (key for shapes in bpy.data.shape_keys for key in shapes.key_blocks[1:]):
        key.slider_min, key.slider_max = -10, 10  # weights that are keyed are cut to these
    frames = []
    for k in range(count):
        bpy.context.scene.frame_set(1 + k)
        points = np.concatenate([evaluated_points(item) for item in meshes])
        frames.append(in_file_axes(points, up_axis, 1.0))
    return np.array(frames)


def compare(found: np.ndarray, truth: np.ndarray) -> float:
    """How far the paths of vertices are from the nearest of the other side, both ways.

    Files split vertices, which cageik welds: each side may have a path several times.
    """
    gaps = np.abs(found[:, :, None] - truth[:, None]).max(axis=(0, 3))
    diagonal = np.linalg.norm(np.ptp(truth[0], axis=0))
    return float(max(gaps.min(axis=0).max(), gaps.min(axis=1).max()) / diagonal)


def spoil(truth: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Expectations that are wrong: a vertex in one frame, frames that are late, and a mirror."""
    moved = truth.copy()
    moved[-1, 3, 1] += 10 * LIMIT * np.linalg.norm(np.ptp(truth[0], axis=0))
    late = np.roll(truth, 1, axis=0)
    return [("a vertex moved", moved), ("late frames", late), ("a mirror", truth * [-1, 1, 1])]


if __name__ == "__main__":
    code = main(Path(sys.argv[1]))
    sys.stdout.flush()
    sys.exit(code)
