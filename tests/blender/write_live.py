"""Write live cages of results of every kind, and beside them what cageik makes of them.

    python write_live.py FOLDER

`FOLDER/live/NAME` is what `cageik export --blender` writes, and `FOLDER/NAME.npz` has the `frames`
(F, m, 3) of `cageik deform` and the `cages` (F, n, 3), in metres with z up, the `weights` (m, n),
the `start` and the `step` of the frames, and where each part stops (`stops`).
"""

import sys
from pathlib import Path

import numpy as np
from write_assets import cageik
from write_parts import write_cage

from cageik_cli.geometry.parts import split_parts
from cageik_cli.store.result import read_animation, read_binding
from tests.character import write_usd

WALKER = Path("data_fixtures/walker")
FRAMES = WALKER / "frames"
IN_CAGE = ("--cage", WALKER / "cage.obj")


def main(folder: Path) -> None:
    """Write folders and expectations into `folder/live`."""
    live = folder / "live"
    live.mkdir(parents=True, exist_ok=True)
    write_cage(live / "hero_cage.obj")
    (live / "hero.usda").unlink(missing_ok=True)
    hero = (write_usd(live / "hero.usda"), "--cage", live / "hero_cage.obj", "--fit")
    scene = ("--fps", 30, "--start", 7, "--frame-step", 2)
    kinds = {
        "fitted": (FRAMES, *IN_CAGE, "--fit"),
        "few": (FRAMES, *IN_CAGE, "--fit", "--influences", 4),
        "ranked": (FRAMES, *IN_CAGE, "--fit", "--fit-rank", 8),
        "centimetres": (FRAMES, *IN_CAGE, "--metres-per-unit", 0.01, *scene),
        "parts": hero,
    }
    for name, words in kinds.items():
        cageik("extract", *words, "-o", live / f"{name}.h5")
    words = (WALKER / "handles.json", "-o", live / "edited.h5")
    cageik("pose", live / "fitted.h5", *words)
    for name in (*kinds, "edited"):
        write(live, name)


def write(live: Path, name: str) -> None:
    """Write the live cage of a result, and what is expected of it."""
    result = live / f"{name}.h5"
    cageik("export", result, live / name, "--blender")
    read = {}
    for command, words in {"deform": ("-o",), "export": ()}.items():
        path = live / f"{name}_{command}.npz"
        cageik(command, result, *words, path, "--to", "m,z")
        with np.load(path) as file:
            read[command] = dict(file)
    held = read_animation(result)
    np.savez(
        live / f"{name}.npz",
        frames=read["deform"]["vertices"],
        cages=read["export"]["vertices"],
        weights=read_binding(held).weights,
        start=held.scene.start,
        step=held.scene.frame_step,
        stops=[part.vertices.stop for part in split_parts(held.rest)],
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
