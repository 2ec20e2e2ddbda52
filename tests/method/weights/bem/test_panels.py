import numpy as np
import pytest

from cageik_cli.method.weights.bem.panels import (
    MAX_SERIES_TANGENT,
    Panels,
    PanelView,
    _arctan2,
    monomials,
)
from cageik_cli.util.arrays import Workspace
from tests.shapes import ball, box, concave, inside


def panels_of(mesh):
    return Panels(mesh.vertices, mesh.faces)


def view(panels, points):
    return PanelView(panels, points, Workspace())


def test_linear_moments_equal_quadrature(seen):
    panels, points, _, barycentric, single, _ = seen
    expected = np.einsum("pqg,dg->dpq", single, monomials(1, barycentric))
    np.testing.assert_allclose(
        view(panels, points).linear_moments(), expected, rtol=1e-9, atol=1e-10
    )


def test_the_double_layer_equals_quadrature(seen):
    panels, points, _, barycentric, _, double = seen
    integrals = view(panels, points).double_layer()
    expected = np.einsum("pqg,dg->dpq", double, monomials(1, barycentric))
    np.testing.assert_allclose(integrals, expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("mesh", [box(), concave(), ball(2)], ids=["box", "concave", "ball"])
def test_solid_angles_sum_to_4_pi_inside_and_0_outside(mesh):
    panels, points = panels_of(mesh), inside(mesh, 50)
    angles = view(panels, points).solid_angle.sum(axis=0)
    np.testing.assert_allclose(angles, 4 * np.pi, rtol=1e-13)
    beyond = points + 3 * mesh.diagonal
    angles = view(panels, beyond).solid_angle.sum(axis=0)
    np.testing.assert_allclose(angles, 0, atol=1e-13)


def test_solid_angle_is_positive_behind_the_outward_normal():
    panels = Panels(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    behind, before = np.array([[0.2, 0.2, -0.1]]), np.array([[0.2, 0.2, 0.1]])
    seen_from_behind = view(panels, behind).solid_angle
    assert 0 < seen_from_behind[0, 0] < 2 * np.pi
    np.testing.assert_array_equal(view(panels, before).solid_angle, -seen_from_behind)


def test_points_in_the_plane_of_a_panel_have_no_solid_angle():
    panels = panels_of(box())
    points = np.array([[1.0, 0.3, 0.1], [1.0, 3.0, 0.1]])
    in_plane = np.isclose(panels.normals[:, 0], 1)
    assert in_plane.sum() == 2
    seen = view(panels, points)
    assert abs(seen.solid_angle[in_plane, 0]).max() == pytest.approx(2 * np.pi)
    seen.set_principal_values()
    assert (seen.double_layer()[:, in_plane] == 0).all()


@pytest.mark.parametrize("depth", [1e-3, 1e-6, 1e-9, 1e-12])
def test_beside_an_edge_its_logarithm_is_that_of_the_distance_to_it(depth):
    """f = asinh(s_b/δ) − asinh(s_a/δ) to rounding over δ, though r_a + r_b − L has no digits."""
    panels = panels_of(box())
    along = np.array([0.3, -0.8, 0.99])
    points = np.column_stack([1 - depth * np.ones(3), 1 - 2 * depth * np.ones(3), along])
    looked = view(panels, points)
    ends = panels.vertices[panels.edges.ends]
    edge = np.flatnonzero((ends[:, :, :2] == 1).all(axis=(1, 2)))
    delta = np.hypot(1 - points[:, 0], 1 - points[:, 1])
    expected = np.arcsinh((1 - along) / delta) - np.arcsinh((-1 - along) / delta)
    np.testing.assert_allclose(looked.edge_log[edge[0]], expected, rtol=1e-13, atol=3e-16 / depth)


def test_workspace_arrays_are_allocated_once():
    scratch = Workspace()
    first = scratch.array("a", 4, 5)
    assert scratch.array("a", 2, 5).base is first.base
    assert scratch.array("a", 5, 5).base is not first.base


def test_results_do_not_depend_on_old_workspace_content():
    panels, points = panels_of(concave()), inside(concave(), 6)
    scratch = Workspace()
    fresh = PanelView(panels, points, scratch).linear_moments().copy()
    for array in scratch._arrays.values():
        array[:] = np.nan
    found = PanelView(panels, points, scratch).linear_moments()
    np.testing.assert_array_equal(found, fresh)


@pytest.mark.parametrize("size", [1e-300, 1e-9, MAX_SERIES_TANGENT, 1.0, 1e9, 1e300])
def test_the_short_arctangent_equals_numpy(size):
    y = size * np.linspace(-1.001, 1.001, 51)[None]
    y[0, 25] = 0.0
    for x in (np.ones_like(y), -np.ones_like(y), np.zeros_like(y)):
        found = _arctan2(y, x, Workspace())
        np.testing.assert_allclose(found, np.arctan2(y, x), rtol=4e-16, atol=0)


def test_only_solid_angles_of_points_inside_are_corrected():
    panels = panels_of(box())
    points = np.array([[0.1, 0.2, 0.3], [3.0, 0, 0], [1 - 1e-9, 1 - 1e-9, 0.2]])
    seen = view(panels, points)
    seen.solid_angle[:, 0] *= 1 + 1e-5
    outside = seen.solid_angle[:, 1].copy()
    seen.close_solid_angles()
    np.testing.assert_allclose(seen.solid_angle[:, [0, 2]].sum(axis=0), 4 * np.pi, rtol=1e-15)
    np.testing.assert_array_equal(seen.solid_angle[:, 1], outside)
