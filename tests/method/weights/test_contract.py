"""What holds of weights of either kind."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights import mean_value
from cageik_cli.method.weights.harmonic import harmonic_weights
from cageik_cli.method.weights.mean_value import mean_value_weights
from tests.shapes import ball, box, concave, inside, rotation

pytestmark = pytest.mark.parametrize(
    "compute", [harmonic_weights, mean_value_weights], ids=["harmonic", "mean value"]
)


CAGES = {"box": box(), "concave": concave(), "ball": ball(1, 1.0)}


@pytest.mark.parametrize("cage", CAGES.values(), ids=CAGES)
def test_rows_sum_to_one_and_give_the_points(compute, cage):
    points = inside(cage, 300)
    weights = compute(cage, points).values
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-13)
    np.testing.assert_allclose(weights @ cage.vertices, points, rtol=0, atol=1e-13 * cage.diagonal)


@pytest.mark.usefixtures("core")
def test_weights_on_the_surface_are_barycentric(compute):
    cage = concave()
    barycentric = np.random.default_rng(1).dirichlet(np.ones(3), len(cage.faces))
    barycentric[0] = [1, 0, 0]
    barycentric[1] = [0.5, 0.5, 0]
    points = np.einsum("fk,fkx->fx", barycentric, cage.vertices[cage.faces])
    expected = np.zeros((len(points), len(cage.vertices)))
    np.put_along_axis(expected, cage.faces, barycentric, axis=1)
    np.testing.assert_allclose(compute(cage, points).values, expected, rtol=0, atol=1e-14)


def test_weights_do_not_depend_on_jobs_and_progress_is_reported(compute, monkeypatch):
    monkeypatch.setattr(mean_value, "MAX_RAY_ENTRIES", 100)
    points = inside(concave(), 2000, margin=0.01)
    calls = []
    one = compute(concave(), points, jobs=1, progress=lambda *done: calls.append(done)).values
    np.testing.assert_array_equal(compute(concave(), points, jobs=3).values, one)
    assert len(calls) > 2
    assert calls[-1] == (len(points), len(points))
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)


@settings(max_examples=5)
@given(st.integers(0, 1000), st.floats(1e-3, 1e3))
def test_similar_cages_have_the_same_weights_and_permuted_vertices_permuted_ones(
    compute, seed, scale
):
    cage, points = concave(), inside(concave(), 20, margin=0.03)
    turn, order = rotation(seed), np.random.default_rng(seed).permutation(len(cage.vertices))
    moved = TriMesh(scale * (cage.vertices @ turn.T)[order] + 3, np.argsort(order)[cage.faces])
    there = scale * points @ turn.T + 3
    found, expected = compute(moved, there).values, compute(cage, points).values[:, order]
    middle = moved.vertices.mean(axis=0)
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=0, atol=1e-12)
    back = found @ (moved.vertices - middle)
    np.testing.assert_allclose(back, there - middle, rtol=0, atol=1e-11 * moved.diagonal)
    # Harmonic products are in single precision. Rounding of the input grows with the offset over
    # the scale.
    tolerance = (
        5e-7 * max(1, 1e-3 / scale) if compute is harmonic_weights else 1e-14 / min(1, scale)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)
