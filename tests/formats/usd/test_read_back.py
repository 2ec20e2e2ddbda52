"""Rigs and scenes in USD that cageik wrote, read again: what `deform` gives."""

import shutil

import numpy as np
import pytest

from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.geometry.parts import list_part_names
from tests.character import NAMES
from tests.clips import frames_of
from tests.texts import texts

SINGLE = 2e-6
"""Of the diagonal: sums of joints in single precision."""


@pytest.fixture
def hero(character_result, tmp_path, monkeypatch):
    """The folder of the result of the character of four parts."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(character_result.path, tmp_path / "cages.h5")
    return tmp_path


def compare(run, command, same, member="", names=None):
    """Run a command; what its file holds is what `deform` gives, or the cages if that is None."""
    outcome = run(*command.split(), "--overwrite")
    assert outcome.code == 0, outcome.err
    expected = open_sequence(["cages.h5"])
    if same is not None:
        words = ("deform", "cages.h5", "-o", "same.npz", "-q", "--overwrite")
        assert run(*words, *same.split()).code == 0
        expected = open_sequence(["same.npz"])
    clip = open_sequence([f"rig.usdc{member}"])
    np.testing.assert_array_equal(clip.first.faces, expected.first.faces)
    np.testing.assert_allclose(
        frames_of(clip), frames_of(expected), rtol=0, atol=SINGLE * expected.first.diagonal
    )
    assert clip.scene.start == 1
    assert names is None or list_part_names(clip.first) == names
    return clip


@pytest.mark.parametrize(
    ("command", "same", "member"),
    [
        ("deform cages.h5 -o rig.usdc", "", ""),
        ("export cages.h5 rig.usdc --with-model", "", "::/cage/model"),
        ("export cages.h5 rig.usdc --with-model", None, "::/cage/cage"),
        ("export cages.h5 rig.usdc --skeleton --influences 4", "--influences 4", ""),
        (
            "export cages.h5 rig.usdc --skeleton --influences 4 --with-model",
            "--influences 4",
            "::/cage/mesh",
        ),
    ],
)
def test_what_commands_write_is_read_back(extracted, run, command, same, member):
    clip = compare(run, command, same, member)
    mesh = load_mesh(f"rig.usdc{member}").mesh
    np.testing.assert_array_equal(mesh.vertices, clip.first.vertices)


def test_a_guide_is_left_out(extracted, run):
    command = "export cages.h5 rig.usdc --skeleton --influences 4 --with-model --guide"
    clip = compare(run, command, "--influences 4")
    assert "rig.usdc: left out /cage/cage (purpose guide)" in texts(clip.notes)


def test_a_character_is_read_back_in_its_parts(hero, run):
    compare(run, "deform cages.h5 -o rig.usdc", "", names=NAMES)
    skeleton = "export cages.h5 rig.usdc --skeleton --influences 4"
    clip = compare(run, skeleton, "--influences 4", names=NAMES)
    assert "rig.usdc: posed by the skeleton /hero/skeleton" in texts(clip.notes)
    compare(run, f"{skeleton} --with-model --guide", "--influences 4", names=NAMES)
    compare(run, "export cages.h5 rig.usdc --with-model --guide", "", names=NAMES)
