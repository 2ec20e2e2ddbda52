"""A character of four parts through the commands: checked, bound, extracted and resumed."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.cages.builder.build import build_cage
from cageik_cli.cages.check.enclosure import locate_vertices
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.parts import list_part_names
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.views.cage import format_check_json
from cageik_cli.run.bind import bind_files
from cageik_cli.run.check import check_cage
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import BindRunSettings, CheckSettings, ExtractSettings
from cageik_cli.util.errors import CageError
from tests.character import NAMES, make_cage, make_character
from tests.texts import format_check_text, texts

TIGHT = 0.56
"""Radius of a cage that holds the body, but not the jacket and the eyes."""


@pytest.fixture
def cage_file(tmp_path, write_obj):
    """Write a prism around the character, and give its path."""

    def write(radius=0.8) -> Path:
        cage = make_cage(radius)
        return write_obj(tmp_path / f"cage_{radius}.obj", cage.vertices, cage.faces)

    return write


def settings(character_usd, cage, output, **given):
    preview = BindSettings(accuracy="preview")
    return ExtractSettings((str(character_usd),), cage, output, bind=preview, **given)


def test_check_says_which_parts_are_outside(character_usd, cage_file):
    checked = check_cage(CheckSettings(cage_file(TIGHT), (str(character_usd),)))
    model, _ = make_character()
    cage = make_cage(TIGHT)
    outside = locate_vertices(cage if cage.volume > 0 else cage.flip(), model).outside_indices
    record = json.loads(format_check_json(checked))["rest"]["outside_parts"]
    assert sum(part["found"] for part in record) == len(outside)
    assert [part["name"] for part in record] == [NAMES[1], NAMES[2], NAMES[3]]
    text = format_check_text(checked)
    first = record[0]
    assert f"({first['name']} {first['found']} of {first['total']}, " in text


def test_check_of_a_fit_cage_names_the_part_next_to_it(character_usd, cage_file):
    checked = check_cage(CheckSettings(cage_file(), (str(character_usd),)))
    vertex = checked.diagnosis.rest.clearance_vertex
    assert checked.diagnosis.is_fit
    assert f"vertex {vertex} ({NAMES[2]}[{vertex - 320}]) from face" in format_check_text(checked)
    assert json.loads(format_check_json(checked))["rest"]["outside_parts"] == []


@pytest.mark.parametrize("command", ["bind", "extract"])
def test_a_refusal_names_the_parts_outside(character_usd, cage_file, tmp_path, command):
    run = {
        "bind": lambda: bind_files(BindRunSettings(cage, character_usd, tmp_path / "b.h5")),
        "extract": lambda: extract(settings(character_usd, cage, tmp_path / "c.h5")),
    }
    cage = cage_file(TIGHT)
    with pytest.raises(CageError, match=rf"\({NAMES[1]} \d+ of 112, .*, the worst, .*\[\d+\]\)"):
        run[command]()


def test_the_note_on_an_open_model_names_the_open_part(character_result):
    (note,) = (note for note in texts(character_result.notes) if "is open" in note)
    assert f"(32 boundary edges: 32 of {NAMES[1]})" in note


@pytest.mark.slow
def test_a_cage_that_is_built_holds_every_part():
    model, _ = make_character()
    cage = build_cage(model, BuildSettings(vertices=60)).cage
    assert len(locate_vertices(cage, model).outside_indices) == 0


def test_a_binding_of_parts_extracts_the_same(
    character_usd, character_result, cage_file, tmp_path, weights_cache
):
    bound = tmp_path / "b.h5"
    weights = WeightSettings(BindSettings(accuracy="preview"), cache=weights_cache)
    bind_files(BindRunSettings(cage_file(), character_usd, bound, weights))
    made = extract(settings(character_usd, None, tmp_path / "c.h5", binding=bound))
    assert list_part_names(made.rest) == NAMES
    with h5py.File(made.path) as one, h5py.File(character_result.path) as other:
        np.testing.assert_allclose(one["verts"][:], other["verts"][:], rtol=0, atol=1e-12)
