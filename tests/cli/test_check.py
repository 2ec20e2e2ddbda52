"""`cageik check`: verdicts are exit codes, text and data go where they belong."""

import json
from pathlib import Path

import pytest
import trimesh

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
    assert outcome.out.startswith("cage.obj: usable, 1 warning\n")


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
    sentence, _, command = sentence.partition("; to repair the cage: ")
    assert sentence in outcome.out
    assert command in outcome.out
    assert bool(command) == (case not in ("swapped", "cage_self_crossing"))


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


@pytest.fixture
def small_cage(folder, write_obj):
    """A cage through which vertices and faces of the rest pose go."""
    from tests.shapes import box

    return write_obj(folder / "small.obj", 0.75 * box().vertices, box().faces)


def test_a_picture_and_coloured_vertices_show_the_faults(run, small_cage):
    typed = ("check", "frames", "--cage", small_cage, "--plot", "faults.png")
    outcome = run(*typed, "--marked", "faults.ply")
    assert outcome.code == 1
    assert "fault 1        outside: 6 vertices (0, 1, 2, ...)" in outcome.out
    assert outcome.out.endswith("wrote faults.png\nwrote faults.ply\n")
    assert Path("faults.png").read_bytes().startswith(b"\x89PNG")
    mesh = trimesh.load("faults.ply", process=False)
    assert mesh.vertices.shape == (8 + 18, 3)
    colours = mesh.visual.vertex_colors[:, :3]
    assert (colours[8:14] == [214, 47, 39]).all()
    assert not (colours[14:] == [214, 47, 39]).all(axis=1).any()
    first = Path("faults.png").read_bytes(), Path("faults.ply").read_bytes()
    again = run(*typed, "--marked", "faults.ply")
    assert "faults.png: exists already" in again.err
    run(*typed, "--marked", "faults.ply", "--overwrite")
    assert (Path("faults.png").read_bytes(), Path("faults.ply").read_bytes()) == first


def test_a_single_element_is_named_in_the_singular(run, fixtures_folder, tmp_path):
    """The kinds of elements that a fault can have."""
    for case, says in [
        ("cage_degenerate_face", "repeated vertex: face 12"),
        ("cage_non_manifold", "non manifold edge: edge 6-7"),
        ("cage_pinched", "pinched vertex: vertex 7"),
    ]:
        cage = fixtures_folder / "broken" / case / "cage.obj"
        outcome = run("check", "--cage", cage, "--marked", tmp_path / f"{case}.ply")
        assert f"fault 1        {says}\n" in outcome.out


def test_a_fit_cage_can_be_drawn_too(run, folder):
    outcome = run("check", "--cage", "cage.obj", "--plot", "a.png", "--marked", "a.ply")
    assert outcome.code == 0
    assert "none that has a place" in outcome.out
    assert len(trimesh.load("a.ply", process=False).vertices) == 8


@pytest.mark.parametrize("option", [("--plot", "a.jpg"), ("--marked", "a.obj")])
def test_pictures_of_another_format_are_wrong_usage(run, folder, option):
    outcome = run(*TYPED, *option)
    assert outcome.code == 2
    assert option[1] in outcome.err


def test_a_picture_is_not_written_over_an_input_or_another_output(run, folder):
    Path("cage.ply").write_text("x")
    for words in (("--cage", "cage.ply", "--marked", "cage.ply"),):
        outcome = run("check", *words, "--overwrite")
        assert outcome.code == 1
        assert "cage.ply: is read or written" in outcome.err
