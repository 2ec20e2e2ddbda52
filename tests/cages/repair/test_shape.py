import numpy as np
import pytest

from cageik_cli.cages.repair import shape as shape_module
from cageik_cli.cages.repair.repair import judge_cage
from cageik_cli.cages.repair.shape import (
    ShapeFit,
    find_self_intersecting_faces,
    push_outward,
    untangle,
)
from cageik_cli.cages.surface_points import sample_surface
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.progress import ignore_progress
from tests.cages.check.test_quality import across_the_corner
from tests.shapes import ball, box, changed, concave

pytestmark = pytest.mark.slow

LEAST, TARGET = 0.01, 0.02
"""Points nearer to the cage than the first are pushed for, to the second."""


def test_samples_are_no_further_apart_than_asked_for():
    """Any point of a face is near to a sample."""
    samples = sample_surface(box())
    generator = np.random.default_rng(0)
    weights = generator.dirichlet(np.ones(3), size=(12, 20))
    points = np.einsum("fpc,fcx->fpx", weights, box().vertices[box().faces]).reshape(-1, 3)
    gaps = np.linalg.norm(points[:, None] - samples, axis=2).min(axis=1)
    assert gaps.max() < 0.03 * box().diagonal
    assert (np.abs(np.abs(samples).max(axis=1) - 1) < 1e-12).all()


def test_small_faces_have_no_samples_but_their_corners():
    assert len(sample_surface(ball(6))) == len(ball(6).vertices)


def test_contacts_have_the_distance_that_is_missing(monkeypatch):
    points = np.array([[0.0, 0, 0], [0.995, 0.1, 0.2], [1.3, 0.1, 0.2]])
    monkeypatch.setattr(shape_module, "push", lambda cage, find, **_: find(cage, 0.0))
    contacts = push_outward(box(), points, LEAST, TARGET)
    np.testing.assert_allclose(contacts.missing, [0.02 - 0.005, 0.3 + 0.02])
    np.testing.assert_allclose(contacts.direction, [[1, 0, 0], [1, 0, 0]], atol=1e-12)
    nearest = np.einsum("kc,kcx->kx", contacts.weights, box().vertices[contacts.corners])
    np.testing.assert_allclose(nearest, [[1, 0.1, 0.2], [1, 0.1, 0.2]], atol=1e-12)


def test_a_push_takes_points_inside_with_their_clearance():
    points = np.array([[1.1, 0.3, -0.2], [0.0, 0.0, -1.05]])
    pushed = push_outward(box(), points, LEAST, TARGET)
    assert (winding_numbers(pushed, points) > 0.5).all()
    assert (closest_points(pushed, points).distance >= LEAST).all()


def test_a_cage_without_contacts_stays_to_the_bit():
    pushed = push_outward(box(), ball(2).vertices, LEAST, TARGET)
    np.testing.assert_array_equal(pushed.vertices, box().vertices)


def test_what_is_far_from_contacts_hardly_moves():
    points = np.array([[1.1, 0.9, 0.9]])
    move = np.linalg.norm(
        push_outward(box(), points, LEAST, TARGET).vertices - box().vertices, axis=1
    )
    assert move.argmax() == 7
    assert move[0] < 0.5 * move[7]


def test_a_vertex_pushed_through_the_other_side_is_untangled():
    cage = ball(1, 1.0)
    vertices = cage.vertices.copy()
    vertices[0] = -1.5 * vertices[0]
    tangled = changed(cage, vertices=vertices)
    assert len(find_self_intersecting_faces(tangled)) > 0
    free = untangle(tangled)
    assert len(find_self_intersecting_faces(free)) == 0
    moved = (free.vertices != tangled.vertices).any(axis=1)
    assert np.count_nonzero(moved) <= 2


def test_a_cage_free_of_crossings_stays_to_the_bit():
    assert (
        untangle(concave()) is concave()
        or (untangle(concave()).vertices == concave().vertices).all()
    )


def test_a_face_without_area_is_a_tangle():
    cage = ball(1)
    vertices = cage.vertices.copy()
    a, b, c = cage.faces[0]
    vertices[a] = (vertices[b] + vertices[c]) / 2
    flat = changed(cage, vertices=vertices)
    assert len(find_self_intersecting_faces(flat)) > 0
    assert len(find_self_intersecting_faces(untangle(flat))) == 0


def test_a_shape_that_cannot_be_fitted_is_never_worse():
    """A model that passes through its cage's inner corner, and a cage of too few vertices."""
    model = across_the_corner(0.5)
    fit = ShapeFit(model, sample_surface(model), 1e-4, 1e-3)
    shape = fit.run(concave(), ignore_progress)
    assert shape.faults <= fit.count_faults(concave())
    np.testing.assert_allclose(shape.cage.vertices - concave().vertices, shape.moves, atol=1e-12)


def test_vertices_return_as_far_as_the_cage_stays_fit():
    """A spike outward holds the model, too: nothing but the dent is moved."""
    cage, model = ball(2, 1.0), ball(3, 0.8)
    vertices = cage.vertices.copy()
    vertices[0] *= 1.5
    vertices[1] *= 0.6
    fit = ShapeFit(model, sample_surface(model), 1e-4, 4e-3)
    shape = fit.run(changed(cage, vertices=vertices), ignore_progress)
    assert shape.faults == 0
    assert not shape.moves[0].any()
    assert shape.moves[1].any()


@pytest.mark.parametrize(
    ("cage", "kind"),
    [
        (TriMesh(box().vertices, box().faces[1:]), "open-edge"),
        (box(0.5), "outside"),
        (concave(), "surface-crossing"),
    ],
)
def test_a_cage_that_does_not_hold_the_model_is_judged_unfit(cage, kind):
    model = across_the_corner(0.5) if kind == "surface-crossing" else ball(2, 0.9)
    faults, _ = judge_cage(cage, model, sample_surface(model))
    assert kind in [fault.kind for fault in faults]


def test_points_outside_are_a_fault_of_their_own():
    (fault,), _ = judge_cage(box(), ball(2), np.array([[0.0, 0, 0], [0, 2, 0]]))
    assert fault.kind == "surface-outside"
    assert fault.value == 1
    assert "(0, 2, 0)" in fault.message


def test_a_fit_cage_is_judged_so():
    assert judge_cage(box(), ball(2), sample_surface(ball(2))) == ((), ())
