import re

import numpy as np
import pytest

from cageik_cli.cages.builder.frame import (
    MirrorFrame,
    add_image,
    average_sides,
    cut_half,
    find_partners,
    find_symmetry,
    measure_moments,
    pair_exactly,
    reflect,
    take_half,
)
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.util.errors import NumericalError
from tests.shapes import ball, box, changed, concave, finer, moved, rotation


def make_wedge():
    """A body whose only plane of symmetry is z = 0.5."""
    model = finer(concave(), 2)
    x, y, z = model.vertices.T
    return changed(model, vertices=np.stack([x, 1.3 * y + 0.2 * x, z], axis=1))


@pytest.mark.parametrize("turn", [None, 1, 2])
def test_the_plane_of_a_model_is_found_wherever_it_is(turn):
    shift = np.array([5.0, 0, -3])
    mirror, _ = find_symmetry(moved(make_wedge(), shift, 2.0, turn), "auto")
    matrix = np.eye(3) if turn is None else rotation(turn)
    expected = Mirror(matrix @ [0, 0, 1], 2 * matrix @ [0, 0, 0.5] + shift)
    assert mirror is not None
    np.testing.assert_allclose(abs(mirror.normal @ expected.normal), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose((mirror.point - expected.point) @ expected.normal, 0, atol=1e-9)


@pytest.mark.parametrize(("bulge", "is_found"), [(0.004, True), (0.007, False)])
def test_a_model_may_be_asymmetric_by_half_a_percent(bulge, is_found):
    model = make_wedge()
    vertices = model.vertices.copy()
    vertices[vertices[:, 2].argmax(), 2] += bulge * model.diagonal
    mirror, note = find_symmetry(changed(model, vertices=vertices), "auto")
    assert (mirror is not None) == is_found == (note is None)
    if note is not None:
        assert "the cage is not symmetric, as the model is not: mirrored about the plane" in note
        assert re.search(
            r"up to 0\.[67]\d* % of the diagonal from itself \(expected .* 0.5 %", note
        )


def test_a_plane_that_is_stated_is_taken_whatever_the_model():
    model = moved(make_wedge(), (-0.4, 0, 0), turn=3)
    assert find_symmetry(model, "off") == (None, None)
    mirror, _ = find_symmetry(model, "y")
    assert mirror is not None
    np.testing.assert_array_equal(mirror.normal, [0, 1, 0])
    point = changed(model, vertices=np.zeros_like(model.vertices))
    assert find_symmetry(point, "y") == (None, None)


def test_a_coordinate_plane_through_the_origin_is_taken_if_it_fits():
    """That of the box is 0; a box that is moved has another."""
    for shift in (0.0, 0.25):
        mirror, _ = find_symmetry(moved(box(), (shift, 0, 0)), "x")
        assert mirror is not None
        np.testing.assert_allclose(mirror.point[0], shift, rtol=0, atol=1e-12)
    assert mirror.point[0] != 0


def test_moments_are_those_of_the_surface():
    """A cube of side 2: ∫ x² over its surface is 16 of its 24 square units; divided the same."""
    for model in (box(), finer(box(), 2)):
        centre, moments = measure_moments(model)
        np.testing.assert_allclose(centre, 0, atol=1e-15)
        expected = (4 * 4 / 3 + 8) / 24
        np.testing.assert_allclose(moments, expected * np.eye(3), rtol=0, atol=1e-14)


def test_a_frame_mirrors_to_the_last_bit_about_a_coordinate_plane():
    model = moved(make_wedge(), (0.1, 0.2, -0.5))
    frame = MirrorFrame(model, Mirror([0.0, 0, 1], [0.0, 0, 0]))
    points = np.random.default_rng(0).normal(size=(50, 3))
    places, images = (frame.to_file_units(p) for p in (points, reflect(points, frame.axis)))
    np.testing.assert_array_equal(images, places * [1, 1, -1])
    np.testing.assert_allclose(frame.to_units(places), points, rtol=0, atol=1e-14)


@pytest.mark.parametrize("normal", [[1.0, 2, -2], [-1, 2, 2], [0, -3, 1], [1, -1, 0]])
def test_a_frame_mirrors_up_to_rounding_about_any_plane(normal):
    mirror = Mirror(normal, [3.0, 0, 1])
    frame = MirrorFrame(moved(ball(1), (4, 5, 6)), mirror)
    points = np.random.default_rng(0).normal(size=(50, 3))
    places, images = (frame.to_file_units(p) for p in (points, reflect(points, frame.axis)))
    np.testing.assert_allclose(images, mirror.reflect(places), rtol=0, atol=4e-15 * 20)
    assert np.linalg.det(frame.to_units(np.eye(3)) - frame.to_units(np.zeros(3))) > 0
    np.testing.assert_allclose(frame.to_units(places), points, rtol=0, atol=1e-14)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_half_and_its_image_are_closed(axis):
    model = moved(ball(2), (0.03, 0.02, 0.04), turn=4)
    half = cut_half(model, axis)
    assert half.vertices[:, axis].min() == 0
    whole = add_image(half, axis)
    assert whole.is_closed
    assert whole.volume == pytest.approx(model.volume, rel=0.2)
    partners = find_partners(whole.vertices, axis)
    np.testing.assert_array_equal(whole.vertices[partners], reflect(whole.vertices, axis))
    again = add_image(take_half(whole, axis), axis)
    assert (len(again.vertices), len(again.faces)) == (len(whole.vertices), len(whole.faces))


def test_sides_become_the_mean_of_both_and_keep_apart():
    before = add_image(cut_half(moved(ball(1), turn=4), 0), 0)
    pushed = before.vertices + np.random.default_rng(0).normal(size=before.vertices.shape) * 1e-3
    pushed[before.vertices[:, 0].argmax(), 0] = -1  # beyond the plane, which its partner is not
    after = average_sides(before.move(pushed), before, 0)
    partners = find_partners(after.vertices, 0)
    np.testing.assert_array_equal(after.vertices[partners], reflect(after.vertices, 0))
    np.testing.assert_array_equal(np.sign(after.vertices[:, 0]), np.sign(before.vertices[:, 0]))
    free = np.abs(before.vertices[:, 0]) < 0.4
    np.testing.assert_allclose(after.vertices[free], before.vertices[free], rtol=0, atol=4e-3)


def test_mirror_images_up_to_rounding_become_exact():
    exact = ball(2).vertices
    noise = 1e-9 * np.random.default_rng(0).random(exact.shape)
    paired = pair_exactly(exact + noise, 1)
    np.testing.assert_allclose(paired, exact, rtol=0, atol=1e-9)
    partners = find_partners(exact, 1)
    np.testing.assert_array_equal(paired[partners], reflect(paired, 1))
    assert (paired[partners == np.arange(len(paired)), 1] == 0).all()
    with pytest.raises(NumericalError, match="mirror image"):
        pair_exactly(exact + 1e-3 * np.random.default_rng(0).random(exact.shape), 1)
