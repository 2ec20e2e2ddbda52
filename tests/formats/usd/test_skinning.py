"""Rigs in USD: what usd-core makes of them is what the formulas say; damaged ones are sentences."""

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.formats.usd import skinning
from cageik_cli.util.errors import InputError
from tests.clips import frames_of
from tests.formats.usd import rigs
from tests.formats.usd.rigs import MESH, MOVES, POINTS, TIMES, WEIGHTS, Rig
from tests.texts import texts

TOL = 1e-6 * MESH.diagonal


@pytest.fixture
def rig(tmp_path):
    return Rig(tmp_path)


def read(rig, member="", **how):
    sequence = open_sequence([f"{rig.save()}{member}"], ClipSettings(**how))
    return sequence, frames_of(sequence)


def refuse(rig):
    with pytest.raises(InputError) as caught:
        read(rig)
    assert "rig.usda" in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", ["rig.usda", "rig.usdc"])
def test_joints_move_points_as_the_formula_says(tmp_path, name):
    rig = Rig(tmp_path, name)
    rig.skin()
    rig.animate()
    sequence, frames = read(rig)
    expected = np.array([rigs.expect_linear(k) for k in range(len(TIMES))])
    np.testing.assert_allclose(frames, expected, rtol=0, atol=TOL)
    assert texts(sequence.notes) == (f"{name}: posed by the skeleton /hero/rig",)
    assert (sequence.scene.fps, sequence.scene.start) == (24, 1)
    (part,) = sequence.first.attributes.parts.transforms
    np.testing.assert_allclose(part[3, :3], rigs.transform(np.array([7.0, 0, 0]), rigs.ROOT))


MIRROR = Gf.Matrix4d(1).SetScale(Gf.Vec3d(-1, 1, 1))


@pytest.mark.parametrize(
    ("mirrored", "is_turned"),
    [("none", False), ("mesh", False), ("bind", True), ("skeleton", True), ("both", False)],
)
def test_faces_are_turned_where_the_rig_mirrors_them(rig, mirrored, is_turned):
    """The transform of the mesh itself does not place it."""
    rig.skin()
    rig.animate()
    if mirrored == "mesh":
        rig.mesh.AddTransformOp().Set(MIRROR)
    if mirrored in ("bind", "both"):
        bind = Gf.Matrix4d(rigs.GEOM_BIND) * MIRROR
        rig.binding.CreateGeomBindTransformAttr(bind)
    if mirrored in ("skeleton", "both"):
        UsdGeom.Xformable(rig.skeleton).AddTransformOp().Set(MIRROR)
    sequence, _ = read(rig)
    assert sequence.first.volume > 0
    assert np.array_equal(sequence.first.faces[0], MESH.faces[0]) != is_turned


def test_a_skin_without_a_bind_transform_is_bound_where_it_is(rig, monkeypatch):
    """The attribute is optional, and absent wherever the mesh is modelled around its skeleton."""
    rig.skin()
    rig.mesh.GetPrim().RemoveProperty("primvars:skel:geomBindTransform")
    rig.animate()
    monkeypatch.setattr(rigs, "GEOM_BIND", np.eye(4))
    expected = np.array([rigs.expect_linear(k) for k in range(len(TIMES))])
    np.testing.assert_allclose(read(rig)[1], expected, rtol=0, atol=TOL)


def test_a_skin_may_change_in_time(rig):
    rig.skin()
    rig.animate(times=(1, 2, 3, 4))
    rig.binding.GetGeomBindTransformAttr().Set(Gf.Matrix4d(rigs.GEOM_BIND), 6)
    rig.binding.GetJointWeightsAttr().Set(rig.binding.GetJointWeightsAttr().Get(), 5)
    assert len(read(rig)[0]) == 6


def test_dual_quaternions_move_points_as_the_formula_says(rig):
    rig.skin(method="dualQuaternion")
    rig.animate(np.ones((3, 3), "f2"))
    expected = np.array([rigs.expect_dual(k) for k in range(len(TIMES))])
    np.testing.assert_allclose(read(rig)[1], expected, rtol=0, atol=TOL)


def test_a_mesh_may_name_some_joints_in_its_own_order(rig):
    rig.skin((1, 0), WEIGHTS[:, :2] / WEIGHTS[:, :2].sum(axis=1, keepdims=True))
    rig.binding.CreateJointsAttr(["hip", "hip/spine/head"])
    rig.animate()
    weights = WEIGHTS[:, :2] / WEIGHTS[:, :2].sum(axis=1, keepdims=True)
    expected = [rigs.expect_linear(k, POINTS, weights, (2, 0)) for k in range(len(TIMES))]
    np.testing.assert_allclose(read(rig)[1], expected, rtol=0, atol=TOL)


