from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.points.field import HarmonicField
from cageik_cli.method.weights import harmonic
from cageik_cli.method.weights.bem.boundary_equation import (
    interior_weights,
    rounded_interior_weights,
    solve_boundary,
)
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.harmonic import (
    STEADY_SHARE,
    Accuracy,
    HarmonicSolution,
    harmonic_weights,
    measure_surface_error,
)
from cageik_cli.method.weights.settings import ACCURACIES
from cageik_cli.util.errors import CageError, SettingError
from tests.benchmarks.walked_cages import make_cages
from tests.shapes import TETRAHEDRON, ball, box, concave, finer, inside, moved, rotation


@pytest.mark.usefixtures("core")
def test_weights_in_a_tetrahedron_are_barycentric():
    points = inside(TETRAHEDRON, 200, margin=0.01)
    expected = np.column_stack([1 - points.sum(axis=1), points])
    np.testing.assert_allclose(
        harmonic_weights(TETRAHEDRON, points).values, expected, rtol=0, atol=1e-13
    )


def assert_exact(weights, cage, points, sums=1e-12, maps=1e-11):
    """Rows sum to one and affine maps are reproduced, measured from the middle of the cage."""
    middle = cage.vertices.mean(axis=0)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=0, atol=sums)
    found = weights @ (cage.vertices - middle)
    np.testing.assert_allclose(found, points - middle, rtol=0, atol=maps * cage.diagonal)


@pytest.mark.parametrize(
    "accuracy", ["preview", "standard", pytest.param("fine", marks=pytest.mark.slow)]
)
def test_far_from_the_origin_only_the_digits_of_the_input_are_lost(accuracy):
    """The equations are solved in single precision: weights may differ in the seventh digit."""
    cage, shift = ball(1, 1.0), 1e4
    points = inside(cage, 50)
    far, there = TriMesh(cage.vertices + shift, cage.faces), points + shift
    moved = harmonic_weights(far, there, accuracy).values
    assert_exact(moved, far, there)
    here = harmonic_weights(cage, points, accuracy).values
    np.testing.assert_allclose(moved, here, rtol=0, atol=1e-7)


def raised(mesh, order, reach=3.0):
    """The mesh with densities of one degree, or of one for each panel; the reach is in radii."""
    if np.max(order) == 1:
        return mesh
    everywhere = np.arange(len(mesh.panels.corners))
    degrees = np.broadcast_to(order, everywhere.shape)
    return mesh.raise_order(everywhere, degrees, reach * mesh.panels.radii)


def solve(mesh):
    with ThreadPoolExecutor(1) as pool:
        return solve_boundary(mesh, pool)


def weights_on(cage, points, levels, order):
    """Weights with every face divided `levels` times and densities of one degree throughout."""
    mesh = BoundaryMesh.from_cage(cage)
    for _ in range(levels):
        mesh = mesh.divide(np.ones(len(mesh.panels.corners), bool))
    return interior_weights(solve(raised(mesh, order)), points)


def mean_row_distance(weights, exact):
    return np.abs(weights - exact).sum(axis=1).mean()


@pytest.mark.slow
def test_weights_converge_as_panels_are_divided():
    """Halved panels gain more than the first order that the edges' singularities leave."""
    points = inside(concave(), 60, margin=0.03)
    exact = weights_on(concave(), points, 2, 3)
    errors = [mean_row_distance(weights_on(concave(), points, k, 1), exact) for k in range(3)]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (slopes > 1.2).all()
    assert errors[-1] < 4e-3


@pytest.mark.slow
def test_weights_converge_as_the_degree_is_raised():
    """About geometrically: every degree takes a share of the error."""
    points = inside(ball(1, 1.0), 60, margin=0.03)
    exact = weights_on(ball(1, 1.0), points, 1, 5)
    errors = [mean_row_distance(weights_on(ball(1, 1.0), points, 0, k), exact) for k in range(1, 5)]
    assert (np.array(errors[1:]) < 0.75 * np.array(errors[:-1])).all()
    assert errors[-1] < 0.1 * errors[0]


