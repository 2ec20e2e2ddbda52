"""Frames whose vertices count differently, against least squares; and outliers that are found."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli import bind
from cageik_cli.captured import robust
from cageik_cli.captured.robust import (
    RobustSolver,
    find_outlier_vertices,
    find_torn_vertices,
    has_outlier_vertices,
    is_often_torn,
    weigh,
)
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.solve.alignment import best_rotations
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from tests.corruptions import corrupt
from tests.shapes import ball, box, merged, rotation

RNG = np.random.default_rng(5)


@pytest.fixture(scope="module")
def binding():
    return bind(ball(levels=2, size=1.0), box(2.0), coordinates="mean-value")


@pytest.fixture(scope="module")
def frames(binding):
    """Frames that a cage gives, but for a little noise."""
    cage, count = binding.cage.vertices, 6
    cages = cage + 0.2 * RNG.standard_normal((count, *cage.shape))
    meshes = binding.weights @ cages @ rotation(7) + np.array([1.0, 2.0, 3.0])
    return meshes + 1e-3 * RNG.standard_normal(meshes.shape)


def least_squares(binding, settings, frame, weights, turn):
    """The cage of a weighted frame, aligned by `turn`, from the stacked equations."""
    n, m = binding.weights.shape[1], len(frame)
    laplacian = uniform_laplacian(binding.cage)
    roots = np.sqrt(settings.beta * weights / m)[:, None]
    rows = np.vstack([np.sqrt(settings.alpha / n) * laplacian, roots * binding.weights])
    offsets = binding.rest.vertices - binding.weights @ binding.cage.vertices
    target = frame - (offsets @ turn if binding.has_offsets else 0)
    delta = np.sqrt(settings.alpha / n) * laplacian @ binding.cage.vertices @ turn
    return np.linalg.lstsq(rows, np.vstack([delta, roots * target]), rcond=None)[0]


def turn_of(binding, frame, weights):
    shares = weights / weights.sum()
    rest = binding.rest.vertices
    return best_rotations((frame - shares @ frame)[None], rest - shares @ rest, weights)[0]


@pytest.mark.parametrize("align", [True, False])
@pytest.mark.parametrize("has_offsets", [True, False])
def test_weighted_frames_are_solved_as_by_least_squares(binding, frames, align, has_offsets):
    if has_offsets:
        squares = binding.weights**2
        weights = squares / squares.sum(axis=1, keepdims=True)
        binding = replace(binding, weights=weights, has_offsets=True)
    settings = SolveSettings(alpha=0.05, beta=1.0, align=align)
    given = RNG.random(frames.shape[:2]) * (RNG.random(frames.shape[:2]) < 0.6)
    given[2] = 1  # a frame without weights of its own among them
    found = RobustSolver(DualLaplacianSolver(binding, settings)).solve(frames, given)
    assert not found.faults
    for k, frame in enumerate(frames):
        turn = turn_of(binding, frame, given[k]) if align else np.eye(3)
        expected = least_squares(binding, settings, frame, given[k], turn)
        np.testing.assert_allclose(found.cages[k], expected, rtol=0, atol=1e-9)
        rebuilt = binding.weights @ found.cages[k]
        if has_offsets:
            offsets = binding.rest.vertices - binding.weights @ binding.cage.vertices
            rebuilt += offsets @ found.rotations[k]
        np.testing.assert_allclose(found.reconstructions[k], rebuilt, rtol=0, atol=1e-9)


def test_where_a_missing_vertex_is_does_not_matter(binding, frames):
    given = np.ones(frames.shape[:2])
    given[:, 7:30] = 0
    moved = frames.copy()
    moved[:, 7:30] += 0.3
    solver = RobustSolver(DualLaplacianSolver(binding, SolveSettings()))
    first, second = solver.solve(frames, given), solver.solve(moved, given)
    np.testing.assert_allclose(first.cages, second.cages, rtol=0, atol=1e-11)
    np.testing.assert_allclose(first.sampled, second.sampled, atol=1e-6)


def test_frames_without_outliers_keep_every_bit(binding, frames):
    solver = DualLaplacianSolver(binding, SolveSettings())
    plain = solver.solve(frames)
    found = RobustSolver(solver, np.full(frames.shape[1], 0.5)).solve(frames)
    assert found.weights is None
    for name in ("cages", "reconstructions", "rotations", "sampled"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))


def push(frames):
    """Push a side of the ball out, further than the cage follows."""
    rest = frames[0]
    ways = np.linalg.norm(rest - rest[0], axis=1)
    return frames + 0.4 * np.exp(-((ways / 0.8) ** 2))[:, None] * [0.0, 0.0, 1.0]


def test_a_quick_motion_keeps_every_bit_and_a_hit_in_it_is_rejected(binding, frames):
    solver = DualLaplacianSolver(binding, SolveSettings())
    pushed, limit = push(frames), 0.1
    plain = solver.solve(pushed)
    residuals = np.linalg.norm(pushed - plain.reconstructions, axis=2)
    assert (residuals > limit).any(axis=1).all()
    cages, robust = plain.cages.copy(), RobustSolver(solver, np.full(frames.shape[1], limit))
    found = robust.solve(pushed)
    assert found.weights is None
    np.testing.assert_array_equal(found.cages, cages)
    pushed[2, 9] += [0.5, 0.0, 0.0]
    found = robust.solve(pushed)
    np.testing.assert_array_equal(np.argwhere(found.weights < 1), [[2, 9]])
    np.testing.assert_allclose(found.cages, cages, rtol=0, atol=2e-2)


def throw(frames, share=0.03):
    """Throw some vertices of some frames 0.3 to 1 away; also which they are."""
    is_out = RNG.random(frames.shape[:2]) < share
    is_out[[0, 3]] = False
    ways = RNG.standard_normal((np.count_nonzero(is_out), 3))
    spoilt = frames.copy()
    spoilt[is_out] += (
        ways / np.linalg.norm(ways, axis=1)[:, None] * RNG.uniform(0.3, 1, (len(ways), 1))
    )
    return spoilt, is_out


def test_outliers_are_found_and_do_not_move_the_cage(binding, frames):
    spoilt, is_out = throw(frames)
    solver = DualLaplacianSolver(binding, SolveSettings())
    clean = solver.solve(frames).cages.copy()
    given = np.where(is_out, 0.0, 1.0)
    without = RobustSolver(solver).solve(frames, given).cages.copy()
    plain = solver.solve(spoilt).cages.copy()
    found = RobustSolver(solver, np.full(frames.shape[1], 0.02)).solve(spoilt)
    np.testing.assert_array_equal(found.weights < 0.5, is_out)
    np.testing.assert_allclose(found.cages, without, rtol=0, atol=1e-3)
    assert np.abs(plain - clean).max() > 20 * np.abs(found.cages - clean).max()
    np.testing.assert_array_equal(found.cages[[0, 3]], plain[[0, 3]])


def test_the_alignment_does_not_follow_outliers(binding, frames):
    spoilt = frames.copy()
    spoilt[:, :8] += [0.0, 0.0, 4.0]
    solver = DualLaplacianSolver(binding, SolveSettings())
    clean, plain = solver.solve(frames).rotations, solver.solve(spoilt).rotations
    found = RobustSolver(solver, np.full(frames.shape[1], 0.02)).solve(spoilt).rotations
    assert np.abs(found - clean).max() < 0.1 * np.abs(plain - clean).max()


def test_a_frame_that_is_far_off_as_a_whole_has_no_outliers(binding, frames):
    spoilt = frames + 0.3 * RNG.standard_normal(frames.shape)
    solver = DualLaplacianSolver(binding, SolveSettings())
    found = RobustSolver(solver, np.full(frames.shape[1], 0.01)).solve(spoilt)
    assert found.weights is None or np.mean(found.weights < 0.5) < 0.05


@pytest.mark.parametrize(("left", "alpha"), [(0, 1e-3), (4, 0.0)])
def test_frames_that_do_not_determine_a_cage_have_a_fault(binding, frames, left, alpha):
    given = np.ones(frames.shape[:2])
    given[4, left:] = 0
    solver = DualLaplacianSolver(binding, SolveSettings(alpha=alpha))
    found = RobustSolver(solver).solve(frames, given)
    assert list(found.faults) == [4]


def test_blocks_do_not_change_what_is_found(binding, frames):
    spoilt, _ = throw(frames)
    solver = RobustSolver(
        DualLaplacianSolver(binding, SolveSettings()), np.full(frames.shape[1], 0.02)
    )
    whole = solver.solve(spoilt)
    for k in range(len(frames)):
        alone = solver.solve(spoilt[[k]])
        np.testing.assert_allclose(alone.cages[0], whole.cages[k], rtol=0, atol=1e-10)


def test_weights_of_residuals():
    relative = np.array([0.0, 1.0, 2.0, 100.0])
    np.testing.assert_allclose(weigh(relative, is_huber=True), [1, 1, 0.5, 0.01])
    np.testing.assert_allclose(weigh(relative, is_huber=False), [1, 1, np.exp(-3), 0])


BALL = ball(3, 1.0)


def make_outlier(share, count=10):
    """Return frames in which a vertex is off by a share of the diagonal, in the last one."""
    frames = np.repeat(BALL.vertices[None], count, axis=0)
    frames[-1, 7] *= 1 + share * BALL.diagonal
    return frames


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        (make_outlier(0.15), True),
        (make_outlier(0.1), True),
        (make_outlier(0.045), False),
        (make_outlier(0.0) * [1, 1, 3], False),
        (make_outlier(0.0)[:0], False),
    ],
    ids=["thrown", "thrown less", "pulled", "stretched", "no frame"],
)
def test_outlier_vertices_are_distinguished_from_motion(frames, expected):
    assert has_outlier_vertices(BALL, frames) is expected


def test_an_outlier_vertex_of_the_rest_pose_is_found():
    frames = make_outlier(0.2)
    assert has_outlier_vertices(BALL.move(frames[-1]), frames[:-1])


@pytest.mark.parametrize("share", [0.004, 0.03, 0.1])
def test_outliers_are_found_however_many_there_are(share):
    """Neighbours that are outliers together are found where others are by themselves."""
    rng = np.random.default_rng(2)
    is_off = np.zeros(len(BALL.vertices), bool)
    is_off[rng.choice(len(is_off), max(1, round(share * len(is_off))), replace=False)] = True
    ways = rng.normal(size=BALL.vertices.shape)
    ways *= 0.3 * BALL.diagonal / np.linalg.norm(ways, axis=1, keepdims=True)
    frame = BALL.vertices + is_off[:, None] * ways
    found = find_outlier_vertices(BALL, frame)
    assert (found == is_off).all()
    frame[is_off] = np.nan
    assert not find_outlier_vertices(BALL, frame).any()


def pair(frames):
    return list(itertools.pairwise(frames))


def test_a_surface_is_torn_by_pieces_that_jump_and_not_by_quick_motion():
    """Nor by noise, nor by pieces that jump in a third of the frames, as a clean clip may have."""
    points = BALL.vertices
    times = np.linspace(0, 6, 25)[:, None, None]
    wave = points + np.sin(times) * points[:, 2:] ** 2 * [1.0, 0.5, 0.0]
    assert not is_often_torn(BALL, pair(wave))
    assert not is_often_torn(BALL, pair(wave[::6]))
    assert not is_often_torn(BALL, pair(corrupt("noise", wave)))
    assert not is_often_torn(BALL, pair(corrupt("patches", wave)))
    torn = corrupt("tears", wave)
    assert is_often_torn(BALL, pair(torn))
    assert not is_often_torn(BALL, pair([*torn[:9], *wave[9:]]))
    assert not is_often_torn(BALL, [])
    torn[:, np.abs(torn - wave).max(axis=(0, 2)) > 0] = np.nan
    assert not is_often_torn(BALL, pair(torn))


def test_of_a_large_mesh_some_edges_tell_whether_it_is_torn(monkeypatch):
    monkeypatch.setattr(robust, "MAX_COMPARED_EDGES", len(BALL.edges.ends) // 2)
    torn = corrupt("tears", np.repeat(BALL.vertices[None], 20, axis=0))
    assert is_often_torn(BALL, pair(torn))


def find_torn(residuals, mesh=BALL, is_data=None):
    is_data = np.ones(len(residuals), bool) if is_data is None else is_data
    return np.flatnonzero(
        find_torn_vertices(mesh, residuals, np.full(len(residuals), 0.1), is_data)
    )


def make_bump(mesh=BALL):
    """Return residuals that grow to four limits at the first vertex, and nowhere jump by one."""
    ways = np.linalg.norm(mesh.vertices - mesh.vertices[0], axis=1)
    return np.outer(np.maximum(0.4 - 0.3 * ways, 0), [0, 0, 1])


def find_ring(vertex, mesh=BALL):
    ends = mesh.edges.ends
    return np.unique(ends[(ends == vertex).any(axis=1)])


def test_residuals_that_grow_from_vertex_to_vertex_are_not_torn():
    assert not len(find_torn(make_bump()))


def test_outlier_vertices_and_pieces_are_torn():
    residuals = make_bump()
    piece = find_ring(200)
    residuals[piece] += [0.2, 0, 0]
    residuals[0] += [0.3, 0, 0]
    np.testing.assert_array_equal(find_torn(residuals), [0, *piece])


def test_a_component_that_is_off_as_a_whole_is_not_torn():
    both = merged(BALL, BALL)
    residuals = np.zeros((2 * len(BALL.vertices), 3))
    residuals[len(BALL.vertices) :] = [0, 0.5, 0]
    assert not len(find_torn(residuals, both))
    residuals[5] = [0, 0.5, 0]
    np.testing.assert_array_equal(find_torn(residuals, both), [5])


def test_the_surface_ends_at_what_is_missing():
    ring, residuals = find_ring(40), np.zeros((len(BALL.vertices), 3))
    is_data = np.ones(len(residuals), bool)
    is_data[ring] = False
    is_data[40] = True
    np.testing.assert_array_equal(find_torn(residuals, is_data=is_data), [40])
