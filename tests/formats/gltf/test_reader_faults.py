"""Rigs in glTF that are wrong: a sentence with the place, soon and in little memory."""

import json
import struct
import tracemalloc

import numpy as np
import pytest

from cageik_cli.formats.base import files
from cageik_cli.formats.open import open_sequence
from cageik_cli.util.errors import InputError
from tests.clips import frames_of
from tests.formats.gltf.built import Built, make_glb
from tests.formats.gltf.rigs import instanced, quantised, skinned
from tests.refusals import refused
from tests.texts import texts

HUGE = 10**9
MOST = 16 << 20
"""Bytes that a wrong file of a few KiB may make the reader take."""


def say(path):
    """The sentence that refuses a file, behind its name."""
    tracemalloc.start()
    with pytest.raises(InputError) as caught:
        frames_of(open_sequence([str(path)]))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < MOST
    text = str(caught.value)
    assert path.name in text.partition(": ")[0]
    assert "\n" not in text
    return text


def put(*steps, value=None):
    """A change of a value of the document, by the steps to it; without a value it is removed."""

    def change(document):
        *above, last = steps
        for step in above:
            document = document[step]
        if value is None:
            del document[last]
        else:
            document[last] = value

    return change


def lose(document):
    """Take the chain of joints from its top, and put its end above its beginning."""
    document["nodes"][6]["children"] = [7]
    document["nodes"][2]["children"] = [0]


INDICES = skinned("LINEAR")[0].json["meshes"][0]["primitives"][0]["indices"]
ATTRIBUTES = ("meshes", 0, "primitives", 0, "attributes")
SAMPLER = ("animations", 0, "samplers", 0)
CHANNEL = ("animations", 0, "channels", 0)
CASES = {
    "nodes[0].children[0] is 99, expected 0 to 8": put("nodes", 0, "children", value=[99]),
    "nodes[0] is below itself": lose,
    "nodes[1] is below nodes[0] and nodes[5]": put("nodes", 5, "children", value=[1]),
    "nodes[0].rotation is a list of 3, expected 4 numbers": put(
        "nodes", 0, "rotation", value=[0, 0, 1]
    ),
    'nodes[0].scale[1] is "1", expected a number': put("nodes", 0, "scale", value=[1, "1", 1]),
    "nodes[1] has a matrix, and its rotation is animated": put(
        "nodes", 1, "matrix", value=np.eye(4).ravel().tolist()
    ),
    "nodes[7].skin is 2, expected 0 to 1": put("nodes", 7, "skin", value=2),
    "nodes[7].mesh is 2, expected 0 to 1": put("nodes", 7, "mesh", value=2),
    "nodes[7].name is 3, expected a text": put("nodes", 7, "name", value=3),
    "the path of nodes[7] has more than 1024 characters": put("nodes", 7, "name", value="n" * 2000),
    "has 1 weights of 0 morph targets": put("nodes", 7, "weights", value=[1]),
    "skins[0].joints is an empty list": put("skins", 0, "joints", value=[]),
    "follows joint 3, expected 0 to 1": put("skins", 0, "joints", value=[0, 1]),
    "6 inverse bind matrices, expected 7": put("skins", 0, "joints", value=[0] * 7),
    "WEIGHTS_1": put(*ATTRIBUTES, "WEIGHTS_1"),
    "has a skin, and a primitive without JOINTS_0": put(*ATTRIBUTES, "JOINTS_0"),
    "accessors[2] has 99 vertices, expected 18": put("accessors", 2, "count", value=99),
    f"accessors[0]: {HUGE} elements of 64 bytes": put("accessors", 0, "count", value=HUGE),
    "accessors[1].count is 0, expected a whole number from 1": put(
        "accessors", 1, "count", value=0
    ),
    "accessors[1].count is 18.0, expected a whole": put("accessors", 1, "count", value=18.0),
    "accessors[1].count is true, expected a whole": put("accessors", 1, "count", value=True),
    "accessors[1].byteOffset is -4": put("accessors", 1, "byteOffset", value=-4),
    "accessors[0].componentType is 0, expected one of 5120": put(
        "accessors", 0, "componentType", value=0
    ),
    "accessors[0].componentType is 5120, expected 5126": put(
        "accessors", 0, "componentType", value=5120
    ),
    "accessors[1].type is": put("accessors", 1, "type", value="VEC2"),
    "accessors[1].bufferView is 99": put("accessors", 1, "bufferView", value=99),
    "bufferViews[1] ends at byte": put("bufferViews", 1, "byteLength", value=HUGE),
    "12 bytes, 4 apart": put("bufferViews", 1, "byteStride", value=4),
    "bufferViews[1].byteStride is 1000000000": put("bufferViews", 1, "byteStride", value=10**30),
    "bufferViews[1].buffer is 1, expected 0 to 0": put("bufferViews", 1, "buffer", value=1),
    "accessors[1].sparse is 3, expected an object": put("accessors", 1, "sparse", value=3),
    "primitives[0].mode is 9": put("meshes", 0, "primitives", 0, "mode", value=9),
    "meshes[0].primitives[0] has 8 corners": put("accessors", INDICES, "count", value=8),
    "animations[0].samplers[0].interpolation": put(*SAMPLER, "interpolation", value="BEZIER"),
    "samplers[0].output has 5 values, expected 15": put(
        *SAMPLER, "interpolation", value="CUBICSPLINE"
    ),
    "channels[0].sampler is 3, expected 0 to 2": put(*CHANNEL, "sampler", value=3),
    "channels[0].target.node is 9": put(*CHANNEL, "target", "node", value=9),
    "channels[1] moves rotation of nodes[1] a second time": put(
        "animations", 0, "channels", 1, "target", value={"node": 1, "path": "rotation"}
    ),
    "scene is 1, expected 0 to 0": put("scene", value=1),
    "is not glTF 2": put("asset", "version", value="1.0"),
    "'KHR_new', which cageik does not read": put("extensionsRequired", value=["KHR_new"]),
    "accessors is 3, expected a list": put("accessors", value=3),
    "nodes[0] is 3, expected an object": put("nodes", value=[3]),
    "in another folder": put("buffers", 0, "uri", value="../a.bin"),
    "is not in a file": put("buffers", 0, "uri", value="http://example.com/a.bin"),
    "lost.bin: no such file": put("buffers", 0, "uri", value="lost.bin"),
    "is not base64": put("buffers", 0, "uri", value="data:a/b;base64,!!!"),
    "of another kind, expected base64": put("buffers", 0, "uri", value="data:,abc"),
    "holds 6 of": put("buffers", 0, "uri", value="data:a/b;base64,AAAABBBB"),
    "NaN": put("nodes", 0, "translation", value=[float("nan"), 0, 0]),
    "nested more than 16 levels": put("extras", value=json.loads("[" * 40 + "]" * 40)),
}