@pytest.fixture(scope="module")
def resolved():
    """Points in a cage with a concave edge, and weights from far more unknowns than are asked."""
    points = inside(concave(), 100, margin=0.01)
    return points, weights_on(concave(), points, 2, 3)


def test_smallest_weight_is_zero_but_for_the_discretisation(resolved):
    """The exact weights are not negative: what is, must vanish as panels are resolved."""
    points, exact = resolved
    assert weights_on(concave(), points, 0, 1).min() < -1e-3
    assert exact.min() > -1e-4


@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_each_accuracy_keeps_its_tolerance_with_a_close_estimate(resolved, accuracy):
    points, exact = resolved
    found = harmonic_weights(concave(), points, accuracy)
    error = mean_row_distance(found.values, exact)
    assert found.error <= ACCURACIES[accuracy].tolerance
    assert error <= ACCURACIES[accuracy].tolerance
    assert error / 4 < found.error < 4 * error


@pytest.mark.slow
def test_panels_are_divided_where_the_error_is_large(monkeypatch):
    """Near a corner of a coarse cage; panels far from every point stay as they are."""
    cage = ball(2, 1.0)
    points = cage.vertices[:1] * np.linspace(0.9, 0.999, 50)[:, None]
    monkeypatch.setitem(ACCURACIES, "standard", Accuracy(2e-3, 1, 0.0, 7200))
    once = harmonic_weights(cage, points)
    assert once.panels > len(cage.faces)
    monkeypatch.setattr(harmonic, "MAX_REFINEMENTS", 0)
    never = harmonic_weights(cage, points)
    assert never.panels == len(cage.faces)
    assert never.error > 2e-3
    exact = weights_on(cage, points, 0, 5)
    assert mean_row_distance(once.values, exact) < mean_row_distance(never.values, exact) / 1.5


@pytest.mark.usefixtures("core")
def test_unknowns_are_bounded_by_lower_degrees(monkeypatch):
    cage, points = ball(2, 1.0), inside(ball(2, 1.0), 200, margin=0.01)
    tree, seen = points / cage.diagonal, []
    unit = TriMesh(cage.vertices / cage.diagonal, cage.faces)
    for most in (10_000, 1000, 500, 0):
        mesh = harmonic._raise_order(
            BoundaryMesh.from_cage(unit), tree, Accuracy(0.0, 3, 1.5, most)
        )
        assert mesh.unknowns <= max(most, 3 * len(cage.faces))
        seen.append((mesh.order, len(mesh.high_panels)))
    assert seen[0] == (3, 128)
    assert seen[1][0] == 2
    assert 0 < seen[2][1] < seen[1][1]
    assert seen[3][1] == 0


def test_needles_have_lower_degrees():
    """Higher terms are unstable at distances of their length; those of extreme ones all are."""
    for thickness, degree in ((0.1, 4), (0.05, 3), (0.002, 1)):
        flat = TriMesh(box().vertices * [1, 1, thickness], box().faces)
        points = inside(flat, 50, margin=0.1 * thickness)
        mesh = harmonic._raise_order(BoundaryMesh.from_cage(flat), points, ACCURACIES["fine"])
        slender = mesh.panels.altitudes.min(axis=0) < 0.2 * mesh.panels.radii
        assert slender.sum() == 8
        assert (mesh.panel_degrees[slender] == degree).all()
        assert (mesh.panel_degrees[~slender] == 5).all()


@pytest.mark.parametrize("length", [1.0, 3.0, 8.0, 20.0, 50.0])
def test_no_panel_has_a_lower_degree_or_reach_for_a_smaller_tolerance(length):
    cage = TriMesh(box().vertices * [1, 0.7, length], box().faces)
    panels = BoundaryMesh.from_cage(cage).panels
    degree, reach = harmonic._choose_degrees(panels, 3, ACCURACIES["standard"].reach)
    finer_degree, finer_reach = harmonic._choose_degrees(panels, 5, ACCURACIES["fine"].reach)
    assert (finer_degree >= degree).all()
    assert (finer_reach >= reach).all()


