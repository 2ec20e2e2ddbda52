"""Three hundred random cages: what holds for all coordinates holds in all of them."""

import numpy as np
import pytest
import trimesh

from cageik_cli.cages.bind import bind
from cageik_cli.cages.check.faults import validate_cage
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.method.weights import harmonic
from cageik_cli.method.weights.settings import ACCURACIES, COORDINATES, BindSettings
from cageik_cli.util.errors import CageikError, InputError, NumericalError
from tests.method.weights.random_cages import KINDS, kind_of, points_within, random_cage
from tests.shapes import box

SEEDS = range(50)

MARKED_SEEDS = [
    *SEEDS[: len(KINDS)],
    *(pytest.param(seed, marks=pytest.mark.slow) for seed in SEEDS[len(KINDS) :]),
    *(pytest.param(seed, marks=pytest.mark.fuzz) for seed in range(50, 300)),
]


def crossings(mesh):
    """How many pairs of an edge and a face apart from it cut each other."""
    start, stop = mesh.vertices[mesh.edges.ends].swapaxes(0, 1)[:, :, None]
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)[:, None]

    def turn(p, q, r, s):
        volume = np.einsum("...x,...x->...", np.cross(q - p, r - p), s - p)
        return np.where(np.abs(volume) < 1e-12 * mesh.diagonal**3, 0, np.sign(volume))

    apart = (mesh.edges.ends[:, None, :, None] != mesh.faces[None, :, None]).all(axis=(2, 3))
    parted = turn(a, b, c, start) * turn(a, b, c, stop) < 0
    around = sum(turn(start, stop, p, q) for p, q in ((a, b), (b, c), (c, a)))
    return np.count_nonzero(apart & parted & (np.abs(around) == 3))


def assert_exact_or_refused(cage, points, coordinates):
    """Weights with sums and affine maps to rounding; or an error that says what to do."""
    faces = np.arange(3 * (len(points) // 3)).reshape(-1, 3)
    settings = BindSettings(coordinates=coordinates)
    try:
        weights = bind(TriMesh(points, faces), cage, settings).weights
    except CageikError as error:
        assert_sentence(error)
        return False
    origin = cage.vertices.mean(axis=0)
    assert np.isfinite(weights).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
    found = weights @ (cage.vertices - origin)
    np.testing.assert_allclose(found, points - origin, rtol=0, atol=1e-11 * cage.diagonal)
    return True


def assert_sentence(error):
    """One line, of what was found and, after a semicolon or a colon, what to do."""
    text = str(error)
    assert isinstance(error, InputError | NumericalError)
    assert "\n" not in text
    assert not text.endswith((".", "!"))
    assert not text[0].isupper()
    assert ";" in text or ": " in text


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("seed", MARKED_SEEDS)
def test_weights_of_any_clean_cage_are_exact(seed, coordinates, monkeypatch):
    """Most in haste, panels divided once; every eleventh, of all kinds, as is done by default."""
    if seed % 11 != 1:
        monkeypatch.setitem(ACCURACIES, "standard", ACCURACIES["preview"])
        monkeypatch.setattr(harmonic, "MAX_REFINEMENTS", 1)
    cage = random_cage(seed)
    bound = assert_exact_or_refused(cage, points_within(cage, seed), coordinates)
    # Linear densities on the faces of the thinnest cages are worth nothing, and said to be.
    assert bound or (coordinates, kind_of(seed)) == ("harmonic", "thin")


@pytest.mark.slow
def test_the_cages_are_clean_and_the_points_inside():
    sizes = set()
    for seed in SEEDS:
        cage = random_cage(seed)
        assert validate_cage(cage) == (cage, ())
        assert trimesh.Trimesh(cage.vertices, cage.faces, process=False).is_volume
        assert crossings(cage) == 0
        sizes.add(len(cage.faces))
        points = points_within(cage, seed)
        distance = closest_points(cage, points).distance / cage.diagonal
        assert (winding_numbers(cage, points) > 0.5).all()
        assert len(points) >= 15
        assert distance.min() < 1e-7 < 1e-3 < distance.max()
    assert min(sizes) >= 20
    assert max(sizes) <= 90
    assert len({str(random_cage(seed).vertices) for seed in SEEDS}) == len(SEEDS)


def test_a_cage_that_crosses_itself_is_detected():
    vertices = box().vertices.copy()
    assert crossings(box()) == 0
    vertices[0] = [3.0, 0.1, 0.2]
    assert crossings(TriMesh(vertices, box().faces)) > 0


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("seed", range(len(KINDS)))
def test_the_refusal_of_a_broken_cage_is_a_sentence(seed, coordinates):
    cage = random_cage(seed)
    points = points_within(cage, seed)
    opened = TriMesh(cage.vertices, cage.faces[1:])
    assert not assert_exact_or_refused(opened, points, coordinates)
    beyond = points + 2 * np.ptp(cage.vertices, axis=0)
    assert not assert_exact_or_refused(cage, beyond, coordinates)
