"""Rigs in glTF, against an evaluation number by number; which animation, parts and surface."""

import numpy as np
import pytest

from cageik_cli.formats.open import describe_contents, list_members, open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.geometry.parts import split_parts
from cageik_cli.util.errors import FileAccessError, SettingError
from tests.clips import frames_of
from tests.formats.gltf.built import Built
from tests.formats.gltf.evaluated import Evaluated
from tests.formats.gltf.rigs import INTERPOLATIONS, RIGS, make_ribbon, morphed, moved, skinned
from tests.refusals import refused
from tests.texts import texts

FPS = 12.5
CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def opened(file, path, member="", **how):
    return open_sequence([f"{file.save(path)}{member}"], ClipSettings(**how))


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("name", RIGS)
def test_frames_are_those_of_the_specification(tmp_path, name, interpolation):
    file, nodes = RIGS[name](interpolation)
    clip = opened(file, tmp_path / "rig.glb", fps=FPS)
    expected, corners = Evaluated(clip.path), clip.first.polygons.corners
    assert len(clip) > 5
    for k, frame in enumerate(clip):
        time = (clip.scene.start + k) / FPS
        found = frame[corners]
        wanted = np.array([p for node in nodes for p in expected.triangles(node, time)])
        if name in ("moved", "instanced"):  # the mirrored faces are turned
            found, wanted = (np.sort(a.reshape(-1, 3, 3), axis=1) for a in (found, wanted))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6 * clip.first.diagonal)


@pytest.mark.parametrize("name", ["rig.gltf", "blob.gltf"])
def test_buffers_may_be_in_the_text_or_beside_it(tmp_path, name):
    expected = frames_of(opened(skinned("LINEAR")[0], tmp_path / "rig.glb"))
    clip = opened(skinned("LINEAR")[0], tmp_path / name)
    np.testing.assert_array_equal(frames_of(clip), expected)
    digest = clip.describe_source()["sha256"]
    assert clip.describe_source().get("files", 1) == len(list(tmp_path.glob("blob*")) or [1])
    changed = next(tmp_path.glob("* data.bin"), clip.path)
    changed.write_bytes(changed.read_bytes().replace(b"armature", b"ARMATURE") + b" ")
    assert open_sequence([str(clip.path)]).describe_source()["sha256"] != digest


# --- animations and times


@pytest.fixture
def dance(tmp_path):
    """A ribbon that moves along x, to 1, 2 or 3 at the last key, below a node that is still."""
    file = Built()
    points, faces = make_ribbon(np.random.default_rng(0))
    primitive = {"attributes": {"POSITION": file.array(points)}}
    primitive["indices"] = file.array(faces.ravel(), "B")
    file.add("meshes", {"primitives": [primitive]})
    file.add("nodes", {"name": "ribbon", "mesh": 0})
    file.add("nodes", {"mesh": 0})
    for k, name in enumerate(["step", "step", "a::b"], start=1):
        moves = [[0, 0, 0], [k, 0, 0]]
        file.animate(name, (0, "translation", [0.5, 1.5], moves, "LINEAR"))
    return file.save(tmp_path / "dance.glb")


def test_an_animation_is_chosen_by_name_or_number(dance):
    for member, length in {"step": 1, "1": 2, "2": 3, "0": 1}.items():
        clip = open_sequence([f"{dance}::{member}"])
        moves = clip.read_frame(len(clip) - 1) - clip.first.vertices
        assert moves.max() == pytest.approx(length)
        assert clip.names[0] == f"dance.glb::{member}[{clip.scene.start:g}]"
        assert clip.first.attributes.parts.names == ("/ribbon", "/node_1")
    both = open_sequence([f"{dance}::1::/ribbon"])
    assert both.first.attributes.parts.names == ("/ribbon",)
    assert both.content_digest(0) != open_sequence([f"{dance}::2::/ribbon"]).content_digest(0)


