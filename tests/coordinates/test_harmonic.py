import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.coordinates import harmonic
from cageik_cli.coordinates.harmonic import divided, harmonic_weights
from cageik_cli.errors import InputError
from cageik_cli.mesh import TriMesh
from tests.shapes import TETRAHEDRON, ball, box, concave, finer, inside, rotation

CAGES = {"box": box(), "concave": concave(), "ball": ball(1, 1.0)}


@pytest.mark.parametrize("cage", CAGES.values(), ids=CAGES.keys())
def test_rows_sum_to_one_and_give_the_points(cage):
    points = inside(cage, 300)
    weights = harmonic_weights(cage, points).values
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-13)
    np.testing.assert_allclose(weights @ cage.vertices, points, atol=1e-13 * cage.diagonal)


def test_of_a_tetrahedron_they_are_barycentric():
    points = inside(TETRAHEDRON, 200, margin=0.01)
    expected = np.column_stack([1 - points.sum(axis=1), points])
    np.testing.assert_allclose(harmonic_weights(TETRAHEDRON, points).values, expected, atol=1e-13)


@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_far_from_the_origin_nothing_is_lost_but_the_input_s_own_digits(shift):
    cage = ball(1, 1.0)
    points = inside(cage, 50)
    moved = harmonic_weights(TriMesh(cage.vertices + shift, cage.faces), points + shift).values
    np.testing.assert_allclose(moved.sum(axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(moved, harmonic_weights(cage, points).values, atol=1e-11)


def test_a_harmonic_polynomial_is_approached_as_the_cage_is_divided():
    """x² − y² is harmonic; only its interpolation on the cage, O(h²), stands between."""
    points = inside(box(), 60, margin=0.1)
    exact = points[:, 0] ** 2 - points[:, 1] ** 2
    errors = []
    for levels in (1, 2, 3):
        cage = finer(box(), levels)
        x, y, _ = cage.vertices.T
        errors.append(np.abs(harmonic_weights(cage, points).values @ (x**2 - y**2) - exact).max())
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (slopes > 1.7).all()
    assert errors[-1] < 0.01


def test_weights_converge_as_panels_are_divided(monkeypatch):
    """Halved panels gain at least the first order that the edges' singularities leave."""
    points = inside(concave(), 60, margin=0.03)
    found = []
    for panels in (28, 112, 448, 1792):
        monkeypatch.setattr(harmonic, "PANEL_GOAL", panels)
        found.append(harmonic_weights(concave(), points).values)
    errors = [np.abs(weights - found[-1]).sum(axis=1).mean() for weights in found[:-1]]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (slopes > 1.2).all()
    assert errors[-1] < 2e-3


def test_smallest_weight_is_zero_but_for_the_discretisation(monkeypatch):
    """The exact weights are not negative: what is, must vanish as panels are divided."""
    points = inside(concave(), 300, margin=0.005)
    smallest = []
    for panels in (28, 1792):
        monkeypatch.setattr(harmonic, "PANEL_GOAL", panels)
        smallest.append(harmonic_weights(concave(), points).values.min())
    assert smallest[0] < -1e-3
    assert smallest[1] > -1e-4


def test_on_the_surface_they_are_barycentric():
    cage = concave()
    barycentric = np.random.default_rng(1).dirichlet(np.ones(3), len(cage.faces))
    barycentric[0] = [1, 0, 0]
    barycentric[1] = [0.5, 0.5, 0]
    points = np.einsum("fk,fkx->fx", barycentric, cage.vertices[cage.faces])
    expected = np.zeros((len(points), len(cage.vertices)))
    np.put_along_axis(expected, cage.faces, barycentric, axis=1)
    np.testing.assert_allclose(harmonic_weights(cage, points).values, expected, atol=1e-14)


def test_near_the_surface_they_meet_its_barycentric_weights(monkeypatch):
    """Nodes alone hold the boundary values, so that a gap of the size of the error is left."""
    cage = concave()
    on = cage.vertices[cage.faces].mean(axis=1)
    inward = -np.cross(*(cage.vertices[cage.faces[:, k]] - on for k in (0, 1)))
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    at = harmonic_weights(cage, on).values
    gaps = []
    for panels in (28, 448, 1792):
        monkeypatch.setattr(harmonic, "PANEL_GOAL", panels)
        for depth in (1e-6, 1e-9, 1e-11):
            near = harmonic_weights(cage, on + depth * inward).values
            np.testing.assert_allclose(near.sum(axis=1), 1, rtol=1e-12)
            np.testing.assert_allclose(near @ cage.vertices, on + depth * inward, atol=1e-11)
        gaps.append(np.abs(near - at).max())
    assert gaps[0] > gaps[1] > gaps[2]
    assert gaps[2] < 2e-4


def test_they_do_not_depend_on_jobs_and_report_progress():
    points = inside(concave(), 300, margin=0.01)
    calls = []
    one = harmonic_weights(
        concave(), points, jobs=1, progress=lambda *done: calls.append(done)
    ).values
    np.testing.assert_allclose(harmonic_weights(concave(), points, jobs=3).values, one, atol=1e-14)
    assert calls[-1] == (len(points), len(points))
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)


@settings(max_examples=10)
@given(st.integers(0, 1000), st.floats(1e-3, 1e3))
def test_similar_cages_have_the_same_weights_and_permuted_vertices_permuted_ones(seed, scale):
    cage, points = concave(), inside(concave(), 20, margin=0.03)
    turn, order = rotation(seed), np.random.default_rng(seed).permutation(len(cage.vertices))
    moved = TriMesh(scale * (cage.vertices @ turn.T)[order] + 3, np.argsort(order)[cage.faces])
    weights = harmonic_weights(moved, scale * points @ turn.T + 3).values
    # The panels are the same; rounding of the input grows with the offset over the scale.
    tolerance = 1e-11 * max(1, 1 / scale)
    np.testing.assert_allclose(
        weights, harmonic_weights(cage, points).values[:, order], atol=tolerance
    )


def test_a_cage_that_does_not_fit_memory_is_refused(monkeypatch):
    monkeypatch.setattr(harmonic, "PANEL_LIMIT", 11)
    with pytest.raises(InputError, match="the cage has 12 faces, at most 11"):
        harmonic_weights(box(), np.zeros((1, 3)))


def test_divided_keeps_surface_and_hats():
    mesh = concave()
    fine, hats = divided(mesh, 500)
    assert len(fine.faces) == 16 * len(mesh.faces)
    assert fine.is_closed
    assert fine.volume == pytest.approx(mesh.volume, rel=1e-14)
    np.testing.assert_allclose(hats @ mesh.vertices, fine.vertices, atol=1e-15)
    np.testing.assert_allclose(hats.sum(axis=1), 1, rtol=1e-15)


@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_near_edges_and_corners_rows_sum_to_one_still(depth):
    """There the single solid angles are ill-conditioned; their sum, and so the rows', is not."""
    cage = ball(1, 1.0)
    corner = cage.vertices[cage.faces]
    on = np.concatenate([corner.reshape(-1, 3), (corner[:, 0] + corner[:, 1]) / 2])
    on = on + 1e-3 * np.random.default_rng(0).normal(size=on.shape) * depth
    points = on * (1 - depth)
    weights = harmonic_weights(cage, points).values
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(weights @ cage.vertices, points, atol=1e-11)
