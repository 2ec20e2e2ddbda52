"""Read the rig that Blender baked from FBX, and compare every vertex with what Blender showed.

    python read_rig.py FOLDER

Exit code 1 if a vertex is off by more than `LIMIT`, or if frames that are wrong pass.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.parts import split_parts

LIMIT = 2e-6
"""Of the diagonal: FBX and Alembic have single precision, and FBX turns and scales axes."""


def main(folder: Path) -> int:
    """Print the difference of each part, and return the exit code."""
    clip = open_sequence([str(folder / "rig.abc")])
    frames = np.array(list(clip))
    code = 0
    with np.load(folder / "RIG.npz") as truth:
        for part in split_parts(clip.first):
            name = next(each for each in truth.files if each in part.name.split("/"))
            found, expected = frames[:, part.vertices], truth[name]
            if found.shape != expected.shape:
                print(f"{part.name}: {found.shape}, expected {expected.shape}", file=sys.stderr)
                return 1
            off = np.abs(found - expected).max() / clip.first.diagonal
            late = np.abs(np.roll(found, 1, axis=0) - expected).max() / clip.first.diagonal
            verdict = "pass" if off <= LIMIT < late else "FAIL"
            code |= verdict == "FAIL"
            print(f"rig.fbx, baked: {part.name:<20} {off:.1e} {verdict}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
