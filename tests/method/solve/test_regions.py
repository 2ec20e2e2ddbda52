from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.metrics import DeviationPeaks
from cageik_cli.method.solve.regions import (
    MAX_REGIONS,
    Cause,
    Evidence,
    attribute_to_loose_cage,
    attribute_to_shared_places,
    attribute_to_smoothing,
    find_worst_regions,
    has_bad_regions,
)
from cageik_cli.method.weights.binding import Binding
from tests.shapes import ball, box

REST = ball(3)


def bound(cage=None, weight=0.9):
    cage = cage or box()
    weights = np.full((len(REST.vertices), len(cage.vertices)), 0.0)
    weights[:, 0] = weight
    return Binding(REST, cage, weights)


def peaks(deviations, frames=None):
    frames = np.zeros(len(REST.vertices), np.int64) if frames is None else frames
    return DeviationPeaks(np.asarray(deviations, float), frames)


def cap(axis, sign):
    """The vertices of the ball within 0.1 of a pole."""
    return sign * REST.vertices[:, axis] > 0.4


def test_two_caps_are_two_regions_the_worst_first():
    deviations, frames = np.zeros(len(REST.vertices)), np.zeros(len(REST.vertices), np.int64)
    deviations[cap(0, 1)], frames[cap(0, 1)] = 0.02, 7
    deviations[cap(1, -1)], frames[cap(1, -1)] = 0.03, 4
    worst = int(np.flatnonzero(cap(1, -1))[2])
    deviations[worst] = 0.04
    first, second = find_worst_regions(bound(), peaks(deviations, frames), 0.01)
    assert first.max_deviation == 0.04
    assert first.worst_vertex == worst
    assert first.frame == 4
    assert (first.vertices, second.vertices) == (cap(1, -1).sum(), cap(0, 1).sum())
    assert second.frame == 7
    np.testing.assert_allclose(first.centre, REST.vertices[cap(1, -1)].mean(axis=0))
    assert first.size == pytest.approx(np.linalg.norm(np.ptp(REST.vertices[cap(1, -1)], axis=0)))
    # The faces of the box on that side: y = −1.
    assert (box().vertices[box().faces[list(first.cage_faces)]][:, :, 1] == -1).all()


def test_the_default_threshold_is_a_share_of_the_largest():
    deviations = np.where(cap(0, 1), 1.0, np.where(cap(1, 1), 0.4, 0.0))
    (region,) = find_worst_regions(bound(), peaks(deviations))
    assert region.vertices == cap(0, 1).sum()


def test_nothing_deviates():
    assert find_worst_regions(bound(), peaks(np.zeros(len(REST.vertices)))) == ()
    assert find_worst_regions(bound(), peaks(np.full(len(REST.vertices), 0.1)), 0.2) == ()


def test_no_more_than_the_most_are_given():
    alone = np.zeros(len(REST.vertices))
    neighbours = {tuple(sorted(edge)) for edge in REST.edges.ends.tolist()}
    chosen = []
    for vertex in range(len(alone)):
        if all(tuple(sorted((vertex, other))) not in neighbours for other in chosen):
            chosen.append(vertex)
        if len(chosen) == MAX_REGIONS + 3:
            break
    alone[chosen] = 1 + np.arange(len(chosen))
    regions = find_worst_regions(bound(), peaks(alone), 0.5)
    assert [region.worst_vertex for region in regions] == chosen[::-1][:MAX_REGIONS]
    assert all(region.size == 0 for region in regions)


def test_a_place_that_limbs_share_is_blamed():
    deviations = np.where(cap(0, 1), 1.0, 0.0)
    regions = find_worst_regions(bound(), peaks(deviations))
    (far,) = attribute_to_shared_places(regions, [(np.array([-0.5, 0, 0]), 0.2)], REST.diagonal)
    assert far.cause is regions[0].cause is not Cause.SHARED_LOOP
    places = [(np.array([-0.5, 0, 0]), 0.2), (np.array([0.5, 0, 0]), 0.2)]
    (inside,) = attribute_to_shared_places(regions, places, REST.diagonal)
    assert inside.cause is Cause.SHARED_LOOP
    assert inside.evidence.in_shared_place
    assert attribute_to_shared_places([inside], [], REST.diagonal)[0].cause is regions[0].cause


