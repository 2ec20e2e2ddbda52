"""Skeletons, skinned by USD itself or by the nodes of glTF: they give what the weights give."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from scipy.spatial.transform import Rotation

from cageik_cli.formats.base.skeleton import (
    HEADING_LIMITS,
    Skeleton,
    Skin,
    SkinWeights,
    compute_skin_weights,
)
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.gltf import skeleton
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.usd import writer as usd_writer
from cageik_cli.formats.usd.library import USD_SUFFIXES
from cageik_cli.geometry.attributes import SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import compute_vertex_normals
from cageik_cli.rigs.joints import turn_normals
from cageik_cli.util.errors import OutputError
from tests.clips import frames_of
from tests.formats.clips import faults_of
from tests.formats.gltf.decoded import Glb
from tests.formats.gltf.painted import paint
from tests.shapes import ball, box, finer
from tests.texts import texts

RANDOM = np.random.default_rng(11)
BALL, BOX = ball(levels=1, size=1.0), box(2.0)
REST, CAGE = (mesh.move(mesh.vertices + np.array([0.5, 0, -0.25])) for mesh in (BALL, BOX))
ROTATIONS = Rotation.from_rotvec(np.outer([0, 1, 2, 3, 4], [0.3, 0.9, -0.2])).as_matrix()
CAGES = (CAGE.vertices + RANDOM.normal(0, 0.2, (5, 8, 3))) @ ROTATIONS + [[[3.0, 0, -2]]]
TURNS = Rotation.from_rotvec(RANDOM.normal(0, 0.5, (40, 3))).as_matrix().reshape(5, 8, 3, 3)
TURNS = TURNS @ ROTATIONS[:, None]
SCENE = Scene(fps=25.0, start=3.0, up_axis="Z", metres_per_unit=0.1)
UPRIGHT = 0.1 * np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
"""From z up and tenths of a metre to y up and metres, for columns."""

CONVEX = ((BALL.vertices[:, None] / BOX.vertices + 1) / 2).prod(axis=2)
"""Trilinear weights of a box's corners: they are convex inside, and rebuild the points."""
# Moved along what gives no point: rows still sum to one and rebuild the rest pose.
SIGNED = CONVEX + 0.2 * np.prod(np.sign(BOX.vertices), axis=1)


def make_weights(count):
    """Some weights with `count` influences per vertex; fewer for the first vertex."""
    weights = RANDOM.dirichlet(np.ones(8), len(REST.vertices))
    np.put_along_axis(weights, np.argsort(weights, axis=1)[:, : 8 - count], 0, axis=1)
    weights[0] = np.eye(8)[5]
    return compute_skin_weights(weights / weights.sum(axis=1, keepdims=True))


WEIGHTS = {str(count): make_weights(count) for count in (1, 3, 4, 5, 8)}
WEIGHTS |= {"convex": compute_skin_weights(CONVEX), "signed": compute_skin_weights(SIGNED)}


class GltfRig:
    """What a GLB file says, by its accessors and nodes."""

    name, make = "rig.glb", skeleton.SkeletonWriter

    def __init__(self, path):
        self.file = Glb(path)
        (self.animation,) = self.file.json["animations"]

    def skin(self):
        """The mesh at each frame, (F, m, 3), in the space of the cages."""
        frames = np.array([self.file.skinned(k) for k in range(len(CAGES))])
        return frames @ np.linalg.inv(UPRIGHT.T)

    def shade(self):
        """The normals of the vertices at each frame, (F, m, 3), of length 1."""
        frames = np.array([self.file.skinned(k, "NORMAL") for k in range(len(CAGES))])
        turned = frames @ np.linalg.inv(UPRIGHT.T)
        return turned / np.linalg.norm(turned, axis=2, keepdims=True)

    def turns(self):
        """The quaternions of the joints that have keys, the real part last, (F, j, 4)."""
        keys = [c for c in self.animation["channels"] if c["target"]["path"] == "rotation"]
        samplers = [self.animation["samplers"][key["sampler"]] for key in keys]
        return np.stack([self.file.array(each["output"]) for each in samplers], axis=1)

    def joints(self):
        """The names of the joints, and their places when they are bound."""
        nodes, (skin,) = self.file.json["nodes"], self.file.json["skins"]
        assert nodes[skin["skeleton"]]["name"] == "root"
        inverse = self.file.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
        return [nodes[k]["name"] for k in skin["joints"]], -inverse[:, 3, :3]

    def parents(self):
        """The names of what each joint is below."""
        nodes, (skin,) = self.file.json["nodes"], self.file.json["skins"]
        above = {child: k for k in skin["joints"] for child in nodes[k].get("children", [])}
        return [nodes[above[k]]["name"] if k in above else None for k in skin["joints"]]

    def aliases(self):
        nodes, (skin,) = self.file.json["nodes"], self.file.json["skins"]
        return [nodes[k].get("extras", {}).get("cage", "") for k in skin["joints"]]


