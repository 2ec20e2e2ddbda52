from functools import cache

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.method.points import field as field_module
from cageik_cli.method.points.field import HarmonicField
from cageik_cli.method.weights import harmonic
from cageik_cli.method.weights.bem.panels import Panels
from cageik_cli.method.weights.settings import ACCURACIES, BindSettings
from cageik_cli.util.errors import CageError, FormatError, SettingError
from tests.method.weights.random_cages import points_within, random_cage
from tests.shapes import TETRAHEDRON, ball, box, concave, inside

CAGES = {"box": box(), "concave": concave(), "ball": ball(1, 1.0)}
ACCURACIES_OF_CAGES = [
    *(("concave", accuracy) for accuracy in ACCURACIES),
    *((cage, "standard") for cage in ("box", "ball")),
    *(pytest.param(cage, "fine", marks=pytest.mark.slow) for cage in ("box", "ball")),
]


@cache
def solve(name, accuracy="standard"):
    """The field of a cage, and the points inside that it was solved for."""
    points = inside(CAGES[name], 40)
    return HarmonicField.solve(CAGES[name], points, accuracy), points


def normals(cage):
    return Panels(cage.vertices, cage.faces).normals


def differentiate(field, points, step):
    """Central differences of fourth order, (m, n, 3)."""
    shifts = step * np.eye(3)
    near = [field.evaluate(points + s) - field.evaluate(points - s) for s in shifts]
    far = [field.evaluate(points + 2 * s) - field.evaluate(points - 2 * s) for s in shifts]
    pairs = zip(near, far, strict=True)
    return np.stack([(8 * a - b) / (12 * step) for a, b in pairs], axis=2)


def assert_affine(gradient, cage, atol=1e-12):
    """The gradients of a point sum to zero, and those of its coordinates are the identity."""
    middle = cage.vertices.mean(axis=0)
    sums = gradient.sum(axis=1) * cage.diagonal
    np.testing.assert_allclose(sums, 0, rtol=0, atol=atol)
    identity = (cage.vertices - middle).T @ gradient
    expected = np.broadcast_to(np.eye(3), identity.shape)
    np.testing.assert_allclose(identity, expected, rtol=0, atol=atol)


@pytest.mark.parametrize(("name", "accuracy"), ACCURACIES_OF_CAGES)
def test_gradients_are_those_of_the_weights(name, accuracy):
    cage = CAGES[name]
    field, points = solve(name, accuracy)
    gradient = field.gradient(points)
    expected = differentiate(field, points, 1e-3 * cage.diagonal)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-5 * abs(expected).max())
    assert_affine(gradient, cage)


@pytest.mark.parametrize(("name", "accuracy"), ACCURACIES_OF_CAGES)
def test_gradients_near_faces_and_edges_are_those_of_the_weights(name, accuracy):
    """A thousandth of the diagonal below them, where single densities decide."""
    cage = CAGES[name]
    shares = np.random.default_rng(2).dirichlet(np.ones(3), len(cage.faces))
    shares[::2, 0] *= 0.01  # every second point is near an edge
    shares /= shares.sum(axis=1, keepdims=True)
    depth = 1e-3 * cage.diagonal
    points = np.einsum("fk,fkx->fx", shares, cage.vertices[cage.faces]) - depth * normals(cage)
    is_deep = closest_points(cage, points).distance > 0.5 * depth
    points = points[is_deep & (winding_numbers(cage, points) > 0.5)]
    assert len(points) >= 6
    field, _ = solve(name, accuracy)
    expected = differentiate(field, points, depth / 24)
    np.testing.assert_allclose(
        field.gradient(points), expected, rtol=0, atol=1e-5 * abs(expected).max()
    )


def test_a_wrong_term_would_be_noticed(monkeypatch):
    """The fading of higher terms has a slope; without it the gradients miss the differences."""
    field, points = solve("concave")
    expected = differentiate(field, points, 1e-3 * field.cage.diagonal)
    nothing = field_module._strength_slopes
    monkeypatch.setattr(field_module, "_strength_slopes", lambda *a: 0 * nothing(*a))
    assert abs(field.gradient(points) - expected).max() > 1e-4 * abs(expected).max()


