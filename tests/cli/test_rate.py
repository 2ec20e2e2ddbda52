"""`--fps`: every command that samples a rig does so at the rate that is given."""

from pathlib import Path

import numpy as np
import pytest

from cageik_cli.store.binding_file import read_binding
from tests.formats.gltf.built import Built
from tests.shapes import ball

SECONDS = 0.5
LAST = {24: 12, 10: 5}
"""The number of the last frame, by the rate."""


@pytest.fixture
def rig(folder):
    """The current folder, with a ball that a node moves for half a second."""
    file, mesh = Built(), ball(1, 0.8)
    primitive = {
        "attributes": {"POSITION": file.array(mesh.vertices)},
        "indices": file.array(mesh.faces.ravel(), "H"),
    }
    file.add("nodes", {"name": "ball", "mesh": file.add("meshes", {"primitives": [primitive]})})
    places = np.array([[0, 0, 0], [0, 0.3, 0]])
    file.animate("rise", (0, "translation", [0, SECONDS], places, "LINEAR"))
    return file.save(folder / "rig.glb")


@pytest.mark.parametrize(
    "command", ["check rig.glb --cage cage.obj", "cage rig.glb -o new.obj", "extract rig.glb"]
)
@pytest.mark.parametrize("rate", LAST)
def test_the_last_frame_is_that_of_the_rate(run, rig, command, rate):
    words = [*command.split(), "--fps", rate, "--rest-frame"]
    outcome = run(*words, LAST[rate] + 1)
    assert outcome.code == 1
    assert f"the clip has {LAST[rate] + 1} frames" in outcome.err


@pytest.mark.parametrize("rate", LAST)
def test_a_fit_of_a_binding_takes_the_frames_of_the_rate(run, rig, rate):
    words = ("--cage", "cage.obj", "--rest", "rig.glb", "--fit", "rig.glb", "--fps", rate)
    outcome = run("bind", *words)
    assert outcome.code == 0, outcome.err
    assert run("info", "rig.glb", "--fps", rate).out.count(f"rig.glb[{LAST[rate]}]") == 1
    (clip,) = read_binding(Path("binding.h5")).fit.clips
    assert clip.frames == LAST[rate] + 1


@pytest.mark.parametrize("rate", ["0", "-24", "nan"])
def test_a_rate_that_is_none_is_refused(run, rig, rate):
    outcome = run("info", "rig.glb", "--fps", rate)
    assert outcome.code == 2
    assert f"{float(rate):g} frames per second" in outcome.err


def test_a_rate_without_a_clip_to_fit_is_wrong_usage(run, rig):
    outcome = run("bind", "--cage", "cage.obj", "--rest", "rig.glb", "--fps", "10")
    assert outcome.code == 2
    assert "--fps" in outcome.err
