"""`cageik cage`: what is given, what is reported, and what is refused."""

import json
from pathlib import Path

import h5py
import pytest

from cageik_cli.formats.obj.frames import encode_exact_obj
from tests.cages.builder.test_limbs import make_rod
from tests.shapes import octahedron

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("folder", "coarse_grids")]
TYPED = ("cage", "frames/frame_1.obj", "-o", "built.obj", "--vertices", "20")


def test_a_cage_that_extract_takes(run):
    outcome = run(*TYPED)
    assert (outcome.code, outcome.out) == (0, "")
    assert outcome.err.startswith("built.obj\n  model          frame_1.obj: 18 vertices")
    assert outcome.err.endswith("wrote built.obj; next: cageik extract FRAMES --cage built.obj\n")
    assert "candidate " not in outcome.err
    assert run("check", "--cage", "built.obj", "frames").code == 0
    assert run("extract", "frames", "--cage", "built.obj", "-q").code == 0


@pytest.mark.parametrize("words", [("--rest-frame", "2"), ("--rest", "frames/frame_3.obj")])
def test_the_next_command_has_the_same_rest_pose(run, words):
    outcome = run("cage", "frames", *TYPED[2:], *words)
    assert outcome.err.endswith(f"extract FRAMES --cage built.obj {' '.join(words)}\n")
    assert run("extract", "frames", "--cage", "built.obj", *words, "-q").code == 0


def test_quads_are_written_as_quads_and_found_fit(run):
    outcome = run(*TYPED, "--quads")
    faces = [line for line in Path("built.obj").read_text().splitlines() if line.startswith("f ")]
    quads = sum(len(line.split()) == 5 for line in faces)
    assert quads > 0
    assert f"20 vertices, {quads} quads, {len(faces) - quads} triangles" in outcome.err
    assert run("check", "--cage", "built.obj", "frames").code == 0
    assert run("extract", "frames", "--cage", "built.obj", "-q").code == 0


def test_loops_are_counted_in_the_recipe_and_the_record(run):
    rod = make_rod(bend=0.06)
    Path("rod.obj").write_bytes(encode_exact_obj(rod.vertices, rod.faces))
    outcome = run("cage", "rod.obj", "-o", "rod_cage.obj", "--vertices", "50", "--loops", "-q")
    assert outcome.err == ""
    words = ("--vertices", "50", "--loops", "--json", "-", "--overwrite")
    outcome = run("cage", "rod.obj", "-o", "rod_cage.obj", *words)
    record = json.loads(outcome.out)
    assert record["settings"]["loops"] is True
    loops = record["cage"]["loops"]
    assert loops >= 2
    assert f", {loops} loops around " in " ".join(outcome.err.split())
    assert run("check", "--cage", "rod_cage.obj", "rod.obj").code == 0


def test_loops_that_are_symmetric_are_refused(run):
    outcome = run(*TYPED, "--symmetric", "auto", "--loops")
    assert outcome.code == 2
    assert "--loops and --symmetric do not go together" in " ".join(outcome.err.split())


def test_quiet_and_verbose(run):
    assert run(*TYPED, "-q").err == ""
    outcome = run(*TYPED, "-v", "--overwrite")
    assert "  candidate      shell 4 % closed by 8 %: 20 vertices, genus 0" in outcome.err


def test_json_on_stdout_is_alone_there(run):
    outcome = run(*TYPED, "--json", "-", "--for", "frames")
    assert outcome.err.startswith("measuring cages on frames, which takes half a minute or more\n")
    record = json.loads(outcome.out)
    assert [known["is_valid"] for known in record["candidates"][:1]] == [True]
    assert any("shifted" in known["recipe"] for known in record["candidates"])
    assert record["cage"]["error_percent"] > 0
    assert "error " in outcome.err


def test_a_symmetric_cage_says_so_and_the_check_of_it_too(run):
    outcome = run(*TYPED, "--symmetric", "auto", "--json", "record.json")
    assert "20 vertices, 36 triangles, genus 0, symmetric about the plane x = 0\n" in outcome.err
    record = json.loads(Path("record.json").read_text())
    assert record["settings"]["symmetric"] == "auto"
    assert record["cage"]["symmetry"] == "the plane x = 0"
    outcome = run("check", "--cage", "built.obj", "frames", "-v")
    assert "genus 0, symmetric about the plane x = 0\n" in outcome.out + outcome.err
    assert run("extract", "frames", "--cage-vertices", "20", "--symmetric", "x").code == 0
    with h5py.File("cages.h5") as file:
        assert "cage/partners" in file
        assert json.loads(file.attrs["settings"])["cage_symmetric"] == "x"


@pytest.mark.parametrize("spelt", ["2%", "2 %", "2", "2.0"])
def test_a_clearance_is_in_percent(run, spelt):
    outcome = run(*TYPED, "--clearance", spelt, "--json", "-", "-q")
    assert json.loads(outcome.out)["settings"]["clearance_percent"] == 2


def test_models_of_equal_counts_and_other_faces_are_no_clip(run, write_obj):
    """The cage would be that of the first, whichever was meant."""
    mesh = octahedron()
    write_obj(Path("models/hat.obj"), mesh.vertices, mesh.faces)
    write_obj(Path("models/shoe.obj"), mesh.vertices, mesh.faces[::-1])
    outcome = run("cage", "models", *TYPED[2:])
    assert outcome.code == 1
    assert "shoe.obj: triangle 0 joins" in outcome.err
    assert "name the one mesh that the cage is for, such as models/hat.obj" in outcome.err
    Path("models/shoe.obj").write_text("v 0 0")  # a damaged frame, which is not needed
    assert run("cage", "models", *TYPED[2:]).code == 0
