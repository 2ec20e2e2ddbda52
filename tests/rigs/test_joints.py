"""Joints that turn: what holds for any motion, and motions that they reproduce."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli.formats.base.skeleton import Skeleton, Skin, compute_skin_weights
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import compute_vertex_normals, uniform_laplacian
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding
from cageik_cli.rigs import joints as module
from cageik_cli.rigs.joints import (
    NORMAL_LENGTH,
    ROTATION_SMOOTHNESS,
    JointSolver,
    find_separate_joints,
    turn_normals,
)
from tests.fitted import small_binding

BALL = small_binding()
STILL = BALL.rest.vertices[None]


def prepare(binding=BALL, alpha=1e-3):
    solver = DualLaplacianSolver(replace(binding, has_offsets=True), SolveSettings(alpha))
    return JointSolver(solver)


def pose(frames, binding=BALL):
    joints = prepare(binding)
    return joints.pose(joints.solve(frames))


def bend(points, angle):
    """Points turned about the vertical by an angle that grows with the height."""
    turns = Rotation.from_rotvec(np.outer(angle * points[:, 1], [0, 1, 0])).as_matrix()
    return np.einsum("mab,mb->ma", turns, points)


def about(angle):
    """The rotation of rows by an angle about a slanted axis."""
    return Rotation.from_rotvec(angle * np.array([0.48, 0.6, 0.64])).as_matrix().T


def bent(count=5):
    return np.stack([bend(BALL.rest.vertices, angle) for angle in np.linspace(0.2, 1, count)])


def spun(frames, turns):
    """Frames whose whole turns so many times, and moves."""
    angles = np.linspace(0, 2 * np.pi * turns, len(frames))
    return np.stack([f @ about(a) + [a, 0, 1] for f, a in zip(frames, angles, strict=True)])


def degrees_off(binding, poses, frames):
    """The angles (k, m) between the normals that joints turn and those of frames."""
    normals = compute_vertex_normals(binding.rest.polygons, binding.rest.vertices)
    found = turn_normals(normals, binding.weights, poses.turns)
    expected = [compute_vertex_normals(binding.rest.polygons, frame) for frame in frames]
    return np.degrees(np.arccos((found * np.stack(expected)).sum(axis=2).clip(-1, 1)))


def assert_proper(turns):
    products = turns @ turns.swapaxes(-1, -2)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), turns.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(turns), 1, rtol=1e-9)


def test_the_rest_pose_gives_joints_at_rest():
    poses = pose(STILL)
    np.testing.assert_allclose(poses.turns[0], np.tile(np.eye(3), (18, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(poses.cages[0], BALL.cage.vertices, rtol=0, atol=1e-12)
    np.testing.assert_allclose(poses.meshes, STILL, rtol=0, atol=1e-12)


def test_a_rigid_clip_turns_all_joints_alike():
    frames = spun(np.repeat(STILL, 7, axis=0), 3)
    poses = pose(frames)
    np.testing.assert_allclose(poses.meshes, frames, rtol=0, atol=1e-11)
    np.testing.assert_allclose(poses.turns - poses.rotations[:, None], 0, atol=1e-11)
    np.testing.assert_allclose(degrees_off(BALL, poses, frames), 0, atol=1e-4)


def test_joints_follow_the_whole():
    """A rigid motion of the frames, in another unit, turns and moves the joints by the same."""
    frames, turn = bent(), about(2.2)
    own, moved = pose(frames), pose(frames @ turn + [5, 0, 1])
    np.testing.assert_allclose(moved.turns, own.turns @ turn, atol=1e-9)
    np.testing.assert_allclose(moved.cages, own.cages @ turn + [5, 0, 1], atol=1e-9)
    small = replace(
        BALL,
        rest=BALL.rest.move(0.01 * BALL.rest.vertices),
        cage=BALL.cage.move(0.01 * BALL.cage.vertices),
    )
    scaled = pose(0.01 * frames, small)
    np.testing.assert_allclose(scaled.turns, own.turns, atol=1e-9)
    np.testing.assert_allclose(scaled.cages, 0.01 * own.cages, atol=1e-11)


def test_each_frame_is_solved_for_itself():
    frames = bent()
    whole, parts = pose(frames), [pose(frame[None]) for frame in frames]
    for name in ("turns", "cages", "meshes"):
        found = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_allclose(found, getattr(whole, name), rtol=0, atol=1e-11)


def test_the_mesh_is_what_a_skin_makes_of_the_joints():
    poses = pose(bent())
    arms = BALL.rest.vertices[:, None] - BALL.cage.vertices
    alone = np.einsum("mna,knab->kmnb", arms, poses.turns) + poses.cages[:, None]
    expected = np.einsum("mn,kmnb->kmb", BALL.weights, alone)
    np.testing.assert_allclose(poses.meshes, expected, rtol=0, atol=1e-12)


def objective(joints, changes, frames):
    """What is minimised, of each frame, from the formula in the module."""
    solver = joints.solver
    columns = solver.align(frames)[0]
    n, count, diagonal = len(solver.rest_cage), len(frames), BALL.rest.diagonal
    parts = changes.reshape(n, 4, count, 3)
    turns = parts[:, :3].transpose(2, 0, 1, 3) + np.eye(3)
    moves = parts[:, 3].swapaxes(0, 1)
    arms = solver.rest[:, None] - solver.rest_cage
    alone = np.einsum("mna,knab->kmnb", arms, turns) + solver.rest_cage + diagonal * moves[:, None]
    meshes = np.einsum("mn,kmnb->kmb", solver.binding.weights, alone)
    aligned = solver.rest + columns.reshape(-1, count, 3).swapaxes(0, 1)
    normals = compute_vertex_normals(BALL.rest.polygons, BALL.rest.vertices)
    shaded = np.einsum("mn,ma,knab->kmb", solver.binding.weights, normals, turns)
    expected = [compute_vertex_normals(BALL.rest.polygons, frame) for frame in aligned]
    data = np.square((meshes - aligned) / diagonal).sum(axis=2)
    data += NORMAL_LENGTH**2 * np.square(shaded - np.stack(expected)).sum(axis=2)
    m = len(normals)
    bends = np.square(uniform_laplacian(BALL.cage) @ turns.reshape(count, n, 9)).sum(axis=(1, 2))
    unit = solver.data_scale * m / n * NORMAL_LENGTH**2
    smooth = np.einsum("kna,nl,kla->k", moves, solver.smoothness, moves)
    return solver.data_scale * data.sum(axis=1) + smooth + ROTATION_SMOOTHNESS * unit * bends


def test_sweeps_lower_the_sum_of_squares_and_end_where_no_rigid_motion_does():
    joints, frames = prepare(), bent() + np.random.default_rng(1).normal(0, 0.02, bent().shape)
    columns = joints.solver.align(frames)[0]
    normals = joints.change_normals(columns)
    right = joints.multiply_moves(columns) + joints.multiply_normals(normals)
    changes = joints.start(right)
    values = [objective(joints, changes, frames)]
    for _ in range(6):
        changes = joints.sweep(right, changes, 1)
        values.append(objective(joints, changes, frames))
    assert (np.diff(values, axis=0) < 0).all()
    changes = joints.sweep(right, changes, 300)
    least, random = objective(joints, changes, frames), np.random.default_rng(0)
    assert (least < 0.99 * values[0]).all()
    for joint in range(18):
        moved = changes.reshape(18, 4, 5, 3).copy()
        turn = Rotation.from_rotvec(1e-3 * random.normal(size=3)).as_matrix()
        moved[joint, :3] = (moved[joint, :3] + np.eye(3)[:, None]) @ turn - np.eye(3)[:, None]
        moved[joint, 3] += 1e-4 * random.normal(size=3)
        assert (objective(joints, moved.reshape(72, 15), frames) > least).all()


def test_the_sum_that_is_left_is_that_of_the_formula():
    joints, frames = prepare(), bent()
    solved = joints.solve(frames)
    expected = objective(joints, solved.changes, frames)
    np.testing.assert_allclose(solved.misfit, expected, rtol=1e-6)
    expected = objective(joints, np.zeros_like(solved.changes), frames)
    np.testing.assert_allclose(solved.still, expected, rtol=1e-9)


def test_joints_that_move_at_once_have_nothing_to_do_with_each_other():
    matrix = np.zeros((6, 4, 6, 4))
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 0)):
        matrix[a, 0, b, 3] = matrix[b, 3, a, 0] = 1
    groups = find_separate_joints(matrix.reshape(24, 24))
    assert [group.tolist() for group in groups] == [[0, 2, 4], [1, 3, 5]]
    groups = find_separate_joints(np.ones((12, 12)))
    assert [group.tolist() for group in groups] == [[0], [1], [2]]


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_sparse_weights_and_blocks_of_rows_give_the_same(monkeypatch, share):
    weights = np.where(BALL.weights > 0.05, BALL.weights, 0)
    binding = replace(BALL, weights=weights / weights.sum(axis=1, keepdims=True))
    expected = pose(bent(), binding)
    monkeypatch.setattr(module, "MAX_SPARSE_SHARE", share)
    monkeypatch.setattr(module, "MAX_ROW_ENTRIES", 5 * 18)
    found = pose(bent(), binding)
    for name in ("turns", "cages", "meshes"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-10)


def test_a_bent_body_is_shaded_far_better_than_by_joints_that_translate():
    frames, joints = bent(), prepare()
    poses = joints.pose(joints.solve(frames))
    still = replace(poses, turns=np.tile(poses.rotations[:, None], (1, 18, 1, 1)))
    turning, translating = (degrees_off(BALL, each, frames) for each in (poses, still))
    assert np.square(turning).mean() < 0.25 * np.square(translating).mean()
    translated = joints.solver.solve(frames).reconstructions
    errors = [np.square(mesh - frames).mean() for mesh in (poses.meshes, translated)]
    assert errors[0] < 1.2 * errors[1]


def test_a_body_that_turns_three_times_has_smooth_quaternions():
    count = 60
    frames = spun(np.stack([bend(BALL.rest.vertices, np.sin(k / 9)) for k in range(count)]), 3)
    poses = pose(frames)
    assert_proper(poses.turns)
    skin = Skin(BALL.rest, compute_skin_weights(BALL.weights), poses.rotations, poses.turns)
    _, turns = zip(*Skeleton(BALL.cage.vertices, skin).advance(poses.cages), strict=True)
    cosines = np.einsum("fjq,fjq->fj", np.stack(turns)[1:], np.stack(turns)[:-1])
    assert cosines.min() > np.cos(0.5 * 2 * np.pi * 3 / (count - 1) + 0.01)


def test_mirrored_frames_are_followed_by_proper_rotations():
    poses = pose(bent() * [-1, 1, 1])
    assert_proper(poses.turns)
    assert np.isfinite(poses.cages).all()


def test_a_mirrored_model_turns_in_the_mirror():
    mirror = np.diag([-1.0, 1, 1])
    faces = BALL.rest.faces[:, ::-1]
    mirrored = Binding(
        replace(BALL.rest, vertices=BALL.rest.vertices @ mirror, faces=faces),
        replace(BALL.cage, vertices=BALL.cage.vertices @ mirror, faces=BALL.cage.faces[:, ::-1]),
        BALL.weights,
    )
    own, found = pose(bent()), pose(bent() @ mirror, mirrored)
    np.testing.assert_allclose(found.turns, mirror @ own.turns @ mirror, atol=1e-9)
    np.testing.assert_allclose(found.cages, own.cages @ mirror, atol=1e-9)


def test_a_joint_that_nothing_follows_turns_with_its_neighbours():
    weights = BALL.weights.copy()
    weights[:, 7] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    poses = pose(bent(), replace(BALL, weights=weights))
    assert_proper(poses.turns)
    near = uniform_laplacian(BALL.cage)[7] < 0
    turned = Rotation.from_matrix(poses.turns[-1]).as_rotvec()
    whole = Rotation.from_matrix(poses.rotations[-1]).as_rotvec()
    bounds = np.vstack([turned[near], whole])
    assert (turned[7] >= bounds.min(axis=0) - 0.05).all()
    assert (turned[7] <= bounds.max(axis=0) + 0.05).all()
    steps = np.diff(Rotation.from_matrix(poses.turns[:, 7]).as_rotvec(), axis=0)
    assert np.abs(steps).max() < 0.2


@pytest.mark.parametrize("size", [0.0, 1e-9])
def test_noise_at_a_joint_that_hardly_anything_follows_turns_it_as_its_neighbours(size):
    """One vertex follows it a little, and jumps from frame to frame."""
    weights = BALL.weights.copy()
    weights[:, 7] = 0
    weights[int(np.argmax(BALL.weights[:, 7])), 7] = size
    binding = replace(BALL, weights=weights / weights.sum(axis=1, keepdims=True))
    frames = np.repeat(STILL, 6, axis=0)
    frames += np.random.default_rng(0).normal(0, 0.01, frames.shape)
    turns = pose(frames, binding).turns.reshape(-1, 3, 3)
    angles = np.linalg.norm(Rotation.from_matrix(turns).as_rotvec(), axis=1).reshape(6, 18)
    near = uniform_laplacian(BALL.cage)[7] < 0
    assert (angles[:, 7] < 1.3 * angles[:, near].max(axis=1)).all()
    assert angles[:, 7].max() < 0.15


def test_a_surface_in_both_windings_turns_by_its_places_alone():
    """Its normals cancel, and what rounding leaves of them must not turn the joints."""
    sides = np.vstack([BALL.rest.faces, BALL.rest.faces[:, ::-1]])
    double = replace(BALL, rest=TriMesh(BALL.rest.vertices, sides))
    frames = spun(np.repeat(STILL, 7, axis=0), 3)
    poses = pose(frames, double)
    np.testing.assert_allclose(poses.turns - poses.rotations[:, None], 0, atol=1e-9)
    np.testing.assert_allclose(poses.meshes, frames, rtol=0, atol=1e-9)
