"""The skeleton, skinned by USD itself: it gives what our weights give."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

from cageik_cli.formats.base.writer import Animation
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.scene import Scene
from cageik_cli.formats.usd import skeleton
from cageik_cli.formats.usd.errors import USD_SUFFIXES
from cageik_cli.formats.usd.skeleton import SkeletonWriter, compute_skin_weights
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import InputError
from tests.formats.clips import faults_of
from tests.shapes import ball, box

RANDOM = np.random.default_rng(11)
REST, CAGE = ball(levels=1, size=1.0), box(2.0)
CAGES = CAGE.vertices + RANDOM.normal(0, 0.2, (5, 8, 3))
SCENE = Scene(fps=25.0, start=3.0, up_axis="Z", metres_per_unit=0.1)


def trilinear(points):
    """Weights of a box's corners: convex inside, and they rebuild the points."""
    x = (points[:, None] / CAGE.vertices[None] + 1) / 2
    return x.prod(axis=2)


CONVEX = trilinear(REST.vertices)
# Moved along what gives no point: rows still sum to one and rebuild the rest pose.
SIGNED = CONVEX + 0.2 * np.prod(np.sign(CAGE.vertices), axis=1)


def written(path, weights, most=None, size=2):
    writer = SkeletonWriter(path, Animation(CAGE, len(CAGES), SCENE, "hero"), REST, weights, most)
    for start in range(0, len(CAGES), size):
        writer.append(CAGES[start : start + size])
    writer.complete()
    return writer


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
    writer = written(path, CONVEX)
    np.testing.assert_allclose(skinned(path), CONVEX @ CAGES, atol=2e-6)
    assert writer.max_skinning_error < 1e-14
    assert writer.influences == 8
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("most", [None, 3])
@pytest.mark.parametrize("compared", [1, 1 << 26])
def test_what_other_weights_cost_is_what_usd_shows(tmp_path, monkeypatch, most, compared):
    monkeypatch.setattr(skeleton, "_COMPARE_BYTES", compared)
    writer = written(tmp_path / "rig.usdc", SIGNED, most)
    found = skinned(tmp_path / "rig.usdc")
    skin = compute_skin_weights(SIGNED, most).to_dense(8)
    expected = REST.vertices + skin @ (CAGES - CAGE.vertices)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    moved = np.linalg.norm(found - SIGNED @ CAGES, axis=2).max()
    assert moved > 0.01
    np.testing.assert_allclose(writer.max_skinning_error, moved, rtol=1e-4)
    assert writer.influences == (most or np.count_nonzero(skin, axis=1).max())


def test_vertices_that_the_weights_do_not_rebuild_are_told_from_the_rest_pose_on(tmp_path):
    """Such as those projected onto the cage: the skin leaves them where they were."""
    weights = trilinear(REST.vertices * 0.9)
    animation = Animation(CAGE, 1, SCENE, "hero")
    writer = SkeletonWriter(tmp_path / "rig.usdc", animation, REST, weights)
    np.testing.assert_allclose(writer.max_skinning_error, 0.1, rtol=1e-12)
    writer.abandon()


def test_joints_are_the_vertices_of_the_cage(tmp_path):
    written(tmp_path / "rig.usdc", CONVEX)
    stage = Usd.Stage.Open(str(tmp_path / "rig.usdc"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (3, 7)
    rig = UsdSkel.Skeleton(stage.GetPrimAtPath("/hero/skeleton"))
    assert list(rig.GetJointsAttr().Get()) == [f"cage_00{k}" for k in range(8)]
    for transforms in (rig.GetBindTransformsAttr().Get(), rig.GetRestTransformsAttr().Get()):
        places = np.array([matrix.ExtractTranslation() for matrix in transforms])
        np.testing.assert_array_equal(places, CAGE.vertices)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/hero/mesh"))
    np.testing.assert_array_equal(mesh.GetPointsAttr().Get(), REST.vertices.astype("f4"))
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"


@pytest.mark.parametrize("suffix", USD_SUFFIXES)
def test_usd_finds_no_fault_with_it(tmp_path, suffix):
    path = tmp_path / f"rig{suffix}"
    written(path, SIGNED, 4)
    assert faults_of(path) == []


def test_the_same_skeleton_gives_the_same_bytes(tmp_path):
    for size in (1, 3):
        written(tmp_path / f"{size}.usdc", SIGNED, size=size)
    first, second = (path.read_bytes() for path in tmp_path.iterdir())
    assert first == second


def test_abandoned_it_lets_go_of_the_file(tmp_path):
    animation = Animation(CAGE, 5, SCENE, "hero")
    writer = SkeletonWriter(tmp_path / "rig.usdz", animation, REST, CONVEX)
    writer.append(CAGES)
    writer.abandon()
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_too_large_for_single_precision_is_refused(tmp_path):
    huge = TriMesh(REST.vertices * 1e40, REST.faces)
    animation = Animation(CAGE, 5, SCENE, "hero")
    with pytest.raises(InputError, match="too large"):
        SkeletonWriter(tmp_path / "rig.usdz", animation, huge, CONVEX)
    assert list(tmp_path.iterdir()) == []


def test_our_reader_says_that_it_does_not_skin(tmp_path):
    written(tmp_path / "rig.usdc", CONVEX)
    with pytest.raises(InputError, match=r"/hero/mesh is moved by a skeleton.*bake it"):
        open_sequence([str(tmp_path / "rig.usdc")])