@pytest.fixture
def save(tmp_path):
    """Writes a document and its buffer."""
    path = tmp_path / "wrong.glb"

    def write(document, blob=b""):
        path.write_bytes(make_glb(json.dumps(document).encode(), blob))
        return path

    return write


def read_document(file):
    """The document of a rig, with its buffer and a scene of all nodes at the top."""
    nodes = file.json["nodes"]
    below = {child for node in nodes for child in node.get("children", ())}
    tops = [k for k in range(len(nodes)) if k not in below]
    buffers = [{"byteLength": len(file.blob)}]
    whole = file.json | {"scene": 0, "scenes": [{"nodes": tops}], "buffers": buffers}
    return json.loads(json.dumps(whole))


PLACES = ("nodes", 0, "extensions", "EXT_mesh_gpu_instancing")


@pytest.mark.parametrize(
    ("says", "change"),
    {
        "has no translations": put(*PLACES, "attributes", value={}),
        "has 3 and 9 translations": put(
            *PLACES, "attributes", value={"TRANSLATION": 2, "ROTATION": 3, "SCALE": 4}
        ),
        "attributes.SCALE is 99": put(*PLACES, "attributes", "SCALE", value=99),
        "attributes is 3, expected an object": put(*PLACES, "attributes", value=3),
        "accessors[4].type is": put("accessors", 4, "type", value="VEC2"),
    }.items(),
)
def test_instances_that_are_wrong_are_a_sentence(save, says, change):
    file, _ = instanced("LINEAR")
    document = read_document(file)
    if "and 9" in says:
        document["accessors"][2]["count"] = 9
        document["accessors"][2].pop("bufferView")
    change(document)
    assert says in say(save(document, file.blob))


