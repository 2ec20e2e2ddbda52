"""`cageik cage`: what is typed, what is told, and what is refused."""

import json

import pytest

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


def test_quiet_and_verbose(run):
    assert run(*TYPED, "-q").err == ""
    outcome = run(*TYPED, "-v", "--overwrite")
    assert "  candidate      shell 4 % closed by 8 %: 20 vertices, genus 0" in outcome.err


def test_json_on_stdout_is_alone_there(run):
    outcome = run(*TYPED, "--json", "-", "--for", "frames")
    record = json.loads(outcome.out)
    assert [known["is_valid"] for known in record["candidates"][:1]] == [True]
    assert any("shifted" in known["recipe"] for known in record["candidates"])
    assert record["cage"]["error_percent"] > 0
    assert "error " in outcome.err


@pytest.mark.parametrize("spelt", ["2%", "2 %", "2", "2.0"])
def test_a_clearance_is_in_percent(run, spelt):
    outcome = run(*TYPED, "--clearance", spelt, "--json", "-", "-q")
    assert json.loads(outcome.out)["settings"]["clearance_percent"] == 2
