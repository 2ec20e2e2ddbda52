import numpy as np
import pytest

from cageik_cli.coordinates.bem import elimination
from cageik_cli.coordinates.bem.elimination import solve_in_place


def definite_system(count, columns=3):
    """A matrix whose symmetric part is positive definite, as that of the boundary equations."""
    generator = np.random.default_rng(count)
    root, skew = generator.normal(size=(2, count, count))
    matrix = root @ root.T / count + np.eye(count) + 0.3 * (skew - skew.T)
    return matrix.astype(np.float32), generator.normal(size=(count, columns)).astype(np.float32)


@pytest.mark.parametrize("count", [1, 7, 16, 50])
@pytest.mark.parametrize("rows", [3, 1024])
def test_elimination_solves_what_numpy_solves(count, rows, monkeypatch):
    monkeypatch.setattr(elimination, "BLOCK_SIZE", 16)
    monkeypatch.setattr(elimination, "ROWS_AT_ONCE", rows)
    matrix, rhs = definite_system(count)
    expected = np.linalg.solve(matrix.astype(float), rhs.astype(float))
    solve_in_place(matrix, rhs)
    np.testing.assert_allclose(rhs, expected, rtol=0, atol=2e-5 * np.abs(expected).max())


def test_a_singular_block_is_an_error():
    with pytest.raises(np.linalg.LinAlgError):
        solve_in_place(np.zeros((2, 2), np.float32), np.ones((2, 1), np.float32))
