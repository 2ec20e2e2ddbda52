"""Harmonic weights against solutions that were found in other ways."""

import itertools

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu

from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.method.weights.harmonic import harmonic_weights
from cageik_cli.method.weights.settings import ACCURACIES
from tests.shapes import ball, box, concave, finer, inside

SOLID_HARMONICS = {
    "xy": lambda x, y, z: x * y,
    "2z² − x² − y²": lambda x, y, z: 2 * z**2 - x**2 - y**2,
    "xyz": lambda x, y, z: x * y * z,
    "z(2z² − 3x² − 3y²)": lambda x, y, z: z * (2 * z**2 - 3 * x**2 - 3 * y**2),
    "x³ − 3xy²": lambda x, y, z: x**3 - 3 * x * y**2,
}
"""r^l Y_lm of degrees two and three: what the sphere's series makes of Y_lm on the unit sphere."""

SEPARABLE = {
    "sin sin sinh": lambda x, y, z: np.sin(x + 1) * np.sin(2 * y) * np.sinh(5**0.5 * z),
    "cos exp": lambda x, y, z: np.cos(2 * x) * np.exp(2 * y) + 0 * z,
}


def errors_of(functions, cages, points):
    """Largest error at `points` of each function from its values at each cage's vertices."""
    errors = []
    for cage in cages:
        weights = harmonic_weights(cage, points).values
        errors.append(
            [
                np.abs(weights @ function(*cage.vertices.T) - function(*points.T)).max()
                for function in functions.values()
            ]
        )
    return np.array(errors)


def rates(errors):
    """Orders of convergence, where the spacing is halved every time."""
    return -np.diff(np.log2(errors), axis=0)


def test_weights_in_a_sphere_converge_to_solid_harmonics():
    """Inscribed flat faces and linear interpolation both leave errors of second order."""
    errors = errors_of(
        SOLID_HARMONICS, [ball(k, 1.0) for k in (1, 2, 3)], 0.6 * ball(3, 1.0).vertices[::7]
    )
    np.testing.assert_allclose(rates(errors)[-1], 2, rtol=0, atol=0.15)
    assert errors[-1].max() < 0.008


@pytest.mark.slow
def test_weights_in_a_box_converge_to_harmonic_functions():
    points = inside(box(), 40, margin=0.1)
    functions = SOLID_HARMONICS | SEPARABLE
    errors = errors_of(functions, [finer(box(), k) for k in (1, 2, 3)], points)
    np.testing.assert_allclose(rates(errors)[-1], 2, rtol=0, atol=0.15)
    on = finer(box(), 3).vertices.T
    sizes = [np.abs(function(*on)).max() for function in functions.values()]
    assert (errors[-1] < 0.015 * np.array(sizes)).all()


@pytest.mark.parametrize("accuracy", ["preview", "standard"])
def test_a_cage_with_divided_faces_has_the_same_basis_functions(accuracy):
    """Basis functions of the coarse cage are sums of those of the divided one; so are weights."""
    cage, points = concave(), inside(concave(), 50, margin=0.03)
    coarse = harmonic_weights(cage, points, accuracy=accuracy).values
    divided = finer(cage, 2)
    basis_functions = closest_points(cage, divided.vertices).barycentric_weights(
        np.ones(len(divided.vertices), bool)
    )
    summed = harmonic_weights(divided, points, accuracy=accuracy).values @ basis_functions
    assert np.abs(coarse - summed).sum(axis=1).mean() < 2 * ACCURACIES[accuracy].tolerance


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cage", "size", "least", "bound"),
    [(box(), 2, 2, 0.004), (concave(), 1, 4 / 3, 0.005)],
    ids=["box", "concave"],
)
def test_linear_finite_elements_converge_to_the_weights(cage, size, least, bound):
    """In second order in a box; an edge of 3π/2 takes that down, in the end to twice 2/3.

    (Schatz and Wahlbin 1978.) The order is that of the finite elements: the boundary elements are
    far more exact, 6e-5 from weights of four times the unknowns here.
    """
    grids = [Grid(cage, size / count) for count in (4, 8, 16)]
    points = grids[0].nodes[closest_points(cage, grids[0].nodes).distance > 0.1]
    weights = harmonic_weights(cage, points, accuracy="fine").values
    errors = [np.abs(grid.at(points) - weights).sum(axis=1).mean() for grid in grids]
    largest = [np.abs(grid.at(points) - weights).max() for grid in grids]
    assert least - 0.1 < rates(largest).min()
    assert rates(largest).max() < 2.1
    assert rates(errors).min() > least - 0.1
    assert errors[-1] < bound


class Grid:
    """Linear finite elements on a mesh of cubes, each parted into six tetrahedra (Kuhn's).

    Attributes
    ----------
    nodes : (k, 3)
    values : (k, n)
        The discrete harmonic extension of each of the cage's basis functions.
    """

    def __init__(self, cage, spacing):
        low, high = cage.vertices.min(axis=0), cage.vertices.max(axis=0)
        counts = np.rint((high - low) / spacing).astype(int)
        cubes = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, 3)
        cubes = cubes[winding_numbers(cage, low + spacing * (cubes + 0.5)) > 0.5]
        paths = [
            np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(order)]], axis=0)
            for order in itertools.permutations(range(3))
        ]
        corners = (cubes[:, None, None] + np.array(paths)).reshape(-1, 3)
        places, index = np.unique(corners, axis=0, return_inverse=True)
        self.nodes = low + spacing * places
        stiffness = _stiffness(self.nodes, index.reshape(-1, 4))
        nearest = closest_points(cage, self.nodes)
        fixed = nearest.distance < 1e-9
        self.values = np.empty((len(self.nodes), len(cage.vertices)))
        self.values[fixed] = nearest.barycentric_weights(fixed)
        rest = stiffness[~fixed]
        load = rest[:, fixed] @ self.values[fixed]
        factor = splu(
            rest[:, ~fixed].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0,
            options={"SymmetricMode": True},
        )
        self.values[~fixed] = -factor.solve(load)

    def at(self, points):
        """The extensions at those nodes."""
        distance = np.abs(self.nodes[None] - points[:, None]).max(axis=2)
        assert distance.min(axis=1).max() < 1e-12
        return self.values[distance.argmin(axis=1)]


def _stiffness(nodes, tetrahedra):
    """∫ ∇φ_i · ∇φ_j, (k, k)."""
    corner = nodes[tetrahedra]
    sides = corner[:, 1:] - corner[:, :1]
    gradients = np.linalg.inv(sides).swapaxes(1, 2)
    gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)
    volumes = np.abs(np.linalg.det(sides)) / 6
    blocks = np.einsum("t,tix,tjx->tij", volumes, gradients, gradients)
    rows, columns = np.broadcast_arrays(tetrahedra[:, :, None], tetrahedra[:, None])
    shape = (len(nodes), len(nodes))
    return sparse.csr_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