def test_several_animations_are_listed(dance):
    with refused(SettingError, "holds 3 animations: step, 1, 2; choose one, as in FILE::step"):
        open_sequence([str(dance)])
    with refused(SettingError, "as in FILE::step::/ribbon"):
        open_sequence([f"{dance}::/ribbon"])
    with refused(
        SettingError, "holds no animation `run`; choose one of step, 1, 2; parts are named"
    ):
        open_sequence([f"{dance}::run"])
    with refused(SettingError, "holds no mesh `/arm`; choose one of /ribbon, /node_1"):
        open_sequence([f"{dance}::step::/arm"])
    assert len(open_sequence([f"{dance}::step::ribbon"]).first.vertices)
    assert list_members(dance) == ["step", "1", "2"]
    rows = describe_contents([str(dance)], ClipSettings())
    assert [text for label, text in rows if label == "animation"] == ["step", "1", "2"]
    assert describe_contents([f"{dance}::step"], ClipSettings()) == []


@pytest.mark.parametrize(("fps", "count"), [(None, 25), (24, 25), (10, 11), (3, 4), (0.4, 1)])
def test_frames_are_from_the_first_key_to_the_last(dance, fps, count):
    clip = open_sequence([f"{dance}::step"], ClipSettings(fps=fps))
    rate = fps or 24.0
    assert (len(clip), clip.scene.start) == (count, 0.5 * rate)
    assert (clip.scene.fps, clip.scene.up_axis, clip.scene.metres_per_unit) == (rate, "Y", 1)
    moves = [frame[0, 0] - clip.first.vertices[0, 0] for frame in clip]
    np.testing.assert_allclose(moves, np.arange(count) / rate, rtol=0, atol=1e-12)
    last = open_sequence([f"{dance}::step"], ClipSettings(slice(-1, None), fps=fps))
    assert last.scene.start == pytest.approx(0.5 * rate + count - 1)


def test_times_of_single_precision_are_at_their_keys(tmp_path):
    """Frame 1001 of 24 is not a float: a step must not come a frame late."""
    file = Built()
    points, faces = make_ribbon(np.random.default_rng(0))
    attributes = {"POSITION": file.array(points[faces.ravel()])}
    file.add("meshes", {"primitives": [{"attributes": attributes}]})
    file.add("nodes", {"mesh": 0})
    keys = np.arange(1001, 1012) / 24
    moves = np.arange(11)[:, None] * [1.0, 0, 0]
    file.animate("", (0, "translation", keys, moves, "STEP"))
    clip = opened(file, tmp_path / "late.glb")
    assert (len(clip), clip.scene.start) == (11, 1001)
    np.testing.assert_array_equal([f[0, 0] - clip.first.vertices[0, 0] for f in clip], range(11))


@pytest.mark.parametrize("interpolation", ["STEP", "LINEAR"])
@pytest.mark.parametrize("clock", [3600, 50_000, 86_400])
def test_keys_at_the_time_of_a_clock_are_each_a_frame(tmp_path, clock, interpolation):
    file = Built()
    file.add("meshes", {"primitives": [{"attributes": {"POSITION": file.array(np.eye(3))}}]})
    file.add("nodes", {"mesh": 0})
    moves = np.arange(25)[:, None] * [1.0, 0, 0]
    keys = clock + np.arange(25) / 24
    file.animate("", (0, "translation", keys, moves, interpolation))
    clip = opened(file, tmp_path / "clock.glb")
    assert (len(clip), clip.scene.start) == (25, 24 * clock)
    np.testing.assert_array_equal([f[1, 0] for f in clip], range(25))


def test_keys_at_one_time_are_a_frame_whatever_the_time(tmp_path):
    file = Built()
    file.add("meshes", {"primitives": [{"attributes": {"POSITION": file.array(np.eye(3))}}]})
    file.add("nodes", {"mesh": 0})
    file.animate("", (0, "translation", [1e30, 1e30], np.zeros((2, 3)), "LINEAR"))
    assert len(opened(file, tmp_path / "late.glb")) == 1