class UsdRig:
    """What USD says of a stage; `skin` changes it."""

    name, make = "rig.usdc", usd_writer.SkeletonWriter

    def __init__(self, path):
        self.stage = Usd.Stage.Open(str(path))
        self.skeleton = UsdSkel.Skeleton(self.stage.GetPrimAtPath("/hero/skeleton"))

    def skin(self):
        assert UsdSkel.BakeSkinning(UsdSkel.Root(self.stage.GetDefaultPrim()))
        points = UsdGeom.Mesh(self.stage.GetPrimAtPath("/hero/mesh")).GetPointsAttr()
        return np.array([np.array(points.Get(3 + k)) for k in range(len(CAGES))], float)

    def shade(self):
        assert UsdSkel.BakeSkinning(UsdSkel.Root(self.stage.GetDefaultPrim()))
        normals = UsdGeom.Mesh(self.stage.GetPrimAtPath("/hero/mesh")).GetNormalsAttr()
        frames = np.array([np.array(normals.Get(3 + k)) for k in range(len(CAGES))], float)
        return frames / np.linalg.norm(frames, axis=2, keepdims=True)

    def turns(self):
        motion = UsdSkel.Animation(self.stage.GetPrimAtPath("/hero/skeleton/motion"))
        frames = [motion.GetRotationsAttr().Get(3 + k) for k in range(len(CAGES))]
        return np.array([[[*turn.imaginary, turn.real] for turn in turns] for turns in frames])

    def joints(self):
        names = [name.rpartition("/")[2] for name in self.skeleton.GetJointsAttr().Get()]
        return names, translations(self.skeleton.GetBindTransformsAttr())

    def parents(self):
        paths = [name.split("/") for name in self.skeleton.GetJointsAttr().Get()]
        return [path[-2] if len(path) > 1 else None for path in paths]

    def aliases(self):
        return list(self.skeleton.GetPrim().GetCustomDataByKey("cage"))


def translations(attribute):
    return np.array([matrix.ExtractTranslation() for matrix in attribute.Get()])


@pytest.fixture(params=[GltfRig, UsdRig])
def rig(request):
    return request.param


def start(rig, path, weights=WEIGHTS["4"], rest=REST, turns=None, limbs=None, **options):
    animation = Animation(CAGE, len(CAGES), SCENE, "hero")
    skin = Skin(rest, weights, ROTATIONS, turns, limbs=limbs, error=0.25)
    return rig.make(path, animation, skin, **options)


def save(rig, path, weights=WEIGHTS["4"], size=2, rest=REST, turns=None, **options):
    """Write the skeleton; return what another program reads, and the notes."""
    writer = start(rig, path, weights, rest, turns, **options)
    for first in range(0, len(CAGES), size):
        writer.append(CAGES[first : first + size])
    writer.complete()
    return rig(path), texts(writer.notes)


def expect(weights):
    """The skin with offsets that turn, (F, m, 3)."""
    dense = weights.to_dense(8)
    return dense @ CAGES + (REST.vertices - dense @ CAGE.vertices) @ ROTATIONS


def test_the_weights_of_the_test_are_what_they_claim():
    for weights in (CONVEX, SIGNED):
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-14)
        np.testing.assert_allclose(weights @ CAGE.vertices, REST.vertices, atol=1e-14)
    assert CONVEX.min() >= 0 > SIGNED.min()
    np.testing.assert_allclose(expect(WEIGHTS["convex"]), CONVEX @ CAGES, atol=1e-14)
    assert np.abs(expect(WEIGHTS["signed"]) - SIGNED @ CAGES).max() > 0.01