def test_as_many_instances_as_no_memory_holds_are_refused(save):
    file, _ = instanced("LINEAR")
    document = read_document(file)
    document["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = {"SCALE": 4}
    document["accessors"][4] = {"componentType": 5126, "type": "VEC3", "count": HUGE}
    say(save(document, file.blob))


@pytest.mark.parametrize(("says", "change"), CASES.items())
def test_wrong_values_are_refused_with_their_place(save, says, change):
    file, _ = skinned("LINEAR")
    document = read_document(file)
    change(document)
    assert says in say(save(document, file.blob))


def overwrite(file, accessor, values, row=0):
    """Put numbers where a row of an accessor is, in the buffer."""
    held = file.json["accessors"][accessor]
    letter = {5126: "f", 5121: "B", 5123: "H"}[held["componentType"]]
    place = file.json["bufferViews"][held["bufferView"]]["byteOffset"]
    place += row * struct.calcsize(letter) * {"SCALAR": 1, "VEC4": 4, "MAT4": 16}[held["type"]]
    data = struct.pack(f"<{len(values)}{letter}", *values)
    file.blob = file.blob[:place] + data + file.blob[place + len(data) :]


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("accessor", "values", "says"),
    [
        ("binds", [NAN], "inverse bind matrices, expected 6 of finite numbers"),
        ("keys", [9.0], "are not ascending times (key 1 is at"),
        ("keys", [NAN], "are not ascending times (they are not all finite)"),
        ("keys", [-9e30], "frames at 24 per second, expected at most 100000; give a lower `fps=`"),
        ("turns", [INF], "samplers[0].output has values that are not finite"),
        ("weights", [NAN], "has weights of joints that are not finite numbers from 0 on"),
        ("weights", [-1.0], "has weights of joints that are not finite numbers from 0 on"),
        ("indices", [18], "primitives[0].indices name vertex 18, expected 0 to 17"),
    ],
)
def test_wrong_numbers_in_buffers_are_refused(save, accessor, values, says):
    file, _ = skinned("LINEAR")
    document = read_document(file)
    (primitive,) = document["meshes"][0]["primitives"]
    sampler = document["animations"][0]["samplers"][0]
    places = {"binds": 0, "keys": sampler["input"], "turns": sampler["output"]}
    places |= {"weights": primitive["attributes"]["WEIGHTS_0"], "indices": primitive["indices"]}
    overwrite(file, places[accessor], values)
    assert says in say(save(document, file.blob))


def test_a_step_between_frames_that_is_next_to_nothing_is_refused(save):
    file, _ = skinned("LINEAR")
    document = read_document(file)
    document["animations"][0]["extras"] = {"cageik_rate": [24, 1e-310]}
    assert "expected at most 100000" in say(save(document, file.blob))


@pytest.mark.parametrize("indices", [[7, 2], [2, 2], [2, 999]])
def test_sparse_indices_must_ascend(save, indices):
    file, _ = quantised("LINEAR")
    document = read_document(file)
    sparse = next(each["sparse"] for each in document["accessors"] if "sparse" in each)
    place = document["bufferViews"][sparse["indices"]["bufferView"]]["byteOffset"]
    blob = file.blob[:place] + struct.pack("<2H", *indices) + file.blob[place + 4 :]
    assert "sparse.indices are not ascending numbers below 48" in say(save(document, blob))


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression"])
@pytest.mark.parametrize("is_required", [True, False])
def test_compressed_meshes_name_a_way_out(save, name, is_required):
    file, _ = skinned("LINEAR")
    document = read_document(file) | {"extensionsUsed": [name]}
    if is_required:
        document["extensionsRequired"] = [name]
    elif name.startswith("KHR"):
        primitive = document["meshes"][0]["primitives"][0]
        primitive["extensions"] = {name: {"bufferView": 0, "attributes": {"POSITION": 0}}}
        del document["accessors"][primitive["attributes"]["POSITION"]]["bufferView"]
    else:
        document["buffers"].append({"byteLength": 8, "extensions": {name: {"fallback": True}}})
        document["bufferViews"][1]["buffer"] = 1
    text = say(save(document, file.blob))
    assert f"({name})" in text
    assert "`gltf-transform cp in.glb out.glb`" in text


def make_plain(**accessor):
    """A triangle whose positions are an accessor without bytes."""
    positions = {"componentType": 5126, "type": "VEC3", "count": 3} | accessor
    return {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [positions],
    }


