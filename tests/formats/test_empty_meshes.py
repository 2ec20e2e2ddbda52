"""Meshes without points or faces beside others, as placeholders, are left out with a note."""

import numpy as np
import pytest
from pxr import Sdf

from cageik_cli.formats.open import open_sequence
from cageik_cli.util.errors import InputError
from tests.clips import frames_of
from tests.formats.scenes import FRAMES, MESH, AlembicScene, UsdScene
from tests.refusals import refused
from tests.texts import texts

NOTHING = np.zeros((1, 0, 3), np.float32)


@pytest.fixture(params=[UsdScene, AlembicScene])
def scene(request, tmp_path):
    return request.param(tmp_path)


def test_empty_meshes_are_left_out_and_named(scene):
    scene.mesh("a", frames=NOTHING, faces=[])
    scene.mesh("body")
    scene.mesh("b", frames=NOTHING, faces=[])
    sequence = scene.opened()
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert sequence.first.attributes.parts.names == ("/body",)
    assert f"{scene.path.name}: left out /a, /b (no points or no faces)" in texts(sequence.notes)
    assert texts(scene.opened("::/body").notes) == ()


def test_so_are_points_without_faces_and_faces_without_points(scene):
    scene.mesh("body")
    scene.mesh("points", faces=[])
    scene.mesh("faces", frames=NOTHING)
    sequence = scene.opened()
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert "left out /points, /faces (no points or no faces)" in " ".join(texts(sequence.notes))


def test_a_mesh_that_has_points_later_is_no_empty_one(scene):
    """It would be lost in the frames that it is in."""
    scene.mesh("body")
    scene.mesh("grown", frames=[NOTHING[0], *FRAMES[1:]])
    assert scene.refused().startswith("/grown: ")


def test_an_empty_mesh_that_is_named_or_alone_is_refused(scene):
    scene.mesh("body")
    scene.mesh("empty", frames=NOTHING, faces=[])
    sentence = scene.refused("::/empty")
    assert "no points" in sentence or "0 faces" in sentence or "expected (count, 3)" in sentence


def test_empty_meshes_alone_are_refused(scene):
    scene.mesh("a", frames=NOTHING, faces=[])
    scene.mesh("b", frames=NOTHING, faces=[])
    assert scene.refused().startswith("/a: ")


def test_a_prim_that_states_nothing_is_refused_as_it_may_lack_a_layer(tmp_path):
    scene = UsdScene(tmp_path)
    scene.mesh("body")
    scene.stage.DefinePrim("/nothing", "Mesh")
    assert scene.refused().startswith("/nothing: the mesh has no points")


def test_a_mesh_without_samples_is_empty(tmp_path):
    archive = AlembicScene(tmp_path)
    archive.mesh("body")
    archive.mesh("nothing", frames=[])
    assert "left out /nothing (no p" in " ".join(texts(archive.opened().notes))


def test_an_empty_mesh_of_a_rig_is_left_out_before_its_rig_is_looked_at(tmp_path):
    scene = UsdScene(tmp_path)
    scene.mesh("body")
    prim = scene.stage.DefinePrim("/hero", "SkelRoot").GetStage().DefinePrim("/hero/skin", "Mesh")
    prim.CreateAttribute("points", Sdf.ValueTypeNames.Point3fArray).Set([])
    prim.CreateAttribute("primvars:skel:jointIndices", Sdf.ValueTypeNames.IntArray).Set([0])
    assert len(scene.opened().first.vertices) == len(MESH.vertices)


@pytest.mark.parametrize("points", ["point9f[] points = [(0, 0, 0)]", "float points = 1"])
def test_points_that_are_no_array_are_not_taken_for_none(tmp_path, points):
    path = tmp_path / "a.usda"
    faces = "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]"
    path.write_text(f'#usda 1.0\ndef Mesh "m" {{\n{points}\n{faces}\n}}\n')
    with refused(InputError, "points", at=path):
        open_sequence([path])