@pytest.mark.parametrize(
    ("fps", "keys", "is_noted"),
    [(None, 30, True), (None, 12, False), (None, 24, False), (25, 30, False)],
)
def test_frames_between_even_keys_are_noted(tmp_path, fps, keys, is_noted):
    file = Built()
    file.add("meshes", {"primitives": [{"attributes": {"POSITION": file.array(np.eye(3))}}]})
    file.add("nodes", {"mesh": 0})
    times = (3 + np.arange(9)) / keys
    file.animate("", (0, "translation", times, np.zeros((9, 3)), "LINEAR"))
    clip = opened(file, tmp_path / "even.glb", fps=fps)
    note = "its keys are 30 per second, and it is sampled at 24; `fps=30` takes the keys"
    assert any(note in text for text in texts(clip.notes)) == is_noted


def test_a_time_that_is_there_twice_is_a_jump(tmp_path):
    file = Built()
    attributes = {"POSITION": file.array(np.eye(3))}
    file.add("meshes", {"primitives": [{"attributes": attributes}]})
    file.add("nodes", {"mesh": 0})
    moves = [[0, 0, 0], [1, 0, 0], [5, 0, 0], [6, 0, 0]]
    file.animate("", (0, "translation", [0, 1, 1, 2], moves, "LINEAR"))
    clip = opened(file, tmp_path / "jump.glb", fps=2)
    assert [frame[1, 0] for frame in clip] == [0, 0.5, 5, 5.5, 6]
    assert any("same time" in note for note in texts(clip.notes))


def test_without_an_animation_there_is_one_frame(tmp_path):
    file, nodes = morphed("LINEAR")
    del file.json["animations"]
    clip = opened(file, tmp_path / "still.glb")
    assert (len(clip), clip.scene.fps, clip.scene.start) == (1, None, None)
    file.json["animations"] = [{"channels": [], "samplers": []}]
    wanted = [p for node in nodes for p in Evaluated(file.save(clip.path)).triangles(node, 0)]
    np.testing.assert_allclose(clip.first.vertices[clip.first.faces].reshape(-1, 3), wanted)


# --- parts


def test_parts_are_paths_of_nodes_with_their_transforms(tmp_path):
    file, _ = moved("LINEAR")
    clip = opened(file, tmp_path / "moved.glb")
    parts = clip.first.attributes.parts
    assert parts.names == ("/mirror/arm/hand", "/mirror/arm/still")
    expected = Evaluated(clip.path)
    for part, node in zip(split_parts(clip.first), (2, 3), strict=True):
        world = np.array(expected.world(node, 0, clip.scene.start / 24))
        np.testing.assert_allclose(part.transform, world.T, rtol=0, atol=1e-12)
    assert "moved by an animated transform" in " ".join(texts(clip.notes))
    assert "2 primitives without faces left out" in " ".join(texts(clip.notes))
    skin = opened(skinned("LINEAR")[0], tmp_path / "skin.glb").first.attributes.parts
    assert skin.names == ("/one", "/two")
    np.testing.assert_array_equal(skin.transforms, np.tile(np.eye(4), (2, 1, 1)))


def test_instances_are_parts_below_their_node(tmp_path):
    file, _ = RIGS["instanced"]("LINEAR")
    file.json["nodes"][0]["children"] = [file.add("nodes", {"name": "instance_0", "mesh": 0})]
    names = opened(file, tmp_path / "trees.glb").first.polygons.parts.names
    expected = [f"/trees/instance__{k}" for k in range(3)]
    assert names == (*expected, "/trees/instance_0")


def test_instances_of_a_skin_are_noted(tmp_path):
    file, nodes = skinned("LINEAR")
    file.json["nodes"][nodes[0]]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {}}}
    clip = opened(file, tmp_path / "rig.glb")
    assert "rig.glb: /one: its instances are not read, as joints place it" in texts(clip.notes)
    assert len(split_parts(clip.first)) == 2