@pytest.mark.parametrize("weights", WEIGHTS.values(), ids=WEIGHTS)
def test_the_mesh_follows_the_cages(tmp_path, rig, weights):
    """What weights lack that were cut off turns with the root."""
    found, _ = save(rig, tmp_path / rig.name, weights)
    np.testing.assert_allclose(found.skin(), expect(weights), rtol=0, atol=5e-6)
    assert [file.name for file in tmp_path.iterdir()] == [rig.name]


def test_the_root_takes_the_short_way(tmp_path, rig):
    """Its rotation passes half a turn, where a quaternion may change its sign."""
    turns = save(rig, tmp_path / rig.name)[0].turns()[:, 0]
    assert (np.einsum("ki,ki->k", turns[1:], turns[:-1]) > 0).all()
    assert turns[-1, 3] < 0


@pytest.mark.parametrize("count", ["1", "4", "8"])
def test_the_mesh_and_its_normals_follow_joints_that_turn(tmp_path, rig, count):
    weights = WEIGHTS[count]
    dense = weights.to_dense(8)
    expected = expect_turning(dense)
    found, _ = save(rig, tmp_path / rig.name, weights, turns=TURNS)
    np.testing.assert_allclose(found.skin(), expected, rtol=0, atol=5e-6)
    found, _ = save(rig, tmp_path / f"again_{rig.name}", weights, turns=TURNS)
    normals = compute_vertex_normals(REST.polygons, REST.vertices)
    cosines = np.einsum("fmx,fmx->fm", found.shade(), turn_normals(normals, dense, TURNS))
    assert np.degrees(np.arccos(cosines.clip(-1, 1))).max() < 0.1


LIMBS = np.array([0, 0, 1, 1, 0, 0, 1, 1])
"""The lower and the upper corners of the box, as z is up."""

TREES = {
    "limbs": {"limbs": LIMBS},
    "extracted": {"is_extracted": True},
    "both": {"limbs": LIMBS, "is_extracted": True},
}


def expect_turning(dense, turns=TURNS):
    arms = REST.vertices[:, None] - CAGE.vertices
    alone = np.einsum("mna,fnab->fmnb", arms, turns) + CAGES[:, None]
    return np.einsum("mn,fmnb->fmb", dense, alone)


@pytest.mark.parametrize("tree", TREES.values(), ids=TREES)
def test_no_tree_of_joints_changes_the_mesh(tmp_path, rig, tree):
    found, _ = save(rig, tmp_path / rig.name, turns=TURNS, **tree)
    expected = expect_turning(WEIGHTS["4"].to_dense(8))
    np.testing.assert_allclose(found.skin(), expected, rtol=0, atol=1e-5)
    turns = save(rig, tmp_path / f"again_{rig.name}", turns=TURNS, **tree)[0].turns()
    assert (np.einsum("fjq,fjq->fj", turns[1:], turns[:-1]) > 0).all()


def test_joints_of_limbs_are_below_them_and_named_by_their_place(tmp_path, rig):
    found, _ = save(rig, tmp_path / rig.name, turns=TURNS, limbs=LIMBS, is_extracted=True)
    names, places = found.joints()
    assert names[:2] == ["root", "body"]
    assert {name.rpartition("_")[0] for name in names[4:]} == set(names[2:4])
    above = found.parents()
    assert above[:4] == [None, "root", "body", "body"]
    for name, parent in zip(names[4:], above[4:], strict=True):
        assert name.startswith(parent)
    np.testing.assert_allclose(places[4:], CAGE.vertices, atol=1e-6)
    np.testing.assert_allclose(places[2], CAGE.vertices[LIMBS == 0].mean(axis=0), atol=1e-6)
    assert found.aliases() == ["", "", "", "", *(f"cage_00{k}" for k in range(8))]


def test_an_extracted_root_stays_on_the_ground_and_upright(tmp_path):
    """It turns about the vertical alone, and is below the mean of the joints."""
    skin = Skin(REST, WEIGHTS["4"], ROTATIONS, TURNS)
    tree = Skeleton(CAGE.vertices, skin, up_axis="Z", is_extracted=True)
    floor = REST.vertices[:, 2].min()
    assert tree.bind_places[0, 2] == floor
    for k, (places, turns) in enumerate(tree.advance(CAGES)):
        np.testing.assert_allclose(places[0], [*CAGES[k].mean(axis=0)[:2], floor], atol=1e-12)
        np.testing.assert_allclose(turns[0, :2], 0, atol=1e-12)
        quaternion = Rotation.from_matrix(ROTATIONS[k].T).as_quat()
        if np.hypot(*quaternion[2:]) > HEADING_LIMITS[1]:
            assert abs(turns[1, 2]) < 1e-12  # the body leans, and does not turn about the vertical
        both = Rotation.from_quat(turns[0]) * Rotation.from_quat(turns[1])
        np.testing.assert_allclose(both.as_matrix(), ROTATIONS[k].T, atol=1e-12)


