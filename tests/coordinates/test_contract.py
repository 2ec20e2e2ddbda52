"""What holds of weights of either kind."""

import numpy as np
import pytest

from cageik_cli.coordinates import mean_value
from cageik_cli.coordinates.harmonic import harmonic_weights
from cageik_cli.coordinates.mean_value import mean_value_weights
from tests.shapes import concave, inside

pytestmark = pytest.mark.parametrize(
    "compute", [harmonic_weights, mean_value_weights], ids=["harmonic", "mean value"]
)


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
