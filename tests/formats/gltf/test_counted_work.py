"""Products of two numbers of a file: what is looked at grows with their sum."""

import json
import os

import numpy as np
import pytest

from cageik_cli.formats.base import scene_graph
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.gltf import document as document_module
from cageik_cli.formats.gltf import nodes
from cageik_cli.formats.gltf import reader as module
from cageik_cli.formats.gltf.document import Document, TrialWanted, Watch
from cageik_cli.formats.gltf.nodes import Skin
from cageik_cli.formats.gltf.reader import Reader
from cageik_cli.util.errors import FormatError
from cageik_cli.util.trial import Trials
from tests.formats.gltf.built import Built
from tests.shapes import TETRAHEDRON

COUNT = 100
"""Of each of two kinds: their product is five times what may be looked at."""

MOST_LOOKS = 20 * COUNT


CORNERS = TETRAHEDRON.vertices


def build_mesh(target_count=0):
    """Build a mesh of four faces, and return it with its primitive."""
    built = Built()
    primitive = {
        "attributes": {"POSITION": built.array(CORNERS)},
        "indices": built.array(TETRAHEDRON.faces.ravel(), "I"),
    }
    if target_count:
        primitive["targets"] = [{} for _ in range(target_count)]
    built.add("nodes", {"mesh": built.add("meshes", {"primitives": [primitive]})})
    return built, primitive


def build_points():
    """Nodes that share a mesh of points."""
    built, _ = build_mesh()
    points = {"mode": 0, "attributes": {}}
    mesh = built.add("meshes", {"primitives": [points] * COUNT})
    built.json["nodes"] += [{"mesh": mesh}] * COUNT
    return built


def build_channels():
    """Channels and samplers, as many of each."""
    built, _ = build_mesh()
    first = len(built.json["nodes"])
    built.json["nodes"] += [{} for _ in range(COUNT)]
    keys, values = built.array([0.0, 1.0]), built.array(np.zeros((2, 3)))
    samplers = [{"input": keys, "output": values}] * COUNT
    targets = [{"node": first + k, "path": "translation"} for k in range(COUNT)]
    channels = [{"sampler": k, "target": target} for k, target in enumerate(targets)]
    built.add("animations", {"samplers": samplers, "channels": channels})
    return built


