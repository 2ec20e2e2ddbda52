"""Weights for joints that turn: the system that needs no frames, and what fits better."""

from dataclasses import replace

import numpy as np

from cageik_cli.fit.alternate import CageSolve, Influences
from cageik_cli.fit.problem import Displacements, SurfaceLaplacian, WeightProblem, complement_basis
from cageik_cli.geometry.shape import compute_vertex_normals
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding
from cageik_cli.rigs.joints import NORMAL_LENGTH, JointSolver, TurningSystem, fit_turning
from tests.fitted import small_binding, smooth_motion

BALL = small_binding()
FEW = Influences.from_dense(BALL.weights, 3)
FRAMES = smooth_motion(BALL, 12)


def prepare(form: Influences) -> JointSolver:
    binding = replace(BALL, weights=form.to_dense(18), has_offsets=True)
    return JointSolver(DualLaplacianSolver(binding, SolveSettings()))


def displacements() -> np.ndarray:
    return prepare(FEW).solver.align(FRAMES)[0]


def expect_system(scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The matrices and right-hand sides from where each joint alone would take each vertex."""
    joints, columns = prepare(FEW), displacements()
    turns, moves = joints.solve_columns(columns, joints.change_normals(columns))
    points, places = joints.solver.rest, joints.solver.rest_cage
    arms = points[:, None] - places
    moved = places + moves.reshape(18, 12, 3).swapaxes(0, 1)
    alone = np.einsum("mna,fnab->fmnb", arms, turns) + moved[:, None] - points[:, None]
    normals = compute_vertex_normals(BALL.rest.polygons, BALL.rest.vertices)
    turned = np.einsum("ma,fnab->fmnb", normals, turns) - normals[:, None]
    length = NORMAL_LENGTH * BALL.rest.diagonal
    frames = columns.reshape(len(points), 12, 3).swapaxes(0, 1)
    shaded = [compute_vertex_normals(BALL.rest.polygons, points + frame) for frame in frames]
    basis = np.concatenate([alone, length * turned], axis=3) * scales[:, None, None, None]
    goal = np.concatenate([frames, length * (np.stack(shaded) - normals)], axis=2)
    goal *= scales[:, None, None]
    chosen = np.take_along_axis(basis, FEW.places[None, :, :, None], axis=2)
    matrices = np.einsum("fmkb,fmlb->mkl", chosen, chosen)
    scale = np.square(moves.reshape(18, 12, 3) * scales[:, None]).sum() / 18
    return matrices / scale, np.einsum("fmkb,fmb->mk", chosen, goal) / scale


def test_the_system_is_that_of_all_frames():
    scales, columns = np.sqrt(np.arange(1.0, 13)), displacements()
    system = TurningSystem(prepare(FEW), FEW.places)
    for part in (slice(0, 7), slice(7, 12)):
        thirds = np.repeat(scales[part], 3)
        system.add(columns[:, 3 * part.start : 3 * part.stop] * thirds, thirds)
    matrices, right = system.read_rows(slice(5, 40))
    expected = expect_system(scales)
    np.testing.assert_allclose(matrices, expected[0][5:40], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(right, expected[1][5:40], rtol=1e-8, atol=1e-10)


def fit(columns: np.ndarray, binding: Binding = BALL) -> np.ndarray:
    problem = WeightProblem(
        binding.weights, complement_basis(binding.cage), SurfaceLaplacian(binding.rest), None, 1, 0
    )
    cage_solve = CageSolve(replace(binding, has_offsets=True), SolveSettings(), None)
    return fit_turning(problem, cage_solve, Displacements.of(columns), FEW)


def test_fitted_weights_are_convex_few_and_nearer():
    found = fit(displacements())
    assert found.min() >= 0
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=0, atol=1e-12)
    assert ((found > 0).sum(axis=1) <= 3).all()
    errors = [
        np.square(prepare(form).solve(FRAMES).meshes - FRAMES).sum()
        for form in (FEW, Influences.from_dense(found, 3))
    ]
    assert errors[1] < 0.8 * errors[0]


def test_weights_are_not_fitted_to_rounding():
    still = np.zeros((len(BALL.rest.vertices), 6))
    rounding = 1e-8 * np.random.default_rng(0).normal(size=still.shape)
    np.testing.assert_allclose(fit(rounding), fit(still), rtol=0, atol=1e-3)