def test_names_that_are_alike_or_have_slashes_are_told_apart(tmp_path):
    file = Built()
    attributes = {"POSITION": file.array(np.eye(3))}
    file.add("meshes", {"primitives": [{"attributes": attributes}]})
    for name in ("a/b", "c", "c", "c\n", ""):
        file.add("nodes", {"mesh": 0, "name": name})
    names = opened(file, tmp_path / "names.glb").first.attributes.parts.names
    assert names == ("/a_b", "/c", "/c_2", "/c_3", "/node_4")
    for node, name in zip(file.json["nodes"], ["a_2", "a", "a", "a_2", "a"], strict=True):
        node["name"] = name
    names = opened(file, tmp_path / "names.glb").first.attributes.parts.names
    assert names == ("/a_2", "/a", "/a_3", "/a_2_2", "/a_4")


def test_nodes_are_parts_in_the_order_of_the_tree(tmp_path):
    """As programs that write them to formats of nested objects list them."""
    file = Built()
    attributes = {"POSITION": file.array(np.eye(3))}
    file.add("meshes", {"primitives": [{"attributes": attributes}]})
    nodes = [("a", []), ("b", []), ("c", []), ("hero", [2, 0]), ("root", [3, 1]), ("first", [])]
    for name, children in nodes:
        below = {"children": children} if children else {}
        file.add("nodes", {"name": name} | below | ({} if children else {"mesh": 0}))
    file.json |= {"scenes": [{"nodes": [5, 4]}]}
    names = opened(file, tmp_path / "tree.glb").first.attributes.parts.names
    assert names == ("/first", "/root/hero/c", "/root/hero/a", "/root/b")


def test_a_number_that_is_the_name_of_an_animation_names_no_other(tmp_path):
    file = Built()
    attributes = {"POSITION": file.array(np.eye(3))}
    file.add("meshes", {"primitives": [{"attributes": attributes}]})
    file.add("nodes", {"mesh": 0})
    for k, name in enumerate(["1", "", "1_2"]):
        moves = [[0, 0, 0], [k, 0, 0]]
        file.animate(name, (0, "translation", [0, 1], moves, "LINEAR"))
    path = file.save(tmp_path / "numbers.glb")
    assert list_members(path) == ["1", "1_2", "1_2_2"]
    for k, member in enumerate(list_members(path)):
        clip = open_sequence([f"{path}::{member}"])
        moved = clip.read_frame(len(clip) - 1) - clip.first.vertices
        assert moved.max() == pytest.approx(k)


def test_materials_of_names_that_are_alike_are_told_apart(tmp_path):
    file = Built()
    primitives = [
        {"attributes": {"POSITION": file.array(np.eye(3) + k)}, "material": k} for k in range(3)
    ]
    file.add("meshes", {"primitives": primitives})
    file.add("nodes", {"mesh": 0})
    for name in ("a_2", "a", "a"):
        file.add("materials", {"name": name})
    materials = opened(file, tmp_path / "alike.glb").first.attributes.materials
    assert materials.names == ("a_2", "a", "a_3")
    np.testing.assert_array_equal(materials.indices, [0, 1, 2])


def test_nodes_outside_the_scene_and_invisible_ones_are_left_out(tmp_path):
    file = Built()
    attributes = {"POSITION": file.array(np.eye(3))}
    file.add("meshes", {"primitives": [{"attributes": attributes}]})
    file.add("meshes", {"primitives": [{"attributes": attributes, "mode": 0}]})
    file.add("nodes", {"mesh": 0, "name": "shown", "children": [2]})
    file.add("nodes", {"mesh": 0, "name": "elsewhere"})
    unseen = {"extensions": {"KHR_node_visibility": {"visible": False}}}
    file.add("nodes", {"mesh": 0, "name": "unseen", **unseen})
    file.add("nodes", {"mesh": 1, "name": "points"})
    file.json |= {"scene": 0, "scenes": [{"nodes": [0, 3]}]}
    clip = opened(file, tmp_path / "some.glb")
    assert clip.first.attributes.parts.names == ("/shown",)
    assert texts(clip.notes) == (
        "some.glb: left out /shown/unseen, /elsewhere (not in the scene, or invisible)",
        "some.glb: left out /points (points or lines)",
    )
    assert len(opened(file, clip.path, "::/shown/unseen").first.vertices) == 3


