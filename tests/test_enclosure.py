import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.enclosure import TOUCHING, check_enclosure, checked_cage
from cageik_cli.errors import InputError
from cageik_cli.mesh import TriMesh
from tests.shapes import ball, box, concave, finer, octahedron, rotation


def changed(mesh, faces=None, vertices=None):
    return TriMesh(
        mesh.vertices if vertices is None else vertices, mesh.faces if faces is None else faces
    )


def two_boxes(shift):
    a = box()
    return TriMesh(
        np.concatenate([a.vertices, a.vertices + shift]), np.concatenate([a.faces, a.faces + 8])
    )


def pinched():
    """Two boxes that share one corner: every edge has two faces, the corner two fans."""
    mesh = two_boxes(np.array([2.0, 2, 2]))
    shared = int(np.flatnonzero((mesh.vertices[:8] == 1).all(axis=1))[0])
    other = 8 + int(np.flatnonzero((mesh.vertices[8:] == 1).all(axis=1))[0])
    faces = np.where(mesh.faces == other, shared, mesh.faces)
    faces = np.where(faces > other, faces - 1, faces)
    return TriMesh(np.delete(mesh.vertices, other, axis=0), faces)


def zero_area():
    """A divided box with the middle of an edge moved onto its end's line, beside a corner."""
    mesh = finer(box(), 1)
    a, b, c = mesh.faces[0]
    vertices = mesh.vertices.copy()
    vertices[a] = (vertices[b] + vertices[c]) / 2
    return changed(mesh, vertices=vertices)


FAULTS = {
    "open": (changed(box(), box().faces[2:]), r"is open: no second face at 4 edges \(.*\); close"),
    "doubled face": (
        changed(box(), np.vstack([box().faces, box().faces[:1]])),
        "has faces that repeat others: face 12; delete it",
    ),
    "third face at an edge": (
        TriMesh(np.vstack([box().vertices, [[3.0, 0, 0]]]), np.vstack([box().faces, [[0, 1, 8]]])),
        "more than two faces meet at edge 0-1",
    ),
    "repeated vertex": (
        changed(box(), np.vstack([box().faces, [[0, 0, 1]]])),
        "has a vertex twice in a face: face 12; delete it",
    ),
    "no area": (zero_area(), "degenerate, corners on a line, at face 0"),
    "two components": (two_boxes(np.array([5.0, 0, 0])), r"has 2 components \(of 8, 8 vertices\)"),
    "turned face": (
        changed(box(), np.vstack([box().faces[:1, ::-1], box().faces[1:]])),
        "has neighbours facing opposite ways at 3 edges",
    ),
    "lone vertex": (
        changed(box(), vertices=np.vstack([box().vertices, [[0, 0, 0]]])),
        "can move nothing: vertex 8; delete it",
    ),
    "pinched": (pinched(), "parts touch in a point at vertex 7"),
}


@pytest.mark.parametrize(("cage", "says"), FAULTS.values(), ids=FAULTS.keys())
def test_every_fault_has_its_sentence(cage, says):
    with pytest.raises(InputError, match=says) as caught:
        checked_cage(cage)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cage", [box(), concave(), ball(1)], ids=["box", "concave", "ball"])
def test_clean_cages_pass_unchanged(cage):
    checked, notes = checked_cage(cage)
    assert checked is cage
    assert notes == ()


def test_an_inward_cage_is_turned_and_said_so():
    checked, notes = checked_cage(concave().flipped())
    assert checked.volume == pytest.approx(3)
    assert len(notes) == 1
    assert "turned outward" in notes[0]


def test_many_numbers_are_cut_to_ten():
    cage = changed(box(), vertices=np.vstack([box().vertices, np.zeros((12, 3))]))
    with pytest.raises(
        InputError, match=r"nothing: 12 vertices \(8, 9, .*, 17, \.\.\.\); delete them$"
    ):
        checked_cage(cage)


def test_vertices_outside_are_counted_measured_and_named():
    rest = ball(2, 0.9)
    vertices = rest.vertices.copy()
    vertices[5] = [1.5, 0, 0]
    vertices[7] = [0, 1.1, 0]
    rest = changed(rest, vertices=vertices)
    with pytest.raises(InputError) as caught:
        check_enclosure(box(), rest)
    worst = f"{100 * 0.5 / rest.diagonal:.3g} %"
    assert re.match(
        rf"2 of {len(vertices)} vertices .* worst by {worst} .* 5, 7 ", str(caught.value)
    )
    assert "swapped" not in str(caught.value)


def test_a_cage_finer_than_the_model_is_asked_whether_they_are_swapped():
    with pytest.raises(InputError, match="has 66 vertices and the model 8: are they swapped"):
        check_enclosure(ball(2), box())


def test_a_vertex_outside_by_rounding_is_moved_onto_the_cage():
    rest = box(1.0)
    vertices = rest.vertices * np.where(np.arange(8) == 3, 1 + 0.1 * TOUCHING, 0.5)[:, None]
    fitted = check_enclosure(box(), changed(rest, vertices=vertices))
    np.testing.assert_allclose(fitted.points[3], rest.vertices[3], rtol=1e-15)
    np.testing.assert_array_equal(np.delete(fitted.points, 3, 0), np.delete(vertices, 3, 0))
    vertices[3] = rest.vertices[3] * (1 + 10 * TOUCHING)
    with pytest.raises(InputError, match="1 of 8 vertices"):
        check_enclosure(box(), changed(rest, vertices=vertices))


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(1e-3, 1e3), st.floats(-100, 100))
def test_the_verdict_does_not_depend_on_place_turn_or_scale(seed, scale, shift):
    turn = rotation(seed)

    def moved(mesh):
        return changed(mesh, vertices=scale * (mesh.vertices @ turn.T + shift))

    assert len(check_enclosure(moved(box()), moved(octahedron(0.9))).points) == 6
    with pytest.raises(InputError, match="6 of 6 vertices"):
        check_enclosure(moved(box()), moved(octahedron(1.1)))
