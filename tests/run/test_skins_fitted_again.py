"""Skins of results whose weights a file cannot hold are fitted again, which is said."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.store.result import read_animation
from tests.clips import frames_of
from tests.run.test_joint_budget import cut_by_height, list_joints
from tests.run.test_rig import EXTRACT, reconstructed
from tests.shapes import finer

SUFFIXES = (".glb", ".usda", ".usdc")
NEGATIVE = "as those of the result are negative in places (down to -"
MANY = "joints move a vertex, of which programs read 8"
CLOSE = ("--fit", "--fit-regularization", 1e-5, "--fit-smoothness", 0)
SHARED = ("--cage", "cage.obj", "-q", "--no-cache")


@pytest.fixture
def make(run, folder, animation, write_obj):
    """Make `cages.h5` of a kind, of a clip that no cage makes exactly.

    The cage has 26 vertices; 8 for captured data, which may not be less than that.
    """
    noise = np.random.default_rng(3).normal(0, 0.2, (5, 18, 3))
    noise[0] = 0  # the rest pose
    frames = np.stack(animation.frames) + noise
    for k, vertices in enumerate(frames, start=1):
        write_obj(Path(f"frames/frame_{k}.obj"), vertices, animation.rest.faces)

    def make(kind):
        cage = animation.cage if kind == "robust" else finer(animation.cage, 1)
        write_obj(folder / "cage.obj", cage.vertices, cage.faces)
        if kind == "parts":
            for path in Path("frames").iterdir():
                path.unlink()
            cut_by_height(animation.rest, frames, 4)
        if kind == "binding":
            words = ("--rest", "frames/frame_1.obj", "--fit", "frames", "-o", "b.h5", *CLOSE[1:])
            assert run("bind", *words, *SHARED).code == 0
            assert run("extract", "frames", "--binding", "b.h5", "-q", "--no-cache").code == 0
            return
        options = {
            "harmonic": (),
            "robust": ("--robust", *CLOSE),
            "rank": ("--fit-rank", 3, *CLOSE),
        }
        assert run(*EXTRACT, *options.get(kind, CLOSE)).code == 0
        if kind == "edit":
            moves = [{"vertex": 0, "offset": [0.1, 0, 0]}]
            Path("edits.json").write_text(json.dumps({"edits": [{"name": "a", "moves": moves}]}))
            Path("cages.h5").rename("whole.h5")
            assert run("pose", "whole.h5", "--cage-edits", "edits.json", "-o", "cages.h5").code == 0

    return make


def measure(path, expected):
    """The rms and the largest distance of a skin in a file from frames, (F, m, 3), percent."""
    found = frames_of(open_sequence([str(path)]))
    distances = np.linalg.norm(found - expected, axis=2)
    percent = 100 * distances / read_animation(Path("cages.h5")).rest.diagonal
    return np.sqrt(np.mean(np.square(percent))), percent.max()


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "kind", ["fitted", "harmonic", "robust", "rank", "parts", "binding", "edit"]
)
def test_a_skeleton_of_any_result_is_written_and_as_near_as_is_said(run, make, kind, suffix):
    make(kind)
    outcome = run("export", "cages.h5", f"c{suffix}", "--skeleton", "-v")
    assert outcome.code == 0, outcome.err
    said = " ".join(outcome.err.split())
    reasons = {NEGATIVE: kind != "harmonic", MANY: kind == "harmonic" and suffix == ".glb"}
    for reason, is_given in reasons.items():
        assert (f"c{suffix}: weights are fitted again, " in said and reason in said) == is_given
    assert ("up to 4 influences per vertex" in said) == any(reasons.values())
    limbs, own = (2, 8) if kind == "robust" else (6, 26)
    assert len(list_joints(Path(f"c{suffix}"))) == 1 + limbs + own
    assert f"{1 + limbs + own} joints (root, {limbs} limbs, {own} that move the mesh)" in said
    follows_cages = kind in ("robust", "edit")
    clip = frames_of(open_sequence(["frames"]))
    if follows_cages:
        clip = read_mesh_of_cages(run)
    opening = "it adds an rms of" if follows_cages else "against the input, an rms of"
    stated = re.search(rf"{opening} (\S+) %, largest (\S+) %", said).groups()
    found = measure(f"c{suffix}", clip)
    np.testing.assert_allclose([float(each) for each in stated], found, rtol=0.06)


def read_mesh_of_cages(run):
    """What the cages give, (F, m, 3)."""
    assert run("deform", "cages.h5", "-o", "m.npz", "--overwrite", "--no-cache").code == 0
    return frames_of(open_sequence(["m.npz"]))


def test_joints_that_translate_keep_to_that(run, make):
    make("fitted")
    outcome = run("export", "cages.h5", "c.usdc", "--skeleton", "--joints", "translate")
    said = " ".join(outcome.err.split())
    assert f"c.usdc: weights are fitted again, {NEGATIVE}" in said
    assert "27 joints (root, 26 that move the mesh); up to 4 influences per vertex" in said
    assert "degrees off" not in said


def test_the_first_note_is_that_weights_are_fitted_again(run, make):
    """Whatever else is noted: the short output has room for one or two."""
    make("fitted")
    shutil.rmtree("frames")
    outcome = run("export", "cages.h5", "c.usdc", "--skeleton", "-v")
    notes = [line for line in outcome.err.splitlines() if line.strip().startswith("note")]
    assert "weights are fitted again" in notes[0]
    assert any("put the input of cages.h5 beside it" in note for note in notes[1:])


def test_weights_that_were_asked_for_need_no_reason(run, make):
    make("fitted")
    for words in (("--influences", 8), ("--joints", 12)):
        outcome = run("export", "cages.h5", "c.glb", "--skeleton", "--overwrite", *words)
        assert outcome.code == 0
        assert "fitted again" not in " ".join(outcome.err.split())


def test_weights_that_are_cut_off_by_little_are_kept(run, make, monkeypatch):
    """By no more than is allowed; the error that is said has what was cut off."""
    make("fitted")
    monkeypatch.setattr("cageik_cli.run.export.MAX_CUT_WEIGHT", 10)
    outcome = run("export", "cages.h5", "c.usdc", "--skeleton", "--joints", "translate")
    said = " ".join(outcome.err.split())
    assert "fitted again" not in said
    assert "up to 4 influences" not in said
    stated = re.search(r"it adds an rms of (\S+) %, largest (\S+) %", said).groups()
    found = measure("c.usdc", reconstructed()[0])
    np.testing.assert_allclose([float(each) for each in stated], found, rtol=0.06)
