"""The fixtures are what their script makes, and what the README says of them."""

import filecmp
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.cages.check.enclosure import check_enclosure
from cageik_cli.formats.open import load_mesh, open_sequence
from tests.texts import texts

FOLDER = Path(__file__).parent.parent / "data_fixtures"


def test_the_script_makes_the_fixtures_byte_for_byte(tmp_path):
    subprocess.run([sys.executable, FOLDER / "make_fixtures.py", tmp_path], check=True)
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    names = ("walker", "posed", "broken")
    held = sorted(
        path.relative_to(FOLDER)
        for name in names
        for path in (FOLDER / name).rglob("*")
        if path.is_file()
    )
    assert made == held
    differing = [
        str(path) for path in made if not filecmp.cmp(tmp_path / path, FOLDER / path, shallow=False)
    ]
    assert differing == []


def test_the_fixtures_are_small():
    held = sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file())
    assert held < 6_000_000


def test_the_walker_is_closed_articulated_and_held_by_its_cage():
    sequence = open_sequence([str(FOLDER / "walker/frames")])
    rest = sequence.first
    assert len(sequence) == 48
    assert sequence.names[:3] == ("walker_1.obj", "walker_2.obj", "walker_3.obj")
    assert len(rest.vertices) >= 1500
    assert rest.is_closed
    assert rest.components.max() == 0
    cage = load_mesh(FOLDER / "walker/cage.obj").mesh
    assert 40 <= len(cage.vertices) <= 80
    assert texts(check_enclosure(cage, rest).notes) == ()
    travelled = np.linalg.norm(sequence.read_frame(47).mean(axis=0) - rest.vertices.mean(axis=0))
    assert travelled > rest.diagonal


@pytest.mark.parametrize("name", ["surface", "tetrahedron"])
def test_posed_frames_are_weights_times_known_cages(name):
    folder = FOLDER / "posed" / name
    truth = np.load(folder / "cages.npz")
    cage = load_mesh(folder / "cage.obj").mesh
    np.testing.assert_array_equal(truth["verts"][0], cage.vertices)
    np.testing.assert_array_equal(truth["tris"], cage.faces)
    sequence = open_sequence([str(folder / "frames")])
    assert len(sequence) == len(truth["verts"])
