"""Import every file of `write.py` into Blender, and compare all vertices at all frames.

    python read_back.py FOLDER [--wrong]

Runs in a Python that has bpy and no cageik. Prints a table to stderr, as bpy talks on stdout; exit
code 1 when a row fails. With `--wrong` each file is held against expectations that are wrong:
a row then passes when they are found out, and only those that fail are printed.
"""

import json
import sys
from pathlib import Path

import numpy as np
from comparing import Clip, furthest, have_same_faces, in_file_axes, wrong_clips
from importing import ShownWrongError, shown

ROW = "{:<22} {:<20} {:>6} {:>7} {:>8} {:>10} {:>6}  {}"
TITLES = ("file", "held against", "frames", "from", "vertices", "difference", "limit", "verdict")
WRONG_BY = 10
"""Limits by which a vertex is moved in what is wrong."""


def main(folder: Path, wrong: bool) -> int:
    """Print the table and return the exit code."""
    cases = json.loads((folder / "cases.json").read_text())
    rows = [row for case in cases for row in rows_of(case, folder, wrong)]
    failed = [row for row in rows if row[-1] != "pass"]
    lines = [ROW.format(*row) for row in (TITLES, *(failed if wrong else rows))]
    what = "wrong expectations found out" if wrong else "files as they were written"
    print(*lines, f"{len(rows) - len(failed)} of {len(rows)} {what}", sep="\n", file=sys.stderr)
    return 1 if failed else 0


def rows_of(case: dict, folder: Path, wrong: bool) -> list[tuple]:
    """The rows of one file: a single one, or one for each wrong expectation."""
    expected, limit = expected_of(case, folder), case["tolerance"]
    frames, vertices, _ = expected.frames.shape
    size, name = (frames, case["first"], vertices), name_of(case)
    try:
        found = found_in(case, folder, expected)
    except (ShownWrongError, RuntimeError) as error:  # the latter when bpy cannot import it
        return [(name, "", *size, "", f"{limit:.0e}", f"FAIL: {str(error).strip()}")]
    held = {"what was written": expected}
    if wrong:
        held = dict(wrong_clips(expected, WRONG_BY * limit))
    rows = []
    for other, clip in held.items():
        difference, same_faces = furthest(found, clip), have_same_faces(found, clip)
        agrees = difference <= limit and same_faces
        verdict = "pass" if agrees != wrong else "FAIL" if same_faces else "FAIL: other faces"
        rows.append((name, other, *size, f"{difference:.1e}", f"{limit:.0e}", verdict))
    return rows


def name_of(case: dict) -> str:
    """The file, and where it was put if it was not imported."""
    where = ", turned model" if case["is_turned"] else ", on model"
    return f"{case['path']}{where if case['on_model'] else ''}"


def expected_of(case: dict, folder: Path) -> Clip:
    """What the file has to show."""
    with np.load(folder / f"{case['truth']}.npz") as truth:
        diagonal = np.linalg.norm(np.ptp(truth["rest"], axis=0))
        return Clip(truth["frames"], truth["faces"], float(diagonal))


def found_in(case: dict, folder: Path, expected: Clip) -> Clip:
    """What Blender shows, in the axes and units of the file."""
    frames, first = [], None
    for points, faces in shown(case, folder, len(expected.frames)):
        if points.shape != expected.frames[0].shape:
            raise ShownWrongError(f"{len(points)} vertices, expected {len(expected.frames[0])}")
        first = faces if first is None else first
        if not np.array_equal(faces, first):
            raise ShownWrongError(f"frame {len(frames)} has other faces than the first")
        frames.append(in_file_axes(points, case["up_axis"], case["metres_per_unit"]))
    return Clip(np.array(frames), first, expected.diagonal)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), "--wrong" in sys.argv[2:]))
