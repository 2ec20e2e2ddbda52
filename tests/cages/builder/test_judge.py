import numpy as np
import pytest

from cageik_cli.cages.builder import judge
from cageik_cli.cages.builder.judge import Demand, find_near_points, measure_segments
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mirror import Mirror
from tests.cages.torture import torus
from tests.shapes import ball, box, changed, finer, merged, moved, octahedron, rotation


def test_the_distance_of_a_corner_from_a_face_is_found_from_either_side():
    inner, outer = octahedron(0.7), box(1.0)
    for surface, cage in ((inner, outer), (outer, inner)):
        distances, _ = find_near_points(surface, cage, 0.5)
        assert distances[0] == distances.min() == pytest.approx(0.3)


def test_the_distance_of_two_edges_is_found():
    first = changed(box(0.5), vertices=box(0.5).vertices @ turned_about(2).T)
    second = changed(box(0.5), vertices=box(0.5).vertices @ turned_about(1).T)
    second = moved(second, (np.sqrt(2) + 0.1, 0, 0))
    distances, points = find_near_points(first, second, 1.0)
    assert distances[0] == pytest.approx(0.1)
    np.testing.assert_allclose(points[0][0], 0.5 * np.sqrt(2), rtol=1e-9)


def test_edges_that_are_measured_a_few_at_a_time_are_as_near(monkeypatch):
    meshes = octahedron(0.7), box(1.0), 0.6
    distances, points = find_near_points(*meshes)
    monkeypatch.setattr(judge, "MAX_SEGMENT_PAIRS", 30)
    for found, expected in zip(find_near_points(*meshes), (distances, points), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_nothing_is_found_beyond_the_limit():
    distances, points = find_near_points(ball(2, 0.2), box(1.0), 0.1)
    assert len(distances) == len(points) == 0


def test_segments_are_as_far_apart_as_the_nearest_of_many_points_on_them():
    generator = np.random.default_rng(1)
    start, stop, a, b = generator.normal(size=(4, 50, 3))
    distance, place = measure_segments(start, stop, a, b)
    share = np.linspace(0, 1, 401)[:, None]
    for k in range(50):
        mine, other = start[k] + share * (stop[k] - start[k]), a[k] + share * (b[k] - a[k])
        sampled = np.linalg.norm(mine[:, None] - other[None], axis=2).min()
        assert distance[k] <= sampled + 1e-12
        assert distance[k] == pytest.approx(sampled, abs=0.02)
        assert np.linalg.norm(np.cross(place[k] - start[k], stop[k] - start[k])) < 1e-9


def turned_about(axis):
    """An eighth of a turn about a coordinate axis."""
    c = np.sqrt(0.5)
    turns = {2: [[c, -c, 0], [c, c, 0], [0, 0, 1]], 1: [[c, 0, c], [0, 1, 0], [-c, 0, c]]}
    return np.array(turns[axis])


def test_a_turn_of_both_changes_nothing():
    turn = rotation(4)
    surface, cage = octahedron(0.7), box(1.0)
    both = [changed(mesh, vertices=mesh.vertices @ turn.T) for mesh in (surface, cage)]
    assert find_near_points(*both, 0.5)[0].min() == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("model", "holes"),
    [
        (torus(), 1),
        (merged(torus(), ball(2)), 1),
        (ball(2), 0),
        (changed(torus(), faces=torus().faces[1:]), 0),
    ],
)
def test_holes_of_the_model_itself_are_counted(model, holes):
    assert Demand(model, BuildSettings()).holes == holes


def test_a_thin_model_has_as_many_samples_on_both_sides_of_its_plane():
    """Its sides lie in one cell: the sample that is kept may be of either."""
    needle = changed(finer(box(), 3), vertices=finer(box(), 3).vertices * [1, 1e-3, 1e-3])
    mirror = Mirror(np.array([0.0, 1, 0]), np.zeros(3))
    demand = Demand(needle, BuildSettings(30), mirror)
    assert demand.axis is not None
    heights = demand.samples[:, demand.axis]
    assert np.count_nonzero(heights > 0) == np.count_nonzero(heights < 0)
    free = Demand(needle, BuildSettings(30))
    assert len(demand.samples) >= len(free.samples)