def test_a_rigid_mesh_has_one_weight_for_all_points(rig):
    rig.binding.CreateGeomBindTransformAttr(Gf.Matrix4d(rigs.GEOM_BIND))
    rig.binding.CreateJointIndicesPrimvar(True, 1).Set([2])
    rig.binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    rig.animate()
    whole = np.ones((len(POINTS), 1))
    expected = [rigs.expect_linear(k, POINTS, whole, (2,)) for k in range(len(TIMES))]
    np.testing.assert_allclose(read(rig)[1], expected, rtol=0, atol=TOL)


@pytest.mark.parametrize("names", [("frown", "smile"), ("frown", "wink")])
def test_blend_shapes_come_before_joints(rig, names):
    """Weights are found by name; a shape that is not animated has no weight."""
    rig.skin()
    rig.animate()
    rig.shape(names)
    sequence, frames = read(rig)
    for k, frame in enumerate(frames):
        shaped = rigs.expect_shaped(k)
        if "smile" not in names:
            shaped[list(rigs.SMILE_POINTS)] -= rigs.SHAPE_WEIGHTS[k, 0] * rigs.SMILE
        np.testing.assert_allclose(frame, rigs.expect_linear(k, shaped), rtol=0, atol=2 * TOL)
    assert "rig.usda: shaped by its blend shapes" in texts(sequence.notes)


def test_a_blend_shape_may_move_nothing(rig):
    """As the shape at rest that some programs write."""
    rig.shape()
    offset(rig).GetOffsetsAttr().Set([])
    offset(rig).GetPointIndicesAttr().Set([])
    _, frames = read(rig)
    shaped = rigs.expect_shaped(3)
    shaped[list(rigs.SMILE_POINTS)] -= rigs.SHAPE_WEIGHTS[3, 0] * rigs.SMILE
    expected = rigs.transform(shaped + np.array([7, 0, 0]), rigs.ROOT)
    np.testing.assert_allclose(frames[3], expected, rtol=0, atol=TOL)


def test_a_mesh_with_blend_shapes_alone_is_placed_by_its_own_transform(rig):
    rig.shape()
    _, frames = read(rig)
    expected = [
        rigs.transform(rigs.expect_shaped(k) + np.array([7, 0, 0]), rigs.ROOT)
        for k in range(len(TIMES))
    ]
    np.testing.assert_allclose(frames, expected, rtol=0, atol=TOL)


def test_frames_are_where_joints_weights_points_or_transforms_are_sampled(rig):
    rig.skin()
    rig.animate(times=(1, 3, 5, 7))
    sequence, _ = read(rig)
    assert (len(sequence), sequence.scene.frame_step) == (4, 2)
    assert "its rig has samples 2 time codes apart" in " ".join(texts(sequence.notes))
    rig.shape()  # at 1, 2, 3, 4
    rig.skeleton.GetPrim().GetAttribute("xformOp:translate").Set((0, 0.5, 0), 6)
    sequence, frames = read(rig)
    assert len(sequence) == 7
    assert "apart" not in " ".join(texts(sequence.notes))
    np.testing.assert_allclose(frames[2], rigs.expect_linear(1, rigs.expect_shaped(2)), atol=2e-6)


def test_a_rig_without_animation_is_one_frame_at_rest(rig):
    rig.skin()
    sequence, frames = read(rig)
    assert len(sequence) == 1
    local = rigs.bind_matrices()
    local[:] = np.eye(4)
    local[:, 3, :3] = rigs.REST.cumsum(axis=0)
    moved = np.linalg.inv(rigs.bind_matrices()) @ local
    bound = rigs.transform(POINTS.astype(float), rigs.GEOM_BIND)
    each = np.array([rigs.transform(bound, matrix) for matrix in moved])
    expected = rigs.place(np.einsum("mj,jmc->mc", WEIGHTS.astype(float), each))
    np.testing.assert_allclose(frames[0], expected, rtol=0, atol=TOL)


def test_a_rig_below_no_root_is_none(rig):
    rig.skin()
    rig.animate()
    UsdGeom.Xform.Define(rig.stage, "/hero")
    placed = rigs.transform(POINTS + np.array([7.0, 0, 0]), rigs.ROOT)
    sequence, frames = read(rig)
    np.testing.assert_allclose(frames, [placed], atol=1e-6)
    assert any("bound to a rig, but below no SkelRoot" in note for note in texts(sequence.notes))


def test_nothing_is_written_to_the_file(rig):
    rig.skin()
    rig.animate()
    before = rig.save().read_bytes()
    read(rig)
    assert rig.path.read_bytes() == before


