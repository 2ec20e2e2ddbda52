import json
import re

import numpy as np
import pytest

from cageik_cli import __version__
from cageik_cli.report.views.cage import format_check_json
from cageik_cli.report.vocabulary import CAGE_VERDICT_WORDS
from cageik_cli.run.check import check_cage
from cageik_cli.run.settings import CheckSettings
from tests.shapes import ball, box
from tests.texts import format_check_text

pytestmark = pytest.mark.usefixtures("folder")


@pytest.fixture
def cage_file(folder, write_obj):
    """Write a cage, and give its path."""
    return lambda mesh: write_obj(folder / "cage.obj", mesh.vertices, mesh.faces)


def rows_of(text):
    lines = text.splitlines()
    return lines[0], [(line[2:16].strip(), line[17:]) for line in lines[1:]]


def test_a_fit_cage_alone(folder):
    headline, rows = rows_of(format_check_text(check_cage(CheckSettings(folder / "cage.obj"))))
    assert headline == "cage.obj: fit"
    assert rows == [
        ("cage", "8 vertices, 12 triangles, 1 component, genus 0"),
        ("volume", "64"),
        ("smallest angle", "45 degrees at face 0"),
    ]


def test_a_fit_cage_with_a_clip(folder):
    headline, rows = rows_of(
        format_check_text(check_cage(CheckSettings(folder / "cage.obj", ("frames",))))
    )
    facts = dict(rows)
    assert headline == "cage.obj: fit"
    assert facts["rest pose"] == "frame_1.obj: 18 vertices, 32 triangles, diagonal 3.4641"
    nearest = r"28.9 % of the diagonal, vertex \d+ from face \d+: enough"
    assert re.fullmatch(nearest, facts["clearance"])
    weakest = r"\d: 0\.\d+, \d: 0\.\d+, \d: 0\.\d+"
    assert re.search(rf"weakest cage vertices \(of 1\): {weakest}; ", facts["influence"])


@pytest.mark.parametrize(
    ("chosen", "name"),
    [
        ({}, "frame_1.obj"),
        ({"rest_frame": 3}, "frame_4.obj"),
    ],
)
def test_the_rest_pose_is_the_frame_chosen(folder, chosen, name):
    checked = check_cage(CheckSettings(folder / "cage.obj", ("frames",), **chosen))
    assert checked.rest.source["name"] == name


def test_the_rest_pose_may_be_a_file_with_frames_or_without(folder):
    rest = folder / "frames" / "frame_2.obj"
    for frames in ((), ("frames",)):
        checked = check_cage(CheckSettings(folder / "cage.obj", frames, rest))
        assert checked.rest.source["name"] == "frame_2.obj"
        assert checked.diagnosis.rest.vertices == 18


def test_findings_are_rows_with_the_worst_first(folder, cage_file):
    small = box(0.75).flip()
    _, rows = rows_of(format_check_text(check_cage(CheckSettings(cage_file(small), ("frames",)))))
    assert rows[-3][0] == "unfit"
    assert [label for label, _ in rows[-2:]] == ["warning", "to repair"]
    assert rows[-3][1].startswith("6 of 18 vertices of the rest pose are outside the cage")
    assert "the cage is scaled by" in rows[-3][1]
    assert dict(rows)["clearance"] == "none (6 vertices are outside)"
    assert "influence" not in dict(rows)


def test_undefined_values_are_reported(folder, cage_file):
    opened = box(2.0)
    path = cage_file(type(opened)(opened.vertices, opened.faces[1:]))
    _, rows = rows_of(format_check_text(check_cage(CheckSettings(path, ("frames",)))))
    facts = dict(rows)
    assert facts["volume"] == "not defined"
    assert facts["clearance"] == "not defined (the cage does not enclose a volume)"
    assert facts["cage"].endswith("1 component")


def test_polygons_are_noted(fixtures_folder):
    checked = check_cage(CheckSettings(fixtures_folder / "broken" / "cage_quads" / "cage.obj"))
    assert rows_of(format_check_text(checked))[1][-1] == (
        "note",
        "cage.obj: 6 polygons cut into triangles to compute with",
    )
    assert json.loads(format_check_json(checked))["notes"] == [
        "cage.obj: 6 polygons cut into triangles to compute with"
    ]


def test_json_is_the_whole_record(folder, cage_file):
    """All numbers of a finding, also those that a sentence leaves out."""
    loose = box(2.0)
    extra = np.arange(36.0).reshape(12, 3) + 100
    path = cage_file(type(loose)(np.vstack([loose.vertices, extra]), loose.faces))
    checked = check_cage(CheckSettings(path, ("frames",)))
    record = json.loads(format_check_json(checked))
    assert list(record) == [
        "schema", "tool", "verdict", "cage", "rest", "notes", "repair_command", "findings"
    ]  # fmt: skip
    assert (record["schema"], record["verdict"]) == (1, "unfit")
    assert record["tool"] == {"name": "cageik", "version": __version__}
    assert record["cage"]["name"] == "cage.obj"
    assert len(record["cage"]["sha256"]) == 64
    assert record["cage"]["volume"] == pytest.approx(64)
    assert (record["rest"]["name"], record["rest"]["outside"]) == ("frame_1.obj", 0)
    (finding,) = [one for one in record["findings"] if one["severity"] == "unfit"]
    assert finding == {
        "kind": "unreferenced-vertex",
        "severity": "unfit",
        "message": "the cage has vertices in no face, which can move nothing: 12 vertices "
        "(8, 9, 10, 11, 12, 13, 14, 15, 16, 17 and 2 more)",
        "remedy": "delete them",
        "elements": "vertices",
        "numbers": list(range(8, 20)),
        "value": 12.0,
        "mesh": "cage",
        "place": None,
    }


def test_the_verdict_is_worded_for_people_alone(folder, monkeypatch):
    checked = check_cage(CheckSettings(folder / "cage.obj"))
    monkeypatch.setitem(CAGE_VERDICT_WORDS, "fit", "sound")
    assert format_check_text(checked).startswith("cage.obj: sound\n")
    assert json.loads(format_check_json(checked))["verdict"] == "fit"


def test_json_without_a_rest_pose(folder, cage_file):
    record = json.loads(format_check_json(check_cage(CheckSettings(cage_file(ball(1))))))
    assert (record["rest"], record["findings"], record["verdict"]) == (None, [], "fit")
