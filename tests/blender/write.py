"""Write the walking figure in every format, and beside it what each file has to show.

    python write.py FOLDER

`FOLDER/cases.json` lists the files and how each is to be read; `FOLDER/TRUTH.npz` has `frames`
(F, m, 3), `rest` (m, 3) and `faces` (f, 3), computed here from the arrays of the result alone, or,
of joints that turn, by the skinning of the tests;
`FOLDER/TRUTH_rest.obj` is the model on which caches are put.
"""

import json
import shutil
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import h5py
import numpy as np
from scipy import sparse

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.formats.gltf.decoded import Glb

WALKER = Path(__file__).resolve().parents[2] / "data_fixtures" / "walker"
SINGLE = 1e-6
"""Of the diagonal: some roundings in float32, of the positions and of an object's transform."""

SKINNED = 5e-6
"""Of the diagonal: a sum in float32 over the joints of a vertex."""

LEAST_IN_FILE, LEAST_IN_BLENDER = 1e-7, 1e-5
"""Smaller skin weights are left out by the file, and then by Blender's import."""


@dataclass(frozen=True)
class Case:
    """A file, and how it lies in Blender.

    Attributes
    ----------
    kind : str
        The importer: obj, ply, usd, alembic, gltf, mdd or pc2.
    path, truth : str
        The file, or folder of files, and its positions; within the folder.
    on_model : bool
        Whether the file is put on the model, as a cache, instead of being imported.
    is_turned : bool
        Whether that model has z up itself, as one made in Blender, and not by its object.
    first : float
        Scene frame of sample 0.
    fps : float
        Frames a second that the scene has before the import.
    up_axis, metres_per_unit : str, float
        The space of the file as far as Blender learns of it.
    tolerance : float
        Largest difference of a coordinate, relative to the diagonal of the rest pose.
    """

    kind: str
    path: str
    truth: str
    on_model: bool = False
    is_turned: bool = False
    first: float = 1
    fps: float = 24
    up_axis: str = "Y"
    metres_per_unit: float = 1
    tolerance: float = SINGLE


USD = ("usdc", "usda", "usdz")
Z_UP = {"up_axis": "Z", "metres_per_unit": 0.01}
CAGES_AND_MESHES = (
    Case("obj", "{}", "{}"),
    Case("ply", "{}_ply", "{}", up_axis="Z"),  # its importer turns nothing
    *(Case("usd", f"{{}}.{suffix}", "{}") for suffix in USD),
    Case("alembic", "{}.abc", "{}"),
    Case("usd", "{}.usdc", "{}", on_model=True),
    Case("alembic", "{}.abc", "{}", on_model=True, is_turned=True),
    Case("mdd", "{}.mdd", "{}", on_model=True),
    Case("pc2", "{}.pc2", "{}", on_model=True),
    Case("mdd", "{}.mdd", "{}", on_model=True, is_turned=True),
    Case("pc2", "{}.pc2", "{}", on_model=True, is_turned=True),
    Case("gltf", "{}.glb", "{}", first=0),  # begins at 0 s
    Case("usd", "{}_z.usdc", "{}", first=101, **Z_UP),  # the scene's frames are time codes
    Case("alembic", "{}_z.abc", "{}", first=101, fps=30),  # states neither axis nor unit
    Case("gltf", "{}_z.glb", "{}", first=0, fps=30, **Z_UP),
)
SKELETONS = (
    *(Case("usd", f"skeleton.{suffix}", "skin", tolerance=SKINNED) for suffix in USD),
    Case("usd", "skeleton_z.usdc", "skin", first=101, tolerance=SKINNED, **Z_UP),
    Case("gltf", "skeleton.glb", "skin", first=0, tolerance=SKINNED),
    Case("gltf", "skeleton_z.glb", "skin", first=0, fps=30, tolerance=SKINNED, **Z_UP),
)

TURNING = {
    "turning": (),
    "travelling": ("--root-motion", "extract"),
    "small": ("--joints", "20", "--quantize", "--tolerance", "0.1%"),
}
"""Skins of joints that turn, and their options."""


