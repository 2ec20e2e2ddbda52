"""Let cages that were edited and exported in Blender move their model by cageik, and compare that
with what Blender showed.

    python deform_live.py FOLDER

Reads what `read_live.py` wrote. Exit code 1 if a vertex is off by more than `LIMIT`, or if late
frames pass.
"""

import sys
from pathlib import Path

import numpy as np
from write_assets import cageik

LIMIT = 1e-6
"""Of the diagonal of the first frame."""


def main(folder: Path) -> int:
    """Print the difference of each file, and return the exit code."""
    live, code = folder / "live", 0
    with np.load(live / "back.npz") as file:
        expected = file["frames"]
    diagonal = np.linalg.norm(np.ptp(expected[0], axis=0))
    for name in ("back.usdc", "back.abc"):
        out = live / f"{name}.npz"
        cageik("deform", live / "few.h5", "--cages", live / name, "-o", out, "--to", "m,z")
        with np.load(out) as file:
            found = file["vertices"]
        off = np.abs(found - expected).max() / diagonal
        late = np.abs(np.roll(found, 1, axis=0) - expected).max() / diagonal
        verdict = "pass" if off <= LIMIT < late else "FAIL"
        code |= verdict == "FAIL"
        print(f"cages in {name}, back in cageik: {off:.1e} {verdict}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
