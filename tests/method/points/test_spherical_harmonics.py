import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from cageik_cli.method.points.oriented import REST_COUNTS, evaluate_band, rotate_harmonics

DEGREES = (1, 2, 3)


def random_directions(count, seed=0):
    directions = np.random.default_rng(seed).normal(size=(3, count))
    return directions / np.linalg.norm(directions, axis=0)


def random_turns(count, seed=1):
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_matrix().transpose(1, 2, 0)


def evaluate(coefficients, directions):
    """The functions, (3, m), of coefficients (3, c, m) at a direction each, (3, m)."""
    values = np.zeros((3, directions.shape[1]))
    harmonics = [h for degree in DEGREES for h in evaluate_band(degree, directions)]
    for i in range(coefficients.shape[1]):
        values += coefficients[:, i] * harmonics[i]
    return values


@pytest.mark.parametrize("degree", DEGREES)
def test_harmonics_are_those_of_scipy_without_its_sign(degree):
    """The real harmonics, with the sign (-1)^m that Gaussian splats have twice: for m and -m."""
    directions = random_directions(50)
    x, y, z = directions
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    for m, found in zip(range(-degree, degree + 1), evaluate_band(degree, directions), strict=True):
        complex_value = sph_harm_y(degree, abs(m), polar, azimuth)
        part = complex_value.real if m >= 0 else complex_value.imag
        expected = part * (np.sqrt(2) if m else 1)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("count", REST_COUNTS)
def test_a_turned_function_has_the_values_of_the_function_turned_back(count):
    m = 200
    coefficients = np.random.default_rng(2).normal(size=(3, count, m)).astype(np.float32)
    turns, directions = random_turns(m), random_directions(m, 3)
    turned = rotate_harmonics(coefficients, turns.astype(np.float32))
    back = np.einsum("ijm,im->jm", turns, directions)
    expected = evaluate(coefficients, back)
    np.testing.assert_allclose(evaluate(turned, directions), expected, rtol=0, atol=1e-5)
    norms = [np.linalg.norm(array, axis=1) for array in (turned, coefficients)]
    np.testing.assert_allclose(*norms, rtol=1e-5)


def test_two_turns_are_one():
    m = 100
    coefficients = np.random.default_rng(2).normal(size=(3, 15, m)).astype(np.float32)
    first, second = random_turns(m, 4), random_turns(m, 5)
    both = np.einsum("ijm,jkm->ikm", second, first)
    one = rotate_harmonics(coefficients, both.astype(np.float32))
    two = rotate_harmonics(coefficients, first.astype(np.float32))
    two = rotate_harmonics(two, second.astype(np.float32))
    np.testing.assert_allclose(one, two, rtol=0, atol=2e-5)