def main(folder: Path) -> None:
    """Write files, positions and cases into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    result = folder / "walker.h5"
    cageik("extract", WALKER / "frames", "--cage", WALKER / "cage.obj", "--output", result,
           "--frames", "0:48:4", "--no-cache")  # fmt: skip
    cases = []
    for pattern in CAGES_AND_MESHES:
        path = folder / pattern.path
        for truth, words in (("cage", ["export", result]), ("mesh", ["deform", result, "-o"])):
            cageik(*words, str(path).format(truth), *options_of(pattern))
            names = {"path": pattern.path.format(truth), "truth": truth}
            cases.append(asdict(pattern) | names)
    few = folder / "few.h5"
    cageik("extract", WALKER / "frames", "--cage", WALKER / "cage.obj", "--output", few,
           "--frames", "0:48:4", "--no-cache", "--fit", "--influences", "8")  # fmt: skip
    for case in SKELETONS:
        words = ("--skeleton", "--joints", "translate", *options_of(case))
        cageik("export", few, folder / case.path, *words)
        cases.append(asdict(case))
    long = folder / "long.h5"  # as many frames as keys can be left out of
    cageik("extract", WALKER / "frames", "--cage", WALKER / "cage.obj", "--output", long,
           "--no-cache")  # fmt: skip
    for truth, words in TURNING.items():
        for case in list_turning(truth):
            chosen = ["--skeleton", "--influences", "4", *words, *options_of(case)]
            cageik("export", long, folder / case.path, *chosen)
            cases.append(asdict(case))
        write_skinned(folder / f"{truth}.glb", long)
    write_truths(result, few, folder)
    shutil.copyfile(WALKER / "cage.obj", folder / "cage_rest.obj")
    shutil.copyfile(WALKER / "frames" / "walker_1.obj", folder / "mesh_rest.obj")
    (folder / "cases.json").write_text(json.dumps(cases, indent=1))


def list_turning(truth: str) -> list[Case]:
    """The files of a skin of joints that turn; those that are quantised are no USD."""
    cases = [Case("gltf", f"{truth}.glb", truth, first=0, tolerance=SKINNED)]
    if "--quantize" not in TURNING[truth]:
        cases.append(Case("usd", f"{truth}.usdc", truth, tolerance=SKINNED))
    return cases


def write_skinned(path: Path, result: Path) -> None:
    """Write what the tests make of a skinned .glb."""
    with h5py.File(result) as file:
        count = len(file["verts"])
    found = Glb(path)
    frames = np.array([found.skinned(k) for k in range(count)])
    np.savez(path.with_suffix(".npz"), frames=frames, rest=frames[0], faces=found.faces())


def options_of(case: Case) -> list[str]:
    """What the command is told of the scene, and of the files of a folder."""
    scene = "--fps 30 --start 101 --up-axis Z --metres-per-unit 0.01"
    chosen = ["--frame-step", "1", *(scene.split() if "_z." in case.path else [])]
    return [*chosen, "--format", "ply"] if case.kind == "ply" else chosen


def cageik(*words: object) -> None:
    """Run the command, which has to succeed."""
    command = [sys.executable, "-m", "cageik_cli", *map(str, words), "--overwrite", "--quiet"]
    subprocess.run(command, check=True)


def write_truths(result: Path, few: Path, folder: Path) -> None:
    """Cages, weights times cages, and few weights times cages with what they lack, turned."""
    with h5py.File(result) as file:
        cages, weights = file["verts"][:], file["weights"][:]
        cage, faces = file["cage/verts"][:], file["tris"][:]
        rest, corners = file["rest/verts"][:], file["rest/tris"][:]
    with h5py.File(few) as file:
        joints, rotations = file["verts"][:], file["rotations"][:]
        entries = [file[f"weights_csr/{name}"][:] for name in ("data", "indices", "indptr")]
    skin = skin_of(sparse.csr_array(tuple(entries), shape=weights.shape).toarray())
    skinned = skin @ joints + (rest - skin @ cage) @ rotations
    np.savez(folder / "cage.npz", frames=cages, rest=cage, faces=faces)
    np.savez(folder / "mesh.npz", frames=weights @ cages, rest=rest, faces=corners)
    np.savez(folder / "skin.npz", frames=skinned, rest=rest, faces=corners)


def skin_of(weights: np.ndarray) -> np.ndarray:
    """Weights (m, n) without what skinning leaves out, rows scaled to one."""
    for least in (LEAST_IN_FILE, LEAST_IN_BLENDER):
        kept = np.where(weights < least, 0, weights)
        weights = kept / kept.sum(axis=1, keepdims=True)
    return weights


if __name__ == "__main__":
    main(Path(sys.argv[1]))
