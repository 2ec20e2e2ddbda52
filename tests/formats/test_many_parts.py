"""Characters of many parts: a note is one line, names three of them, and counts the others."""

import numpy as np
import pytest
from pxr import Sdf, UsdGeom

from cageik_cli.formats.base.mesh_data import Change
from cageik_cli.formats.base.scene_graph import count_kinds, describe_by_part
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.formats.write import write_mesh
from tests.formats.gltf.built import Built
from tests.formats.scenes import FRAMES, AlembicScene, UsdScene, translation
from tests.shapes import box
from tests.texts import texts

COUNT = 60
MAX_NOTE = 230
"""Characters of a note, with paths of about 25."""


def write_gltf(folder):
    """Each part has attributes, seams, triangles and vertices of its own that are left out."""
    file, mesh = Built(), box()
    top = file.add("nodes", {"name": "character", "children": []})
    skin = {"joints": [file.add("nodes", {"name": "hip"})]}
    file.add("skins", skin)
    file.json["nodes"][top]["children"].append(1)
    for k in range(COUNT):
        points = np.vstack([mesh.vertices[mesh.faces.ravel()] + [3 * k, 0, 0], np.zeros((k, 3))])
        corners = [*range(36), *[0, 0, 1] * (k % 7)]
        attributes = {"POSITION": file.array(points), f"_OF_{k}": file.array(np.ones(len(points)))}
        if k % 2:
            attributes["JOINTS_0"] = file.array(np.zeros((len(points), 4)), "B")
            attributes["WEIGHTS_0"] = file.array(np.tile([1 + k / 100, 0, 0, 0], (len(points), 1)))
        primitives = [{"attributes": attributes, "indices": file.array(corners, "H")}]
        primitives += [{"attributes": {}, "mode": 0}] * (k % 3)
        number = file.add("meshes", {"primitives": primitives})
        node = {"name": f"limb_number_{k}", "mesh": number} | ({"skin": 0} if k % 2 else {})
        file.json["nodes"][top]["children"].append(file.add("nodes", node))
    file.animate("", (1, "translation", [0, 1 / 24], [[0, 0, 0], [1, 0, 0]], "LINEAR"))
    return file.save(folder / "many.glb")


def write_usd(folder):
    """Each part has layers that do not fit; others are empty, hidden, or no meshes."""
    scene = UsdScene(folder)
    for k in range(COUNT):
        scene.transform([translation(3 * k, 0, 0)], f"of_{k}")
        scene.mesh(f"limb_number_{k}", f"of_{k}")
        mesh = UsdGeom.Mesh(scene.stage.GetPrimAtPath(scene.places[f"limb_number_{k}"]))
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, "faceVarying").Set([(0, 0)] * (k + 1))
        if k % 3 == 1:
            mesh.CreateVisibilityAttr("invisible")
        if k % 3 == 2:
            mesh.CreatePurposeAttr("guide")
        UsdGeom.Sphere.Define(scene.stage, f"/ball_number_{k}")
        UsdGeom.Cube.Define(scene.stage, f"/brick_number_{k}")
        scene.mesh(f"empty_number_{k}", frames=np.zeros((1, 0, 3), "f4"), faces=[])
    scene.close()
    return scene.path


def write_alembic(folder):
    scene = AlembicScene(folder)
    for k in range(COUNT):
        scene.transform([translation(3 * k, 0, 0)], f"of_{k}")
        scene.mesh(f"limb_number_{k}", f"of_{k}")
        scene.mesh(f"empty_number_{k}", frames=np.zeros((1, 0, 3), "f4"), faces=[])
    scene.close()
    return scene.path


@pytest.fixture(params=[write_gltf, write_usd, write_alembic])
def character(request, tmp_path):
    return request.param(tmp_path)


def test_notes_are_few_and_short_and_name_three(character):
    exclude = ("*_2*",)
    notes = texts(open_sequence([str(character)], ClipSettings(exclude=exclude)).notes)
    assert 3 <= len(notes) <= 8
    assert max(map(len, notes)) <= MAX_NOTE
    for note in notes:
        assert sum(note.count(name) for name in ("limb_", "empty_", "ball_", "brick_")) <= 3
    assert any(" more (`exclude=*_2*`)" in note for note in notes)


def test_what_commands_print_of_it_is_short(run, character, coarse_panels):
    model = open_sequence([str(character)]).first
    cage, result = character.with_name("cage.obj"), character.with_name("result.h5")
    around = box(model.diagonal)
    write_mesh(cage, around, around.vertices + model.vertices.mean(axis=0), overwrite=False)
    words = ("extract", str(character), "--cage", str(cage), "-o", str(result), "--no-fit", "-v")
    outcome = run(*words)
    assert outcome.code == 0, outcome.err
    for printed in (outcome.err, run("info", str(result)).out):
        lines = [line for line in printed.splitlines() if line.startswith("  note ")]
        assert 3 <= len(lines) <= 12
        assert max(map(len, lines)) <= MAX_NOTE + 20


def test_what_notes_of_gltf_count_is_added(tmp_path):
    notes = " ".join(texts(open_sequence([str(write_gltf(tmp_path))]).notes))
    assert f"{COUNT * (COUNT - 1) // 2:,}".replace(",", " ") + " vertices of no triangle" in notes
    assert f"{sum(k % 7 for k in range(COUNT))} triangles with a corner twice left out" in notes
    assert f"{sum(k % 3 for k in range(COUNT))} primitives without faces left out" in notes
    assert "left out _OF_0, _OF_1, _OF_2 and 57 more" in notes
    assert "sum to 1.03 to 1.59, and are divided by their sum" in notes


def test_changes_in_the_same_words_are_one():
    lost = [(f"/{k}", Change("{} lost", "vertex", k)) for k in range(1, 6)]
    named = [("/1", Change("posed by the {}", "skeleton", names=("/a",)))]
    other = [("/2", Change("posed by the {}", "skeleton", names=("/b",)))]
    plain = [("/1", "turned"), ("/2", "turned")]
    assert describe_by_part([*lost, *named, *other, *plain], 5) == [
        "15 vertices lost",
        "/1, /2: posed by the skeletons /a, /b",
        "/1, /2: turned",
    ]
    assert describe_by_part(named, 1) == ["posed by the skeleton /a"]


def test_kinds_share_the_names_of_a_note():
    many = {f"/{kind}{k}": kind for kind in "abcde" for k in range(4)}
    assert count_kinds({path: kind for path, kind in many.items() if kind == "a"}) == (
        "4 a (/a0, /a1, /a2 and 1 more)"
    )
    assert count_kinds(many) == (
        "4 a (/a0 and 3 more), 4 b (/b0 and 3 more), 4 c (/c0 and 3 more) and 2 more"
    )


def test_frames_are_those_of_the_parts(character):
    """The notes are all that has changed."""
    sequence = open_sequence([str(character)])
    parts = sequence.first.attributes.parts
    assert len(parts.names) in (COUNT, COUNT // 3)
    assert parts.vertex_counts.tolist() == [len(sequence.first.vertices) // len(parts.names)] * len(
        parts.names
    )
    if character.suffix != ".glb":
        np.testing.assert_array_equal(sequence.read_frame(1)[:6], FRAMES[1].astype(float))
