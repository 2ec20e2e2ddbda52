from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from cageik_cli.method.points.field import HarmonicField
from cageik_cli.method.weights import harmonic
from cageik_cli.method.weights.harmonic import measure_surface_error
from tests.shapes import box, inside


@pytest.fixture(scope="module")
def field():
    return HarmonicField.solve(box(), inside(box(), 500, margin=0.01), "standard")


def measure(field):
    with ThreadPoolExecutor(2) as pool:
        return measure_surface_error(field.boundary, pool)


def test_the_error_on_the_cage_is_that_of_weights_just_inside(field):
    generator = np.random.default_rng(0)
    faces = np.repeat(np.arange(12), 400)
    corners, barycentric = field.cage.faces[faces], generator.dirichlet([1, 1, 1], len(faces))
    basis_functions = np.zeros((len(faces), 8))
    np.put_along_axis(basis_functions, corners, barycentric, axis=1)
    found = field.evaluate(basis_functions @ field.cage.vertices * (1 - 1e-9))
    expected = np.abs(found - basis_functions).sum(axis=1).mean()
    assert measure(field) == pytest.approx(expected, rel=0.15)


def test_where_no_point_is_near_nothing_is_measured():
    assert measure(HarmonicField.solve(box(), np.zeros((1, 3)))) == 0


def test_of_many_panels_some_are_measured(field, monkeypatch):
    expected = measure(field)
    monkeypatch.setattr(harmonic, "MAX_MEASURED_PANELS", 110)
    assert len(field.boundary.mesh.panels.corners) > 100
    assert measure(field) == pytest.approx(expected, rel=0.3)