@pytest.mark.parametrize("lean", [0, 3, -20])
def test_a_somersault_keeps_the_heading(tmp_path, lean):
    """About the side axis the body passes through a half turn, near which it has no heading."""
    flips = Rotation.from_rotvec(np.outer(np.linspace(0, 2 * np.pi, 49), [1, 0, 0]))
    whole = (flips * Rotation.from_euler("y", lean, degrees=True)).as_matrix()
    skin = Skin(REST, WEIGHTS["4"], whole.swapaxes(1, 2))
    tree = Skeleton(CAGE.vertices, skin, up_axis="Z", is_extracted=True)
    found = [turns[0] for _, turns in tree.advance(np.repeat(CAGE.vertices[None], 49, axis=0))]
    steps = [2 * np.arccos(min(1, abs(a @ b))) for a, b in pairwise(found)]
    assert np.degrees(max(steps)) <= 2 * abs(lean) + 1e-3
    assert np.degrees(2 * np.arccos(min(1, abs(found[-1][3])))) < 1e-3


def test_a_moved_animation_keeps_the_root_on_the_ground(tmp_path, rig):
    """The joints of `--recentre` are moved already, and so is what their root stands on."""
    origin = (100.0, 50.0, 7.0)
    animation = replace(Animation(CAGE, len(CAGES), SCENE, "hero"), origin=origin)
    rest = REST.move(REST.vertices + np.array(origin))
    skin = Skin(rest, WEIGHTS["4"], ROTATIONS, TURNS, limbs=LIMBS)
    writer = rig.make(tmp_path / rig.name, animation, skin, is_extracted=True)
    writer.append(CAGES)
    writer.complete()
    names, places = rig(tmp_path / rig.name).joints()
    assert places[0, 2] == pytest.approx(REST.vertices[:, 2].min(), abs=1e-5)
    assert (
        names == save(rig, tmp_path / f"a_{rig.name}", turns=TURNS, **TREES["both"])[0].joints()[0]
    )


def test_vertices_in_no_face_are_no_ground():
    far = TriMesh(np.vstack([REST.vertices, [[0, 0, -30.0]]]), REST.faces)
    weights = SkinWeights(
        np.vstack([WEIGHTS["4"].joints, WEIGHTS["4"].joints[:1]]),
        np.vstack([WEIGHTS["4"].values, WEIGHTS["4"].values[:1]]),
    )
    tree = Skeleton(CAGE.vertices, Skin(far, weights, ROTATIONS), up_axis="Z", is_extracted=True)
    assert tree.bind_places[0, 2] == REST.vertices[:, 2].min()


def test_three_turns_about_the_vertical_are_three_turns_of_an_extracted_root(tmp_path):
    angles = np.linspace(0, 6 * np.pi, 40)
    whole = Rotation.from_rotvec(np.outer(angles, [0, 0, 1])).as_matrix().swapaxes(1, 2)
    tree = Skeleton(CAGE.vertices, Skin(REST, WEIGHTS["4"], whole), up_axis="Z", is_extracted=True)
    frames = np.repeat(CAGE.vertices[None], 40, axis=0)
    found = np.array([turns[0] for _, turns in tree.advance(frames)])
    steps = 2 * np.arccos((found[1:] * found[:-1]).sum(axis=1).clip(-1, 1))
    np.testing.assert_allclose(steps, angles[1], atol=1e-6)


def test_all_joints_that_turn_take_the_short_way(tmp_path, rig):
    frames = save(rig, tmp_path / rig.name, turns=TURNS)[0].turns()
    assert frames.shape == (5, 9, 4)
    assert (np.einsum("fjq,fjq->fj", frames[1:], frames[:-1]) > 0).all()


