import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import (
    MIN_ALTITUDE_RATIO,
    bounds_volume,
    corner_angles,
    degenerate_face_mask,
    thin_face_pairs,
)
from tests.shapes import box, concave, finer, rotation

RIGHT = TriMesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, np.sqrt(3), 0]]), np.array([[0, 1, 2]]))


def test_angles_are_those_of_half_an_equilateral_triangle():
    np.testing.assert_allclose(corner_angles(RIGHT), [[90, 60, 30]], rtol=1e-14)


def test_angles_of_every_face_sum_to_180_degrees():
    np.testing.assert_allclose(corner_angles(concave()).sum(axis=1), 180, rtol=1e-14)


def test_areas():
    np.testing.assert_allclose(RIGHT.face_areas, [np.sqrt(3) / 2], rtol=1e-15)
    assert box().face_areas.sum() == pytest.approx(24)


@pytest.mark.parametrize(("lift", "flat"), [(2.0, False), (0.5, True), (0.0, True)])
def test_a_face_is_flat_below_a_share_of_its_longest_side(lift, flat):
    corners = np.array([[0.0, 0, 0], [3, 0, 0], [1, 3 * lift * MIN_ALTITUDE_RATIO, 0]])
    assert degenerate_face_mask(TriMesh(corners @ rotation(0).T, [[0, 1, 2]])).tolist() == [flat]


def test_a_face_of_one_point_is_flat():
    assert degenerate_face_mask(TriMesh(np.zeros((3, 3)), [[0, 1, 2]])).tolist() == [True]


@pytest.mark.parametrize(("degrees", "flat"), [(0.99e-5, True), (1.01e-5, False)])
def test_needles_are_degenerate_below_an_angle(degrees, flat):
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, np.radians(degrees), 0]])
    assert degenerate_face_mask(TriMesh(corners, [[0, 1, 2]])).tolist() == [flat]


def test_what_bounds_a_volume():
    cage = box()
    assert bounds_volume(cage)
    assert bounds_volume(cage.flip())
    assert not bounds_volume(TriMesh(cage.vertices, cage.faces[1:]))
    assert not bounds_volume(
        TriMesh(cage.vertices, np.vstack([cage.faces[:1, ::-1], cage.faces[1:]]))
    )
    doubled = np.vstack([cage.faces, cage.faces[:1], cage.faces[:1, ::-1]])
    assert not bounds_volume(TriMesh(cage.vertices, doubled))


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("height", [1.0, 1e-3])
def test_the_sheet_opposite_a_face_of_a_slab_is_its_height_away(height, flip):
    slab = TriMesh(finer(box(), 1).vertices * [1, 1, height], finer(box(), 1).faces)
    slab = slab.flip() if flip else slab
    level = np.ptp(slab.vertices[slab.faces][:, :, 2], axis=1) == 0
    expected = 2 * height / np.sqrt(0.5)
    pairs, nearness = thin_face_pairs(slab, 1.01 * expected)
    of_level = level[pairs[:, 0]] & level[pairs[:, 1]]
    np.testing.assert_allclose(nearness[of_level], expected, rtol=1e-12)
    np.testing.assert_array_equal(np.unique(pairs[of_level, 0]), np.flatnonzero(level))
    heights = slab.vertices[slab.faces[pairs[of_level]]][:, :, 0, 2]
    np.testing.assert_array_equal(heights[:, 0], -heights[:, 1])
    pairs, _ = thin_face_pairs(slab, 0.99 * expected)
    assert not (level[pairs[:, 0]] & level[pairs[:, 1]]).any()


def test_a_sheet_outside_counts_and_one_face_has_none():
    """The walls of a channel face each other across the air."""
    walls = TriMesh(
        np.array([[0.0, 0, 0], [0, 2, 0], [0, 0, 2], [0.1, 0, 0], [0.1, 2, 0], [0.1, 0, 2]]),
        [[0, 1, 2], [3, 5, 4]],
    )
    pairs, nearness = thin_face_pairs(walls, 1.0)
    np.testing.assert_allclose(nearness, 0.1 / np.sqrt(2), rtol=1e-12)
    assert pairs.tolist() == [[0, 1], [1, 0]]
    assert len(thin_face_pairs(RIGHT, 1e9)[0]) == 0


def test_a_sheet_beside_the_normal_does_not_count():
    walls = TriMesh(
        np.array([[0.0, 0, 0], [0, 2, 0], [0, 0, 2], [0.1, 2, 2], [0.1, 4, 2], [0.1, 2, 4]]),
        [[0, 1, 2], [3, 5, 4]],
    )
    assert len(thin_face_pairs(walls, 1e9)[0]) == 0


def test_blocks_change_nothing(monkeypatch):
    slab = TriMesh(box().vertices * [1, 1, 0.1], box().faces)
    whole = thin_face_pairs(slab, 1.0)
    assert len(whole[0]) > 0
    monkeypatch.setattr("cageik_cli.geometry.shape.MAX_SEARCHED_FACES", 5)
    for found, expected in zip(thin_face_pairs(slab, 1.0), whole, strict=True):
        np.testing.assert_array_equal(found, expected)
