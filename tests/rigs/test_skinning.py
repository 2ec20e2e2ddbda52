"""Weights for joints that turn: least squares of a vertex, their minima, and what fits better."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cageik_cli.fit.alternate import Alternator, CageSolve, Influences
from cageik_cli.fit.problem import Displacements, SurfaceLaplacian, WeightProblem, complement_basis
from cageik_cli.geometry.shape import compute_vertex_normals
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.rigs import skinning
from cageik_cli.rigs.joints import NORMAL_LENGTH, SWEEPS, JointSolver
from cageik_cli.rigs.merging import merge_joints
from cageik_cli.rigs.skinning import (
    FewColumns,
    SkinSystem,
    compare_roughness,
    find_normals,
    fit_turning,
    keep_cheapest,
    minimize_on_faces,
    refit_skin,
)
from tests.fitted import small_binding, smooth_motion

BALL = small_binding()
FEW = Influences.from_dense(BALL.weights, 3)
FRAMES = smooth_motion(BALL, 12)


def prepare(form: Influences) -> JointSolver:
    binding = replace(BALL, weights=form.to_dense(18), has_offsets=True)
    return JointSolver(DualLaplacianSolver(binding, SolveSettings()))


def displacements(frames: np.ndarray = FRAMES) -> np.ndarray:
    return prepare(FEW).solver.align(frames)[0]


def solve_changes(joints: JointSolver, columns: np.ndarray) -> np.ndarray:
    normals = joints.change_normals(columns)
    right = joints.multiply_moves(columns) + joints.multiply_normals(normals)
    return joints.sweep(right, joints.start(right), SWEEPS)


def expect_system(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """All Σ u_j u_k, Σ d u_j and s, from where each joint alone would take each vertex."""
    joints, columns = prepare(FEW), displacements()
    changes = solve_changes(joints, columns).reshape(18, 4, 12, 3)
    diagonal, points, places = BALL.rest.diagonal, joints.solver.rest, joints.solver.rest_cage
    turns = changes[:, :3].transpose(2, 0, 1, 3) + np.eye(3)
    moves = changes[:, 3].swapaxes(0, 1)
    arms = points[:, None] - places
    alone = np.einsum("mna,fnab->fmnb", arms, turns) + places - points[:, None]
    alone = alone / diagonal + moves[:, None]
    normals = compute_vertex_normals(BALL.rest.polygons, BALL.rest.vertices)
    turned = np.einsum("ma,fnab->fmnb", normals, turns) - normals[:, None]
    frames = columns.reshape(len(points), 12, 3).swapaxes(0, 1)
    shaded = [compute_vertex_normals(BALL.rest.polygons, points + frame) for frame in frames]
    basis = np.concatenate([alone, NORMAL_LENGTH * turned], axis=3)
    goal = [frames / diagonal, NORMAL_LENGTH * (np.stack(shaded) - normals)]
    products = np.einsum("f,fmkb,fmlb->mkl", shares, basis, basis)
    right = np.einsum("f,fmkb,fmb->mk", shares, basis, np.concatenate(goal, axis=2))
    return products, right, float(np.einsum("f,fnb->", shares, moves**2) / 18)


def test_the_system_is_that_of_all_frames():
    shares, joints = np.arange(1.0, 13), prepare(FEW)
    target = Displacements.join(np.split(displacements(), 12, axis=1), shares)
    changes = solve_changes(joints, displacements()) * np.repeat(np.sqrt(shares), 3)
    normals = find_normals(joints, target)
    whole = [FewColumns(part, None, target.weight) for part in (target, normals)]
    system = SkinSystem(joints, *whole, changes)
    products, right, scale = expect_system(shares)
    rows, places = slice(5, 40), FEW.places[5:40]
    expected = products[np.arange(5, 40)[:, None, None], places[:, :, None], places[:, None]]
    exact = {"rtol": 1e-8, "atol": 1e-12}
    np.testing.assert_allclose(system.read_matrices(rows, places), expected, **exact)
    np.testing.assert_allclose(system.multiply(rows), right[rows], **exact)
    own = np.einsum("mkk->mk", products)
    np.testing.assert_allclose(system.measure_joints(rows), own[rows], **exact)
    assert system.scale == pytest.approx(scale, rel=1e-9)


def make_squares(count: int, size: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Random least squares: matrices of which some are nearly singular, and right-hand sides."""
    random = np.random.default_rng(seed)
    basis = random.normal(size=(count, size, size)) * random.choice([1, 1e-2], (count, size, 1))
    goals = random.normal(size=(count, 1, size)) @ basis
    return basis.swapaxes(1, 2) @ basis + 1e-6 * np.eye(size), goals[:, 0]


