import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.cages.check.enclosure import TOUCH_TOL, check_enclosure
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import CageError
from tests.shapes import ball, box, changed, finer, octahedron, rotation
from tests.texts import texts


def test_vertices_outside_are_counted_and_named():
    rest = ball(2, 0.9)
    vertices = rest.vertices.copy()
    vertices[5] = [1.5, 0, 0]
    vertices[7] = [0, 1.1, 0]
    rest = changed(rest, vertices=vertices)
    with pytest.raises(CageError) as caught:
        check_enclosure(box(), rest)
    worst = f"{100 * 0.5 / rest.diagonal:.3g} %"
    assert re.match(
        rf"2 of {len(vertices)} vertices .* the worst, 5, by {worst} .* 5, 7 ", str(caught.value)
    )
    assert "swapped" not in str(caught.value)


def test_a_model_given_as_the_cage_is_known_from_the_cage_that_encloses_it():
    with pytest.raises(CageError, match=r"are swapped: this mesh of 66 .* other, of 8; give"):
        check_enclosure(ball(2), box())


def test_the_message_asks_whether_cage_and_model_are_swapped():
    beside = changed(box(), vertices=box().vertices + 1.5)
    with pytest.raises(CageError, match="has 66 vertices and the model 8: are they swapped"):
        check_enclosure(ball(2), beside)


def test_a_vertex_outside_by_rounding_is_moved_onto_the_cage():
    rest = box(1.0)
    vertices = rest.vertices * np.where(np.arange(8) == 3, 1 + 0.1 * TOUCH_TOL, 0.5)[:, None]
    fitted = check_enclosure(box(), changed(rest, vertices=vertices))
    np.testing.assert_allclose(fitted.points[3], rest.vertices[3], rtol=1e-15)
    np.testing.assert_array_equal(np.delete(fitted.points, 3, 0), np.delete(vertices, 3, 0))
    vertices[3] = rest.vertices[3] * (1 + 10 * TOUCH_TOL)
    with pytest.raises(CageError, match="1 of 8 vertices"):
        check_enclosure(box(), changed(rest, vertices=vertices))


def test_vertices_outside_are_projected_on_request():
    rest = ball(1, 0.9)
    vertices = rest.vertices.copy()
    vertices[5], vertices[7] = [1.5, 0.25, 0], [0, 0.5, -2]
    held = check_enclosure(box(), changed(rest, vertices=vertices), outside="project")
    assert held.outside_indices.tolist() == [5, 7]
    np.testing.assert_allclose(held.points[[5, 7]], [[1, 0.25, 0], [0, 0.5, -1]], atol=1e-12)
    kept = np.delete(np.arange(len(vertices)), [5, 7])
    np.testing.assert_array_equal(held.points[kept], vertices[kept])
    (note,) = texts(held.notes)
    assert note.startswith("2 of 18 vertices of the model are outside the cage")
    assert "numbers 5, 7 (from 0); they have the weights of the nearest points" in note


def test_projecting_gives_no_note_when_nothing_is_outside():
    held = check_enclosure(box(), ball(1, 0.9), outside="project")
    assert (texts(held.notes), held.outside_indices.tolist()) == ((), [])


@pytest.mark.parametrize("diagonals", [1e5, 1e9])
def test_a_model_on_its_cage_is_enclosed_at_any_distance_from_the_origin(diagonals):
    """Rounding grows with the coordinates: a vertex is then outside by more than `TOUCH_TOL`."""
    rest, turn = finer(box(), 2), rotation(1)

    def moved(mesh):
        return changed(mesh, vertices=(mesh.vertices + diagonals * box().diagonal) @ turn.T)

    assert texts(check_enclosure(moved(box()), moved(rest)).notes) == ()
    stretched = changed(rest, vertices=rest.vertices * 1.001)
    with pytest.raises(CageError, match="98 of 98 vertices"):
        check_enclosure(moved(box()), moved(stretched))


def test_a_rest_pose_of_one_point_is_refused():
    with pytest.raises(CageError, match="the rest pose is one point, expected a surface"):
        check_enclosure(box(), TriMesh(np.zeros((3, 3)), [[0, 1, 2]]))


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(1e-3, 1e3), st.floats(-100, 100))
def test_the_verdict_does_not_depend_on_position_rotation_or_scale(seed, scale, shift):
    turn = rotation(seed)

    def moved(mesh):
        return changed(mesh, vertices=scale * (mesh.vertices @ turn.T + shift))

    assert len(check_enclosure(moved(box()), moved(octahedron(0.9))).points) == 6
    with pytest.raises(CageError, match="6 of 6 vertices"):
        check_enclosure(moved(box()), moved(octahedron(1.1)))


MISPLACED = {
    "other units": (1000.0, np.zeros(3), "the cage is in metres instead of millimetres"),
    "a rod, beside": (np.array([9.0, 0.1, 0.1]), np.array([0, 5.0, 0]), "their bounding boxes do"),
    "a rod": (np.array([30.0, 30.0, 0.1]), np.zeros(3), r"the cage is 0\.0408 times as large"),
    "moved": (1.0, np.array([5.0, 0, 0]), r"the cage is moved by \(-5, 0, 0\)"),
}


@pytest.mark.parametrize(("scale", "shift", "says"), MISPLACED.values(), ids=MISPLACED)
@pytest.mark.parametrize("outside", ["refuse", "project"])
def test_a_model_mostly_outside_is_refused_with_what_is_found(scale, shift, says, outside):
    rest = changed(octahedron(1.0), vertices=scale * octahedron(1.0).vertices + shift)
    with pytest.raises(CageError, match=f"of 6 vertices .*; {says}"):
        check_enclosure(box(), rest, outside)