# --- the surface


def make_box(is_indexed=True):
    """A cube whose every face has its own vertices, normals, texture coordinates and colours."""
    file = Built()
    points = CUBE[np.ravel(QUADS)]
    normals = np.repeat([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], 4, 0)
    attributes = {
        "POSITION": file.array(points),
        "NORMAL": file.array(normals, "b", 127, stride=4),
        "TEXCOORD_0": file.array(np.tile([[0, 0], [1, 0], [1, 0.25], [0, 0.25]], (6, 1))),
        "COLOR_0": file.array(np.tile(points, 1) * 0.5 + 0.25, "H", 65535, stride=8),
        "TANGENT": file.array(np.tile([1.0, 0, 0, 1], (24, 1))),
        "_HEAT": file.array(np.zeros(24)),
    }
    corners = (4 * np.arange(6)[:, None] + [0, 1, 2, 0, 2, 3]).reshape(6, 6)
    red = {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 0.5]}, "name": "red"}
    file.json["materials"] = [red, {"name": "red"}, {"name": "unused"}]
    parts = [{"indices": file.array(corners[:4].ravel(), "B"), "material": 0}]
    parts += [{"indices": file.array(corners[4].ravel(), "H"), "material": 1}]
    parts += [{"indices": file.array(corners[5].ravel(), "I")}]
    file.add("meshes", {"primitives": [part | {"attributes": attributes} for part in parts]})
    file.add("nodes", {"mesh": 0, "name": "box"})
    return file


def test_split_vertices_are_welded_and_the_surface_is_kept_per_corner(tmp_path):
    clip = opened(make_box(), tmp_path / "box.glb")
    mesh, look = clip.first, clip.first.attributes
    assert (len(mesh.vertices), mesh.is_closed, round(mesh.volume, 9)) == (8, True, 1)
    assert "16 vertices welded to others" in " ".join(texts(clip.notes))
    assert "left out TANGENT, _HEAT" in " ".join(texts(clip.notes))
    assert look.materials.names == ("red", "red_2")
    assert look.materials.indices.tolist() == [0] * 8 + [1] * 2 + [-1] * 2
    assert look.material_colours.tolist() == [[1, 0, 0, 0.5], [1, 1, 1, 1]]
    assert len(np.unique(look.normal_fans)) == 24
    np.testing.assert_allclose(look.uvs.values[look.uvs.indices[:3]], [[0, 1], [1, 1], [1, 0.75]])
    np.testing.assert_allclose(look.colours, mesh.vertices * 0.5 + 0.25, rtol=0, atol=1e-4)


def test_colours_that_differ_at_a_vertex_and_layers_that_are_damaged_are_noted(tmp_path):
    file = make_box()
    colours = np.random.default_rng(0).uniform(0, 1, (24, 4))
    coordinates = np.full((24, 2), np.inf)
    attributes = file.json["meshes"][0]["primitives"][0]["attributes"]
    attributes |= {"COLOR_0": file.array(colours), "TEXCOORD_0": file.array(coordinates)}
    clip = opened(file, tmp_path / "box.glb")
    notes = " ".join(texts(clip.notes))
    assert "several colours at 8 vertices" in notes
    assert "its texture coordinates left out" in notes
    np.testing.assert_allclose(clip.first.attributes.colours[0], colours[0], rtol=1e-6)


