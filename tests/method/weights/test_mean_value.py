import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import SURFACE_ROUNDING_TOL, closest_points, winding_numbers
from cageik_cli.method.weights import mean_value
from cageik_cli.method.weights.mean_value import mean_value_weights
from tests.shapes import TETRAHEDRON, ball, box, concave, inside, octahedron, rotation

CAGES = {"box": box(), "concave": concave(), "ball": ball(1, 1.0)}


def flattened(mesh, share):
    return TriMesh(mesh.vertices * [1, 1, share], mesh.faces)


def with_needles(altitude):
    """A box, one face of it parted at a point that near the middle of its longest side."""
    mesh = box()
    a, b, c = mesh.vertices[mesh.faces[0]]
    sides = [np.linalg.norm(b - c), np.linalg.norm(c - a), np.linalg.norm(a - b)]
    corner = mesh.faces[0][int(np.argmax(sides))]
    first, last = mesh.faces[0][mesh.faces[0] != corner]
    middle = mesh.vertices[[first, last]].mean(axis=0)
    inward = mesh.vertices[corner] - middle
    tip = middle + altitude * inward / np.linalg.norm(inward)
    new = [[i, j, 8] for i, j in zip(mesh.faces[0], np.roll(mesh.faces[0], -1), strict=True)]
    return TriMesh(np.vstack([mesh.vertices, tip]), np.concatenate([mesh.faces[1:], new]))


HARD = CAGES | {
    "thin": flattened(ball(1, 1.0), 0.01),
    "needles": with_needles(1e-4),
    "thinner needles": with_needles(1e-7),
    "far": TriMesh(concave().vertices @ rotation(3).T + 1e4, concave().faces),
}


def assert_exact(cage, points, weights):
    """Rows sum to one and give the points; from the cage's middle, to round as little as can be."""
    origin = cage.vertices.mean(axis=0)
    assert np.isfinite(weights).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-14)
    found = weights @ (cage.vertices - origin)
    on = closest_points(cage, points).is_touching  # but for rounding of the coordinates
    allowed = np.where(
        on, SURFACE_ROUNDING_TOL * np.abs(cage.vertices).max(), 2e-15 * cage.diagonal
    )
    assert (np.abs(found - (points - origin)) <= allowed[:, None]).all()


def near_surface(cage, depth, seed=0):
    """Points inside, `depth` diagonals from places on faces, on edges and at corners."""
    generator = np.random.default_rng(seed)
    share = generator.uniform(size=(len(cage.edges.ends), 1))
    start, stop = cage.vertices[cage.edges.ends].swapaxes(0, 1)
    barycentric = generator.dirichlet(np.ones(3), len(cage.faces))
    on = np.concatenate(
        [
            np.einsum("fk,fkx->fx", barycentric, cage.vertices[cage.faces]),
            share * start + (1 - share) * stop,
            cage.vertices,
        ]
    )
    on = np.repeat(on, 4, axis=0)
    away = generator.normal(size=on.shape)
    points = on + depth * cage.diagonal * away / np.linalg.norm(away, axis=1)[:, None]
    off = closest_points(cage, points).distance > 2e-12 * cage.diagonal
    return points[off & (winding_numbers(cage, points) > 0.5)]


def in_planes(cage, height, seed=0):
    """Points inside, `height` diagonals behind the plane of a face that may be far away."""
    points = inside(cage, 200, seed)
    chosen = np.random.default_rng(seed).integers(len(cage.faces), size=len(points))
    a, b, c = cage.vertices[cage.faces[chosen]].swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    step = np.einsum("ix,ix->i", a - points, normal) - height * cage.diagonal
    points = points + step[:, None] * normal
    off = closest_points(cage, points).distance > 1e-3 * cage.diagonal
    return points[off & (winding_numbers(cage, points) > 0.5)]


