"""The skeleton, skinned by USD itself: it gives what our weights give."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from scipy.spatial.transform import Rotation

from cageik_cli.formats.base.skin import Skin, compute_skin_weights
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.usd.library import USD_SUFFIXES
from cageik_cli.formats.usd.writer import SkeletonWriter
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import FormatError, OutputError
from tests.formats.clips import faults_of
from tests.shapes import ball, box

RANDOM = np.random.default_rng(11)
REST, CAGE = ball(levels=1, size=1.0), box(2.0)
ROTATIONS = Rotation.from_rotvec(np.outer([0, 1, 2, 3, 4], [0.3, 0.9, -0.2])).as_matrix()
CAGES = (CAGE.vertices + RANDOM.normal(0, 0.2, (5, 8, 3))) @ ROTATIONS + [[[3.0, 0, -2]]]
SCENE = Scene(fps=25.0, start=3.0, up_axis="Z", metres_per_unit=0.1)


def trilinear(points):
    """Weights of a box's corners: convex inside, and they rebuild the points."""
    x = (points[:, None] / CAGE.vertices[None] + 1) / 2
    return x.prod(axis=2)


CONVEX = trilinear(REST.vertices)
# Moved along what gives no point: rows still sum to one and rebuild the rest pose.
SIGNED = CONVEX + 0.2 * np.prod(np.sign(CAGE.vertices), axis=1)


def skin_of(weights, rest=REST):
    return Skin(rest, compute_skin_weights(weights), ROTATIONS)


def written(path, weights, size=2):
    writer = SkeletonWriter(path, Animation(CAGE, len(CAGES), SCENE, "hero"), skin_of(weights))
    for start in range(0, len(CAGES), size):
        writer.append(CAGES[start : start + size])
    writer.complete()


def skinned(path):
    """The mesh at each frame, (F, m, 3), by USD's own skinning."""
    stage = Usd.Stage.Open(str(path))
    root = UsdSkel.Root(stage.GetDefaultPrim())
    assert UsdSkel.BakeSkinning(root)
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/hero/mesh")).GetPointsAttr()
    return np.array([np.array(points.Get(3 + k)) for k in range(len(CAGES))], float)


def test_the_weights_of_the_test_are_what_they_claim():
    for weights in (CONVEX, SIGNED):
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-14)
        np.testing.assert_allclose(weights @ CAGE.vertices, REST.vertices, atol=1e-14)
    assert CONVEX.min() >= 0 > SIGNED.min()


@pytest.mark.parametrize("suffix", USD_SUFFIXES)
def test_convex_weights_give_the_mesh_of_the_cages(tmp_path, suffix):
    path = tmp_path / f"rig{suffix}"
    written(path, CONVEX)
    np.testing.assert_allclose(skinned(path), CONVEX @ CAGES, atol=5e-6)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_what_other_weights_lack_turns_with_the_root(tmp_path):
    written(tmp_path / "rig.usdc", SIGNED)
    skin = compute_skin_weights(SIGNED).to_dense(8)
    expected = skin @ CAGES + (REST.vertices - skin @ CAGE.vertices) @ ROTATIONS
    np.testing.assert_allclose(skinned(tmp_path / "rig.usdc"), expected, atol=5e-6)
    assert np.abs(expected - SIGNED @ CAGES).max() > 0.01


def test_the_root_takes_the_short_way(tmp_path):
    """Its rotation passes half a turn, where a quaternion may change its sign."""
    written(tmp_path / "rig.usdc", CONVEX)
    stage = Usd.Stage.Open(str(tmp_path / "rig.usdc"))
    motion = UsdSkel.Animation(stage.GetPrimAtPath("/hero/skeleton/motion"))
    turns = [motion.GetRotationsAttr().Get(3 + k)[0] for k in range(len(CAGES))]
    found = np.array([[turn.GetReal(), *turn.GetImaginary()] for turn in turns])
    assert (np.einsum("ki,ki->k", found[1:], found[:-1]) > 0).all()
    assert found[-1, 0] < 0


def test_joints_are_the_vertices_of_the_cage(tmp_path):
    written(tmp_path / "rig.usdc", CONVEX)
    stage = Usd.Stage.Open(str(tmp_path / "rig.usdc"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (3, 7)
    rig = UsdSkel.Skeleton(stage.GetPrimAtPath("/hero/skeleton"))
    assert list(rig.GetJointsAttr().Get()) == ["root", *(f"root/cage_00{k}" for k in range(8))]
    centre = CAGE.vertices.mean(axis=0)
    for transforms, places in (
        (rig.GetBindTransformsAttr().Get(), CAGE.vertices),
        (rig.GetRestTransformsAttr().Get(), CAGE.vertices - centre),
    ):
        found = np.array([matrix.ExtractTranslation() for matrix in transforms])
        np.testing.assert_array_equal(found, np.vstack([centre, places]))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/hero/mesh"))
    np.testing.assert_array_equal(mesh.GetPointsAttr().Get(), REST.vertices.astype("f4"))
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"


@pytest.mark.parametrize("suffix", USD_SUFFIXES)
def test_usd_finds_no_fault_with_it(tmp_path, suffix):
    path = tmp_path / f"rig{suffix}"
    written(path, SIGNED)
    assert faults_of(path) == []


def test_the_same_skeleton_gives_the_same_bytes(tmp_path):
    for size in (1, 3):
        written(tmp_path / f"{size}.usdc", SIGNED, size=size)
    first, second = (path.read_bytes() for path in tmp_path.iterdir())
    assert first == second


def test_abandoned_it_lets_go_of_the_file(tmp_path):
    animation = Animation(CAGE, 5, SCENE, "hero")
    writer = SkeletonWriter(tmp_path / "rig.usdz", animation, skin_of(CONVEX))
    writer.append(CAGES)
    writer.abandon()
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_too_large_for_single_precision_is_refused(tmp_path):
    huge = TriMesh(REST.vertices * 1e40, REST.faces)
    animation = Animation(CAGE, 5, SCENE, "hero")
    with pytest.raises(OutputError, match="too large"):
        SkeletonWriter(tmp_path / "rig.usdz", animation, skin_of(CONVEX, huge))
    assert list(tmp_path.iterdir()) == []


def test_our_reader_says_that_it_does_not_skin(tmp_path):
    written(tmp_path / "rig.usdc", CONVEX)
    with pytest.raises(FormatError, match=r"/hero/mesh is moved by a skeleton.*bake it"):
        open_sequence([str(tmp_path / "rig.usdc")])