def test_hard_edges_of_the_asset_are_kept(tmp_path, rig):
    """Corners with normals of their own face keep them; each corner is lit as its face."""
    counts, corners = np.full(len(REST.faces), 3), REST.faces.ravel()
    hard = SurfaceAttributes(counts, corners, normal_fans=np.arange(len(corners)))
    rest = TriMesh(REST.vertices, REST.faces, hard)
    found, _ = save(rig, tmp_path / rig.name, rest=rest, turns=ROTATIONS[:, None].repeat(8, axis=1))
    own = [np.cross(*(c[1] - c[0], c[2] - c[0])) for c in REST.vertices[REST.faces]]
    own = np.repeat(own / np.linalg.norm(own, axis=1, keepdims=True), 3, axis=0)
    shaded = found.shade()
    if rig is GltfRig:
        shaded = shaded[:, found.file.faces().ravel()]
    np.testing.assert_allclose(shaded, own @ ROTATIONS, rtol=0, atol=1e-5)


def test_normals_of_a_surface_in_both_windings_have_a_length(tmp_path):
    both = TriMesh(REST.vertices, np.vstack([REST.faces, REST.faces[:, ::-1]]))
    found, _ = save(GltfRig, tmp_path / "a.glb", rest=both, turns=TURNS)
    np.testing.assert_allclose(np.linalg.norm(found.file.attribute("NORMAL"), axis=1), 1, rtol=1e-6)


def test_joints_that_only_translate_have_no_normals(tmp_path):
    found, _ = save(GltfRig, tmp_path / "a.glb")
    assert "NORMAL" not in found.file.primitives[0]["attributes"]
    found, _ = save(UsdRig, tmp_path / "a.usdc")
    mesh = UsdGeom.Mesh(found.stage.GetPrimAtPath("/hero/mesh"))
    assert not mesh.GetNormalsAttr().HasAuthoredValue()


def test_joints_are_the_vertices_of_the_cage(tmp_path, rig):
    names, places = save(rig, tmp_path / rig.name)[0].joints()
    assert names == ["root", *(f"cage_00{k}" for k in range(8))]
    expected = np.vstack([CAGE.vertices.mean(axis=0), CAGE.vertices])
    np.testing.assert_allclose(places, expected, atol=1e-6)


def test_the_same_skeleton_gives_the_same_bytes(tmp_path, rig):
    for size in (1, 3):
        save(rig, tmp_path / f"{size}{rig.name}", size=size)
    first, second = (path.read_bytes() for path in tmp_path.iterdir())
    assert first == second


@pytest.mark.parametrize(("rig", "name"), [(GltfRig, "rig.glb"), (UsdRig, "rig.usdz")])
def test_abandoned_it_leaves_nothing(tmp_path, rig, name):
    writer = start(rig, tmp_path / name)
    writer.append(CAGES)
    writer.abandon()
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_too_large_for_single_precision_is_refused(tmp_path, rig):
    huge = TriMesh(REST.vertices * 1e40, REST.faces)
    with pytest.raises(OutputError, match="too large"):
        start(rig, tmp_path / rig.name, rest=huge)
    assert list(tmp_path.iterdir()) == []


# --- glTF


def test_nodes_of_gltf_are_at_rest_and_their_keys_at_the_times_of_frames(tmp_path):
    """A program that does not play shows the rest pose."""
    found, _ = save(GltfRig, tmp_path / "a.glb")
    for sampler in found.animation["samplers"]:
        times = found.file.array(sampler["input"])[:, 0]
        np.testing.assert_allclose(times * 25, np.arange(5), rtol=1e-6)
    found.animation["channels"] = []
    rest = REST.vertices @ UPRIGHT.T
    np.testing.assert_allclose(found.file.skinned(0), rest, rtol=0, atol=1e-6)
    nodes = [found.file.json["nodes"][k] for k in found.file.json["scenes"][0]["nodes"]]
    assert [(node["name"], node.get("skin")) for node in nodes] == [("mesh", 0), ("hero", None)]


