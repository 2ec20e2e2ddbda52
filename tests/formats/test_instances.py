"""Instances: a file holds a mesh once, and it is read many times; memory alone bounds how often."""

import numpy as np
import pytest

from cageik_cli.formats.base import files
from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.parts import split_parts
from cageik_cli.util.errors import FormatError
from tests.formats.gltf.built import Built
from tests.formats.scenes import FRAMES, MESH, AlembicScene, UsdScene, translation
from tests.refusals import refused

COUNT = 200
PLACES = np.column_stack([np.arange(COUNT), np.zeros((COUNT, 2))]).astype(np.float32)


def build_gltf():
    file = Built()
    attributes = {"POSITION": file.array(FRAMES[0].astype(np.float32))}
    indices = file.array(MESH.faces.ravel(), "H")
    file.add("meshes", {"primitives": [{"attributes": attributes, "indices": indices}]})
    return file


def write_gpu_instances(folder):
    file = build_gltf()
    held = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": file.array(PLACES)}}}
    file.add("nodes", {"mesh": 0, "extensions": held})
    return file.save(folder / "scene.glb")


def write_nodes(folder):
    file = build_gltf()
    for place in PLACES:
        file.add("nodes", {"mesh": 0, "translation": place.tolist()})
    return file.save(folder / "scene.glb")


def write_usd(folder, is_instanceable, suffix=".usdc"):
    scene = UsdScene(folder, f"scene{suffix}")
    scene.places["proto"] = str(scene.stage.CreateClassPrim("/proto").GetPath())
    scene.mesh(parent="proto", frames=FRAMES[:1])
    for k, place in enumerate(PLACES.tolist()):
        scene.transform([translation(*place)], f"copy_{k}")
        prim = scene.stage.GetPrimAtPath(f"/copy_{k}")
        prim.GetReferences().AddInternalReference("/proto")
        prim.SetInstanceable(is_instanceable)
    scene.close()
    return scene.path


def write_alembic(folder):
    scene = AlembicScene(folder)
    scene.transform([translation(*PLACES[0])], "proto")
    scene.mesh(parent="proto", frames=FRAMES[:1])
    for k, place in enumerate(PLACES[1:].tolist(), start=1):
        scene.transform([translation(*place)], f"place_{k}")
        scene.objects[f"place_{k}"].addChildInstance(scene.objects["proto"], "copy")
    scene.close()
    return scene.path


SCENES = {
    "instances of a glTF node": write_gpu_instances,
    "glTF nodes of one mesh": write_nodes,
    "USD instances": lambda folder: write_usd(folder, is_instanceable=True),
    "USD references": lambda folder: write_usd(folder, is_instanceable=False),
    "references in a text": lambda folder: write_usd(folder, False, ".usda"),
    "Alembic instances": write_alembic,
}


@pytest.mark.parametrize("kind", SCENES)
def test_instances_may_be_far_more_than_their_file_and_not_than_memory(kind, tmp_path, monkeypatch):
    path = SCENES[kind](tmp_path)
    # What a file of one large mesh and as many instances has: little beside what they take.
    monkeypatch.setattr(files, "MIN_UNPACKED_LIMIT", 2000)
    monkeypatch.setattr(files, "MAX_UNPACKED_RATIO", 0)
    parts = split_parts(open_sequence([str(path)]).first)
    assert len(parts) == COUNT
    for part, place in zip(parts, PLACES, strict=True):
        np.testing.assert_allclose(part.mesh.vertices, FRAMES[0] + place, rtol=0, atol=1e-5)
        assert len(part.mesh.faces) == len(MESH.faces)
    monkeypatch.setattr(files, "MAX_INSTANCED_BYTES", COUNT * files.PART_BYTES)
    says = "of memory with all instances of its meshes, expected at most 1 MB, as the file has "
    with refused(FormatError, says, path):
        open_sequence([str(path)])


def test_memory_counts_where_the_file_holds_each_array_once(tmp_path, monkeypatch):
    """Faces that a file names again, mesh by mesh, are read once, and joined for each."""
    path = write_nodes(tmp_path)
    monkeypatch.setattr(files, "MAX_INSTANCED_BYTES", (COUNT + 1) * files.PART_BYTES)
    monkeypatch.setattr(files, "MAX_UNPACKED_RATIO", 0)
    monkeypatch.setattr(files, "MIN_UNPACKED_LIMIT", 2 * COUNT * files.PART_BYTES)
    assert len(split_parts(open_sequence([str(path)]).first)) == COUNT
    monkeypatch.setattr(files, "MIN_UNPACKED_LIMIT", (COUNT + 1) * files.PART_BYTES)
    with refused(FormatError, "of memory with all instances of its meshes", path):
        open_sequence([str(path)])


def test_instances_of_a_file_that_is_as_large_are_not_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MAX_INSTANCED_BYTES", 0)
    monkeypatch.setattr(files, "MIN_UNPACKED_LIMIT", 2 * COUNT * files.PART_BYTES)
    path = write_nodes(tmp_path)
    assert len(split_parts(open_sequence([str(path)]).first)) == COUNT


def test_instances_share_what_is_not_moved(tmp_path):
    """The faces of a mirrored instance turn, and those of others are read once."""
    file = build_gltf()
    scales = np.array([[1, 1, 1], [-1, 1, 1], [2, 2, 2], [1, 1, -1]], np.float32)
    held = {"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": file.array(scales)}}}
    file.add("nodes", {"mesh": 0, "extensions": held})
    parts = split_parts(open_sequence([str(file.save(tmp_path / "scene.glb"))]).first)
    signs = [np.sign(part.mesh.volume) for part in parts]
    assert signs == [signs[0]] * 4
    for part, scale in zip(parts, scales, strict=True):
        np.testing.assert_allclose(part.mesh.vertices, FRAMES[0] * scale, rtol=1e-6)
