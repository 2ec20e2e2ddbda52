"""Write the asset of the tests in every format that keeps it, and beside it what it is.

    python write_assets.py FOLDER

`FOLDER/assets.json` lists the files and what each keeps; `FOLDER/ASSET.npz` has `counts` (p,),
`corners` (c,), `uvs` (c, 2) and `materials` (p,), read line by line from the text of the asset.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.assets import asset_text, parse_asset
from tests.shapes import quad_text

KEEPS = {
    "asset.usdc": ("usd", ["polygons", "uvs", "materials"]),
    "asset.abc": ("alembic", ["polygons", "uvs", "materials"]),
    "asset/asset_0001.obj": ("obj", ["polygons", "uvs", "materials"]),
    "asset_ply/asset_ply_0001.ply": ("ply", ["polygons"]),
}
"""Blender reads no texture coordinates of corners from PLY."""


def main(folder: Path) -> None:
    """Write files and expectations into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "asset_frames").mkdir(exist_ok=True)
    for k in range(2):
        (folder / "asset_frames" / f"f_{k + 1}.obj").write_text(asset_text(1 + 0.01 * k))
    (folder / "asset_cage.obj").write_text(quad_text(1.2))
    result = folder / "asset.h5"
    cageik("extract", folder / "asset_frames", "--cage", folder / "asset_cage.obj", "-o", result)
    for name in KEEPS:
        path = folder / name.replace("0001", "####")
        cageik("deform", result, "-o", path)
    asset = parse_asset(asset_text())
    np.savez(
        folder / "ASSET.npz",
        counts=[len(polygon) for polygon in asset.polygons],
        corners=np.concatenate(asset.polygons),
        uvs=np.concatenate(asset.corner_uvs),
        materials=[name[2] for name in asset.names],
    )
    (folder / "assets.json").write_text(json.dumps(KEEPS, indent=1))


def cageik(*words: object) -> None:
    """Run the command, which has to succeed."""
    command = [sys.executable, "-m", "cageik_cli", *map(str, words), "--overwrite", "--quiet"]
    subprocess.run(command, check=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
