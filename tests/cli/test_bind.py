"""`cageik bind`: weights in a file of their own, and how good they are."""

import json
from pathlib import Path

import h5py
import numpy as np

from cageik_cli.method.weights.binding import Binding
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
    assert rows["weights"].startswith("sums differ from 1 by up to ")
    assert rows["accuracy"].startswith("standard: estimated weight error ")
    assert "projected" not in rows
    assert "cache" not in rows
    assert not {"seconds", "cache", "from cage"} & set(rows)  # only -v prints them
    assert outcome.err.splitlines()[-1] == (
        "wrote binding.h5; next: cageik extract FRAMES --binding binding.h5"
    )


def test_info_shows_the_same(run, folder):
    _, said = rows_of(run(*TYPED).err)
    outcome = run("info", "binding.h5")
    headline, rows = rows_of(outcome.out)
    assert (outcome.code, headline) == (0, "binding.h5")
    assert rows.pop("holds").startswith("a binding of cageik bind ")
    assert rows.pop("from cage") == "cage.obj"
    assert rows.pop("from rest") == "frame_1.obj"
    assert rows == said
    assert "\n  seconds        open " in run(*TYPED, "--overwrite", "-v").err


def test_coordinates_in_closed_form_have_no_panels():
    from cageik_cli.run.info import format_binding_rows

    bound = StoredBinding(Binding(TETRAHEDRON, TETRAHEDRON, np.eye(4)), {})
    assert ("accuracy", "exact (closed form)") in format_binding_rows(bound)


def test_the_next_command_works_as_told(run, folder):
    """And `info` takes the binding beside the result."""
    assert run(*TYPED).code == 0
    assert run("extract", "frames", "--binding", "binding.h5").code == 0
    assert run("report").out.startswith(
        "cages.h5: 5 frames, 18 vertices, a cage of 8 that was given"
    )
    pages = run("info", "binding.h5", "cages.h5").out.split("\n\n")
    assert [page.splitlines()[0] for page in pages] == ["binding.h5", "cages.h5"]


def test_options_reach_the_file(run, folder, animation, write_obj):
    write_obj(Path("cage.obj"), 0.4 * animation.cage.vertices, animation.cage.faces)
    assert run(*TYPED).code == 1
    outcome = run(*TYPED, "--accuracy", "preview", "--outside", "project", "-o", "b.h5")
    assert outcome.code == 0, outcome.err
    _, rows = rows_of(outcome.err)
    assert rows["settings"] == "coordinates harmonic, accuracy preview, outside project"
    assert rows["projected"] == "6 vertices outside"
    assert rows["notes"].startswith("1: cage.obj: 6 of 18 vertices of the model are outside the")
    assert rows["accuracy"].startswith("preview: ")
    with h5py.File("b.h5") as file:
        assert json.loads(file.attrs["settings"])["outside"] == "project"


def test_two_names_of_one_binding_hold_the_same_bytes_from_the_cache_or_not(run, folder):
    for name, words in (("one.h5", []), ("two.h5", []), ("three.h5", ["--no-cache"])):
        assert run(*TYPED, "-o", name, *words).code == 0
    assert Path("one.h5").read_bytes() == Path("two.h5").read_bytes()
    assert Path("one.h5").read_bytes() == Path("three.h5").read_bytes()


def test_verbose_says_where_the_cache_is(run, folder, cache):
    assert run(*TYPED, "-v").err.splitlines()[-1] == f"cache: {cache}"
    outcome = run(*TYPED, "-v", "--no-cache", "--overwrite")
    assert outcome.err.splitlines()[-1] == "cache: None"