def by_quadrature(cage, point, order):
    """The definition summed over directions: every ray is met with every face, one by one.

    Directions are those to the places of product rules on the six sides of a cube about the point.
    """
    x, w = leggauss(order)
    u, v = (a.ravel() for a in np.meshgrid(x, x))
    area = np.outer(w, w).ravel() / (1 + u**2 + v**2) ** 1.5
    sums = np.zeros(len(cage.vertices))
    for axis in range(3):
        for sign in (-1, 1):
            rays = np.roll(np.column_stack([np.full(len(u), sign), u, v]), axis, axis=1)
            rays /= np.linalg.norm(rays, axis=1)[:, None]
            for face in cage.faces:
                corner = cage.vertices[face] - point
                shares = rays @ np.linalg.inv(corner)  # the ray as a sum of the corners
                hit = (shares >= 0).all(axis=1)
                # It meets the face at r = 1 / Σ shares, and φ / r there are the shares.
                sums[face] += np.sign(np.linalg.det(corner)) * (area[hit] @ shares[hit])
    return sums / sums.sum()


def test_weights_are_in_closed_form():
    found = mean_value_weights(box(), np.zeros((1, 3)))
    assert (found.panels, found.error) == (0, 0.0)


def test_weights_in_a_tetrahedron_are_barycentric():
    points = np.concatenate(
        [inside(TETRAHEDRON, 200, margin=1e-4), near_surface(TETRAHEDRON, 1e-8)]
    )
    expected = np.column_stack([1 - points.sum(axis=1), points])
    np.testing.assert_allclose(
        mean_value_weights(TETRAHEDRON, points).values, expected, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("cage", [box(), concave()], ids=["box", "concave"])
def test_weights_equal_the_integrals_of_the_definition(cage):
    """A jump at every edge leaves plain quadrature an error of the order of its spacing."""
    points = inside(cage, 3, margin=0.08)
    found = mean_value_weights(cage, points).values
    errors = [
        max(
            np.abs(by_quadrature(cage, p, order) - w).max()
            for p, w in zip(points, found, strict=True)
        )
        for order in (10, 160)
    ]
    assert errors[0] > 8 * errors[1]
    assert errors[1] < 3e-4


def test_weights_equal_the_formula_of_the_paper():
    """Figure 4 of Ju, Schaefer and Warren, where its quotients are far from 0/0."""
    cage = concave()
    points = inside(cage, 40, margin=0.05)
    corner = cage.vertices[cage.faces][:, None] - points[:, None]
    r = np.linalg.norm(corner, axis=3)
    u = corner / r[..., None]
    chord = np.linalg.norm(np.roll(u, -1, axis=2) - np.roll(u, -2, axis=2), axis=3)
    theta = 2 * np.arcsin(chord / 2)
    half = theta.sum(axis=2, keepdims=True) / 2
    nxt, prv = np.roll(theta, -1, axis=2), np.roll(theta, -2, axis=2)
    cosine = 2 * np.sin(half) * np.sin(half - theta) / (np.sin(nxt) * np.sin(prv)) - 1
    sine = np.sign(np.linalg.det(u))[..., None] * np.sqrt(1 - cosine**2)
    cosine_next, cosine_prv = np.roll(cosine, -1, axis=2), np.roll(cosine, -2, axis=2)
    weights = theta - cosine_next * prv - cosine_prv * nxt
    weights /= r * np.sin(nxt) * np.roll(sine, -2, axis=2)
    expected = np.zeros((len(points), len(cage.vertices)))
    np.add.at(expected.T, cage.faces.T, weights.transpose(2, 0, 1))
    expected /= expected.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(mean_value_weights(cage, points).values, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("cage", [box(), ball(1, 1.0), flattened(box(), 0.01)])
def test_weights_in_convex_cages_are_positive(cage):
    points = [inside(cage, 300, margin=1e-4), *(near_surface(cage, 10.0**-k) for k in (3, 6, 10))]
    assert mean_value_weights(cage, np.concatenate(points)).values.min() > 0


def test_some_weights_behind_a_concave_edge_are_negative():
    assert mean_value_weights(concave(), inside(concave(), 100)).values.min() < -1e-3


@pytest.mark.parametrize("depth", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
def test_weights_converge_to_the_hats_at_the_surface(depth):
    """Their slopes have a logarithm at edges; towards the surface |w − φ| is of order δ log δ."""
    cage = concave()
    points = near_surface(cage, depth)
    nearest = closest_points(cage, points)
    basis_functions = nearest.barycentric_weights(np.ones(len(points), bool))
    gap = np.abs(mean_value_weights(cage, points).values - basis_functions).max()
    assert gap < 3 * depth * -np.log(depth)


@pytest.mark.parametrize("cage", HARD.values(), ids=HARD.keys())
@pytest.mark.parametrize("depth", [1e-3, 1e-5, 1e-7, 1e-9, 1e-10])
def test_weights_near_faces_edges_and_corners_are_exact(cage, depth):
    points = near_surface(cage, depth)
    assert len(points) > 10
    assert_exact(cage, points, mean_value_weights(cage, points).values)


@pytest.mark.parametrize("cage", HARD.values(), ids=HARD.keys())
@pytest.mark.parametrize("height", [0, 1e-14, 1e-10, 1e-6, 1e-3])
def test_weights_near_the_planes_of_faces_are_exact(cage, height):
    points = np.concatenate([in_planes(cage, height), inside(cage, 5, margin=1e-3)])
    assert_exact(cage, points, mean_value_weights(cage, points).values)


def test_weights_are_smooth_across_a_plane():
    """On a line through the planes of both inner walls; a fourth difference finds any jump."""
    step = 1e-3
    share = np.arange(0, 1, step)[:, None]
    points = (1 - share) * np.array([1.2, 0.7, 0.4]) + share * np.array([0.7, 1.2, 0.5])
    assert (points[0, :2] > 1).tolist() == (points[-1, :2] < 1).tolist() == [True, False]
    weights = mean_value_weights(concave(), points).values
    assert np.abs(np.diff(weights, 4, axis=0)).max() < 3000 * step**4


@pytest.mark.parametrize("height", [1e-4, 1e-8, 1e-12])
def test_weights_next_to_a_plane_are_linear_in_the_distance(height):
    """No digit is lost there: the second difference across the plane is that of a smooth function.

    Written as quotients, weights have an error of rounding over the height.
    """
    cage, away = concave(), np.array([[1.0, 0, 0]])
    plane = np.array([[1.0, 0.3, 0.4], [1.0, 0.8, 0.7], [1.0, 0.5, 0.001]])
    below, at, above = (
        mean_value_weights(cage, plane + k * height * away).values for k in (-1, 0, 1)
    )
    np.testing.assert_allclose(above - 2 * at + below, 0, rtol=0, atol=30 * height**2 + 3e-15)


@pytest.mark.parametrize("flat", [0.01, 0.1, 2.0])
def test_both_formulas_of_the_total_of_a_face_agree(monkeypatch, flat):
    cage, points = ball(1, 1.0), inside(ball(1, 1.0), 300)
    expected = mean_value_weights(cage, points).values
    monkeypatch.setattr(mean_value, "MAX_EDGE_ON_RATIO", flat)
    np.testing.assert_allclose(
        mean_value_weights(cage, points).values, expected, rtol=0, atol=2e-14
    )


@pytest.mark.parametrize("square", [1e-3, 2e-3, 5e-3])
def test_both_formulas_of_the_strength_of_a_side_agree(monkeypatch, square):
    points = np.concatenate([in_planes(concave(), 1e-9), in_planes(concave(), 1e-3)])
    expected = mean_value_weights(concave(), points).values
    monkeypatch.setattr(mean_value, "MAX_SERIES_SQUARE", square)
    np.testing.assert_allclose(
        mean_value_weights(concave(), points).values, expected, rtol=0, atol=1e-13
    )


def test_weights_in_the_middle_of_a_symmetric_cage_are_equal():
    found = mean_value_weights(octahedron(), np.zeros((1, 3))).values
    np.testing.assert_allclose(found, 1 / 6, rtol=1e-15)


def test_a_mirrored_point_has_mirrored_weights():
    cage, points = octahedron(), inside(octahedron(), 50)
    mirrored = np.array([1, 0, 2, 3, 4, 5])
    found = mean_value_weights(cage, points * [-1, 1, 1]).values
    np.testing.assert_allclose(
        found, mean_value_weights(cage, points).values[:, mirrored], rtol=0, atol=1e-15
    )
