from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.linalg import lu_factor, lu_solve
from threadpoolctl import threadpool_info, threadpool_limits

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.bem import boundary_equation
from cageik_cli.method.weights.bem.boundary_equation import solve_in_place
from cageik_cli.method.weights.harmonic import harmonic_weights
from cageik_cli.util.errors import NumericalError
from tests.shapes import box


@pytest.mark.parametrize(
    "degrees", [1, *(pytest.param(angle, marks=pytest.mark.slow) for angle in (0.1, 0.01))]
)
def test_sharp_wedges_lose_few_more_digits_than_with_exchanged_rows(monkeypatch, degrees):
    """The condition number is 1e5 at a degree, and 1e7 at a hundredth of one."""
    height = np.tan(np.radians(degrees))
    ground = np.array([[0, 0], [1, 0], [1, height]])
    vertices = np.concatenate([np.insert(ground, 2, z, axis=1) for z in (0, 1)])
    faces = [[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]]
    cage = TriMesh(vertices, faces)
    points = np.column_stack([(x := np.linspace(0.1, 0.9, 30)), 0.4 * x * height, 0.2 + 0.6 * x])

    def weights_by(solve):
        def solve_in_place(matrix, rhs, pool, **_):
            rhs[:] = solve(matrix, rhs)

        monkeypatch.setattr(boundary_equation, "solve_in_place", solve_in_place)
        return harmonic_weights(cage, points).values

    found = harmonic_weights(cage, points).values
    exact = weights_by(lambda matrix, rhs: np.linalg.solve(matrix.astype(float), rhs.astype(float)))
    with_exchanges = weights_by(lambda matrix, rhs: lu_solve(lu_factor(matrix), rhs))
    error, other = (np.abs(each - exact).sum(axis=1).mean() for each in (found, with_exchanges))
    assert 0 < error < 4 * other


def test_the_linear_algebra_has_one_thread(monkeypatch):
    """Two would wait for each other, which takes 10 times as long where others run."""
    found = set()

    def solve(matrix, rhs, pool, **_):
        found.update(p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas")
        solve_in_place(matrix, rhs, pool)

    monkeypatch.setattr(boundary_equation, "solve_in_place", solve)
    with threadpool_limits(2, user_api="blas"):
        harmonic_weights(box(), np.zeros((1, 3)))
    assert found == {1}


def test_equations_without_a_solution_are_refused(monkeypatch):
    def fail(matrix, rhs, pool, **_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(boundary_equation, "solve_in_place", fail)
    with pytest.raises(NumericalError, match="no solution for this cage; check it with"):
        harmonic_weights(box(), np.zeros((1, 3)))


def definite_system(count, columns=3):
    """A matrix whose symmetric part is positive definite, as that of the boundary equations."""
    generator = np.random.default_rng(count)
    root, skew = generator.normal(size=(2, count, count))
    matrix = root @ root.T / count + np.eye(count) + 0.3 * (skew - skew.T)
    return matrix.astype(np.float32), generator.normal(size=(count, columns)).astype(np.float32)


def solve(matrix, rhs, threads, **sizes):
    solution = rhs.copy()
    with ThreadPoolExecutor(threads) as pool:
        solve_in_place(matrix.copy(), solution, pool, **sizes)
    return solution


@pytest.mark.parametrize("count", [1, 7, 16, 50])
@pytest.mark.parametrize("columns", [3, 100])
def test_elimination_solves_what_numpy_solves(count, columns):
    matrix, rhs = definite_system(count, columns)
    expected = np.linalg.solve(matrix.astype(float), rhs.astype(float))
    found = solve(matrix, rhs, 2, block_size=16)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * np.abs(expected).max())


def test_the_number_of_threads_does_not_change_the_solution():
    matrix, rhs = definite_system(900, 150)
    expected = solve(matrix, rhs, 1)
    for threads in (2, 3, 5):
        np.testing.assert_array_equal(solve(matrix, rhs, threads), expected)


def test_the_progress_of_an_elimination_is_that_of_its_work():
    """The first of three blocks has 19 of 27 parts of the work."""
    matrix, rhs = definite_system(48)
    calls = []
    solve(matrix, rhs, 1, block_size=16, progress=lambda *done: calls.append(done))
    assert calls == [(34, 48), (46, 48), (48, 48)]


@pytest.mark.parametrize("most", [10, 10**6])
def test_only_a_long_elimination_is_shown(monkeypatch, most):
    """The shown work comes before the points, of which there are few."""
    monkeypatch.setattr(boundary_equation, "MIN_SHOWN_UNKNOWNS", most)
    calls = []
    harmonic_weights(box(), np.zeros((1, 3)), progress=lambda *done: calls.append(done))
    shown, last = calls[:-1], calls[-1]
    assert last == (1, 1)
    assert bool(shown) == (most == 10)
    for done, total in shown:
        assert 0 < done <= total > 10


@pytest.mark.parametrize("place", [0, 300])
def test_a_singular_block_is_an_error(place):
    matrix, rhs = definite_system(600)
    matrix[place : place + 256] = 0
    with pytest.raises(np.linalg.LinAlgError):
        solve(matrix, rhs, 2)
