"""Skinned meshes, posed by their own nodes: they give what the skin weights give."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli.formats.base.skin import Skin, SkinWeights, compute_skin_weights
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.gltf_skeleton import SkeletonWriter
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import OutputError
from tests.formats.gltf.decoded import Glb
from tests.formats.gltf.painted import paint
from tests.shapes import ball, box, finer

RANDOM = np.random.default_rng(11)
REST, CAGE = ball(levels=1, size=1.0), box(2.0)
ROTATIONS = Rotation.from_rotvec(np.outer([0, 1, 2, 3, 4], [0.3, 0.9, -0.2])).as_matrix()
CAGES = (CAGE.vertices + RANDOM.normal(0, 0.2, (5, 8, 3))) @ ROTATIONS + [[[3.0, 0, -2]]]
PLAIN, PLACED = Scene(fps=25.0, start=3.0), Scene(25.0, 3.0, "Z", 0.1)
UPRIGHT = 0.1 * np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
"""From z up and tenths of a metre to y up and metres, for columns."""


def make_weights(count, mesh=REST):
    """Some weights with `count` influences per vertex; fewer for the first vertex."""
    weights = RANDOM.dirichlet(np.ones(8), len(mesh.vertices))
    np.put_along_axis(weights, np.argsort(weights, axis=1)[:, : 8 - count], 0, axis=1)
    weights[0] = np.eye(8)[5]
    return compute_skin_weights(weights / weights.sum(axis=1, keepdims=True))


def save(path, weights, scene=PLAIN, size=2, rest=REST):
    skin = Skin(rest, weights, ROTATIONS)
    writer = SkeletonWriter(path, Animation(CAGE, len(CAGES), scene, "hero"), skin)
    for start in range(0, len(CAGES), size):
        writer.append(CAGES[start : start + size])
    writer.complete()
    return Glb(path), writer.notes


def expect(weights):
    """The skin with offsets that turn, (F, m, 3)."""
    dense = weights.to_dense(8)
    return dense @ CAGES + (REST.vertices - dense @ CAGE.vertices) @ ROTATIONS


@pytest.mark.parametrize("count", [1, 3, 4, 5, 8])
@pytest.mark.parametrize("scene", [PLAIN, PLACED])
def test_the_mesh_follows_the_cages(tmp_path, count, scene):
    weights = make_weights(count)
    file, _ = save(tmp_path / "a.glb", weights, scene)
    expected = expect(weights) @ (UPRIGHT.T if scene is PLACED else np.eye(3))
    for k, frame in enumerate(expected):
        np.testing.assert_allclose(file.skinned(k), frame, rtol=0, atol=5e-6)
    (animation,) = file.json["animations"]
    for sampler in animation["samplers"]:
        times = file.array(sampler["input"])[:, 0]
        np.testing.assert_allclose(times * 25, 3 + np.arange(5), rtol=1e-6)


def test_nodes_are_at_rest(tmp_path):
    """A program that does not play shows the rest pose."""
    file, _ = save(tmp_path / "a.glb", make_weights(4))
    file.json["animations"][0]["channels"] = []
    np.testing.assert_allclose(file.skinned(0), REST.vertices, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("count", "sets"), [(1, 1), (4, 1), (5, 2), (8, 2)])
def test_weights_are_in_sets_of_four(tmp_path, count, sets):
    file, notes = save(tmp_path / "a.glb", make_weights(count))
    found = list(file.influences())
    assert len(found) == sets
    joints, weights = (np.concatenate(arrays, axis=1) for arrays in zip(*found, strict=True))
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=0, atol=1e-6)
    assert (np.diff(weights, axis=1) <= 0).all()
    np.testing.assert_array_equal(joints[weights == 0], 0)
    np.testing.assert_array_equal(joints[0], [6] + [0] * (4 * sets - 1))
    assert any("`influences=4`" in note for note in notes) == (sets == 2)


def test_joints_are_the_vertices_of_the_cage(tmp_path):
    file, _ = save(tmp_path / "a.glb", make_weights(4), PLACED)
    nodes, (skin,) = file.json["nodes"], file.json["skins"]
    assert [nodes[k]["name"] for k in skin["joints"]] == [
        "root",
        *(f"cage_00{k}" for k in range(8)),
    ]
    assert nodes[skin["skeleton"]]["name"] == "root"
    inverse = file.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
    centre = CAGE.vertices.mean(axis=0)
    np.testing.assert_allclose(-inverse[:, 3, :3], np.vstack([centre, CAGE.vertices]), atol=1e-6)
    roots = file.json["scenes"][0]["nodes"]
    assert [(nodes[k]["name"], nodes[k].get("skin")) for k in roots] == [
        ("mesh", 0),
        ("hero", None),
    ]


def test_the_root_takes_the_short_way(tmp_path):
    """Its rotation passes half a turn, where a quaternion may change its sign."""
    file, _ = save(tmp_path / "a.glb", make_weights(4))
    (animation,) = file.json["animations"]
    (channel,) = [c for c in animation["channels"] if c["target"]["path"] == "rotation"]
    turns = file.array(animation["samplers"][channel["sampler"]]["output"])
    assert (np.einsum("ki,ki->k", turns[1:], turns[:-1]) > 0).all()
    assert turns[-1, 3] < 0


@pytest.mark.parametrize(("joint", "kind"), [(254, 5121), (255, 5123)])
def test_many_joints_have_wider_numbers(tmp_path, joint, kind):
    many = finer(CAGE, 3)
    weights = SkinWeights(np.full((18, 1), joint), np.ones((18, 1)))
    skin = Skin(REST, weights, ROTATIONS[:1])
    writer = SkeletonWriter(tmp_path / "a.glb", Animation(many, 1, PLAIN, "hero"), skin)
    up = np.array([0, 1, 0])
    writer.append(many.vertices[None] + up)
    writer.complete()
    file = Glb(tmp_path / "a.glb")
    number = file.primitives[0]["attributes"]["JOINTS_0"]
    assert file.json["accessors"][number]["componentType"] == kind
    np.testing.assert_allclose(file.skinned(0), REST.vertices + up, rtol=0, atol=1e-5)


def test_materials_and_uvs_come_along(tmp_path):
    weights = make_weights(4)
    uv = RANDOM.random((len(REST.faces), 3, 2))
    rest = paint(REST, uv, np.zeros(len(REST.faces), np.int64), ("skin",))
    file, _ = save(tmp_path / "a.glb", weights, rest=rest)
    assert file.json["materials"][0]["name"] == "skin"
    moved = file.skinned(2)[file.faces()]
    np.testing.assert_allclose(moved, expect(weights)[2][REST.faces], rtol=0, atol=5e-6)
    np.testing.assert_allclose(
        file.attribute("TEXCOORD_0")[file.faces()], uv * [1, -1] + [0, 1], atol=1e-6
    )


def test_the_same_skeleton_gives_the_same_bytes(tmp_path):
    weights = make_weights(4)
    for size in (1, 3):
        save(tmp_path / f"{size}.glb", weights, size=size)
    first, second = (path.read_bytes() for path in tmp_path.iterdir())
    assert first == second


def test_more_joints_than_programs_read_are_refused(tmp_path):
    weights = SkinWeights(np.tile(np.arange(9), (18, 1)), np.full((18, 9), 1 / 9))
    skin = Skin(REST, weights, ROTATIONS)
    with pytest.raises(OutputError, match="up to 9 joints move a vertex, and programs read at mos"):
        SkeletonWriter(tmp_path / "a.glb", Animation(CAGE, 5, PLAIN, "hero"), skin)
    assert list(tmp_path.iterdir()) == []


def test_there_is_no_time_before_zero(tmp_path):
    animation = Animation(CAGE, 5, Scene(start=-2), "hero")
    with pytest.raises(OutputError, match="first frame is -2, and glTF has no time before 0"):
        SkeletonWriter(tmp_path / "a.glb", animation, Skin(REST, make_weights(4), ROTATIONS))


def test_abandoned_it_leaves_nothing(tmp_path):
    animation = Animation(CAGE, 5, PLAIN, "hero")
    writer = SkeletonWriter(tmp_path / "a.glb", animation, Skin(REST, make_weights(4), ROTATIONS))
    writer.append(CAGES)
    writer.abandon()
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_too_large_for_single_precision_is_refused(tmp_path):
    skin = Skin(TriMesh(REST.vertices * 1e40, REST.faces), make_weights(4), ROTATIONS)
    with pytest.raises(OutputError, match="too large"):
        SkeletonWriter(tmp_path / "a.glb", Animation(CAGE, 5, PLAIN, "hero"), skin)
    assert list(tmp_path.iterdir()) == []
