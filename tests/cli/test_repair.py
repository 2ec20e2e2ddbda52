"""`cageik cage --repair`: a user's cage made fit, or refused with what is left."""

import json
from pathlib import Path

import pytest

from tests.shapes import quad_text

pytestmark = pytest.mark.usefixtures("folder")
TYPED = ("cage", "--repair", "mine.obj", "--rest", "frames/frame_1.obj", "-o", "mended.obj")


@pytest.fixture
def turned(folder):
    """Write a box of quads around the model, one of whose faces is turned inward."""
    lines = quad_text(2.0).splitlines()
    face = next(k for k, line in enumerate(lines) if line.startswith("f "))
    lines[face] = "f " + " ".join(reversed(lines[face].split()[1:]))
    Path("mine.obj").write_text("\n".join(lines) + "\n")


def read_lines(path, word):
    return [line.split()[1:] for line in Path(path).read_text().splitlines() if line[:2] == word]


@pytest.mark.usefixtures("turned")
def test_a_turned_quad_is_turned_and_stays_a_quad(run):
    outcome = run(*TYPED)
    assert (outcome.code, outcome.out) == (0, ""), outcome.err
    assert "moved          no vertex" in outcome.err
    assert [len(face) for face in read_lines("mended.obj", "f ")] == [4] * 6
    vertices = [list(map(float, row)) for row in read_lines("mine.obj", "v ")]
    assert [list(map(float, row)) for row in read_lines("mended.obj", "v ")] == vertices
    assert run("check", "--cage", "mended.obj", "frames").code == 0


@pytest.mark.usefixtures("turned")
def test_the_record_names_each_step(run):
    record = json.loads(run(*TYPED, "--json", "-").out)
    assert record["is_fit"] is True
    assert "turn" in [step["kind"] for step in record["steps"]]
    assert record["moved_vertices"] == []
    assert record["vertex_map"] == list(range(8))


def test_a_cage_that_is_too_small_is_pushed_out(run):
    Path("mine.obj").write_text(quad_text(0.97))
    outcome = run(*TYPED)
    assert outcome.code == 0, outcome.err
    assert "no vertex" not in outcome.err
    assert run("check", "--cage", "mended.obj", "frames").code == 0


def test_what_cannot_be_repaired_is_refused_and_nothing_is_written(run):
    Path("mine.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    outcome = run(*TYPED)
    assert outcome.code == 1
    assert outcome.err.startswith("Error: mine.obj: ")
    assert not Path("mended.obj").exists()
