import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

from cageik_cli.method.weights.bem.panels import Panels
from tests.shapes import concave, inside


def quadrature(order):
    """Points (barycentric) and weights of a product rule on a triangle of area one."""
    x, w = leggauss(order)
    x, w = (x + 1) / 2, w / 2
    u, v = np.meshgrid(x, x, indexing="ij")
    b, c = u * (1 - v), u * v
    return np.stack([1 - b - c, b, c], -1).reshape(-1, 3), (2 * np.outer(w, w) * u).ravel()


@pytest.fixture(scope="session")
def seen():
    """A surface, points off it, and what plain quadrature makes of every integral."""
    mesh = concave()
    panels = Panels(mesh.vertices, mesh.faces)
    points = np.concatenate(
        [inside(mesh, 5, margin=0.15), [[3.0, 3, 3], [-1, 0.2, 0.4], [0.5, 0.5, 9]]]
    )
    barycentric, weights = quadrature(60)
    corner = panels.vertices[panels.corners]
    places = np.einsum("gk,pkx->pgx", barycentric, corner)
    offset = places[:, None] - points[None, :, None]
    r = np.linalg.norm(offset, axis=-1)
    height = np.einsum("pqgx,px->pqg", offset, panels.normals)
    area = panels.areas[:, None, None] * weights
    return panels, points, places, barycentric, area / r, area * height / r**3
