"""What a page calls a clip, and the words of its command."""

import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.geometry.attributes import FaceLabels, SurfaceAttributes
from cageik_cli.store.result import read_result
from cageik_cli.view.player.clip import find_base_colours, load_player_clip, make_single_pose
from tests.shapes import box


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("walker.h5", "walker.h5"),
        ("$(touch x) it's.h5", "$(touch x) it's.h5"),
        ("bad\udcff.h5", "bad\ufffd.h5"),
        ("two\nlines.h5", "two lines.h5"),
    ],
)
def test_any_file_name_is_one_word_of_the_command(closed, tmp_path, name, title):
    copy = shutil.copy(closed.result.path, tmp_path / name)
    clip = load_player_clip(read_result(copy))
    assert clip.title == title
    assert shlex.split(clip.target) == [title]


def test_a_model_is_named_with_its_options(clip):
    clip = make_single_pose(clip.binding, ["my model.obj", "--cage", "cage.obj"])
    assert (clip.title, clip.target) == ("my model.obj", "'my model.obj' --cage cage.obj")


def test_a_model_in_no_file_has_a_place_to_fill_in(clip):
    clip = make_single_pose(clip.binding)
    assert (clip.title, clip.target) == ("", "MODEL.obj --cage CAGE.obj")


def coloured(mesh, **attributes):
    counts = np.full(len(mesh.faces), 3)
    return replace(mesh, attributes=SurfaceAttributes(counts, mesh.faces.ravel(), **attributes))


def test_colours_are_those_of_the_vertices_else_of_the_materials():
    mesh = box()
    paints = np.linspace(0, 1, 24).reshape(8, 3)
    np.testing.assert_array_equal(
        find_base_colours(coloured(mesh, colours=paints)), np.rint(255 * paints)
    )
    half = FaceLabels(("red", "white"), np.array([0] * len(mesh.faces)))
    linear = np.array([[0.2, 0.0, 1.0, 1], [1, 1, 1, 1]])
    found = find_base_colours(coloured(mesh, materials=half, material_colours=linear))
    np.testing.assert_array_equal(found, np.tile([124, 0, 255], (8, 1)))  # encoded as in sRGB
    bare = FaceLabels(("red", "white"), np.full(len(mesh.faces), -1))
    found = find_base_colours(coloured(mesh, materials=bare, material_colours=linear))
    assert len(np.unique(found)) == 1
    assert 200 < found[0, 0] < 230


def test_a_mesh_without_colours_has_none():
    assert find_base_colours(box()) is None
    assert find_base_colours(coloured(box())) is None
    labels = FaceLabels(("skin",), np.zeros(len(box().faces), int))
    assert find_base_colours(coloured(box(), materials=labels)) is None