@pytest.mark.parametrize(("count", "sets"), [(1, 1), (4, 1), (5, 2), (8, 2)])
def test_weights_of_gltf_are_in_sets_of_four(tmp_path, count, sets):
    rig, notes = save(GltfRig, tmp_path / "a.glb", WEIGHTS[str(count)])
    found = list(rig.file.influences())
    assert len(found) == sets
    joints, weights = (np.concatenate(arrays, axis=1) for arrays in zip(*found, strict=True))
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=0, atol=1e-6)
    assert (np.diff(weights, axis=1) <= 0).all()
    np.testing.assert_array_equal(joints[weights == 0], 0)
    np.testing.assert_array_equal(joints[0], [6] + [0] * (4 * sets - 1))
    assert any("`influences=4`" in note for note in notes) == (sets == 2)


@pytest.mark.parametrize(("joint", "kind"), [(254, 5121), (255, 5123)])
def test_many_joints_have_wider_numbers_in_gltf(tmp_path, joint, kind):
    many = finer(CAGE, 3)
    weights = SkinWeights(np.full((18, 1), joint), np.ones((18, 1)))
    skin = Skin(REST, weights, ROTATIONS[:1])
    writer = GltfRig.make(tmp_path / "a.glb", Animation(many, 1, Scene(), "hero"), skin)
    up = np.array([0, 1, 0])
    writer.append(many.vertices[None] + up)
    writer.complete()
    file = Glb(tmp_path / "a.glb")
    number = file.primitives[0]["attributes"]["JOINTS_0"]
    assert file.json["accessors"][number]["componentType"] == kind
    np.testing.assert_allclose(file.skinned(0), REST.vertices + up, rtol=0, atol=1e-5)


def write_long(path, tolerance=None, is_quantized=False, rest=REST):
    """A skeleton of 40 frames that move smoothly; the file, the notes, and the mesh, (F, m, 3)."""
    times = np.arange(40)
    swing = np.sin(times[:, None] / 12 + np.arange(8))[..., None] * [0.2, 0.5, 0.1]
    turns = Rotation.from_rotvec(swing.reshape(-1, 3)).as_matrix().reshape(40, 8, 3, 3)
    cages = CAGE.vertices + 0.3 * swing
    whole = np.repeat(np.eye(3)[None], 40, axis=0)
    skin = Skin(rest, WEIGHTS["4"], whole, turns, limbs=LIMBS, error=0.25)
    animation = Animation(CAGE, 40, SCENE, "hero")
    words = {"tolerance": tolerance, "is_quantized": is_quantized}
    writer = GltfRig.make(path, animation, skin, **words)
    writer.append(cages)
    try:
        writer.complete()
    except OutputError:
        writer.abandon()
        raise
    arms = REST.vertices[:, None] - CAGE.vertices
    alone = np.einsum("mna,fnab->fmnb", arms, turns) + cages[:, None]
    return (
        Glb(path),
        texts(writer.notes),
        np.einsum("mn,fmnb->fmb", WEIGHTS["4"].to_dense(8), alone),
    )


def measure_apart(file, expected):
    """The rms and the largest distance of the skin in a file, percent of the diagonal."""
    frames = np.array([file.skinned(k) for k in range(len(expected))])
    apart = np.linalg.norm(frames @ np.linalg.inv(UPRIGHT.T) - expected, axis=2)
    return [100 * value / REST.diagonal for value in (np.sqrt(np.mean(apart**2)), apart.max())]


@pytest.mark.parametrize("tolerance", [0.01, 0.1, 1.0])
def test_keys_are_left_out_within_a_tolerance(tmp_path, tolerance):
    whole, notes, expected = write_long(tmp_path / "all.glb")
    assert notes == (("frame 3 is at 0 s, where players begin; cageik reads its number"),)
    file, notes, _ = write_long(tmp_path / "a.glb", tolerance)
    rms, largest = measure_apart(file, expected)
    assert largest <= tolerance * (1 + 1e-3)
    assert f"rms of {rms:.2g} %, {largest:.2g} % at most; against the input" in notes[-1]
    keys = [len(file.array(each["output"])) for each in file.json["animations"][0]["samplers"]]
    assert f"{sum(keys)} of {len(keys) * 40} keys are kept" in notes[-1]
    assert (len(file.binary) < 0.8 * len(whole.binary)) == (tolerance > 0.01)


def test_a_tolerance_that_is_rounding_keeps_all_keys(tmp_path):
    """Its bytes are those without one; the note says so."""
    whole, _, _ = write_long(tmp_path / "all.glb")
    file, notes, _ = write_long(tmp_path / "a.glb", 1e-16)
    assert file.binary == whole.binary
    kept = f"{22 * 40} of {22 * 40} keys are kept, by which vertices are off by an rms of 0 %"
    assert kept in notes[-1]