@pytest.mark.parametrize("is_above", [False, True])
def test_instances_of_a_rig_move_each_by_its_own_animation(tmp_path, is_above):
    """Two copies of one prototype: the root is in it, or above both."""
    rig = Rig(tmp_path, "asset.usda")
    rig.skin()
    rig.animate()
    if is_above:
        UsdGeom.Xform.Define(rig.stage, "/hero")
    rig.save()
    shot = Rig(tmp_path, "rig.usda", "/unused")
    shot.stage.RemovePrim("/unused")
    (UsdSkel.Root if is_above else UsdGeom.Xform).Define(shot.stage, "/crowd")
    still = UsdSkel.Animation.Define(shot.stage, "/still")
    still.CreateJointsAttr(list(rigs.NAMES))
    still.CreateTranslationsAttr(Vt.Vec3fArray.FromNumpy(MOVES[2]))
    still.CreateRotationsAttr(Vt.QuatfArray.FromNumpy(rigs.QUATERNIONS[2]))
    still.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(rigs.SCALES))
    for k in range(2):
        above = UsdGeom.Xform.Define(shot.stage, f"/crowd/at_{k}")
        above.AddTranslateOp().Set((10.0 * k, 0, 0))
        copy = shot.stage.DefinePrim(f"/crowd/at_{k}/copy")
        copy.GetReferences().AddReference("asset.usda", "/hero")
        copy.SetInstanceable(True)
    sequence, frames = read(shot)
    names = ("/crowd/at_0/copy/mesh", "/crowd/at_1/copy/mesh")
    assert sequence.first.attributes.parts.names == names
    expected = np.array([rigs.expect_linear(k) for k in range(len(TIMES))])
    np.testing.assert_allclose(frames[:, :6], expected, rtol=0, atol=TOL)
    np.testing.assert_allclose(frames[:, 6:], expected + np.array([10, 0, 0]), rtol=0, atol=4e-6)


def set_indices(rig, values):
    rig.binding.GetJointIndicesAttr().Set(Vt.IntArray.FromNumpy(np.asarray(values, "i4")))


def set_weights(rig, values):
    rig.binding.GetJointWeightsAttr().Set(Vt.FloatArray.FromNumpy(np.asarray(values, "f4")))


def break_weights_later(rig):
    values = WEIGHTS.ravel().copy()
    rig.binding.GetJointWeightsAttr().Set(Vt.FloatArray.FromNumpy(values), 1)
    values[3] = np.nan
    rig.binding.GetJointWeightsAttr().Set(Vt.FloatArray.FromNumpy(values), 3)


def break_points_later(rig):
    rig.mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(POINTS), 1)
    rig.mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(POINTS[:5]), 4)


def offset(rig, name="smile"):
    return UsdSkel.BlendShape(rig.stage.GetPrimAtPath(f"/hero/mesh/{name}"))


def shape_weights(rig):
    return rig.motion().GetBlendShapeWeightsAttr()


