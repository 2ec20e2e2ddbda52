"""The error of each part: computed from the frames themselves, and shown by all views."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from cageik_cli.report.html.page import render_page
from cageik_cli.report.record import build_report
from cageik_cli.report.regions import (
    MAX_PART_ROWS,
    PartRecord,
    format_part_rows,
    label_vertex,
    sort_parts,
)
from cageik_cli.report.views.data import format_json
from cageik_cli.report.views.text import format_text
from cageik_cli.store.result import read_rotations
from cageik_cli.view.player.clip import load_player_clip
from cageik_cli.view.player.section import build_payload
from tests.character import NAMES, make_character
from tests.report.markup import parse_page
from tests.view.player.rebuild import unpack_payload

COUNTS = (208, 112, 56, 56)
PARTS = tuple(
    PartRecord(f"part{k}", 10 * k, 10, rms, None if rms is None else 10 * rms)
    for k, rms in enumerate([0.2, None, 0.5, 0.1])
)


@pytest.fixture(scope="module")
def character_report(character_result):
    return build_report(character_result)


def test_the_rms_of_a_part_is_that_of_its_vertices_over_the_clip(
    character_result, character_report
):
    _, frames = make_character()
    with h5py.File(character_result.path) as file:
        weights, cages, rest = file["weights"][:], file["verts"][:], file["cage/verts"][:]
    turned = rest @ read_rotations(character_result)  # weights move what the cage moves
    base = character_result.rest.vertices @ read_rotations(character_result)
    squares = ((base + weights @ (cages - turned) - frames) ** 2).sum(axis=2)
    start = 0
    for part, name, count in zip(character_report.parts, NAMES, COUNTS, strict=True):
        assert (part.name, part.first_vertex, part.vertices) == (name, start, count)
        rms = np.sqrt(squares[:, start : start + count].mean())
        assert part.rms == pytest.approx(rms, rel=1e-4)
        percent = 100 * part.rms / character_result.rest.diagonal
        assert part.rms_percent == pytest.approx(percent, rel=1e-12)
        start += count
    whole = sum(part.vertices * part.rms**2 for part in character_report.parts) / start
    assert character_report.summary.rms == pytest.approx(np.sqrt(whole), rel=1e-12)


def test_the_worst_part_is_named(character_report):
    worst = max(character_report.parts, key=lambda part: part.rms)
    assert character_report.summary.worst_part == worst.name
    assert json.loads(format_json([character_report]))["summary"]["worst_part"] == worst.name
    lines = format_text(character_report).splitlines()
    assert f"  worst part     {worst.rms_percent:.4f} % in {worst.name}" in lines
    assert sum(line.startswith("  part ") for line in lines) == 3


def test_the_text_names_the_part_of_the_worst_vertex(character_report):
    vertex = character_report.summary.max_deviation_vertex
    assert f"at vertex {label_vertex(character_report.parts, vertex)} of " in format_text(
        character_report
    )


def test_parts_are_sorted_and_those_without_data_are_last():
    assert [part.name for part in sort_parts(PARTS)] == ["part2", "part0", "part3", "part1"]
    rows = format_part_rows(PARTS, "worst")
    assert rows[0] == ("worst part", "5.0000 % in part2")
    assert rows[-1] == ("part", "no data in part1")


def test_many_parts_are_counted():
    many = tuple(replace(PARTS[0], name=f"part{k}", rms_percent=float(k)) for k in range(500))
    rows = format_part_rows(many, "worst")
    assert len(rows) == MAX_PART_ROWS + 1
    assert rows[-1] == ("parts", f"and {500 - MAX_PART_ROWS} more")
    assert len(format_part_rows(many[:MAX_PART_ROWS], "worst")) == MAX_PART_ROWS


def test_a_vertex_is_placed_in_its_part():
    assert label_vertex(PARTS, 9) == "9 (part0[9])"
    assert label_vertex(PARTS, 20) == "20 (part2[0])"
    assert label_vertex(None, 20) == "20"


def test_a_model_of_one_mesh_has_no_parts(report):
    assert report.parts is None
    assert report.summary.worst_part is None
    assert "part" not in {line[2:16].split(" ")[-1] for line in format_text(report).splitlines()}


def test_the_page_lists_the_parts_the_worst_first(character_report, report):
    page = parse_page(render_page(character_report))
    rows = page.by_id("parts").rows[1:]
    wanted = [(part.name, f"{part.rms_percent:.4f}") for part in sort_parts(character_report.parts)]
    assert [tuple(row[:2]) for row in rows] == wanted
    assert 'id="parts"' not in render_page(report)


def test_the_player_holds_the_parts(character_result, character_report, report, clip):
    header, _ = unpack_payload(build_payload(load_player_clip(character_result)))
    assert [one["name"] for one in header["parts"]] == list(NAMES)
    assert [one["vertices"] for one in header["parts"]] == list(COUNTS)
    errors = [one["rms"] for one in header["parts"]]
    assert errors == pytest.approx([part.rms_percent for part in character_report.parts])
    assert unpack_payload(build_payload(clip))[0]["parts"] == []