def value(matrices: np.ndarray, linear: np.ndarray, weights: np.ndarray) -> np.ndarray:
    squares = np.einsum("pk,pkl,pl->p", weights, matrices, weights)
    return squares / 2 - (linear * weights).sum(axis=1)


def search_faces(matrix: np.ndarray, linear: np.ndarray, most: int) -> float:
    """The least value over all faces of the simplex with at most so many corners."""
    size, found = len(linear), np.inf
    for count in range(1, most + 1):
        for chosen in map(list, combinations(range(size), count)):
            bordered = np.ones((count + 1, count + 1))
            bordered[:count, :count], bordered[count, count] = matrix[np.ix_(chosen, chosen)], 0
            weights = np.linalg.solve(bordered, [*linear[chosen], 1])[:count]
            if (weights >= 0).all():
                whole = np.zeros((1, size))
                whole[0, chosen] = weights
                found = min(found, value(matrix[None], linear[None], whole)[0])
    return found


@pytest.mark.parametrize("corner", [False, True])
def test_minima_are_the_least_over_all_faces(corner):
    matrices, linear = make_squares(60, 5)
    start = np.eye(5)[np.arange(60) % 5] if corner else np.full((60, 5), 0.2)
    found = minimize_on_faces(matrices, linear, start, np.ones((60, 5), bool))
    assert found.min() >= 0
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=1e-12)
    expected = [search_faces(*each, most=5) for each in zip(matrices, linear, strict=True)]
    np.testing.assert_allclose(value(matrices, linear, found), expected, rtol=1e-9, atol=1e-12)
    assert ((found == 0).sum(axis=1) > 0).any()


def test_what_may_not_grow_stays_zero():
    matrices, linear = make_squares(40, 4)
    may_grow = np.tile([True, True, True, False], (40, 1))
    start = np.tile([0.5, 0.5, 0, 0], (40, 1))
    found = minimize_on_faces(matrices, linear, start, may_grow)
    assert not found[:, 3].any()
    expected = minimize_on_faces(matrices[:, :3, :3], linear[:, :3], start[:, :3], may_grow[:, :3])
    np.testing.assert_allclose(found[:, :3], expected, rtol=0, atol=1e-9)


def test_few_weights_are_kept_and_nearly_the_best_ones():
    matrices, linear = make_squares(80, 6, seed=1)
    start = np.full((80, 6), 1 / 6)
    found = keep_cheapest(matrices, linear, start, 2)
    assert ((found > 0).sum(axis=1) <= 2).all()
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=1e-12)
    best = [search_faces(*each, most=2) for each in zip(matrices, linear, strict=True)]
    values = value(matrices, linear, found)
    assert (values >= np.array(best) - 1e-9).all()
    assert np.isclose(values, best, rtol=1e-6).mean() > 0.7
    full = minimize_on_faces(matrices, linear, start, np.ones((80, 6), bool))
    largest = Influences.from_dense(full, 2).to_dense(6)
    assert values.mean() < value(matrices, linear, largest).mean()


def pose(jobs: int = 1, weights: np.ndarray | None = None) -> WeightProblem:
    basis = complement_basis(BALL.cage)
    return WeightProblem(
        BALL.weights, basis, SurfaceLaplacian(BALL.rest), weights, 1e-3, 0, jobs=jobs
    )