@pytest.mark.usefixtures("core")
def test_terms_above_the_degree_of_a_panel_are_left_out():
    """What is left is a mesh of degree 3, but for the nodes on which its equations are tested."""
    cage, points = concave(), inside(concave(), 40, margin=0.03)
    linear = BoundaryMesh.from_cage(cage)
    plain = raised(linear, 3)
    wide = replace(plain, order=5)
    assert wide.unknowns > len(wide.solved_unknowns) == plain.unknowns
    mixed = raised(linear, np.where(np.arange(len(cage.faces)) == 4, 5, 3))
    of_plain, of_wide, of_mixed = (
        interior_weights(solve(mesh), points) for mesh in (plain, wide, mixed)
    )
    np.testing.assert_allclose(of_wide, of_plain, rtol=0, atol=1e-3)
    assert 1e-5 < np.abs(of_mixed - of_plain).max() < 0.02
    np.testing.assert_allclose(of_mixed @ cage.vertices, points, rtol=0, atol=1e-10)


def test_the_weights_of_a_point_do_not_depend_on_other_points():
    """Blocks share what is near; what fades out does so by each point's own distance."""
    cage, points = ball(2, 1.0), inside(ball(2, 1.0), 100, margin=0.01)
    boundary = solve(raised(BoundaryMesh.from_cage(cage), 3, reach=1.5))
    alone = [interior_weights(boundary, point[None])[0] for point in points]
    np.testing.assert_allclose(interior_weights(boundary, points), alone, rtol=0, atol=1e-13)


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("margin", [1e-6, 0.03])
def test_a_product_in_single_precision_changes_the_seventh_digit(order, margin):
    """Sums and affine maps stay exact to the rounding of double precision."""
    cage, points = concave(), inside(concave(), 200, margin=margin)
    boundary = solve(raised(BoundaryMesh.from_cage(cage), order))
    exact = interior_weights(boundary, points)
    found = rounded_interior_weights(boundary, points)
    assert 0 < np.abs(found - exact).sum(axis=1).max() < 2e-6
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found @ cage.vertices, points, rtol=0, atol=1e-13)
    uncorrected = interior_weights(replace(boundary, densities=boundary.rounded_densities), points)
    assert np.abs(uncorrected @ cage.vertices - points).max() > 1e-10


@pytest.mark.slow
def test_weights_near_the_surface_approach_barycentric_ones():
    """The equations hold in the mean, so that a gap of the size of the error is left."""
    cage = concave()
    on = cage.vertices[cage.faces].mean(axis=1)
    inward = -np.cross(*(cage.vertices[cage.faces[:, k]] - on for k in (0, 1)))
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    at = harmonic_weights(cage, on).values
    gaps = []
    for levels, order in ((0, 1), (1, 3), (2, 3)):
        for depth in (1e-6, 1e-9, 1e-11):
            near = weights_on(cage, on + depth * inward, levels, order)
            np.testing.assert_allclose(near.sum(axis=1), 1, rtol=1e-12)
            np.testing.assert_allclose(
                near @ cage.vertices, on + depth * inward, rtol=0, atol=1e-11
            )
        gaps.append(np.abs(near - at).max())
    assert gaps[0] > gaps[1] > gaps[2]
    assert gaps[2] < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("depth", [1e-5, 1e-2])
def test_near_edges_the_estimate_is_the_residual_of_the_equations(depth):
    """There a series of degrees does not see the density's logarithms."""
    cage = ball(1, 1.0)
    points = cage.vertices[cage.edges.ends].mean(axis=1)[::2] * (1 - depth)
    found = harmonic_weights(cage, points)
    error = mean_row_distance(found.values, weights_on(cage, points, 2, 3))
    assert found.error > error / 3


