import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.pose.constraints import CageConstraints, free_basis
from cageik_cli.method.pose.poser import CageResponseSolver
from tests.shapes import ball, concave, finer, octahedron

CAGE = finer(concave(), 1)
APART = TriMesh(
    np.concatenate([ball(1).vertices, 0.3 * octahedron().vertices]),
    np.concatenate([ball(1).faces, octahedron().faces + 18]),
)
CASES = {
    "one": (CAGE, CageConstraints()),
    "locked": (CAGE, CageConstraints((4, 30))),
    "two parts": (APART, CageConstraints()),
    "one of two parts locked": (APART, CageConstraints((2,))),
}


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request):
    """A solver, its Laplacian, its basis, and rows of six anchors."""
    cage, constraints = request.param
    laplacian, basis = uniform_laplacian(cage), free_basis(cage, constraints, 1)
    rows = np.random.default_rng(0).dirichlet(np.ones(len(cage.vertices)), 6)
    return CageResponseSolver(cage, laplacian, basis), laplacian, basis, rows


def minimum(case, compliance, targets, differences):
    """Of |L d − differences|² + |A d − targets|² / softness over the basis, by lstsq."""
    _, laplacian, basis, rows = case
    roots = compliance[:, None] ** -0.5
    matrix = np.vstack([laplacian, roots * rows]) @ basis
    right = np.vstack([differences, roots * targets])
    return basis @ np.linalg.lstsq(matrix, right, rcond=None)[0]


@pytest.mark.parametrize("softness", [1e-6, 1e-2, 10.0])
def test_responses_minimise_for_every_target_and_difference(case, softness):
    solver, laplacian, _, rows = case
    n, compliance = len(laplacian), softness * np.linspace(0.5, 2, 6)
    response = solver.solve_response(rows, compliance)
    targets, differences = np.eye(6), np.eye(n)
    np.testing.assert_allclose(
        response.anchor_response, minimum(case, compliance, targets, np.zeros((n, 6))), atol=1e-9
    )
    np.testing.assert_allclose(
        response.differential_response,
        minimum(case, compliance, np.zeros((6, n)), differences),
        atol=1e-8,
    )
    assert response.free_modes == 0


def test_hard_anchors_are_met_and_forces_are_balanced(case):
    """Lagrange: what is left of LᵀL d in the basis are forces of the anchors alone."""
    solver, laplacian, basis, rows = case
    response = solver.solve_response(rows, np.zeros(6))
    np.testing.assert_allclose(rows @ response.anchor_response, np.eye(6), atol=1e-12)
    np.testing.assert_allclose(rows @ response.differential_response, 0, atol=1e-12)
    pulls = basis.T @ laplacian.T @ laplacian @ response.anchor_response
    forces = np.linalg.lstsq(basis.T @ rows.T, pulls, rcond=None)[0]
    np.testing.assert_allclose(basis.T @ rows.T @ forces, pulls, atol=1e-9 * np.abs(pulls).max())


def test_the_condition_number_is_that_of_the_anchor_system():
    """Of A G Aᵀ + E among forces of sum zero, G being the pseudoinverse of LᵀL."""
    laplacian = uniform_laplacian(CAGE)
    rows = np.random.default_rng(0).dirichlet(np.ones(42), 5)
    compliance = np.linspace(1, 2, 5)
    response = CageResponseSolver(CAGE, laplacian, np.eye(42)).solve_response(rows, compliance)
    centring = np.eye(5) - 1 / 5
    inverse = np.linalg.pinv(laplacian.T @ laplacian, rcond=1e-12)
    shifted = np.eye(42) - 1 / 42
    influence = rows @ shifted @ inverse @ shifted @ rows.T
    system = centring @ (influence + np.diag(compliance)) @ centring
    values = np.linalg.eigvalsh(system)[1:]
    assert response.condition_number == pytest.approx(values[-1] / values[0], rel=1e-6)


def test_a_cage_that_cannot_move_has_an_infinite_condition_number():
    solver = CageResponseSolver(CAGE, uniform_laplacian(CAGE), np.zeros((42, 0)))
    rows = np.random.default_rng(0).dirichlet(np.ones(42), 2)
    assert solver.solve_response(rows, np.zeros(2)).condition_number == np.inf
    assert solver.solve_response(rows, np.ones(2)).condition_number == 1


def test_redundant_anchors_are_detected():
    solver = CageResponseSolver(CAGE, uniform_laplacian(CAGE), np.eye(42))
    rows = np.random.default_rng(0).dirichlet(np.ones(42), 4)
    rows = np.vstack([rows, rows[1]])
    response = solver.solve_response(rows, np.zeros(5))
    assert response.condition_number > 1e12
    np.testing.assert_allclose(
        np.abs(response.weakest_mode), [0, 0.5**0.5, 0, 0, 0.5**0.5], atol=1e-6
    )
    assert solver.solve_response(rows, np.full(5, 1e-6)).condition_number < 1e12


@pytest.mark.parametrize(("count", "loose"), [(0, 2), (1, 1), (2, 0)])
def test_undecided_components_are_counted(count, loose):
    solver = CageResponseSolver(APART, uniform_laplacian(APART), np.eye(24))
    rows = np.random.default_rng(0).dirichlet(np.ones(24), count).reshape(count, 24)
    response = solver.solve_response(rows, np.zeros(count))
    assert response.free_modes == loose
    assert response.anchor_response.shape == (24, count)
    np.testing.assert_allclose(response.anchor_response.sum(axis=1), min(count, 1), atol=1e-11)


def test_a_component_without_anchors_follows_the_other():
    """Its weights are zero there: it moves as one, with the mean motion of what is anchored."""
    solver = CageResponseSolver(APART, uniform_laplacian(APART), np.eye(24))
    rows = np.zeros((3, 24))
    rows[:, :18] = np.random.default_rng(0).dirichlet(np.ones(18), 3)
    response = solver.solve_response(rows, np.zeros(3))
    assert response.free_modes == 1
    np.testing.assert_allclose(np.ptp(response.anchor_response[18:], axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(response.anchor_response.sum(axis=1), 1, atol=1e-12)