def fit(columns: np.ndarray, jobs: int = 1, weights: np.ndarray | None = None) -> np.ndarray:
    cage_solve = CageSolve(replace(BALL, has_offsets=True), SolveSettings(), weights)
    return fit_turning(pose(jobs, weights), cage_solve, Displacements.of(columns), FEW)


def measure(weights: np.ndarray, frames: np.ndarray) -> float:
    """The rms distance of a skin from frames, in diagonals."""
    form = Influences.from_dense(weights, int((weights > 0).sum(axis=1).max()))
    joints = prepare(form)
    error = joints.pose(joints.solve(frames)).meshes - frames
    return float(np.sqrt(np.square(error).sum(axis=2).mean())) / BALL.rest.diagonal


def test_fitted_weights_are_convex_few_and_nearer():
    found = fit(displacements())
    assert found.min() >= 0
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=0, atol=1e-12)
    assert ((found > 0).sum(axis=1) <= 3).all()
    assert measure(found, FRAMES) < 0.6 * measure(FEW.to_dense(18), FRAMES)


def test_roughness_is_that_of_the_largest_weights_before():
    cage_solve = CageSolve(BALL, SolveSettings(), None)
    alternator = Alternator(pose(), cage_solve, 1)
    laplacian = SurfaceLaplacian(BALL.rest)
    skin = replace(BALL, weights=fit(displacements()))
    expected = laplacian.measure(skin.weights) / laplacian.measure(FEW.to_dense(18))
    assert compare_roughness(alternator, skin, 3) == pytest.approx(expected, rel=1e-12)
    joints = np.arange(18) % 4
    merged = merge_joints(BALL, joints)
    kept = replace(merged, weights=Influences.from_dense(merged.weights, 2).to_dense(4))
    assert compare_roughness(alternator, kept, 2, joints) == pytest.approx(1, rel=1e-9)
    alone = np.zeros(18, int)
    assert compare_roughness(alternator, merge_joints(BALL, joints), 1, alone) is None


