"""How much of a model touches itself: near in space, far along the surface."""

import numpy as np
import pytest

from cageik_cli.cages.check import self_contact as module
from cageik_cli.cages.check.self_contact import make_contact_meter
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import ball, box, merged, moved
from tests.strips import fold_strip, make_strip


def measure(model, frame=None):
    return make_contact_meter(model).measure(model.vertices if frame is None else frame)


def test_legs_touch_the_more_the_nearer_they_are():
    strip = make_strip(0.5)
    shares = [measure(strip, fold_strip(angle)) for angle in (0.5, 0.05, 0.02, 0.0)]
    assert shares[0] == 0
    assert sorted(shares) == shares
    assert shares[1] > 0
    assert shares[3] > 0.8


def test_it_does_not_matter_in_which_pose_the_surface_was_sampled():
    for angle in (0.02, 0.2, 0.5):
        assert measure(make_strip(angle), fold_strip(0.5)) == pytest.approx(0, abs=0.01)


@pytest.mark.parametrize("model", [box(), ball(1), ball(3), make_strip(0.5)])
def test_a_model_without_limbs_touches_nothing_whatever_its_faces(model):
    assert measure(model) == 0


def test_the_sides_of_a_coarse_fold_touch():
    corners = [[-1, 2, 0], [-1, 2, 1], [0, 0, 0], [0, 0, 1], [1, 2, 0], [1, 2, 1]]
    faces = [[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]]
    coarse = TriMesh(np.array(corners, float), faces)
    assert measure(coarse) == 0
    assert measure(coarse, coarse.vertices * [0.001, 1, 1]) > 0.5


def test_a_seam_does_not_part_the_surface():
    strip = make_strip(0.5)
    corners = np.arange(strip.faces.size).reshape(-1, 3)
    torn = TriMesh(strip.vertices[strip.faces].reshape(-1, 3), corners)
    assert measure(torn) == 0


def test_parts_that_are_not_joined_touch():
    pair, apart = (merged(ball(2), moved(ball(2), (gap, 0, 0))) for gap in (1.01, 2.01))
    assert 0 < measure(pair) < 0.2
    assert measure(pair, apart.vertices) == 0


def test_size_and_place_do_not_matter():
    strip, frame = make_strip(0.5), fold_strip(0.02)
    far = moved(strip, [1e6] * 3, 1000)
    assert measure(far, 1000 * frame + 1e6) == pytest.approx(measure(strip, frame), abs=1e-4)


def test_blocks_do_not_matter(monkeypatch):
    expected = make_contact_meter(make_strip(0.5))
    monkeypatch.setattr(module, "MAX_SOURCES", 7)
    np.testing.assert_array_equal(make_contact_meter(make_strip(0.5)).joined, expected.joined)


def test_a_model_without_area_cannot_be_measured():
    line = TriMesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), [[0, 1, 2]])
    assert make_contact_meter(line) is None