def test_few_bytes_cannot_ask_for_much(save, monkeypatch):
    assert "expected at most 1048576" in say(save(make_plain(count=HUGE)))
    same = {"attributes": {"POSITION": 0}}
    document = make_plain(count=3000)
    others = [{**same, "attributes": {"POSITION": 0, f"_{k}": 0}} for k in range(99)]
    document["meshes"][0]["primitives"] = others
    assert "expected at most 1048576" in say(save(document))
    document = make_plain(count=3000)
    document["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 0}] * 999
    assert "expected at most 1048576" in say(save(document))
    file = Built()
    points = file.array(np.random.default_rng(0).normal(size=(999, 3)))
    file.add("meshes", {"primitives": [{"attributes": {"POSITION": points}}]})
    file.json["nodes"] = [{"mesh": 0}] * 99
    monkeypatch.setattr(files, "MAX_INSTANCED_BYTES", 1 << 20)
    assert "of memory with all instances" in say(save(read_document(file), file.blob))


def repeat_influences(name, count):
    """A document, and its buffer, of a skinned mesh whose joints and weights have many names."""
    file = skinned("LINEAR")[0]
    document = read_document(file)
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    for k in range(2, count):
        attributes |= {
            f"{what}_{name.format(k)}": attributes[f"{what}_0"] for what in ("JOINTS", "WEIGHTS")
        }
    return document, file.blob


def test_many_sets_of_joints_are_refused_before_they_take_memory(save):
    assert "packed in" in say(save(*repeat_influences("{}", 2000)))


def test_names_of_joints_without_a_number_are_no_sets(save):
    path = save(*repeat_influences("x{}", 2000))
    tracemalloc.start()
    clip = open_sequence([str(path)])
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "left out JOINTS_x2, WEIGHTS_x2" in " ".join(texts(clip.notes))
    assert most < MOST


def test_a_chain_of_many_nodes_is_no_more_work_than_others(save):
    document = make_plain()
    chain = [{"children": [k + 1]} for k in range(999)]
    document["nodes"] = [*chain, {"mesh": 0}]
    assert "the path of nodes[999] has more than 1024 characters" in say(save(document))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda data: data[:15], "is cut short in its header"),
        (lambda data: data[:-9], "it is cut short"),
        (lambda data: data[:4] + struct.pack("<I", 1) + data[8:], "is glTF 1, expected glTF 2.0"),
        (lambda data: data[:12] + struct.pack("<I", HUGE) + data[16:], "it is cut short"),
        (lambda data: data.replace(b"JSON", b"JSOM"), "does not begin with JSON"),
        (
            lambda data: data[:-9][:8] + struct.pack("<I", len(data) - 9) + data[12:-9],
            "binary part",
        ),
        (lambda data: b"no glTF", "is not a glTF file"),
        (lambda data: b"{}", "is JSON without the `asset` of a glTF file"),
        (lambda data: b'{"asset": {"version": "1.0"}}', "is not glTF 2 (its version is `1.0`)"),
        (lambda data: b'{"asset": {}}', "is not glTF 2 (it states no version)"),
        (lambda data: b'{"asset": {"version": "2.0"}}', "holds no mesh"),
    ],
)
def test_damaged_containers_are_refused(tmp_path, change, says):
    path = skinned("LINEAR")[0].save(tmp_path / "wrong.glb")
    path.write_bytes(change(path.read_bytes()))
    assert says in say(path)


def test_names_of_files_have_no_zeros_and_stay_below_the_folder(tmp_path):
    (tmp_path / "inside").mkdir()
    path = skinned("LINEAR")[0].save(tmp_path / "inside" / "blob.gltf")
    for uri in ("%2e%2e/blob.bin", "/etc/passwd", "a%00b", "file:///etc/passwd"):
        document = json.loads(path.read_text())
        document["buffers"][0]["uri"] = uri
        path.write_text(json.dumps(document))
        assert "folder" in say(path) or "is not in a file" in say(path)


def test_what_a_file_cannot_be_read_without_is_named_and_the_rest_is_taken(tmp_path):
    file = Built()
    file.add("meshes", {"primitives": [{"attributes": {"POSITION": file.array(np.eye(3))}}]})
    file.add("nodes", {"mesh": 0})
    file.json["extensionsRequired"] = ["KHR_materials_unlit", "KHR_node_visibility"]
    path = file.save(tmp_path / "unlit.glb")
    assert len(open_sequence([str(path)]).first.vertices) == 3


