"""`cageik check`: verdicts are exit codes, text and data go where they belong."""

import json
from pathlib import Path

import pytest
import trimesh

from tests.shapes import box

TYPED = ("check", "frames", "--cage", "cage.obj")
UNFIT = ("cage_open", "cage_non_manifold", "cage_too_small", "cage_self_crossing", "swapped")


def test_a_fit_cage_is_exit_code_0(run, folder):
    outcome = run(*TYPED)
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("cage.obj: fit\n")


def test_a_cage_that_is_named_without_its_option_has_the_words_to_type(run, folder):
    outcome = run("check", "cage.obj", "frames")
    assert outcome.code == 2
    words = outcome.err.splitlines()[-1].rpartition(": cageik ")[2].split()
    assert run(*words).code == 0
    assert run("check", "frames").err.endswith(": cageik check --cage CAGE frames\n")
    assert run("check").err.endswith(": cageik check --cage CAGE FRAMES\n")


def test_a_usable_cage_is_exit_code_0(run, fixtures_folder):
    outcome = run("check", "--cage", fixtures_folder / "broken/cage_inside_out/cage.obj")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("cage.obj: usable, 1 warning\n")


@pytest.mark.parametrize("case", UNFIT)
def test_an_unfit_cage_is_exit_code_1_in_the_words_of_extract(
    run, fixtures_folder, tmp_path, monkeypatch, case
):
    monkeypatch.chdir(fixtures_folder / "broken" / case)
    outcome = run(*TYPED, "-v")
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
    record = json.loads(outcome.out)
    assert (record["verdict"], record["schema"]) == ("fit", 1)
    assert outcome.err.startswith("cage.obj: fit")
    assert run(*TYPED, "--json", "-", "-q").err == ""


def test_an_unfit_cage_still_gets_its_json(run, fixtures_folder):
    cage = fixtures_folder / "broken/cage_open/cage.obj"
    outcome = run("check", "--cage", cage, "--json", "-", "-q")
    assert (outcome.code, outcome.err) == (1, "")
    assert json.loads(outcome.out)["findings"][0]["kind"] == "open-edge"


@pytest.fixture
def small_cage(folder, write_obj):
    """A cage through which vertices and faces of the rest pose go."""
    return write_obj(folder / "small.obj", 0.75 * box().vertices, box().faces)


def test_json_words_what_to_do_and_leaves_names_alone(run, folder, write_obj):
    vertices = 0.5 * box().vertices
    vertices[0] *= 2.2
    cage = write_obj(Path("cage`rest=a`.obj"), box().vertices, box().faces)
    rest = write_obj(Path("model`rest=a`.obj"), vertices, box().faces)
    record = json.loads(run("check", "--cage", cage, "--rest", rest, "--json", "-", "-q").out)
    assert (record["cage"]["name"], record["rest"]["name"]) == (cage.name, rest.name)
    assert f"--repair '{cage}' --rest '{rest}'" in record["repair_command"]
    (outside,) = [one for one in record["findings"] if one["kind"] == "outside"]
    assert outside["remedy"].endswith("with --outside project")


def test_a_picture_and_coloured_vertices_show_the_faults(run, small_cage):
    views = ("--plot", "faults.png", "--marked", "faults.ply")
    outcome = run("check", "frames", "--cage", small_cage, *views)
    assert outcome.code == 1
    assert "fault 1        outside: 6 vertices (0, 1, 2 and 3 more)" in outcome.out
    assert outcome.out.endswith("wrote faults.png\nwrote faults.ply\n")
    assert Path("faults.png").read_bytes().startswith(b"\x89PNG")
    mesh = trimesh.load("faults.ply", process=False)
    assert mesh.vertices.shape == (8 + 18, 3)
    colours = mesh.visual.vertex_colors[:, :3]
    assert (colours[8:14] == [214, 47, 39]).all()
    assert not (colours[14:] == [214, 47, 39]).all(axis=1).any()


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
