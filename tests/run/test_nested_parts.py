"""Parts below parts, from glTF to USD: what the notes say is in the files."""

import re
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from scipy.spatial.transform import Rotation

from cageik_cli.formats.open import open_sequence
from tests.clips import frames_of
from tests.formats.clips import faults_of
from tests.formats.gltf.built import Built
from tests.shapes import box, finer

FRAMES = 6


@pytest.fixture
def truck(tmp_path, monkeypatch):
    """A body that slides, and below its node a wheel that turns."""
    monkeypatch.chdir(tmp_path)
    file, mesh = Built(), finer(box(1.0), 2)
    for k, (name, size) in enumerate((("body", 1.0), ("wheel", 0.4))):
        attributes = {"POSITION": file.array(size * mesh.vertices[mesh.faces.ravel()])}
        file.add("meshes", {"primitives": [{"attributes": attributes}]})
        file.add("nodes", {"name": name, "mesh": k})
    file.json["nodes"][0]["children"] = [1]
    file.json["nodes"][1]["translation"] = [1.6, 0, 0]
    keys = np.arange(FRAMES) / 24
    turns = Rotation.from_rotvec(np.outer(np.arange(FRAMES), [0, 0, 0.35])).as_quat()
    slides = np.outer(np.arange(FRAMES), [0.1, 0, 0])
    file.animate(
        "", (0, "translation", keys, slides, "LINEAR"), (1, "rotation", keys, turns, "LINEAR")
    )
    return file.save(Path("truck.glb"))


def test_the_stated_error_is_that_of_the_file_as_usd_poses_it(run, truck, coarse_panels):
    assert run("extract", "truck.glb", "--cage-vertices", "60", "-o", "t.h5", "-q").code == 0
    outcome = run("export", "t.h5", "t.usdc", "--skeleton", "--influences", "4")
    assert outcome.code == 0, outcome.err
    stated = float(re.search(r"largest ([\d.e-]+) %", " ".join(outcome.err.split()))[1])
    expected = frames_of(open_sequence(["truck.glb"]))
    assert faults_of("t.usdc") == []
    stage = Usd.Stage.Open("t.usdc")
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetDefaultPrim()))
    names = ("/cage/body/bodyShape", "/cage/body/wheel")
    points = [UsdGeom.Mesh(stage.GetPrimAtPath(name)).GetPointsAttr() for name in names]
    found = np.array([np.vstack([each.Get(k) for each in points]) for k in range(FRAMES)])
    diagonal = np.linalg.norm(np.ptp(expected[0], axis=0))
    largest = 100 * np.linalg.norm(found - expected, axis=2).max() / diagonal
    assert largest == pytest.approx(stated, rel=0.05)
    wheel = len(expected[0]) // 2
    assert np.linalg.norm(np.ptp(found[:, wheel:], axis=0), axis=1).max() > 0.3


@pytest.mark.parametrize(
    "command", [("export", "--with-model"), ("deform", "-o")], ids=["export", "deform"]
)
def test_caches_of_it_are_sound_and_read_by_the_old_names(run, truck, coarse_panels, command):
    assert run("extract", "truck.glb", "--cage-vertices", "60", "-o", "t.h5", "-q").code == 0
    verb, option = command
    words = ("t.usdz", option) if option != "-o" else (option, "t.usdz")
    assert run(verb, "t.h5", *words, "-q").code == 0
    assert faults_of("t.usdz") == []
    sequence = open_sequence(["t.usdz::body"])
    assert [name.rpartition("/")[2] for name in sequence.first.attributes.parts.names] == [
        "body",
        "wheel",
    ]
    assert run("deform", "t.h5", "-o", "t.npz", "-q").code == 0
    expected = frames_of(open_sequence(["t.npz"]))
    np.testing.assert_allclose(frames_of(sequence), expected, rtol=0, atol=1e-6 * 6)
