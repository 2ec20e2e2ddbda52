import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.bem.panels import exponents
from tests.shapes import concave


def some(mesh, every=3):
    chosen = np.zeros(len(mesh.panels.corners), bool)
    chosen[::every] = True
    return chosen


@pytest.mark.parametrize("every", [1, 3])
def test_dividing_keeps_the_surface_and_the_hats(every):
    """Also where some panels are divided and others not, twice over."""
    cage = concave()
    mesh = BoundaryMesh.from_cage(cage)
    for _ in range(2):
        mesh = mesh.divide(some(mesh, every))
    panels = mesh.panels
    assert panels.areas.sum() == pytest.approx(
        BoundaryMesh.from_cage(cage).panels.areas.sum(), rel=1e-14
    )
    assert TriMesh(panels.vertices, panels.corners).volume == pytest.approx(cage.volume, rel=1e-13)
    np.testing.assert_allclose(
        mesh.basis_functions.to_matrix() @ cage.vertices, panels.vertices, atol=1e-15
    )
    np.testing.assert_allclose(mesh.basis_functions.values.sum(axis=1), 1, rtol=1e-15)
    np.testing.assert_array_equal(
        mesh.basis_functions.evaluate(panels.corners, np.eye(3)[[2] * len(panels.corners)]),
        mesh.basis_functions.to_matrix().toarray()[panels.corners[:, 2]],
    )


def test_children_take_the_place_of_their_parent():
    mesh = BoundaryMesh.from_cage(concave())
    chosen = some(mesh)
    finer = mesh.divide(chosen)
    parent = np.repeat(np.arange(len(chosen)), np.where(chosen, 4, 1))
    np.testing.assert_allclose(finer.panels.normals, mesh.panels.normals[parent], atol=1e-14)
    sums = np.bincount(parent, finer.panels.areas)
    np.testing.assert_allclose(sums, mesh.panels.areas, rtol=1e-14)


def test_hats_are_interpolated_linearly():
    mesh = BoundaryMesh.from_cage(concave()).divide(some(BoundaryMesh.from_cage(concave())))
    barycentric, chosen = np.array([[0.2, 0.3, 0.5], [1, 0, 0]]), np.array([0, 4, 9])
    corner = mesh.panels.vertices[mesh.panels.corners[chosen]]
    places = np.einsum("jk,ckx->cjx", barycentric, corner)
    values = mesh.evaluate_basis_functions(chosen, barycentric)
    np.testing.assert_allclose(values @ concave().vertices, places, atol=1e-15)
    assert values.min() >= 0


def test_every_unknown_has_one_number_and_a_degree():
    mesh = BoundaryMesh.from_cage(concave())
    high = np.array([1, 4, 7])
    mesh = mesh.raise_order(high, np.full(3, 3), np.ones(3))
    low = np.setdiff1d(np.arange(len(mesh.panels.corners)), high)
    rows = np.concatenate([mesh.panel_unknowns(high).ravel(), mesh.panel_unknowns(low).ravel()])
    np.testing.assert_array_equal(np.sort(rows), np.arange(mesh.unknowns))
    degree, highest, panel = mesh.unknown_degrees
    expected = [a + b for a, b in exponents(3)]
    np.testing.assert_array_equal(degree[mesh.panel_unknowns(high)], [expected] * 3)
    np.testing.assert_array_equal(degree[mesh.panel_unknowns(low)], [expected[:3]] * len(low))
    np.testing.assert_array_equal(
        panel[mesh.panel_unknowns(high)], np.repeat(high[:, None], 10, axis=1)
    )
    assert (highest[mesh.panel_unknowns(high)] == 3).all()
    assert (highest[mesh.panel_unknowns(low)] == 1).all()