def test_merged_joints_name_all_their_vertices(tmp_path, rig):
    joints = np.array([0, 0, 1, 2, 3, 4, 5, 6, 7])  # of a cage of nine vertices
    animation = Animation(CAGE, len(CAGES), SCENE, "hero")
    skin = Skin(REST, WEIGHTS["4"], ROTATIONS, TURNS, cage_joints=joints)
    writer = rig.make(tmp_path / rig.name, animation, skin)
    writer.append(CAGES)
    writer.complete()
    assert rig(tmp_path / rig.name).aliases()[:3] == ["", "cage_000 cage_001", "cage_002"]


def test_quantized_skins_are_small_and_near(tmp_path):
    uv = RANDOM.random((len(REST.faces), 3, 2))
    rest = paint(REST, uv, np.zeros(len(REST.faces), np.int64), ("skin",))
    whole, _, _ = write_long(tmp_path / "all.glb", rest=rest)
    file, notes, expected = write_long(tmp_path / "a.glb", is_quantized=True, rest=rest)
    assert file.json["extensionsRequired"] == ["KHR_mesh_quantization"]
    assert "extensionsRequired" not in whole.json or not whole.json["extensionsRequired"]
    faces = file.faces()
    frames = np.array([file.skinned(k) for k in range(40)]) @ np.linalg.inv(UPRIGHT.T)
    apart = np.linalg.norm(frames[:, faces] - expected[:, REST.faces], axis=3)
    assert 0 < 100 * apart.max() / REST.diagonal < 0.5
    assert f"{100 * apart.max() / REST.diagonal:.2g} % at most" in notes[-1]
    np.testing.assert_allclose(
        file.attribute("TEXCOORD_0")[faces], uv * [1, -1] + [0, 1], atol=1e-5
    )
    np.testing.assert_allclose(file.attribute("WEIGHTS_0").sum(axis=1), 1, rtol=0, atol=1e-12)
    normals = [each.attribute("NORMAL") for each in (file, whole)]
    np.testing.assert_allclose(*normals, atol=0.5 / 127 + 1e-6)
    assert len(file.binary) < 0.7 * len(whole.binary)
    assert file.json["accessors"][file.primitives[0]["indices"]]["componentType"] == 5123


def test_uvs_beyond_a_texture_are_not_quantized(tmp_path):
    uv = 3 * RANDOM.random((len(REST.faces), 3, 2))
    rest = paint(REST, uv, np.zeros(len(REST.faces), np.int64), ("skin",))
    file, _, _ = write_long(tmp_path / "a.glb", is_quantized=True, rest=rest)
    found = file.attribute("TEXCOORD_0")[file.faces()]
    np.testing.assert_allclose(found, uv * [1, -1] + [0, 1], atol=1e-6)


def test_rounding_beyond_the_tolerance_is_refused(tmp_path):
    with pytest.raises(OutputError, match="rounding to 16 bits moves vertices by up to"):
        write_long(tmp_path / "a.glb", 1e-6, is_quantized=True)


def test_a_still_clip_keeps_its_length(tmp_path):
    still = np.repeat(np.eye(3)[None], 6, axis=0)
    skin = Skin(REST, WEIGHTS["4"], still, np.tile(np.eye(3), (6, 8, 1, 1)))
    animation = Animation(CAGE, 6, SCENE, "hero")
    writer = GltfRig.make(tmp_path / "a.glb", animation, skin, tolerance=0.1)
    writer.append(np.repeat(CAGE.vertices[None], 6, axis=0))
    writer.complete()
    file = Glb(tmp_path / "a.glb")
    times = [file.array(each["input"]) for each in file.json["animations"][0]["samplers"]]
    assert max(each.max() for each in times) == pytest.approx(5 / SCENE.fps)
    assert sum(map(len, times)) == len(times) + 1
    assert len(open_sequence([str(tmp_path / "a.glb")])) == 6


