import numpy as np
import pytest

from cageik_cli.geometry import mirror as module
from cageik_cli.geometry.mirror import PAIR_TOL, Mirror, are_pairs, find_mirror
from cageik_cli.util.errors import HandlesError
from tests.shapes import ball, box, moved, quad_box, rotation


def make_twins(seed: int, on_plane: int = 5) -> np.ndarray:
    """Make points and their mirror images across x = 0, and some on the plane, in any order."""
    generator = np.random.default_rng(seed)
    half, middle = generator.normal(size=(20, 3)), generator.normal(size=(on_plane, 3))
    points = np.concatenate([half, half * [-1, 1, 1], middle * [0, 1, 1]])
    return generator.permutation(points)


def test_two_reflections_are_none():
    mirror, points = Mirror([1.0, 2, -2], [0.3, 0, 1]), np.random.default_rng(0).normal(size=(9, 3))
    images = mirror.reflect(points)
    np.testing.assert_allclose(mirror.reflect(images), points, rtol=0, atol=1e-14)
    heights = [(p - mirror.point) @ mirror.normal for p in (points, images)]
    np.testing.assert_allclose(heights[0], -heights[1], rtol=0, atol=1e-14)


@pytest.mark.parametrize("normal", [[0.0, 0, 0], [np.nan, 0, 1]])
def test_a_plane_without_a_direction_is_refused(normal):
    with pytest.raises(HandlesError, match="normal is"):
        Mirror(normal, [0.0, 0, 0])


def test_a_plane_is_named_by_its_axis_or_by_its_normal():
    assert str(Mirror([0.0, -2, 0], [5.0, 0.25, 1])) == "the plane y = 0.25"
    for tilted in (Mirror([3.0, 4, 0], [0.0, 1, 5]), Mirror([-3.0, -4, 0], [4.0, -2, 0])):
        assert str(tilted) == "the plane through (0.48, 0.64, 0) across (0.6, 0.8, 0)"


def test_partners_are_mirror_images():
    points = make_twins(1)
    partner = Mirror([1.0, 0, 0], [0.0, 0, 0]).find_pairs(points, tolerance=0)
    np.testing.assert_array_equal(points[partner], points * [-1, 1, 1])
    np.testing.assert_array_equal(partner[partner], np.arange(len(points)))


def test_points_that_are_no_pairs_have_no_partners():
    """One point has left; and two points share the image of the third."""
    mirror, points = Mirror([1.0, 0, 0], [0.0, 0, 0]), make_twins(1)
    points[np.abs(points[:, 0]).argmax()] += 2 * PAIR_TOL * np.linalg.norm(np.ptp(points, axis=0))
    assert mirror.find_pairs(points) is None
    assert mirror.find_pairs(np.array([[1.0, 0, 0], [1, 0, 0], [-1, 0, 0]])) is None


@pytest.mark.parametrize("seed", range(4))
def test_a_plane_is_found_wherever_it_is(seed):
    turn, shift = rotation(seed), np.array([3.0, -1, 7])
    points = (make_twins(seed) @ turn.T + shift).astype(np.float32).astype(np.float64)
    mirror = find_mirror(points)
    assert mirror is not None
    assert mirror.find_pairs(points) is not None
    assert abs(mirror.normal @ turn[:, 0]) == pytest.approx(1, abs=1e-6)


def test_of_several_planes_the_first_axis_is_taken():
    mirror = find_mirror(ball(2).vertices)
    assert mirror is not None
    np.testing.assert_array_equal(mirror.normal, [1, 0, 0])


def test_points_without_a_plane_have_none_even_on_a_sphere():
    """All points of a sphere are equally far from its centre: every pair is a candidate."""
    points = np.random.default_rng(2).normal(size=(300, 3))
    assert find_mirror(points) is None
    assert find_mirror(points / np.linalg.norm(points, axis=1)[:, None]) is None


class CountingCells(module._Cells):
    """Counts the planes that all vertices were compared for, and the work of all."""

    planes, made = 0, None

    def __init__(self, *arguments):
        super().__init__(*arguments)
        CountingCells.made = self

    def find_pairs(self, mirror):
        CountingCells.planes += 1
        return super().find_pairs(mirror)


