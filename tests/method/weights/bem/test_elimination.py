from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from cageik_cli.method.weights.bem.boundary_equation import solve_in_place


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


@pytest.mark.parametrize("place", [0, 300])
def test_a_singular_block_is_an_error(place):
    matrix, rhs = definite_system(600)
    matrix[place : place + 256] = 0
    with pytest.raises(np.linalg.LinAlgError):
        solve(matrix, rhs, 2)