DAMAGES = {
    "a joint that is not there": (
        lambda rig: set_indices(rig, [0, 1, 3] * 6),
        "/hero/mesh: a joint index is 3 at time 1, but there are 3 joints",
    ),
    "a joint below 0": (lambda rig: set_indices(rig, [0, 1, -1] * 6), "a joint index is -1"),
    "too few indices": (
        lambda rig: set_indices(rig, [0, 1, 2]),
        "3 joint indices and 18 joint weights at time 1, expected 18; bind the mesh again",
    ),
    "too many weights": (
        lambda rig: set_weights(rig, np.ones(30)),
        "18 joint indices and 30 joint weights",
    ),
    "a weight that is nan": (
        lambda rig: set_weights(rig, [np.nan] * 18),
        "a joint weight is not finite at time 1",
    ),
    "a weight that is nan later": (
        break_weights_later,
        "rig.usda[2]: /hero/mesh: a joint weight is not finite at time 2",
    ),
    "fewer points later": (break_points_later, "/hero/mesh: 5 vertices at time 4, but its rig"),
    "no weights": (
        lambda rig: rig.mesh.GetPrim().RemoveProperty("primvars:skel:jointWeights"),
        "its joint indices and joint weights do not belong together",
    ),
    "element sizes that differ": (
        lambda rig: rig.binding.CreateJointWeightsPrimvar(False, 2),
        "its joint indices and joint weights do not belong together",
    ),
    "an element size of 10^9": (
        lambda rig: [
            make(False, 10**9)
            for make in (
                rig.binding.CreateJointIndicesPrimvar,
                rig.binding.CreateJointWeightsPrimvar,
            )
        ],
        "expected 6000000000",
    ),
    "a joint that only the mesh names": (
        lambda rig: rig.binding.CreateJointsAttr(["hip", "tail", "hip/spine"]),
        "/hero/rig has no joint tail",
    ),
    "no bind transforms": (
        lambda rig: rig.skeleton.GetPrim().RemoveProperty("bindTransforms"),
        "/hero/rig: 0 bind transforms for 3 joints",
    ),
    "too few rest transforms": (
        lambda rig: rig.skeleton.GetRestTransformsAttr().Set([Gf.Matrix4d(1)]),
        "/hero/rig: 1 rest transforms for 3 joints",
    ),
    "a child before its parent": (
        lambda rig: rig.skeleton.GetJointsAttr().Set(["hip/spine", "hip", "hip/spine/head"]),
        "the joints of /hero/rig make no skeleton",
    ),
    "a chain of joints": (
        lambda rig: rig.skeleton.GetJointsAttr().Set(["/".join("a" * 501)] * 3),
        "/hero/rig: is a chain of 501 joints, expected at most 500",
    ),
    "too few moves": (
        lambda rig: rig.motion().GetTranslationsAttr().Set([(0, 0, 0)], 1),
        "/hero/rig/motion has 1 translations at time 1 for 3 joints",
    ),
    "too few moves later": (
        lambda rig: rig.motion().GetRotationsAttr().Set([Gf.Quatf(1)], 4),
        "rig.usda[4]: /hero/mesh: /hero/rig/motion has 1 rotations at time 4 for 3 joints",
    ),
    "an animation without scales": (
        lambda rig: rig.motion().GetPrim().RemoveProperty("scales"),
        "/hero/rig/motion has 0 scales at time 1 for 3 joints",
    ),
    "a move that is nan": (
        lambda rig: rig.motion().GetTranslationsAttr().Set([(np.nan, 0, 0)] * 3, 2),
        "nan",
    ),
    "a weight of a shape that is nan": (
        lambda rig: shape_weights(rig).Set([np.nan, 0], 2),
        "rig.usda[2]: /hero/mesh: /hero/rig/motion: 2 weights of blend shapes at time 2",
    ),
    "too few weights of shapes": (
        lambda rig: shape_weights(rig).Set([0.5], 1),
        "/hero/rig/motion: 1 weights of blend shapes at time 1, expected 2 finite numbers",
    ),
    "more names than shapes": (
        lambda rig: rig.binding.CreateBlendShapesAttr(["smile", "frown", "wink"]),
        "/hero/mesh: 3 names of blend shapes and 2 targets",
    ),
    "a shape that is not there": (
        lambda rig: rig.stage.RemovePrim("/hero/mesh/smile"),
        "there is no blend shape /hero/mesh/smile",
    ),
    "a point that is not there": (
        lambda rig: offset(rig).GetPointIndicesAttr().Set([1, 6]),
        "/hero/mesh/smile: it moves point 6, but there are 6",
    ),
    "a point below 0": (
        lambda rig: offset(rig).GetPointIndicesAttr().Set([-1, 2]),
        "/hero/mesh/smile: it moves point -1",
    ),
    "too few offsets": (
        lambda rig: offset(rig).GetOffsetsAttr().Set([(0, 0, 0)]),
        "/hero/mesh/smile: `offsets` has 1 offset for 2 points",
    ),
    "too few offsets between": (
        lambda rig: offset(rig, "frown").GetInbetween("half").SetOffsets([(0, 0, 0)]),
        "/hero/mesh/frown: `inbetweens:half` has 1 offset for 6 points",
    ),
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_rig_is_a_sentence(rig, kind):
    damage, sentence = DAMAGES[kind]
    rig.skin()
    rig.animate()
    rig.shape()
    assert len(read(rig)[1]) == len(TIMES)
    damage(rig)
    assert sentence in refuse(rig)


def test_more_joints_than_usd_can_place_are_refused(rig, monkeypatch):
    rig.skin()
    monkeypatch.setattr(skinning, "MAX_JOINTS", 3)
    read(rig)
    monkeypatch.setattr(skinning, "MAX_JOINTS", 2)
    assert "/hero/rig: has 3 joints, expected at most 2" in refuse(rig)


def test_usd_itself_bakes_the_same_points(rig):
    rig.skin()
    rig.animate()
    rig.shape()
    _, frames = read(rig)
    stage = Usd.Stage.Open(str(rig.path))
    stage.SetEditTarget(stage.GetSessionLayer())
    assert UsdSkel.BakeSkinning(stage.Traverse())
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/hero/mesh"))
    for time, frame in zip(TIMES, frames, strict=True):
        matrix = np.array(mesh.ComputeLocalToWorldTransform(time))
        baked = rigs.transform(np.array(mesh.GetPointsAttr().Get(time), float), matrix)
        np.testing.assert_allclose(frame, baked, rtol=0, atol=4 * TOL)
