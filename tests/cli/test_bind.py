"""`cageik bind`: weights in a file of their own, and how good they are."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.coordinates.binding import Binding
from cageik_cli.store.binding_file import StoredBinding
from tests.shapes import TETRAHEDRON

TYPED = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_1.obj")


def rows_of(text):
    lines = text.splitlines()
    return lines[0], {line[2:16].strip(): line[17:] for line in lines[1:] if line[:2] == "  "}


def test_the_figures_go_to_stderr_and_end_with_what_to_do_next(run, folder):
    outcome = run(*TYPED)
    assert (outcome.code, outcome.out) == (0, "")
    headline, rows = rows_of(outcome.err)
    assert headline == "binding.h5"
    assert rows["model"] == "18 vertices, 32 triangles"
    assert rows["cage"] == "8 vertices, 12 triangles"
    assert rows["settings"] == "coordinates harmonic, accuracy standard, outside refuse"
    assert rows["weights"].startswith("partition of unity error ")
    assert rows["accuracy"].startswith("standard: estimated weight error ")
    assert "projected" not in rows
    assert "cache" not in rows
    assert rows["seconds"].startswith("open ")
    assert outcome.err.splitlines()[-1] == (
        "wrote binding.h5; next: cageik extract FRAMES --binding binding.h5"
    )


def test_the_next_command_works_as_told(run, folder):
    assert run(*TYPED).code == 0
    assert run("extract", "frames", "--binding", "binding.h5").code == 0
    assert run("report").out.startswith("cages.h5: 5 frames of 18 vertices in a cage of 8")


def test_info_shows_the_same(run, folder):
    _, said = rows_of(run(*TYPED).err)
    outcome = run("info", "binding.h5")
    headline, rows = rows_of(outcome.out)
    assert (outcome.code, headline) == (0, "binding.h5")
    assert rows.pop("holds").startswith("a binding of cageik bind ")
    del said["seconds"]
    assert rows == said
    assert rows["from cage"] == "cage.obj"
    assert rows["from rest"] == "frame_1.obj"


def test_coordinates_in_closed_form_have_no_panels():
    from cageik_cli.workflows.info import format_binding_rows

    bound = StoredBinding(Binding(TETRAHEDRON, TETRAHEDRON, np.eye(4)), {})
    assert ("accuracy", "exact (closed form)") in format_binding_rows(bound)


def test_info_takes_a_binding_beside_a_result(run, folder):
    assert run(*TYPED).code == 0
    assert run("extract", "frames", "--binding", "binding.h5").code == 0
    pages = run("info", "binding.h5", "cages.h5").out.split("\n\n")
    assert [page.splitlines()[0] for page in pages] == ["binding.h5", "cages.h5"]


@pytest.mark.parametrize("command", ["report", "extract"])
def test_a_binding_is_no_result_and_no_clip(run, folder, command):
    assert run(*TYPED).code == 0
    words = {"report": ["binding.h5"], "extract": ["binding.h5", "--cage", "cage.obj"]}[command]
    outcome = run(command, *words)
    assert outcome.code == 1
    assert outcome.err.startswith("Error: binding.h5: ")
    assert len(outcome.err.splitlines()) == 1


def test_options_reach_the_file(run, folder, animation, write_obj):
    write_obj(Path("cage.obj"), 0.4 * animation.cage.vertices, animation.cage.faces)
    assert run(*TYPED).code == 1
    outcome = run(*TYPED, "--accuracy", "preview", "--outside", "project", "-o", "b.h5")
    assert outcome.code == 0, outcome.err
    _, rows = rows_of(outcome.err)
    assert rows["settings"] == "coordinates harmonic, accuracy preview, outside project"
    assert rows["projected"] == "6 vertices outside"
    assert rows["note"].startswith("cage.obj: 6 of 18 vertices of the model are outside the cage")
    assert rows["accuracy"].startswith("preview: ")
    with h5py.File("b.h5") as file:
        assert json.loads(file.attrs["settings"])["outside"] == "project"


def test_a_file_may_hold_every_option(run, folder):
    Path("cageik.toml").write_text(
        '[bind]\ncage = "cage.obj"\nrest = "frames/frame_1.obj"\noutput = "told.h5"\n'
        'coordinates = "harmonic"\naccuracy = "fine"\noutside = "project"\ncache = "kept"\n'
        'timings = "seconds.json"\njobs = 1\noverwrite = true\nquiet = true\n'
    )
    outcome = run("bind", "--config", "cageik.toml")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    with h5py.File("told.h5") as file:
        assert json.loads(file.attrs["settings"])["accuracy"] == "fine"
    assert set(json.loads(Path("seconds.json").read_text())) == {"open", "bind", "write", "total"}
    assert len(list(Path("kept").glob("*.weights"))) == 1


def test_an_old_binding_stays_unless_it_may_be_replaced(run, folder):
    Path("binding.h5").write_text("old")
    outcome = run(*TYPED)
    assert outcome.code == 1
    assert "binding.h5: exists already" in outcome.err
    assert Path("binding.h5").read_text() == "old"
    assert run(*TYPED, "--overwrite").code == 0
    assert run("info", "binding.h5").code == 0


@pytest.mark.parametrize("name", ["cage.obj", "frames/frame_1.obj"])
def test_no_input_is_written_over(run, folder, name):
    before = Path(name).read_bytes()
    outcome = run(*TYPED, "-o", name, "--overwrite")
    assert outcome.code == 1
    assert "is read or written by this command already" in outcome.err
    assert Path(name).read_bytes() == before


def test_a_binding_is_not_written_under_the_name_of_another_format(run, folder):
    outcome = run(*TYPED, "-o", "binding.npz")
    assert outcome.code == 1
    assert "binding.npz: the output is an HDF5 file" in outcome.err
    assert not Path("binding.npz").exists()


def test_two_names_of_one_binding_hold_the_same_bytes_from_the_cache_or_not(run, folder):
    for name, words in (("one.h5", []), ("two.h5", []), ("three.h5", ["--no-cache"])):
        assert run(*TYPED, "-o", name, *words).code == 0
    assert Path("one.h5").read_bytes() == Path("two.h5").read_bytes()
    assert Path("one.h5").read_bytes() == Path("three.h5").read_bytes()


def test_verbose_says_where_the_cache_is(run, folder, cache):
    assert run(*TYPED, "-v").err.splitlines()[-1] == f"cache: {cache}"
    outcome = run(*TYPED, "-v", "--no-cache", "--overwrite")
    assert outcome.err.splitlines()[-1] == "cache: None"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["bind", "--rest", "frames/frame_1.obj"], "Missing option '--cage'"),
        (["bind", "--cage", "cage.obj"], "Missing option '--rest'"),
        ([*TYPED, "--accuracy", "best"], "'best' is not one of 'preview', 'standard', 'fine'"),
        ([*TYPED, "--outside", "drop"], "'drop' is not one of 'refuse', 'project'"),
        ([*TYPED, "--coordinates", "green"], "'green' is not"),
        ([*TYPED, "--cache", "a", "--no-cache"], "--cache and --no-cache exclude each other"),
    ],
)
def test_wrong_usage_is_exit_code_2(run, folder, words, says):
    outcome = run(*words)
    assert (outcome.code, outcome.out) == (2, "")
    assert says in outcome.err
    assert not Path("binding.h5").exists()
