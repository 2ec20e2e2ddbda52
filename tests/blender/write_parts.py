"""Write the character of four parts in every format that has parts, and beside it what it is.

    python write_parts.py FOLDER

`FOLDER/parts.json` lists the files, what each keeps and its up axis; `FOLDER/PARTS.npz` has of each
part `NAME.frames` (F, m, 3), which the weights of the result give, `NAME.counts` (p,) and
`NAME.corners` (c,) of its polygons, `NAME.uvs` (c, 2), `NAME.material`, `NAME.colour` (3,) and
`NAME.origin` (3,).
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
from write_assets import cageik

from tests.character import COLOURS, NAMES, make_cage, make_parts, make_transforms, write_usd

OF_ALL = ["names", "counts", "positions", "uvs", "materials"]
KEEPS = {
    "hero.usdc": ("usd", [*OF_ALL, "polygons", "colours", "origins"], "Z"),
    "hero.abc": ("alembic", [*OF_ALL, "polygons", "origins"], "Y"),
    "hero.glb": ("gltf", [*OF_ALL, "colours", "origins"], "Z"),
    "hero_obj/hero_####.obj": ("obj", [*OF_ALL, "polygons"], "Y"),
}
"""Alembic and OBJ do not state the up axis, for which Blender takes Y; glTF is turned to Y by
definition, and Blender turns it back. glTF has triangles, OBJ no transforms, Alembic no colours."""


def main(folder: Path) -> None:
    """Write files and expectations into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    source, cage, result = folder / "hero.usda", folder / "hero_cage.obj", folder / "hero.h5"
    source.unlink(missing_ok=True)
    write_cage(cage)
    cageik("extract", write_usd(source), "--cage", cage, "--output", result, "--no-cache")
    for name in KEEPS:
        cageik("deform", result, "--output", folder / name)
    with h5py.File(result) as file:
        frames = file["weights"][:] @ file["verts"][:]
    np.savez(folder / "PARTS.npz", **describe_parts(frames))
    (folder / "parts.json").write_text(json.dumps(KEEPS, indent=1))


def write_cage(path: Path) -> None:
    """Write the cage of the character."""
    mesh = make_cage()
    lines = ["v {!r} {!r} {!r}".format(*point) for point in mesh.vertices.tolist()]
    lines += ["f {} {} {}".format(*face) for face in (mesh.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")


def describe_parts(frames: np.ndarray) -> dict:
    """What each part has to be, by its name and the word of the thing."""
    found, start = {}, 0
    for name, mesh, matrix in zip(NAMES, make_parts(), make_transforms(), strict=True):
        given, stop = mesh.attributes, start + len(mesh.vertices)
        (material,) = given.materials.names
        held = {
            "frames": frames[:, start:stop],
            "counts": given.corner_counts,
            "corners": given.corners,
            "uvs": given.uvs.values[given.uvs.indices],
            "material": material,
            "colour": COLOURS[material][:3],
            "origin": matrix[3, :3],
        }
        found |= {f"{name.rpartition('/')[2]}.{word}": value for word, value in held.items()}
        start = stop
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]))
