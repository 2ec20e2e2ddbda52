import numpy as np
import pytest

from cageik_cli.cages.check.quality import Loop, Slicer, find_shared_sections
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import ball, box, concave, finer, merged, moved, prism


def trousers(gap):
    """A block with two legs, 0.8 long, `gap` apart, made of cubes of a grid; outward."""
    right = 1 + gap
    return prism(
        [
            [0, 0],
            [1, 0],
            [1, 0.8],
            [right, 0.8],
            [right, 0],
            [1 + right, 0],
            [1 + right, 2],
            [0, 2],
        ],
        [[0, 1, 2], [0, 2, 7], [2, 3, 6], [2, 6, 7], [3, 4, 5], [3, 5, 6]],
    )


BOX = moved(box(), (1.25, 1, 0.5), 1.5)
"""A box around trousers."""


def test_a_section_of_a_box_is_its_square():
    (loop,) = Slicer(box(), 1).cut(0.3)
    np.testing.assert_allclose(loop.segments[:, :, 1], 0.3)
    length = np.linalg.norm(loop.segments[:, 1] - loop.segments[:, 0], axis=1)
    assert length.sum() == pytest.approx(8)
    assert loop.goes_around(np.array([0.9, 0.3, -0.9]))
    assert not loop.goes_around(np.array([1.1, 0.3, 0]))
    assert Slicer(box(), 1).cut(1.3) == []


def test_a_plane_through_vertices_cuts_whole_loops():
    (loop,) = Slicer(ball(2), 2).cut(0.0)
    assert loop.is_closed
    starts, stops = loop.segments.sum(axis=0)
    np.testing.assert_allclose(starts, stops, rtol=0, atol=1e-12)


def test_legs_are_two_loops():
    assert len(Slicer(trousers(0.5), 1).cut(0.4)) == 2
    assert len(Slicer(trousers(0.5), 1).cut(1.4)) == 1


def test_a_box_around_two_legs_is_one_loop_for_both():
    model = finer(trousers(0.5), 3)
    place = find_shared_sections(BOX, model)[0]
    assert place.axis == 1
    assert place.limbs == 2
    assert place.gap == pytest.approx(0.5)
    assert place.size == pytest.approx(np.hypot(2.5, 1))
    np.testing.assert_allclose(place.centre[[0, 2]], [1.25, 0.5])
    # As far as the surface does not join the legs nearby.
    assert 0 < place.centre[1] < 0.8
    assert 0.4 < place.length < 0.8


def test_places_near_points_are_found_alone():
    model = finer(trousers(0.5), 3)
    (place,) = find_shared_sections(BOX, model, near=np.array([[1.25, 0.4, 0.5]]))
    assert (place.axis, place.limbs) == (1, 2)
    step = 2 / 24
    assert abs(place.centre[1] - 0.4) <= step
    assert place.length <= 2 * step
    # Sections through the block above hold one limb; those across x hold one leg.
    assert find_shared_sections(BOX, model, near=np.array([[0.5, 1.6, 0.5]])) == []
    assert find_shared_sections(BOX, model, near=np.empty((0, 3))) == []


def test_a_cage_with_legs_of_its_own_shares_nothing():
    model = trousers(0.5)
    centre = np.array([1.25, 1, 0.5])
    grown = model.vertices + 0.1 * np.sign(model.vertices - centre)
    inner = np.isin(model.vertices[:, 0], [1.0, 1.5])
    grown[inner, 0] = np.where(model.vertices[inner, 0] == 1.0, 1.1, 1.4)
    grown[inner & (model.vertices[:, 1] == 0.8), 1] = 0.7
    cage = TriMesh(grown, model.faces)
    assert find_shared_sections(cage, finer(model, 3)) == []


def test_legs_too_near_for_a_cage_between_are_one():
    assert find_shared_sections(BOX, finer(trousers(0.005), 3)) == []


def test_a_body_without_limbs_shares_nothing():
    assert find_shared_sections(box(1.0), ball(3)) == []
    assert find_shared_sections(box(3.0), finer(concave(), 2)) == []


def test_a_body_in_another_body_is_no_limb():
    """A shell within a shell, and one beside: only parts of one body are limbs."""
    model = merged(ball(3), moved(ball(3), scale=0.5), moved(ball(3), (1.2, 0, 0)))
    assert find_shared_sections(box(3.0), model) == []


def test_only_loops_in_each_others_boxes_are_compared(monkeypatch):
    """A thousand loops would be a million comparisons."""
    calls, goes_around = [], Loop.goes_around

    def count(*arguments):
        calls.append(arguments)
        return goes_around(*arguments)

    monkeypatch.setattr(Loop, "goes_around", count)
    model = merged(*(moved(ball(2), (1.2 * k, 0, 0)) for k in range(12)))
    assert find_shared_sections(box(20.0), model) == []
    # Each loop of the model is compared with the one loop of the cage.
    assert len(calls) <= 12 * 24 * 3
