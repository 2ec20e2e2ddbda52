"""`cageik check`: verdicts are exit codes, text and data go where they belong."""

import json
from pathlib import Path

import pytest

TYPED = ("check", "frames", "--cage", "cage.obj")
UNFIT = (
    "cage_open", "cage_non_manifold", "cage_two_components", "cage_degenerate_face",
    "cage_zero_area", "cage_duplicate_faces", "cage_mixed_orientation", "cage_too_small",
    "cage_unreferenced_vertex", "cage_self_crossing", "cage_pinched", "swapped",
)  # fmt: skip


def test_a_fit_cage_is_exit_code_0(run, folder):
    outcome = run(*TYPED)
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("cage.obj: fit\n")


def test_a_usable_cage_is_exit_code_0(run, fixtures_folder):
    outcome = run("check", "--cage", fixtures_folder / "broken/cage_inside_out/cage.obj")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("cage.obj: usable\n")


@pytest.mark.parametrize("case", UNFIT)
def test_an_unfit_cage_is_exit_code_1_in_the_words_of_extract(
    run, fixtures_folder, tmp_path, monkeypatch, case
):
    monkeypatch.chdir(fixtures_folder / "broken" / case)
    outcome = run(*TYPED)
    assert (outcome.code, outcome.err) == (1, "")
    assert outcome.out.startswith("cage.obj: unfit\n")
    refused = run("extract", *TYPED[1:], "-o", tmp_path / "cages.h5")
    assert refused.code == 1
    sentence = refused.err.removeprefix("Error: cage.obj: ").split("; the cage has")[0].strip()
    assert sentence in outcome.out


def test_json_on_stdout_is_alone_there(run, folder):
    outcome = run(*TYPED, "--json", "-")
    assert json.loads(outcome.out)["verdict"] == "fit"
    assert outcome.err.startswith("cage.obj: fit")
    assert run(*TYPED, "--json", "-", "-q").err == ""


def test_json_in_a_file(run, folder):
    assert run(*TYPED, "--json", "check.json").out.startswith("cage.obj: fit")
    assert json.loads(Path("check.json").read_text())["schema"] == 1
    again = run(*TYPED, "--json", "check.json")
    assert again.code == 1
    assert "check.json: exists already" in again.err
    assert again.out == ""
    assert run(*TYPED, "--json", "check.json", "--overwrite", "-q").code == 0


def test_an_unfit_cage_still_gets_its_json(run, fixtures_folder):
    cage = fixtures_folder / "broken/cage_open/cage.obj"
    outcome = run("check", "--cage", cage, "--json", "-", "-q")
    assert (outcome.code, outcome.err) == (1, "")
    assert json.loads(outcome.out)["findings"][0]["kind"] == "open-edge"


@pytest.mark.parametrize("taken", ["cage.obj", "frames/frame_1.obj"])
def test_an_input_is_not_written_over(run, folder, taken):
    before = Path(taken).read_bytes()
    outcome = run("check", taken, "--cage", "cage.obj", "--json", taken, "--overwrite")
    assert outcome.code == 1
    assert "is read or written by this command already" in outcome.err
    assert Path(taken).read_bytes() == before


def test_quiet_is_the_exit_code_alone(run, folder, fixtures_folder):
    assert run(*TYPED, "-q").out == ""
    outcome = run("check", "--cage", fixtures_folder / "broken/cage_open/cage.obj", "-q")
    assert (outcome.code, outcome.out, outcome.err) == (1, "", "")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--rest", "cage.obj", "--rest-frame", "0"], "--rest-frame"),
        ([], "Missing option '--cage'"),
    ],
)
def test_wrong_usage_is_exit_code_2(run, folder, words, says):
    cage = ["--cage", "cage.obj"] if words else []
    outcome = run("check", "frames", *cage, *words)
    assert (outcome.code, outcome.out) == (2, "")
    assert says in outcome.err


def test_a_frame_of_no_clip_is_wrong_usage(run, folder):
    outcome = run("check", "--cage", "cage.obj", "--rest-frame", "1")
    assert (outcome.code, outcome.out) == (2, "")
    assert "--rest-frame needs FRAMES" in outcome.err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--cage", "none.obj"], "none.obj: cannot be read"),
        (["nowhere", "--cage", "cage.obj"], "nowhere: no such file or folder"),
        (["frames", "--cage", "cage.obj", "--rest-frame", "9"], "--rest-frame 9: the clip has 5"),
        (["--cage", "cage.obj", "--rest", "none.obj"], "none.obj: cannot be read"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(run, folder, words, says):
    outcome = run("check", *words)
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith(f"Error: {says}")
    assert len(outcome.err.splitlines()) == 1


def test_options_from_a_file(run, folder):
    Path("cageik.toml").write_text('[check]\njson = "-"\n')
    assert json.loads(run(*TYPED, "--config", "cageik.toml").out)["verdict"] == "fit"


def test_a_frame_in_a_folder_is_not_written_over(run, folder):
    frame = Path("frames/frame_2.obj")
    before = frame.read_bytes()
    outcome = run("check", "frames", "--cage", "cage.obj", "--json", frame, "--overwrite")
    assert outcome.code == 1
    assert "is read or written by this command already" in outcome.err
    assert frame.read_bytes() == before
