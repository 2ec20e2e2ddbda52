"""Colours of materials, from the library that an OBJ file names."""

import os

import numpy as np
import pytest

from cageik_cli.formats.obj import frames
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.geometry.attributes import PLAIN_COLOUR
from cageik_cli.util.files import read_input
from tests.assets import asset_text
from tests.texts import texts

LIBRARY = """# three of the tube
newmtl skin
Ka 1 1 1
Kd 0.5 0.25 0.125
d 0.5
newmtl cloth
Kd 0.75
Tr 0.25
newmtl unused
Kd 1 0 0
"""


def write_model(folder, library=LIBRARY, named="body.mtl"):
    lines = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1", f"mtllib {named}"]
    for name, face in (("skin", "1 3 2"), ("cloth", "1 2 4"), ("bare", "1 4 3"), ("skin", "2 3 4")):
        lines += [f"usemtl {name}", f"f {face}"]
    path = folder / "body.obj"
    path.write_text("\n".join(lines))
    if library is not None:
        (folder / named).parent.mkdir(parents=True, exist_ok=True)
        (folder / named).write_text(library)
    return path


def colours_of(path):
    loaded = load_mesh(path)
    found = loaded.mesh.attributes.material_colours
    return None if found is None else found.tolist(), texts(loaded.notes)


@pytest.mark.parametrize("named", ["body.mtl", "looks/of body.mtl"])
def test_colours_are_those_of_the_library(tmp_path, named):
    expected = [[0.5, 0.25, 0.125, 0.5], [0.75, 0.75, 0.75, 0.75], list(PLAIN_COLOUR)]
    path = write_model(tmp_path, named=named)
    assert colours_of(path) == (expected, ())
    clip = open_sequence([str(path)])
    np.testing.assert_array_equal(clip.first.attributes.material_colours, expected)


def test_several_libraries_are_read(tmp_path):
    path = write_model(tmp_path, None, "a.mtl b.mtl")
    (tmp_path / "a.mtl").write_text("newmtl skin\nKd 1 0 0\n")
    (tmp_path / "b.mtl").write_text("newmtl bare\nKd 0 1 0\n")
    assert colours_of(path)[0] == [[1, 0, 0, 1], list(PLAIN_COLOUR), [0, 1, 0, 1]]


@pytest.mark.parametrize("library", [None, "", "newmtl other\nKd 1 1 1\n"])
def test_without_colours_there_are_none(tmp_path, library):
    assert colours_of(write_model(tmp_path, library)) == (None, ())


@pytest.mark.parametrize("line", ["Kd spectral file.rfl 1", "Kd xyz 1 1 1", "map_Kd a.png", "\x00"])
def test_what_is_no_colour_is_passed_over(tmp_path, line):
    found, notes = colours_of(write_model(tmp_path, f"newmtl skin\n{line}\n"))
    assert found[0] == list(PLAIN_COLOUR)
    assert notes == ()


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("Kd", "has no colour in line 2"),
        ("Kd 1 2", "has no colour in line 2"),
        ("Kd nan 1 1", "has no colour in line 2"),
        ("Kd root:x:0 1 1", "has no colour in line 2"),
        ("d", "has no number in line 2"),
        ("Tr x", "has no number in line 2"),
    ],
)
def test_a_damaged_library_is_left_out_with_a_note(tmp_path, line, fault):
    found, notes = colours_of(write_model(tmp_path, f"newmtl skin\n{line}\n"))
    assert found is None
    assert notes == (f"the colours of its materials are left out (the library {fault})",)


def test_colours_beyond_the_screen_are_cut_off(tmp_path):
    found, _ = colours_of(write_model(tmp_path, "newmtl skin\nKd 2 -1 1e300\nd 7\n"))
    assert found[0] == [1, 0, 1, 1]


@pytest.mark.parametrize("name", ["../out.mtl", "/etc/passwd", "link.mtl"])
def test_a_library_of_another_folder_is_not_read(tmp_path, name):
    folder = tmp_path / "models"
    folder.mkdir()
    (tmp_path / "out.mtl").write_text(LIBRARY)
    os.symlink(tmp_path / "out.mtl", folder / "link.mtl")
    found, (note,) = colours_of(write_model(folder, None, name))
    assert found is None
    assert "is in another folder, expected one beside the mesh" in note


def test_a_library_that_is_a_pipe_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "body.mtl")
    found, (note,) = colours_of(write_model(tmp_path, None))
    assert found is None
    assert "is a pipe or a device" in note


def test_a_library_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr("cageik_cli.formats.obj.frames.MAX_LIBRARY_BYTES", 10)
    found, (note,) = colours_of(write_model(tmp_path))
    assert found is None
    assert "expected at most 10" in note


def test_the_asset_has_the_colours_of_its_library(tmp_path):
    path = tmp_path / "tube.obj"
    path.write_text(asset_text())
    (tmp_path / "skins").mkdir()
    (tmp_path / "skins" / "tube 1.mtl").write_text("newmtl gold%1\nKd 0.1 0.2 0.3\n")
    attributes = load_mesh(path).mesh.attributes
    found = dict(zip(attributes.materials.names, attributes.material_colours, strict=True))
    assert found.pop("gold%1").tolist() == [0.1, 0.2, 0.3, 1]
    assert [tuple(colour) for colour in found.values()] == [PLAIN_COLOUR] * 2


@pytest.mark.parametrize("named", ["a" * 300, "b" * 300 + " body.mtl"])
def test_a_name_that_no_file_can_have_is_that_of_a_missing_library(tmp_path, named):
    path = write_model(tmp_path, None, named)
    assert colours_of(path) == (None, ())
    (tmp_path / "body.mtl").write_text(LIBRARY)
    assert (colours_of(path)[0] is None) == ("body" not in named)


def test_libraries_are_read_once_and_within_one_limit(tmp_path, monkeypatch):
    read = []

    def read_counted(path, left, **options):
        read.append((path.name, left))
        return read_input(path, left, **options)

    monkeypatch.setattr(frames, "read_input", read_counted)
    monkeypatch.setattr(frames, "MAX_LIBRARY_BYTES", 2 * len(LIBRARY) - 1)
    path = write_model(tmp_path, LIBRARY, "a.mtl")
    path.write_text(path.read_text().replace("a.mtl", " ".join(["a.mtl"] * 100)))
    assert colours_of(path)[0] is not None
    assert read == [("a.mtl", 2 * len(LIBRARY) - 1)]
    (tmp_path / "b.mtl").write_text(LIBRARY)
    path.write_text(path.read_text().replace("a.mtl a.mtl", "a.mtl b.mtl"))
    found, notes = colours_of(path)
    assert found is None
    assert "expected at most" in notes[0]
