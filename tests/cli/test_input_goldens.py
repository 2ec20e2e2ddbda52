"""What is said of the inputs that commands are given, word by word.

Each line of `goldens/inputs.txt` that begins with `$` is run in one folder of meshes, clips and
results. They are in several units, with several axes, orders of vertices and parts; some are no
such thing at all. Below it are the exit code, the error, and what else is said.
"""

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.settings import Scene
from cageik_cli.formats.write import write_mesh as write_posed_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import join_meshes
from tests.cli.test_goldens import GOLDENS, compare
from tests.cli.test_units import (
    HERE,
    SCENES,
    UP_TURNS,
    bend,
    make_cage,
    make_rest,
    prepared,
    read_positions,
    write_clip,
    write_mesh,
)
from tests.conftest import run_in_process
from tests.shapes import box

__all__ = ["prepared"]

INPUTS = GOLDENS / "inputs.txt"
LINES = re.findall(r"^\$ cageik (.*)$", INPUTS.read_text(encoding="utf-8"), re.MULTILINE)

FILM = np.arange(3)
"""Frames of the clips of parts."""


def shift(mesh: TriMesh, offset: list[float]) -> TriMesh:
    return mesh.move(mesh.vertices + np.array(offset))


def write_models(folder: Path) -> None:
    """Write the model, in several scenes and with other vertices."""
    rest = make_rest()
    for name, scene in SCENES.items():
        write_mesh(folder / f"rest_{name.replace(',', '')}.obj", rest, scene)
    write_mesh(folder / "rest.obj", rest, HERE)
    write_mesh(folder / "rest_iny.usdc", rest, SCENES["in,y"])
    write_clip(folder / "rest_lie.usdc", rest, rest.vertices[None], SCENES["m,z"])
    write_mesh(folder / "rest_longer.obj", rest.move(1.8 * rest.vertices), HERE)
    write_mesh(
        folder / "rest_lying.obj", rest.move(bend(rest.vertices, 2) @ UP_TURNS["Z", "Y"]), HERE
    )
    write_mesh(folder / "rest_other.obj", make_cage(), HERE)
    write_mesh(
        folder / "prop.obj", rest.move((rest.vertices - [0, 0, 90]) * 0.05 + [5, 4, 120]), HERE
    )
    write_mesh(folder / "outside.obj", shift(rest, [40, 0, 0]), HERE)
    lines = ["ply", "format ascii 1.0", f"element vertex {len(rest.vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"] + ["end_header"]
    lines += [" ".join(f"{value:.6g}" for value in vertex) for vertex in rest.vertices]
    (folder / "points.ply").write_text("\n".join(lines) + "\n")


def write_cages(folder: Path) -> None:
    """Write the cage in several scenes, too small, elsewhere and open; and edited cages."""
    cage = make_cage()
    for name in ("m,z", "cm,y", "mm,z"):
        write_mesh(folder / f"cage_{name.replace(',', '')}.obj", cage, SCENES[name])
    write_mesh(folder / "cage_iny.usdc", cage, SCENES["in,y"])
    changes = {
        "small": cage.move(cage.vertices * [0.95, 0.95, 0.99]),
        "far": shift(cage, [300, 0, 0]),
        "lower": shift(cage, [0, 0, -180]),
        "big": cage.move(3.3 * cage.vertices),
        "open": type(cage)(cage.vertices, cage.faces[1:]),
    }
    for name, changed in changes.items():
        write_mesh(folder / f"cage_{name}.obj", changed, HERE)
    frames = read_positions("plain.npz")
    write_clip(folder / "edit.npz", cage, frames + np.array([0, 0, 1]), Scene())
    write_clip(folder / "edit_tenfold.npz", cage, 10 * frames, Scene())
    write_clip(folder / "edit_tenfold.pc2", cage, 10 * frames, HERE)
    write_clip(folder / "edit_lying.pc2", cage, frames @ UP_TURNS["Z", "Y"], HERE)
    write_clip(folder / "edit_stretched.pc2", cage, frames * [1, 1, 2.2], HERE)
    write_clip(folder / "edit_longer.pc2", cage, np.concatenate([frames, frames]), HERE)
    write_clip(folder / "edit_lie.usdc", cage, frames, SCENES["m,z"])
    write_clip(folder / "edit_iny.usdc", cage, frames / 2.54 @ UP_TURNS["Z", "Y"], SCENES["in,y"])
    write_clip(folder / "edit_gap/edit_####.obj", cage, frames, HERE)
    (folder / "edit_gap" / "edit_0002.obj").unlink()
    order = np.roll(np.arange(len(cage.vertices)), 1)
    turned = type(cage)(cage.vertices[order], np.argsort(order)[cage.faces])
    write_clip(folder / "edit_renumbered.npz", turned, frames[:, order], Scene())
    write_clip(folder / "edit_other.npz", make_rest(), make_rest().vertices[None], Scene())


