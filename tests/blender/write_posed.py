"""Write rigs of every kind in glTF and USD, and beside them what cageik reads of them.

    python write_posed.py FOLDER

`FOLDER/POSED.npz` has the positions (F, m, 3) of all vertices of each file, under its name, in its
own axes and metres. `FOLDER/posed.json` lists the up axis of each.
"""

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from pxr import UsdGeom

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from tests.formats.gltf.built import Built
from tests.formats.gltf.rigs import INTERPOLATIONS, RIGS
from tests.formats.usd.rigs import Rig

FPS = 24


def main(folder: Path) -> None:
    """Write files and expectations into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    truth, axes = {}, {}
    for kind in ("skinned", "morphed", "moved"):
        for interpolation in INTERPOLATIONS:
            file, _ = RIGS[kind](interpolation)
            put_keys_on_frames(file)
            if kind == "skinned":  # an armature of Blender has one bind pose, of the first skin
                del file.json["nodes"][8]["mesh"], file.json["nodes"][8]["skin"]
            path = file.save(folder / f"{kind}_{interpolation.lower()}.glb")
            truth[path.name], axes[path.name] = read(path), "Y"
    for kind in ("joints", "shapes"):
        path = write_usd(folder / f"posed_{kind}.usda", has_shapes=kind == "shapes")
        truth[path.name], axes[path.name] = read(path), "Z"
    np.savez(folder / "POSED.npz", **truth)
    (folder / "posed.json").write_text(json.dumps(axes, indent=1))


def put_keys_on_frames(file: Built) -> None:
    """Give all channels a key in each frame from 1 on: between keys Blender has its own curves."""
    for sampler in file.json["animations"][0]["samplers"]:
        count = file.json["accessors"][sampler["input"]]["count"]
        sampler["input"] = file.array(np.arange(1, count + 1) / FPS)


def write_usd(path: Path, *, has_shapes: bool) -> Path:
    """Write the rig of the tests, in metres with z up, without what Blender leaves out.

    That is a transform of the skeleton itself, and shapes between.
    """
    path.unlink(missing_ok=True)
    rig = Rig(path.parent, path.name)
    UsdGeom.SetStageUpAxis(rig.stage, "Z")
    UsdGeom.SetStageMetersPerUnit(rig.stage, 1.0)
    rig.skeleton.GetPrim().GetAttribute("xformOp:translate").Set((0, 0, 0))
    rig.skin()
    rig.animate()
    if has_shapes:
        rig.shape()
        rig.stage.GetPrimAtPath(f"{rig.at}/mesh/frown").RemoveProperty("inbetweens:half")
    return rig.save()


def read(path: Path) -> np.ndarray:
    """The positions of a file in all frames, as cageik reads them."""
    return np.array(list(open_sequence([str(path)], ClipSettings(fps=FPS))))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