@pytest.mark.parametrize("what", ["joints", "weights", "target", "sparse target"])
def test_vertices_that_come_apart_are_not_welded(tmp_path, what):
    """Two triangles that share an edge at rest; both vertices at one of its ends differ."""
    file = Built()
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    joints, weights, move = np.zeros((6, 4)), np.tile([0.5, 0.5, 0, 0], (6, 1)), np.zeros((6, 3))
    joints[:, 1] = 1
    joints[:3, 2] = 1  # weighs nothing
    if what == "joints":
        joints[3, 1] = 2
    elif what == "weights":
        weights[3] = [0.25, 0.75, 0, 0]
    else:
        move[3, 2] = 1
    for k in range(3):
        file.add("nodes", {"translation": [0, 0, k]})
    attributes = {"POSITION": file.array(points)}
    attributes |= {"JOINTS_0": file.array(joints, "B"), "WEIGHTS_0": file.array(weights)}
    some = {"sparse": {3: None}, "is_dense": False} if what == "sparse target" else {}
    targets = [{"POSITION": file.array(move, **some)}]
    file.add("meshes", {"primitives": [{"attributes": attributes, "targets": targets}]})
    file.add("skins", {"joints": [0, 1, 2]})
    file.add("nodes", {"mesh": 0, "skin": 0})
    clip = opened(file, tmp_path / "edge.glb")
    assert clip.first.faces.tolist() == [[0, 1, 2], [3, 2, 4]]
    assert clip.first.vertices[:, :2].tolist() == points[[0, 1, 2, 3, 5], :2].tolist()


def test_triangles_without_area_and_vertices_of_none_are_left_out(tmp_path):
    file = Built()
    points = np.concatenate([CUBE[:4], CUBE[:1]])
    indices = [0, 1, 2, 0, 4, 2]
    part = {"attributes": {"POSITION": file.array(points)}, "indices": file.array(indices, "B")}
    file.add("meshes", {"primitives": [part]})
    file.add("nodes", {"mesh": 0})
    clip = opened(file, tmp_path / "flat.glb")
    assert (len(clip.first.vertices), len(clip.first.faces)) == (3, 1)
    notes = " ".join(texts(clip.notes))
    assert "1 vertex of no triangle left out" in notes
    assert "1 triangle with a corner twice left out" in notes


def test_weights_are_divided_by_their_sum_and_lost_vertices_follow_their_first_joint(tmp_path):
    file = Built()
    weights = [[0.5, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 0, 0, 0]]
    attributes = {"POSITION": file.array(np.eye(3)), "WEIGHTS_0": file.array(weights)}
    attributes["JOINTS_0"] = file.array(np.tile([1, 0, 0, 7], (3, 1)), "B")
    file.add("meshes", {"primitives": [{"attributes": attributes}]})
    for x in (4, 2):
        file.add("nodes", {"translation": [x, 0, 0]})
    file.add("skins", {"joints": [0, 1]})
    file.add("nodes", {"mesh": 0, "skin": 0})
    clip = opened(file, tmp_path / "weights.glb")
    np.testing.assert_allclose(clip.first.vertices - np.eye(3), [[2, 0, 0], [3, 0, 0], [2, 0, 0]])
    notes = " ".join(texts(clip.notes))
    assert "the weights of 1 vertex sum to 0; the first joint" in notes
    assert "the weights of 1 vertex sum to 0.5 to 1, and are divided" in notes


def test_a_buffer_that_is_written_again_keeps_no_digest(tmp_path):
    built = Built()
    positions = built.array(np.eye(4, 3))
    corners = built.array([0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3], "I")
    primitive = {"attributes": {"POSITION": positions}, "indices": corners}
    built.add("nodes", {"mesh": built.add("meshes", {"primitives": [primitive]})})
    path = built.save(tmp_path / "blob.gltf")
    sequence = open_sequence([str(path)])
    assert sequence.describe_source()["files"] == 2
    with (tmp_path / "blob data.bin").open("ab") as file:
        file.write(b"0000")
    with refused(FileAccessError, "changed while it was read", tmp_path / "blob data.bin"):
        sequence.describe_source()