def make_halves(count: int) -> np.ndarray:
    half = np.random.default_rng(0).normal(size=(count // 2, 3)) * [1, 2, 0.7]
    half[:, 0] = np.abs(half[:, 0]) + 0.1
    return half


def make_touching(distance: float) -> np.ndarray:
    """Make mirrored halves, of which two pairs are at the same places."""
    half = make_halves(1200)
    half[3] = half[7]
    points = np.concatenate([half, half * [-1, 1, 1]])
    points[3, 1] += distance
    points[603, 1] -= distance  # the nearest is the other one's partner
    return points @ rotation(1)


def make_prism(last: np.ndarray) -> np.ndarray:
    """Make a prism of as many planes as it has sides, and a vertex that none of them mirrors."""
    angles = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    prism = np.concatenate([ring, ring + np.eye(3)[2], 2 * ring, 2 * ring + np.eye(3)[2]])
    return np.concatenate([prism, prism[:1] + last]) @ rotation(2)


def make_cluster(size: float) -> np.ndarray:
    """Make a far vertex and a ball of vertices, which are all as far from the centre."""
    points = size * np.random.default_rng(0).normal(size=(1200, 3))
    points[0] = [1, 0, 0]
    return points


def make_sphere() -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(1200, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


NO_PAIRS = {
    "coincident": (lambda: make_touching(0.0), PAIR_TOL),
    "nearly coincident": (lambda: make_touching(1e-7), PAIR_TOL),
    "prism": (lambda: make_prism(np.array([0, 1e-9, 0])), PAIR_TOL),
    "spoilt prism": (lambda: make_prism(np.array([0.1, 0.2, 0])), PAIR_TOL),
    "small cluster": (lambda: make_cluster(1e-8), PAIR_TOL),
    "cluster": (lambda: make_cluster(1e-4), 1e-3),
    "sphere": (make_sphere, 1e-3),
}


@pytest.mark.parametrize("name", NO_PAIRS)
def test_the_work_for_points_without_pairs_is_bounded(monkeypatch, name):
    """Each pair of vertices names a plane, often one that was compared; each compares all."""
    monkeypatch.setattr(module, "_Cells", CountingCells)
    monkeypatch.setattr(CountingCells, "planes", 0)
    monkeypatch.setattr(CountingCells, "made", None)
    monkeypatch.setattr(module, "MAX_WORK", 2_000_000)
    make_points, tolerance = NO_PAIRS[name]
    points = make_points()
    assert find_mirror(points, tolerance) is None
    assert CountingCells.planes <= 60
    if name == "coincident":
        assert CountingCells.made is None
    else:
        assert CountingCells.made.work <= module.MAX_WORK + len(points) ** 2


def test_partners_are_named_where_they_are_near():
    mirror, points = Mirror([1.0, 0, 0], [0.0, 0, 0]), make_twins(1)
    lost = int(np.abs(points[:, 0]).argmax())
    partner = mirror.find_pairs(points)[lost]
    points[lost] += 0.1
    distances, nearest = mirror.find_nearest(points, 1e-3)
    assert np.flatnonzero(np.isinf(distances)).tolist() == sorted([lost, partner])
    near = np.isfinite(distances)
    np.testing.assert_array_equal(points[nearest][near], (points * [-1, 1, 1])[near])


def test_a_plane_that_was_compared_is_not_compared_again(monkeypatch):
    monkeypatch.setattr(module, "_Cells", CountingCells)
    monkeypatch.setattr(CountingCells, "planes", 0)
    assert find_mirror(make_touching(1e-7)) is None
    assert CountingCells.planes < 5


def test_beyond_the_work_nothing_is_found(monkeypatch):
    points = make_twins(1) @ rotation(3).T
    assert find_mirror(points) is not None
    monkeypatch.setattr(module, "MAX_WORK", 3 * module.PLANE_WORK)
    assert find_mirror(points) is None


@pytest.mark.parametrize("block", [1, 50, 1 << 18])
def test_the_nearest_are_those_of_all(monkeypatch, block):
    """In cells of one point and of many, on their sides, and with equal distances: the first."""
    monkeypatch.setattr(module, "MAX_COMPARED", block)
    generator = np.random.default_rng(4)
    points = np.concatenate([generator.uniform(-1, 1, (60, 3)), generator.integers(-2, 3, (60, 3))])
    queries = np.concatenate(
        [points + generator.normal(0, 0.05, points.shape), points, [[9, 9, 9]]]
    )
    distances = np.linalg.norm(queries[:, None] - points, axis=2)
    for reach in (0.0, 0.01, 0.1, 1.0, 20.0):
        found, nearest = module._Cells(points, reach).find_nearest(queries)
        is_near = distances.min(axis=1) <= reach
        expected = np.where(is_near, distances.min(axis=1), np.inf)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=0)
        np.testing.assert_array_equal(nearest, np.where(is_near, distances.argmin(axis=1), 0))


def test_polygons_are_mirrored_where_triangles_are_not():
    """The diagonals of a box all run one way; its quads have none."""
    mirror = Mirror([1.0, 0, 0], [0.0, 0, 0])
    assert mirror.mirrors_polygons(quad_box())
    assert not mirror.mirrors_polygons(box())
    assert not mirror.mirrors_polygons(moved(box(), (0.1, 0, 0)))


def test_pairs_are_known_to_be_pairs_and_other_numbers_not():
    points = make_twins(1) @ rotation(3).T
    mirror = find_mirror(points)
    assert mirror is not None
    partners = mirror.find_pairs(points)
    assert are_pairs(points, partners)
    assert are_pairs(points.astype(np.float32).astype(np.float64), partners)
    swapped = partners.copy()
    swapped[[0, partners[0]]] = [0, partners[0]]
    for wrong in (np.roll(partners, 1), swapped, np.arange(len(points)), partners + 1):
        assert not are_pairs(points, wrong)


@pytest.mark.parametrize("thickness", [0.1, 0.8, 2.0])
def test_pairs_of_thin_noisy_points_are_pairs(thickness):
    """Lines between partners are short there, and each alone shows the plane badly."""
    for seed in range(30):
        points = make_twins(seed) * [thickness / 2, 1, 1]
        size = np.linalg.norm(np.ptp(points, axis=0))
        noise = np.random.default_rng(seed).uniform(-1, 1, points.shape)
        points = points + 0.2 * PAIR_TOL * size * noise
        partners = Mirror([1, 0, 0], points.mean(axis=0)).find_pairs(points)
        assert partners is not None
        assert are_pairs(points, partners)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("count", [0, 1])
def test_one_vertex_has_no_plane(count):
    assert find_mirror(np.zeros((count, 3))) is None
