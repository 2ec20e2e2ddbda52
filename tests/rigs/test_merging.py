"""Joints that are merged: costs against a direct solve, cuts, limbs, and bindings to few joints."""

import numpy as np
import pytest

from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.settings import FitSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Binding
from cageik_cli.rigs.merging import JointTree, merge_joints, regroup_vertices
from cageik_cli.rigs.skinning import group_joints
from tests.fitted import Frames, small_binding, smooth_motion
from tests.shapes import ball, merged, moved, rotation

BALL = small_binding()
FRAMES = smooth_motion(BALL, 10)


def displace(frames, rest):
    """Displacements (m, 3k) of frames (k, m, 3)."""
    return (frames - rest).transpose(1, 0, 2).reshape(len(rest), -1)


def grow(binding=BALL, frames=FRAMES, scales=None):
    rest = binding.rest.vertices
    scales = np.ones(len(frames)) if scales is None else scales
    columns = displace(frames, rest) * np.repeat(scales, 3)
    blocks = np.split(columns, [3 * 4], axis=1)  # two blocks, of 4 frames and the others
    return JointTree(binding.weights, rest, blocks, scales, binding.cage.edges.ends)


def measure_rigid(rest, frames):
    """The sum of squares from the best rigid motion of each frame, by its own alignment."""
    total = 0.0
    for frame in frames:
        a, b = rest - rest.mean(axis=0), frame - frame.mean(axis=0)
        left, _, right = np.linalg.svd(a.T @ b)
        flip = np.diag([1, 1, np.sign(np.linalg.det(left @ right))])
        total += np.square(a @ (left @ flip @ right) - b).sum()
    return total


def test_a_cost_is_the_distance_from_rigid_motions_of_the_strongest_followers(monkeypatch):
    monkeypatch.setattr("cageik_cli.rigs.merging.COMPACTNESS", 0.0)
    scales = np.linspace(0.5, 2, len(FRAMES))
    costs = JointTree._measure(grow(scales=scales)._sums[:1])
    # After all merges, the first joint holds the sums of all vertices.
    rest = BALL.rest.vertices
    expected = sum(s**2 * measure_rigid(rest, f[None]) for s, f in zip(scales, FRAMES, strict=True))
    assert costs[0] == pytest.approx(expected / np.abs(rest).max() ** 2, rel=1e-9)


def test_cuts_are_nested_and_have_the_count_that_is_asked_for():
    tree = grow()
    np.testing.assert_array_equal(tree.cut(18), np.arange(18))
    np.testing.assert_array_equal(tree.cut(1), np.zeros(18))
    for count in range(2, 19):
        finer, coarser = tree.cut(count), tree.cut(count - 1)
        assert len(np.unique(finer)) == count
        pairs = {(a, b) for a, b in zip(finer, coarser, strict=True)}
        assert len(pairs) == count  # each finer joint is in one coarser joint


def test_frames_that_turn_as_a_whole_change_nothing():
    turned = np.stack([frame @ rotation(k) + k for k, frame in enumerate(FRAMES)])
    np.testing.assert_array_equal(grow(frames=turned).cut(6), grow().cut(6))


def two_bodies():
    """Two balls in cages of their own, of which each moves rigidly; their cages are not joined."""
    apart = moved(BALL.rest, shift=(1.5, 0, 0))
    cage = merged(BALL.cage, moved(BALL.cage, shift=(1.5, 0, 0)))
    none = np.zeros_like(BALL.weights)
    weights = np.block([[BALL.weights, none], [none, BALL.weights]])
    binding = Binding(merged(BALL.rest, apart), cage, weights)
    m = len(BALL.rest.vertices)
    frames = np.stack([binding.rest.vertices.copy() for _ in range(6)])
    for k in range(6):
        frames[k, :m] = frames[k, :m] @ rotation(k)
        frames[k, m:] += [0, k, 0]
    return binding, frames


def test_bodies_that_move_apart_are_merged_last():
    binding, frames = two_bodies()
    np.testing.assert_array_equal(grow(binding, frames).cut(2), np.repeat([0, 1], 18))


@pytest.mark.parametrize("scales", [np.ones(6), np.linspace(0.5, 2, 6)])
def test_vertices_go_to_the_joint_that_moves_as_they_do(scales):
    """A third of each ball begins with the joint of the other, and one joint has nothing."""
    binding, frames = two_bodies()
    m = len(BALL.rest.vertices)
    owners = np.repeat([0, 1], m)
    wrong = owners.copy()
    wrong[::3] = 1 - wrong[::3]
    start = Binding(binding.rest, BALL.cage.move(BALL.cage.vertices + 9), np.eye(18)[wrong])
    columns = displace(frames, binding.rest.vertices) * np.repeat(scales, 3)
    found = regroup_vertices(
        start, binding.rest.vertices, lambda: np.split(columns, [6], axis=1), scales
    )
    np.testing.assert_array_equal(found.weights, (np.eye(18)[owners] + np.eye(18)[wrong]) / 2)
    middle = binding.rest.vertices[:m].mean(axis=0)
    np.testing.assert_allclose(found.cage.vertices[0], middle, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.cage.vertices[2:], start.cage.vertices[2:])