@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_gradients_in_a_tetrahedron_are_those_of_barycentric_coordinates(shift):
    points = inside(TETRAHEDRON, 50, margin=0.01) + shift
    cage = TriMesh(TETRAHEDRON.vertices + shift, TETRAHEDRON.faces)
    gradient = HarmonicField.solve(cage, points).gradient(points)
    expected = np.concatenate([-np.ones((1, 3)), np.eye(3)])
    expected = np.broadcast_to(expected, gradient.shape)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-12 * (1 + shift))


def test_values_are_the_weights_of_a_binding():
    """The field is the one that the weights came from, but for their single precision inside."""
    cage = ball(1, 1.0)
    inner = inside(cage, 60)
    on_cage = cage.vertices[cage.faces].mean(axis=1)[:10]
    rest = TriMesh(np.concatenate([inner, on_cage]), np.arange(69).reshape(-1, 3))
    binding = bind(rest, cage, BindSettings())
    field = HarmonicField.solve(binding.cage, rest.vertices)
    found = field.evaluate(rest.vertices)
    np.testing.assert_allclose(found[:60], binding.weights[:60], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found[60:], binding.weights[60:])
    assert field.error == binding.estimated_error


def test_gradients_on_the_cage_are_the_limit_from_inside():
    """Up to the error of the weights, which shrinks with the accuracy."""
    cage = CAGES["ball"]
    on_cage = np.einsum("fkx,k->fx", cage.vertices[cage.faces], [0.3, 0.3, 0.4])
    apart = []
    for accuracy in ("preview", "standard"):
        field = HarmonicField.solve(cage, on_cage * 0.99, accuracy)
        limit, near = field.gradient(on_cage), field.gradient(on_cage - 1e-6 * normals(cage))
        assert_affine(limit, cage)
        apart.append(np.linalg.norm(limit - near) / np.linalg.norm(near))
    assert apart[0] < 0.02
    assert apart[1] < 0.25 * apart[0]


@pytest.mark.parametrize("seed", range(8))
def test_gradients_of_random_cages_are_exact_for_affine_maps(seed, monkeypatch):
    """Also at points a ten-thousand-millionth of the diagonal from faces, edges and corners."""
    cage = random_cage(seed)
    points = points_within(cage, seed)
    accuracy = "standard" if seed == 1 else "preview"
    if seed != 1:  # most in haste: panels are divided once
        monkeypatch.setattr(harmonic, "MAX_REFINEMENTS", 1)
    gradient = HarmonicField.solve(cage, points, accuracy).gradient(points)
    assert np.isfinite(gradient).all()
    size = max(1.0, abs(cage.vertices.mean(axis=0)).max() / cage.diagonal)
    largest = max(1.0, abs(gradient).max() * cage.diagonal)
    assert_affine(gradient, cage, atol=1e-13 * size * largest)


def test_threads_do_not_change_gradients_and_progress_is_reported():
    points = inside(concave(), 1500)
    field, seen = HarmonicField.solve(concave(), points, "preview"), []
    one = field.gradient(points, jobs=1, progress=lambda *done: seen.append(done))
    np.testing.assert_array_equal(field.gradient(points, jobs=2), one)
    assert seen[-1] == (1500, 1500)


def test_points_outside_are_refused():
    field = HarmonicField.solve(box(), inside(box(), 20), "preview")
    points = inside(box(), 5)
    points[3] += 10
    for method in (field.evaluate, field.gradient):
        with pytest.raises(CageError, match=r"1 of 5 points are outside the cage, .* number 3"):
            method(points)
    with pytest.raises(FormatError, match=r"expected \(count, 3\)"):
        field.gradient(np.zeros(3))


def test_unknown_accuracy_and_too_many_faces_are_refused(monkeypatch):
    with pytest.raises(SettingError, match="accuracy is 'best'"):
        HarmonicField.solve(box(), np.full((1, 3), 0.5), "best")
    monkeypatch.setattr("cageik_cli.method.weights.harmonic.MAX_HARMONIC_FACES", 5)
    with pytest.raises(CageError, match="12 faces, at most 5"):
        HarmonicField.solve(box(), np.full((1, 3), 0.5))