def make_skin(seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A skin of two joints per vertex, the nearest ones, and frames in which its joints turn."""
    distances = np.linalg.norm(BALL.rest.vertices[:, None] - BALL.cage.vertices, axis=2)
    weights = Influences.from_dense(1 / distances**2, 2).to_dense(18)
    weights /= weights.sum(axis=1, keepdims=True)
    random = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(0.3 * random.normal(size=(20 * 18, 3))).as_matrix()
    turns = turns.reshape(20, 18, 3, 3)
    arms = BALL.rest.vertices[:, None] - BALL.cage.vertices
    places = BALL.cage.vertices + 0.1 * random.normal(size=(20, 18, 3))
    alone = np.einsum("mna,fnab->fmnb", arms, turns) + places[:, None]
    return weights, np.einsum("mn,fmnb->fmb", weights, alone)


def test_joints_that_a_vertex_did_not_have_are_found():
    """Of the joints of a skin whose motion is known; a third of the vertices have a wrong one."""
    weights, frames = make_skin()
    form = Influences.from_dense(weights, 2)
    joints, columns = prepare(form), displacements(frames)
    target, changes = Displacements.of(columns), solve_changes(joints, columns)
    normals = find_normals(joints, target)
    whole = [FewColumns(part, None, target.weight) for part in (target, normals)]
    system = SkinSystem(joints, *whole, changes)
    wrong = form.places.copy()
    wrong[::3, 0] = (wrong[::3, 1] + 5) % 18
    start = Influences(np.sort(wrong, axis=1), np.full(wrong.shape, 0.5))
    found = refit_skin(replace(pose(), regularization=1e-6), start, system)

    def count_squares(form: Influences) -> np.ndarray:
        rows, dense = slice(None), form.to_dense(18)
        every = np.tile(np.arange(18), (len(dense), 1))
        matrices, linear = system.read_matrices(rows, every), system.multiply(rows)
        least = [search_faces(*each, most=2) for each in zip(matrices, linear, strict=True)]
        return value(matrices, linear, dense) - np.array(least)

    before, after = count_squares(start)[::3], count_squares(found)
    assert after.min() > -1e-9  # of all pairs of joints, the best ones are known
    assert (after[::3] < 0.05 * before).mean() > 0.8
    assert np.isclose(after, 0, atol=1e-6).mean() > 0.6


def test_weights_are_not_fitted_to_rounding():
    still = np.zeros((len(BALL.rest.vertices), 6))
    rounding = 1e-8 * np.random.default_rng(0).normal(size=still.shape)
    np.testing.assert_allclose(fit(rounding), fit(still), rtol=0, atol=1e-3)


def test_blocks_and_threads_change_nothing(monkeypatch):
    whole = fit(displacements())
    monkeypatch.setattr(skinning, "MAX_ROW_ENTRIES", 10 * 16 * 9**2)
    parts = fit(displacements())
    np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(fit(displacements(), jobs=3), parts)


def test_frames_in_single_precision_are_fitted_alike():
    columns = displacements()
    target = Displacements.join(np.split(columns.astype(np.float32), 12, axis=1), np.ones(12))
    joints = prepare(FEW)
    normals = find_normals(joints, target)
    assert {part.dtype for part in normals.parts} == {np.dtype(np.float32)}
    expected = joints.change_normals(columns)
    np.testing.assert_allclose(np.hstack(list(normals.blocks())), expected, rtol=0, atol=1e-7)


def test_vertices_that_do_not_count_do_not_matter():
    weights = np.ones(len(BALL.rest.vertices))
    weights[7] = 0
    weights *= len(weights) / weights.sum()
    columns = displacements()
    away = columns.copy()
    away[7] += 0.01 * np.random.default_rng(0).normal(size=columns.shape[1])
    near = BALL.rest.faces[(BALL.rest.faces == 7).any(axis=1)]
    others = np.setdiff1d(np.arange(len(weights)), near)  # their normals stay
    change = fit(away, weights=weights) - fit(columns, weights=weights)
    counted = fit(away) - fit(columns)
    assert np.abs(change[others]).mean() < 0.5 * np.abs(counted[others]).mean()
    assert np.isfinite(change).all()


def test_few_columns_hold_a_motion_of_few_directions():
    """All that is left out is small, and what is multiplied is what all columns give."""
    random = np.random.default_rng(0)
    columns = random.normal(size=(60, 5)) @ random.normal(size=(5, 36))
    columns += 1e-9 * random.normal(size=columns.shape)
    target = Displacements.of(columns)
    few = FewColumns.of(target, 1e-5)
    assert len(few.columns) == 2
    assert few.weight == target.weight == 12
    left, rows = random.normal(size=(7, 60)), random.normal(size=(4, 36))
    np.testing.assert_allclose(
        few.multiply_left(lambda block: left @ block), left @ columns, atol=1e-6
    )
    product = few.columns.read_rows(slice(0, 60)) @ few.reduce(rows).T
    np.testing.assert_allclose(product, columns @ rows.T, atol=1e-6)


@pytest.mark.parametrize("tolerance", [1e-9, 1e-3])
def test_all_columns_are_kept_where_few_would_leave_something_out(tolerance):
    target = Displacements.of(np.random.default_rng(0).normal(size=(60, 36)))
    few = FewColumns.of(target, tolerance)
    assert few.columns is target
    assert few.basis is None


def test_a_fit_to_few_columns_is_that_to_all(monkeypatch):
    left, sizes, right = np.linalg.svd(displacements(), full_matrices=False)
    columns = (left[:, :6] * sizes[:6]) @ right[:6]
    assert len(FewColumns.of(Displacements.of(columns), skinning.MOVES_TOL).columns) == 2
    few = fit(columns)
    monkeypatch.setattr(skinning, "MOVES_TOL", 0.0)
    monkeypatch.setattr(skinning, "NORMALS_TOL", 0.0)
    np.testing.assert_allclose(few, fit(columns), atol=1e-3)