def test_rounding_and_keys_that_are_left_out_are_measured_together(tmp_path):
    file, notes, expected = write_long(tmp_path / "a.glb", 0.1, is_quantized=True)
    rms, largest = measure_apart(file, expected)
    assert largest <= 0.1
    assert "keys are kept and numbers are rounded, by which vertices are off" in notes[-1]
    assert f"rms of {rms:.2g} %, {largest:.2g} % at most" in notes[-1]
    assert f"the rms is at most {0.25 + rms:.2g} %" in notes[-1]


def test_materials_and_uvs_come_along_in_gltf(tmp_path):
    uv = RANDOM.random((len(REST.faces), 3, 2))
    rest = paint(REST, uv, np.zeros(len(REST.faces), np.int64), ("skin",))
    rig, _ = save(GltfRig, tmp_path / "a.glb", rest=rest)
    faces = rig.file.faces()
    assert rig.file.json["materials"][0]["name"] == "skin"
    expected = expect(WEIGHTS["4"])[:, REST.faces]
    np.testing.assert_allclose(rig.skin()[:, faces], expected, rtol=0, atol=5e-6)
    found = rig.file.attribute("TEXCOORD_0")[faces]
    np.testing.assert_allclose(found, uv * [1, -1] + [0, 1], atol=1e-6)


def test_more_joints_than_programs_read_from_gltf_are_refused(tmp_path):
    weights = SkinWeights(np.tile(np.arange(9), (18, 1)), np.full((18, 9), 1 / 9))
    with pytest.raises(OutputError, match="up to 9 joints move a vertex, and programs read at mos"):
        start(GltfRig, tmp_path / "a.glb", weights)
    assert list(tmp_path.iterdir()) == []


# --- USD


@pytest.mark.parametrize("suffix", USD_SUFFIXES)
def test_usd_finds_no_fault_with_any_of_its_kinds(tmp_path, suffix):
    found, _ = save(UsdRig, tmp_path / f"rig{suffix}", WEIGHTS["convex"])
    assert faults_of(tmp_path / f"rig{suffix}") == []
    np.testing.assert_allclose(found.skin(), CONVEX @ CAGES, atol=5e-6)
    assert [file.name for file in tmp_path.iterdir()] == [f"rig{suffix}"]


def test_a_stage_is_at_rest_without_its_motion(tmp_path):
    found, _ = save(UsdRig, tmp_path / "rig.usdc")
    assert (found.stage.GetStartTimeCode(), found.stage.GetEndTimeCode()) == (3, 7)
    centre = CAGE.vertices.mean(axis=0)
    places = translations(found.skeleton.GetRestTransformsAttr())
    np.testing.assert_array_equal(places, np.vstack([centre, CAGE.vertices - centre]))
    mesh = UsdGeom.Mesh(found.stage.GetPrimAtPath("/hero/mesh"))
    np.testing.assert_array_equal(mesh.GetPointsAttr().Get(), REST.vertices.astype("f4"))
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert not mesh.GetResetXformStack()


@pytest.mark.parametrize("weights", ["1", "8", "convex"])
def test_our_reader_poses_what_our_writer_wrote(tmp_path, weights):
    found, _ = save(UsdRig, tmp_path / "rig.usdc", WEIGHTS[weights])
    sequence = open_sequence([str(tmp_path / "rig.usdc")])
    np.testing.assert_allclose(frames_of(sequence), expect(WEIGHTS[weights]), rtol=0, atol=5e-6)
    np.testing.assert_allclose(frames_of(sequence), found.skin(), rtol=0, atol=1e-6)
    assert (sequence.scene.fps, sequence.scene.start) == (25, 3)


@pytest.mark.parametrize("is_extracted", [False, True])
def test_a_clip_begins_as_if_none_was_before(is_extracted):
    """Neither the heading nor the signs of quaternions go on from the clip before."""
    turns = np.outer(np.linspace(0, 5, len(CAGES)), [0, 1.0, 0])  # more than half a turn
    rotations = Rotation.from_rotvec(np.concatenate([turns, turns[::-1]])).as_matrix()
    skin = Skin(REST, WEIGHTS["4"], rotations)
    both = Skeleton(CAGE.vertices, skin, is_extracted=is_extracted)
    list(both.advance(CAGES))
    both.begin_clip()
    alone = Skeleton(
        CAGE.vertices, replace(skin, rotations=rotations[len(CAGES) :]), is_extracted=is_extracted
    )
    for found, expected in zip(both.advance(CAGES), alone.advance(CAGES), strict=True):
        for each, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(each, other)