@pytest.mark.slow
def test_the_estimate_is_within_twice_the_error_where_a_series_of_degrees_is_not():
    """The error on the cage does not all change its sign within a panel, and reaches inside."""
    cage, model = make_cages()["star"]
    points = model.vertices[::8]
    found = harmonic_weights(cage, points)
    error = mean_row_distance(found.values, harmonic_weights(cage, points, "fine").values)
    assert error / 2 < found.error < 2 * error


def test_a_share_of_the_error_on_the_cage_is_in_the_estimate(monkeypatch):
    monkeypatch.setattr(harmonic, "measure_surface_error", lambda *_: 0.5)
    found = harmonic_weights(box(), inside(box(), 20))
    assert found.error == 0.5 * STEADY_SHARE
    assert found.surface_error == 0.5


def test_panels_far_from_the_sample_do_not_change_the_estimate(monkeypatch):
    """One point is near panels of higher order; the points of the sample are far from them."""
    monkeypatch.setattr(harmonic, "MAX_ERROR_SAMPLES", 1)
    monkeypatch.setattr(harmonic, "MIN_PANELS", 192)
    points = np.concatenate([np.zeros((20, 3)), [[0.95, 0.95, 0.95]]])
    found = harmonic_weights(box(), points)
    assert 0 <= found.error < 0.01
    assert found.panels == 192


def test_panels_that_face_a_near_one_have_a_higher_degree_far_from_all_points():
    plate = finer(moved(box(), scale=(8, 1, 0.05)), 2)
    points = np.array([[-7.5, 0, 0]])
    mesh = HarmonicSolution(plate, points, "standard", 1).boundary.mesh
    is_far = mesh.panels.centroids[:, 0] > 0
    faces_another = is_far & (np.abs(mesh.panels.normals[:, 2]) > 0.9)
    assert (mesh.panel_degrees[faces_another] == 3).all()
    apart = HarmonicSolution(moved(plate, scale=(1, 1, 20)), points, "standard", 1).boundary.mesh
    assert (apart.panel_degrees[apart.panels.centroids[:, 0] > 0.3] == 1).all()


@pytest.mark.parametrize("shift", [1e3, 1e5, 1e7])
def test_points_on_a_cage_far_from_the_origin_are_on_it(shift):
    cage = concave()
    far = TriMesh(cage.vertices @ rotation(3).T + shift, cage.faces)
    points = far.vertices[far.faces].mean(axis=1)
    weights = harmonic_weights(far, points).values
    np.testing.assert_allclose(np.sort(weights, axis=1)[:, -3:], 1 / 3, rtol=0, atol=1e-15 * shift)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)


def test_without_a_tolerance_no_face_of_the_cage_is_divided():
    cage, points = finer(concave(), 1), inside(finer(concave(), 1), 100)
    tight, loose = (Accuracy(tolerance, 1, 0.0, 9000) for tolerance in (1e-3, np.inf))
    assert harmonic_weights(cage, points, tight).panels > len(cage.faces)
    assert harmonic_weights(cage, points, loose).panels == len(cage.faces)


def test_an_unknown_accuracy_is_refused():
    with pytest.raises(SettingError, match="accuracy is 'good'"):
        harmonic_weights(box(), np.zeros((1, 3)), "good")


def test_a_cage_with_too_many_faces_is_refused(monkeypatch):
    monkeypatch.setattr(harmonic, "MAX_HARMONIC_FACES", 11)
    with pytest.raises(CageError, match="12 faces, at most 11"):
        harmonic_weights(box(), np.zeros((1, 3)))


@pytest.mark.slow
@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_rows_sum_to_one_near_edges_and_corners(depth):
    """There the single solid angles are ill-conditioned; their sum, and so the rows', is not."""
    cage = ball(1, 1.0)
    corner = cage.vertices[cage.faces]
    on = np.concatenate([corner.reshape(-1, 3), (corner[:, 0] + corner[:, 1]) / 2])
    on = on + 1e-3 * np.random.default_rng(0).normal(size=on.shape) * depth
    points = on * (1 - depth)
    weights = harmonic_weights(cage, points).values
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(weights @ cage.vertices, points, rtol=0, atol=1e-11)


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