def build_targets():
    """Morph targets that move nothing, of nodes that share a mesh."""
    built, _ = build_mesh(COUNT)
    built.json["meshes"][0]["weights"] = [0.0] * COUNT
    built.json["nodes"] += [{"mesh": 0}] * (COUNT // 10)
    return built


def build_levels():
    """Nodes that are all below many others."""
    built, _ = build_mesh()
    first = len(built.json["nodes"])
    built.json["nodes"] += [{"name": "a", "children": [first + k + 1]} for k in range(COUNT)]
    below = [first + COUNT + 1 + k for k in range(COUNT)]
    built.json["nodes"].append({"name": "a", "children": below})
    built.json["nodes"] += [{"mesh": 0}] * COUNT
    built.animate("move", (first, "translation", [0.0, 1.0], np.eye(2, 3), "LINEAR"))
    return built


def build_skins(skin_count=1):
    """Nodes whose meshes and joints are the same."""
    built, primitive = build_mesh()
    primitive["attributes"] |= {
        "JOINTS_0": built.array(np.zeros((4, 4)), "B"),
        "WEIGHTS_0": built.array(np.eye(4)[[0] * 4]),
    }
    for _ in range(skin_count):
        built.add("skins", {"joints": [0] * COUNT})
    nodes = [{"mesh": 0, "skin": k % skin_count} for k in range(10)]
    built.json["nodes"][0] = nodes[0]
    built.json["nodes"] += nodes[1:]
    return built


@pytest.mark.parametrize("build", [build_points, build_channels, build_targets, build_skins])
def test_what_nodes_share_is_looked_at_once(tmp_path, monkeypatch, build):
    looks = []
    monkeypatch.setattr(Watch, "look", lambda self: looks.append(1))
    reader = Reader(ClipRequest((build().save(tmp_path / "a.glb"),)))
    assert len(reader.first.vertices) >= 4
    assert len(looks) < MOST_LOOKS


def test_nodes_below_many_others_are_named_and_moved_by_them(tmp_path):
    """Their paths begin with that of the node above, and it is known whether that moves."""
    reader = Reader(ClipRequest((build_levels().save(tmp_path / "a.glb"),)))
    names = list(reader._meshes)
    assert names[0] == "/node_0"
    above = "/a" * (COUNT + 1)
    assert all(name.startswith(f"{above}/node_") for name in names[1:])
    moved = [mesh.has_moving_transform() for mesh in reader._meshes.values()]
    assert moved == [False] + [True] * COUNT
    tree = reader._rig.tree
    steps = len(tree._paths)
    assert steps == 2 * COUNT + 2  # each node once


def test_a_sampler_that_channels_share_counts_once(tmp_path):
    """The times of the frames are chosen from the keys of all samplers."""
    built = build_channels()
    for channel in built.json["animations"][0]["channels"]:
        channel["sampler"] = 0
    reader = Reader(ClipRequest((built.save(tmp_path / "a.glb"),)))
    assert len(reader) == 25
    assert len(reader._rig.animation._read) == 1
    assert len(reader._rig.animation._samplers) == COUNT


def test_targets_that_move_nothing_are_skipped(tmp_path):
    built, primitive = build_mesh(COUNT)
    primitive["targets"][7] = {"POSITION": built.array(np.ones((4, 3)))}
    built.json["nodes"][0]["weights"] = [float(k == 7) for k in range(COUNT)]
    reader = Reader(ClipRequest((built.save(tmp_path / "a.glb"),)))
    (geometry,) = reader._geometries.values()
    assert list(geometry._targets) == [7]
    np.testing.assert_array_equal(reader.first.vertices, CORNERS + 1)


def test_targets_of_what_has_no_faces_are_not_those_of_the_mesh(tmp_path):
    """Weights of a mesh are those of its triangles."""
    built, primitive = build_mesh(2)
    points = {"mode": 0, "attributes": primitive["attributes"], "targets": [{}] * 5}
    built.json["meshes"][0]["primitives"].append(points)
    built.animate("move", (0, "weights", [0.0, 1.0], [0.0, 0, 1, 1], "LINEAR"))
    reader = Reader(ClipRequest((built.save(tmp_path / "a.glb"),)))
    np.testing.assert_array_equal(reader.read_positions(3), CORNERS)


def test_targets_count_as_what_they_are_compared_with(tmp_path):
    """A target of a few vertices is compared with all: of 50 times 20 000, that is too much."""
    built, primitive = build_mesh(0)
    many = {"POSITION": built.array(np.random.default_rng(0).normal(size=(20_001, 3)))}
    moved = {"POSITION": built.array(np.ones((4, 3)))}
    still = [{} for _ in range(600)]
    primitive["targets"] = [moved for _ in still]
    built.json["meshes"][0]["primitives"].append({"attributes": many, "targets": still})
    with pytest.raises(FormatError, match="takes at least"):
        Reader(ClipRequest((built.save(tmp_path / "a.glb"),)))


@pytest.mark.parametrize("skin_count", [1, 2, 9])
def test_copies_of_a_skinned_mesh_share_its_joints(tmp_path, monkeypatch, skin_count):
    calls = []
    compute = Skin.compute_moves
    monkeypatch.setattr(
        Skin, "compute_moves", lambda self, worlds: calls.append(1) or compute(self, worlds)
    )
    reader = Reader(ClipRequest((build_skins(skin_count).save(tmp_path / "a.glb"),)))
    assert len(reader.first.vertices) == 40
    assert len(calls) == skin_count


LIMITED = {
    "nodes": build_points,
    "primitives": build_points,
    "joints": build_skins,
    "animated values": build_channels,
}


@pytest.mark.parametrize("noun", LIMITED)
def test_objects_of_a_small_file_take_little(tmp_path, monkeypatch, noun):
    """Each takes thousands of bytes, and a few of the file."""
    monkeypatch.setattr(document_module, "MAX_OBJECT_BYTES", 0)
    monkeypatch.setattr(document_module, "compute_unpacked_limit", lambda packed: 500 * COUNT)
    for name, owner in (("NODE", nodes), ("JOINT", nodes), ("CHANNEL", module)):
        is_meant = noun.startswith(name[:5].lower()) or (name, noun) == (
            "CHANNEL",
            "animated values",
        )
        monkeypatch.setattr(owner, f"{name}_BYTES", 501 if is_meant else 0)
    if noun == "primitives":
        built, primitive = build_mesh()
        built.json["meshes"][0]["primitives"] = [primitive] * COUNT
    else:
        built = LIMITED[noun]()
    with pytest.raises(FormatError, match=rf"has 1\d\d {noun}, with .* expected at most 50 kB"):
        Reader(ClipRequest((built.save(tmp_path / "a.glb"),)))


@pytest.mark.parametrize("link", [False, True])
def test_a_file_that_many_buffers_name_is_read_once(tmp_path, monkeypatch, link):
    built, _ = build_mesh()
    path = built.save(tmp_path / "blob.gltf")
    document = Document(path)
    (tmp_path / "blob data.bin").rename(tmp_path / "data.bin")
    names = ["data.bin", "./data.bin", "%64ata.bin", "data.bin"]
    if link:
        os.symlink("data.bin", tmp_path / "link.bin")
        names.append("link.bin")
    root = document.root.values
    root["buffers"] = [{"uri": name, "byteLength": len(built.blob)} for name in names]
    for k, view in enumerate(root["bufferViews"]):
        view["buffer"] = k % len(names)
    root["meshes"][0]["primitives"] *= len(names)
    path.write_text(json.dumps(root))
    sizes = []
    read = document_module.read_input

    def count(file, *words, **more):
        sizes.append(file.name)
        return read(file, *words, **more)

    monkeypatch.setattr(document_module, "read_input", count)
    reader = Reader(ClipRequest((path,)))
    assert sizes == ["blob.gltf", "data.bin"]
    assert len(reader.files) == 2
    assert reader.describe_source()["files"] == 2


@pytest.fixture
def trials(monkeypatch):
    """Trials as of the command line, with the calls that were tried."""
    trials = Trials()
    trials.are_wanted, trials.tried = True, []
    monkeypatch.setattr(module, "trials", trials)
    monkeypatch.setattr(scene_graph, "trials", trials)
    return trials


def test_a_file_that_takes_long_is_tried_first(tmp_path, monkeypatch, trials):
    path = build_skins().save(tmp_path / "a.glb")
    plain = Reader(ClipRequest((path,)))
    monkeypatch.setattr(module, "MAX_UNTRIED_SECONDS", -1.0)
    monkeypatch.setattr(
        trials, "find_fault", lambda library, *rest, key: trials.tried.append(library) or ""
    )
    reader = Reader(ClipRequest((path,)))
    assert trials.tried == ["cageik"]
    np.testing.assert_array_equal(reader.first.vertices, plain.first.vertices)
    assert reader.notes == plain.notes


def test_a_file_that_fails_in_its_trial_is_refused(tmp_path, monkeypatch, trials):
    path = build_skins().save(tmp_path / "a.glb")
    monkeypatch.setattr(module, "MAX_UNTRIED_SECONDS", -1.0)
    monkeypatch.setattr(trials, "find_fault", lambda *words, key: "is damaged: it takes too long")
    with pytest.raises(FormatError, match=r"a\.glb: is damaged: it takes too long$"):
        Reader(ClipRequest((path,)))


def test_an_ordinary_file_is_not_tried(tmp_path, monkeypatch, trials):
    monkeypatch.setattr(trials, "find_fault", lambda *words, key: pytest.fail("tried"))
    Reader(ClipRequest((build_skins().save(tmp_path / "a.glb"),)))


def test_the_watch_reads_the_clock_now_and_then():
    with pytest.raises(TrialWanted):
        Watch(-1.0).read()
    watch = Watch(-1.0)
    for _ in range(document_module.LOOKS_PER_READING - 1):
        watch.look()
    with pytest.raises(TrialWanted):
        watch.look()
    Watch().read()
    watch.allow(2 * document_module.WATCHED_BYTES_PER_SECOND)
    watch.read()