HARMLESS = [
    *("FB_ngon_encoding", "EXT_mesh_features", "EXT_structural_metadata", "EXT_instance_features"),
    *(
        "CESIUM_primitive_outline",
        "KHR_texture_transform",
        "KHR_texture_basisu",
        "EXT_texture_webp",
    ),
    *("VRM", "VRMC_vrm", "VRMC_springBone", "VRMC_materials_mtoon", "EXT_texture_webp"),
    *("KHR_lights_punctual", "MSFT_texture_dds", "KHR_xmp_json_ld", "FB_geometry_metadata"),
    *("NV_materials_mdl", "EXT_lights_ies", "OMI_audio_emitter", "AGI_stk_metadata"),
    *("EXT_feature_metadata", "KHR_node_selectability", "GODOT_single_root"),
]


@pytest.mark.parametrize("name", HARMLESS)
def test_extensions_that_move_no_vertex_are_left_out_with_a_note(tmp_path, name):
    file, _ = skinned("LINEAR")
    plain = frames_of(open_sequence([str(file.save(tmp_path / "plain.glb"))]))
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = [name]
    sequence = open_sequence([str(file.save(tmp_path / "a.glb"))])
    np.testing.assert_array_equal(frames_of(sequence), plain)
    expected = f"a.glb: needs extensions that move no vertex and are not kept: {name}"
    assert expected in texts(sequence.notes)


@pytest.mark.parametrize(
    "name", ["CESIUM_RTC", "KHR_animation_pointer", "EXT_mesh_primitive_restart", "VRMX", "FB_new"]
)
def test_extensions_that_may_move_vertices_are_refused(tmp_path, name):
    file, _ = skinned("LINEAR")
    file.json["extensionsRequired"] = ["KHR_texture_transform", name]
    with refused(InputError, f"needs the extension '{name}', which cageik does not read"):
        open_sequence([str(file.save(tmp_path / "a.glb"))])


def test_extensions_that_are_read_are_not_noted(tmp_path):
    file, _ = skinned("LINEAR")
    file.json["extensionsRequired"] = ["KHR_mesh_quantization", "KHR_node_visibility"]
    sequence = open_sequence([str(file.save(tmp_path / "a.glb"))])
    assert "needs" not in " ".join(texts(sequence.notes))


def test_channels_that_move_nothing_are_left_out_with_a_note(tmp_path):
    file, _ = skinned("STEP")
    channels = file.json["animations"][0]["channels"]
    channels[0]["target"] = {"path": "pointer"}
    channels[1]["target"] = {"node": 7, "path": "weights"}
    notes = " ".join(texts(open_sequence([str(file.save(tmp_path / "odd.glb"))]).notes))
    assert "channels that move no node are left out" in notes
    assert "nodes[7] has no morph targets for its animated weights" in notes


@pytest.mark.parametrize(
    ("letter", "says"),
    [("b", "componentType is 5120, expected 5121, 5123 or 5125"), ("f", "is 5126, expected 5121")],
)
def test_joints_and_indices_count_from_0(tmp_path, letter, says):
    file = Built()
    primitive = {"attributes": {"POSITION": file.array(np.eye(3))}}
    primitive["indices"] = file.array([0, 1, 2], letter)
    file.add("meshes", {"primitives": [primitive]})
    file.add("nodes", {"mesh": 0})
    assert says in say(file.save(tmp_path / "signed.glb"))


def test_primitives_of_a_mesh_have_as_many_targets(save):
    document = make_plain()
    document["meshes"][0]["primitives"] = [
        {"attributes": {"POSITION": 0}, "targets": [{"POSITION": 0}] * k} for k in (1, 2)
    ]
    assert "meshes[0] has primitives of other numbers of morph targets" in say(save(document))


def test_a_buffer_needs_data_and_a_file_without_animations_has_none_to_choose(save):
    document = make_plain(bufferView=0)
    document |= {"bufferViews": [{"buffer": 1, "byteLength": 36}]}
    document |= {"buffers": [{"byteLength": 36}, {"byteLength": 36}]}
    path = save(document, bytes(36))
    assert "buffers[1]: names no data" in say(path)
    with refused(InputError, "holds no mesh"):
        open_sequence([f"{path}::run"])


def test_positions_may_be_zero_but_for_some(tmp_path):
    file = Built()
    some = {1: None, 2: None}
    positions = file.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], sparse=some, is_dense=False)
    file.add("meshes", {"primitives": [{"attributes": {"POSITION": positions}}]})
    file.add("nodes", {"mesh": 0})
    clip = open_sequence([str(file.save(tmp_path / "sparse.glb"))])
    assert clip.first.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    del file.json["accessors"][positions]["sparse"]["values"]
    assert "sparse.values is null, expected an object" in say(file.save(clip.path))