def test_a_rigid_clip_has_limbs_that_hang_together():
    frames = np.stack([BALL.rest.vertices @ rotation(k) for k in range(5)])
    limbs = grow(frames=frames).group_limbs()
    assert limbs.max() == 18 // 4 - 1
    for k in range(limbs.max() + 1):
        chosen = np.flatnonzero(limbs == k)
        inside = np.isin(BALL.cage.faces, chosen).all(axis=1)
        edges = BALL.cage.edges.ends
        kept = edges[np.isin(edges, chosen).all(axis=1)]
        reached = {chosen[0]}
        for _ in chosen:
            reached |= {int(v) for e in kept for v in e if e[0] in reached or e[1] in reached}
        assert reached >= set(chosen.tolist())
        assert inside.any()


def test_too_few_joints_have_no_limbs():
    tree = grow()
    assert tree.group_limbs(tree.cut(7)) is None
    limbs = tree.group_limbs(tree.cut(8))
    assert limbs.shape == (8,)
    assert limbs.max() == 1


def test_a_merged_joint_is_in_the_middle_of_what_follows_it():
    joints = np.array([0] * 9 + [1] * 8 + [2])
    found = merge_joints(BALL, joints)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(found.weights[:, 0], BALL.weights[:, :9].sum(axis=1), atol=1e-12)
    expected = found.weights[:, 0] @ BALL.rest.vertices / found.weights[:, 0].sum()
    np.testing.assert_allclose(found.cage.vertices[0], expected, atol=1e-12)
    np.testing.assert_array_equal(found.cage.vertices[2], BALL.cage.vertices[17])
    assert found.has_offsets


def test_joints_that_nothing_follows_are_in_the_middle_of_their_own():
    weights = BALL.weights.copy()
    weights[:, :2] = 0
    still = Binding(BALL.rest, BALL.cage, weights / weights.sum(axis=1, keepdims=True))
    found = merge_joints(still, np.array([0, 0, *range(1, 17)]))
    np.testing.assert_allclose(
        found.cage.vertices[0], BALL.cage.vertices[:2].mean(axis=0), atol=1e-12
    )
    assert np.isfinite(grow(still).cut(3)).all()


def test_faces_of_merged_joints_have_three_joints():
    found = merge_joints(BALL, grow().cut(6))
    assert len(found.cage.vertices) == 6
    assert (np.diff(np.sort(found.cage.faces, axis=1), axis=1) > 0).all()
    chain = np.digitize(BALL.cage.vertices[:, 1], [-0.5, 0.5])  # no face is in three
    faces = merge_joints(BALL, chain).cage.faces
    np.testing.assert_array_equal(faces, [[0, 1, 2]])


def test_one_vertex_of_any_model_can_be_a_joint():
    """A cage whose joints have one follower each costs nothing to merge, and is merged."""
    tiny = TriMesh(BALL.cage.vertices * 0.5, ball(1, 1.0).faces)
    binding = Binding(tiny, BALL.cage, np.eye(18))
    moves = np.where(tiny.vertices[:, :1] > 0, 1.0, 0.0) * [0, 0, 1]
    frames = np.stack([tiny.vertices + k * moves for k in range(3)])
    found = grow(binding, frames).cut(2)
    np.testing.assert_array_equal(found == found[tiny.vertices[:, 0].argmax()], moves[:, 2] > 0)


def test_vertices_in_no_face_decide_nothing():
    """One more, far away, changes neither the cuts nor the places of merged joints."""
    far = np.array([[0.0, -30, 0]])
    rest = TriMesh(np.vstack([BALL.rest.vertices, far]), BALL.rest.faces)
    more = Binding(rest, BALL.cage, np.vstack([BALL.weights, np.eye(18)[3:4]]))
    frames = np.concatenate([FRAMES, np.tile(far, (len(FRAMES), 1, 1))], axis=1)
    found, own = (
        group_joints(fitter.cage_solve, fitter.sample([Frames(clip)]).target).cut(6)
        for fitter, clip in (
            (Fitter(more, FitSettings(influences=3)), frames),
            (Fitter(BALL, FitSettings(influences=3)), FRAMES),
        )
    )
    np.testing.assert_array_equal(found, own)
    np.testing.assert_allclose(
        merge_joints(more, found).cage.vertices, merge_joints(BALL, found).cage.vertices, atol=1e-9
    )