def write_parts(folder: Path) -> None:
    """Write a model of three parts: clips, and rest poses with another order, or fewer parts."""
    body, eye, hat = make_rest(), box(4.0), box(6.0)
    eye, hat = shift(eye, [8, 12, 150]), shift(hat, [0, 0, 160])
    parts = {"body": body, "eye": eye, "hat": hat}

    def join(*names: str):
        return join_meshes([parts[name] for name in names], names)

    for stem, names in {
        "hero": ("body", "eye", "hat"),
        "hero_swapped": ("body", "hat", "eye"),
        "hero_bald": ("body", "eye"),
        "hero_renamed": ("body", "eye", "cap"),
    }.items():
        parts["cap"] = hat
        mesh = join(*names)
        if stem == "hero_swapped":
            write_clip(folder / f"{stem}.usdc", mesh, mesh.vertices[None], HERE)
        else:
            write_posed_mesh(folder / f"{stem}.obj", mesh, mesh.vertices, False)
    whole = join("body", "eye", "hat")
    frames = np.stack([bend(whole.vertices, k) for k in FILM])
    write_clip(folder / "hero/hero_####.obj", whole, frames, HERE)
    write_clip(folder / "hero_clip.usdc", whole, frames, HERE)
    bald = join("body", "eye")
    write_clip(folder / "bald.usdc", bald, np.stack([bend(bald.vertices, k) for k in FILM]), HERE)
    swapped = join("body", "hat", "eye")
    write_clip(
        folder / "swapped.usdc", swapped, np.stack([bend(swapped.vertices, k) for k in FILM]), HERE
    )
    (folder / "stl").mkdir()
    for k in FILM:
        posed = trimesh.Trimesh(bend(body.vertices, k), body.faces, process=False)
        posed.export(folder / "stl" / f"stl_{k + 1:04}.stl")


@pytest.fixture
def here(prepared, tmp_path, monkeypatch, coarse_panels, coarse_grids):
    """The current folder, with all inputs."""
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAGEIK_CACHE", str(tmp_path / "cache"))
    assert run_in_process("export", "cages.h5", "plain.npz", "-q").code == 0
    words = ("bind", "--rest", "rest.obj", "--cage", "cage.obj", "-o", "binding.h5", "-q")
    write_models(tmp_path)
    write_cages(tmp_path)
    write_parts(tmp_path)
    assert run_in_process(*words).code == 0
    handles = [{"name": "top", "vertex": 4, "offset": [1, 2, 3]}]
    handles.append({"name": "foot", "vertex": 5, "pin": True})
    (tmp_path / "top.json").write_text(json.dumps({"handles": handles}))
    (tmp_path / "text.obj").write_text("no mesh\n")
    (tmp_path / "scene.fbx").write_text("no mesh\n")
    (tmp_path / "empty").mkdir()
    return tmp_path


def show(line: str) -> str:
    """Return the exit code of a command, and what it says: its error, or its findings and notes."""
    outcome = run_in_process(*shlex.split(line), "-v")
    found = [line for line in outcome.err.splitlines() if line.startswith("Error: ")]
    label = ""
    for text in (outcome.err + outcome.out).splitlines():
        label = text[:17].strip() or label if text.startswith("  ") else ""
        if label in ("note", "notes", "warning", "unfit", "to repair"):
            found.append(text)
    return "\n".join([f"$ cageik {line}", f"{outcome.code}:", *found]) + "\n"


def test_what_is_said_of_inputs_is_as_before(here):
    compare("\n".join(map(show, LINES)), INPUTS)
