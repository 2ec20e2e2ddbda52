"""Joints of skeletons are counted in the files, by libraries of others."""

from pathlib import Path

import numpy as np
import pygltflib
import pytest
from pxr import Usd, UsdSkel

from cageik_cli.formats.open import open_sequence
from tests.conftest import run_in_process

WALKER = Path(__file__).parents[2] / "data_fixtures" / "walker"
COUNTS = (12, 20, 24, 32, 64)
FULL = 93
"""The root, 12 limbs, and a joint for each of the 80 vertices of the cage."""


def list_joints(path):
    """The names of the joints in a file."""
    if path.suffix == ".glb":
        scene = pygltflib.GLTF2().load(str(path))
        (skin,) = scene.skins
        return [scene.nodes[joint].name for joint in skin.joints]
    stage = Usd.Stage.Open(str(path))
    (prim,) = (prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton))
    return list(UsdSkel.Skeleton(prim).GetJointsAttr().Get())


def cut_by_height(mesh, frames, count):
    """OBJ files of frames whose faces are in `count` parts, from the lowest to the highest."""
    heights = mesh.vertices[mesh.faces].mean(axis=1)[:, 1]
    parts = np.array_split(np.argsort(heights), count)
    for k, vertices in enumerate(frames, start=1):
        lines, base = [], 1
        for number, chosen in enumerate(parts):
            used, faces = np.unique(mesh.faces[chosen], return_inverse=True)
            lines.append(f"o part_{number}")
            lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices[used].tolist()]
            lines += [f"f {a} {b} {c}" for a, b, c in faces.reshape(-1, 3) + base]
            base += len(used)
        path = Path(f"frames/f_{k}.obj")
        path.parent.mkdir(exist_ok=True)
        path.write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module", params=[1, 4])
def walker(request, tmp_path_factory):
    """A folder with a few frames of the walker, in some parts, and their cages."""
    folder = tmp_path_factory.mktemp("walker")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("CAGEIK_CACHE", str(folder / "cache"))
        clip = open_sequence([str(WALKER / "frames")])
        cut_by_height(clip.first, [clip.read_frame(k) for k in range(0, 48, 8)], request.param)
        words = ("extract", "frames", "--cage", WALKER / "cage.obj", "-q", "--accuracy", "preview")
        assert run_in_process(*words).code == 0
    return folder


@pytest.fixture
def export(walker, run, monkeypatch):
    """Export the walker to a file, and return the joints in it and what was said."""
    for name in ("ROUNDS", "MERGED_ROUNDS"):  # no count depends on how well weights are fitted
        monkeypatch.setattr(f"cageik_cli.rigs.skinning.{name}", 1)
    monkeypatch.chdir(walker)
    monkeypatch.setenv("CAGEIK_CACHE", str(walker / "cache"))

    def write(name, *words):
        outcome = run("export", "cages.h5", name, "--skeleton", "--overwrite", *words)
        assert outcome.code == 0, outcome.err
        return list_joints(Path(name)), " ".join(outcome.err.split())

    return write


@pytest.mark.parametrize("suffix", [".glb", ".usdc"])
@pytest.mark.parametrize("count", COUNTS)
def test_a_file_has_as_many_joints_as_were_asked_for(export, count, suffix):
    """Its limbs are no joints, but joints are still named by them."""
    names, said = export(f"c{suffix}", "--joints", count)
    assert len(names) == len(set(names)) == count
    assert f"{count} joints (root, {count - 1} that move the mesh)" in said
    assert f"of {count} joints that move" in said
    if count >= 24:
        assert sum(name.endswith("_02") for name in names) > 1


@pytest.mark.parametrize("suffix", [".glb", ".usdc"])
@pytest.mark.parametrize("count", [4, 81, 82, 90, FULL])
def test_limbs_are_left_out_before_joints_are_merged(export, count, suffix):
    names, said = export(f"c{suffix}", "--joints", count)
    limbs = max(0, count - 81)
    kinds = {0: "", 1: "1 limb, "}.get(limbs, f"{limbs} limbs, ")
    assert len(names) == count
    assert f"{count} joints (root, {kinds}{min(80, count - 1)} that move the mesh)" in said


@pytest.mark.parametrize("suffix", [".glb", ".usdc"])
def test_an_extracted_root_counts_as_two(export, suffix):
    names, said = export(f"c{suffix}", "--joints", 20, "--root-motion", "extract")
    assert len(names) == 20
    assert "20 joints (root, body, 18 that move the mesh)" in said


@pytest.mark.parametrize("suffix", [".glb", ".usdc"])
def test_all_joints_are_counted_without_a_budget(export, suffix):
    names, said = export(f"c{suffix}", "--influences", 4)
    assert len(names) == FULL
    assert "93 joints (root, 12 limbs, 80 that move the mesh); up to 4" in said
    names, said = export(f"t{suffix}", "--influences", 4, "--joints", "translate")
    assert len(names) == 81
    assert "81 joints (root, 80 that move the mesh); up to 4" in said


@pytest.mark.parametrize("count", [3, 94])
def test_what_no_skeleton_has_is_refused_with_the_numbers_it_can_have(walker, run, count):
    outcome = run("export", walker / "cages.h5", "c.glb", "--skeleton", "--joints", count)
    assert outcome.code == 1
    assert f"--joints {count}, and the skeleton of a cage of 80 vertices" in outcome.err
    assert "has 4 joints at least and 93 at most; give 4 to 93" in " ".join(outcome.err.split())


def test_fewer_joints_than_influences_have_as_many(export):
    _, said = export("c.glb", "--joints", 4, "--influences", 8)
    assert "up to 3 influences per vertex" in said