def test_a_loose_cage_is_blamed_before_places_that_limbs_share():
    regions = find_worst_regions(bound(), peaks(np.where(cap(0, 1), 1.0, 0.0)))
    places = [(np.array([0.5, 0, 0]), 0.2)]
    shared = attribute_to_shared_places(regions, places, REST.diagonal)
    (loose,) = attribute_to_loose_cage(shared, REST.diagonal)
    assert loose.cause is Cause.LOOSE_CAGE
    assert loose.evidence.has_loose_cage


@pytest.mark.parametrize(("before", "is_blamed"), [(0.79, True), (0.81, False), (1.3, False)])
def test_smoothing_is_blamed_before_the_cage_if_deviations_were_less(before, is_blamed):
    deviations = np.where(cap(0, 1), 2.0, 0.0)
    regions = attribute_to_loose_cage(find_worst_regions(bound(), peaks(deviations)), REST.diagonal)
    (region,) = attribute_to_smoothing(regions, peaks(before * deviations), REST.diagonal)
    assert region.cause is (Cause.SMOOTHING if is_blamed else Cause.LOOSE_CAGE)
    assert region.evidence.unsmoothed_share == pytest.approx(before)


def test_a_cage_far_away_is_blamed_and_measured():
    deviations = np.where(cap(0, 1), 1.0, 0.0)
    (region,) = find_worst_regions(bound(), peaks(deviations))
    assert region.cause is Cause.FAR_CAGE
    depth = 1 - REST.vertices[cap(0, 1), 0].mean()
    assert region.evidence.cage_distance == pytest.approx(100 * depth / REST.diagonal)


SOUND = Evidence(
    cage_distance=1.0,
    vertex_distance=2.0,
    largest_weight=0.6,
    smallest_angle=30.0,
    edge_length=5.0,
    in_shared_place=False,
    has_loose_cage=False,
)


@pytest.mark.parametrize(
    ("name", "limit", "worse", "cause"),
    [
        ("cage_distance", 4.0, 1.1, Cause.FAR_CAGE),
        ("vertex_distance", 15.0, 1.1, Cause.FAR_CAGE),
        ("largest_weight", 0.25, 0.9, Cause.WEAK_INFLUENCE),
        ("smallest_angle", 5.0, 0.9, Cause.THIN_FACES),
        ("edge_length", 10.0, 1.1, Cause.COARSE_FACES),
        ("unsmoothed_share", 0.8, 0.9, Cause.SMOOTHING),
    ],
)
def test_each_cause_has_its_limit(name, limit, worse, cause):
    """The region has a size of 10 %, so that its own size is a limit, too."""
    assert SOUND.judge(10.0) is Cause.UNKNOWN
    assert replace(SOUND, **{name: worse * limit}).judge(10.0) is cause
    assert replace(SOUND, **{name: limit / worse}).judge(10.0) is Cause.UNKNOWN


def test_faces_of_the_cage_that_are_nearest_may_be_thin():
    slab = TriMesh(box().vertices * [0.6, 0.6, 20.0], box().faces)
    deviations = np.where(cap(0, 1), 1.0, 0.0)
    (region,) = find_worst_regions(bound(cage=slab), peaks(deviations))
    assert region.cause is Cause.THIN_FACES
    assert region.evidence.smallest_angle == pytest.approx(np.degrees(np.arctan(0.6 / 20)))


@pytest.mark.parametrize(
    ("rms", "largest", "is_bad"),
    [
        (0.02, 0.061, True),  # above 3 % of a diagonal of 2
        (0.02, 0.06, False),
        (0.001, 0.0101, True),  # above ten times the rms
        (0.001, 0.01, False),
        (1e-9, 1.9e-5, False),  # rounding
        (1e-9, 2.1e-5, True),
        (0.0, 0.0, False),
    ],
)
def test_regions_are_told_of_large_deviations_alone(rms, largest, is_bad):
    assert has_bad_regions(rms, largest, 2.0) is is_bad
