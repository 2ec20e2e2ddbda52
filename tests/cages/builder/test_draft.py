import numpy as np
import pytest

from cageik_cli.cages.builder.draft import Draft, Edit, collapse_edge, flip_edge, move_vertex
from cageik_cli.cages.builder.polish import find_least_move, improve_angles, settle, tighten
from cageik_cli.cages.check.faults import find_cage_faults
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import ball, box, concave, finer, octahedron


@pytest.fixture
def draft():
    """A cube of side 2 around a ball of radius 0.9."""
    return Draft(finer(box(), 1), ball(4, 0.9).vertices, 0.05)


def vertex_at(draft, place):
    return int(np.linalg.norm(draft.vertices - place, axis=1).argmin())


def test_a_move_that_keeps_clear_is_made(draft):
    corner = vertex_at(draft, (1, 1, 1))
    assert draft.take(move_vertex(draft, corner, np.array([0.93, 0.93, 0.93])))
    np.testing.assert_array_equal(draft.vertices[corner], [0.93, 0.93, 0.93])
    assert find_cage_faults(draft.to_mesh()) == ()


@pytest.mark.parametrize("place", [(0.92, 0, 0), (0.5, 0, 0), (-3, 0, 0)])
def test_a_move_into_the_clearance_or_over_samples_is_not_made(draft, place):
    middle = vertex_at(draft, (1, 0, 0))
    assert not draft.take(move_vertex(draft, middle, np.array(place, float)))
    np.testing.assert_array_equal(draft.vertices[middle], [1, 0, 0])


def test_a_move_that_makes_faces_meet_is_not_made(draft):
    empty = Draft(draft.to_mesh(), np.full((1, 3), 50.0), 0.05)
    middle = vertex_at(empty, (1, 0, 0))
    assert not empty.take(move_vertex(empty, middle, np.array([-1.5, 0.1, 0.2])))


def test_a_move_that_folds_faces_onto_each_other_is_not_made():
    """The upper half of an octahedron goes down into the lower one."""
    draft = Draft(octahedron(1.0), np.full((1, 3), 50.0), 0.01)
    top = vertex_at(draft, (0, 0, 1))
    assert not draft.take(move_vertex(draft, top, np.array([0, 0, -0.95])))
    assert draft.take(move_vertex(draft, top, np.array([0, 0, -0.3])))


def test_a_split_changes_neither_volume_nor_soundness(draft):
    start, stop = draft.faces[0, :2]
    before = draft.to_mesh()
    draft.split(int(start), int(stop))
    after = draft.to_mesh()
    assert len(after.vertices) == len(before.vertices) + 1
    assert after.volume == pytest.approx(before.volume)
    assert after.is_closed


def test_a_flip_turns_an_edge_and_keeps_the_surface_closed():
    draft = Draft(ball(2), np.zeros((1, 3)), 0.0)
    start, stop = map(int, draft.faces[0, :2])
    edit = flip_edge(draft, start, stop)
    assert draft.take(edit)
    assert draft.to_mesh().is_closed
    assert stop not in draft.neighbours(start)
    assert find_cage_faults(draft.to_mesh()) == ()


def test_an_edge_whose_other_diagonal_exists_is_not_flipped():
    tetrahedron = Draft(octahedron(), np.zeros((1, 3)), 0.0)
    merged = collapse_edge(tetrahedron, 0, 2, np.array([0.5, 0.5, 0]))
    assert merged is None or tetrahedron.take(merged)
    flips = [flip_edge(tetrahedron, a, b) for a, b in tetrahedron.to_mesh().edges.ends]
    assert any(flip is None for flip in flips)


def test_a_collapse_keeps_the_surface_closed_and_takes_one_vertex():
    draft = Draft(ball(3), np.zeros((1, 3)), 0.0)
    start, stop = map(int, draft.faces[10, :2])
    count = draft.count
    edit = collapse_edge(draft, start, stop, 1.05 * draft.vertices[start])
    assert draft.take(edit)
    assert draft.count == count - 1
    assert find_cage_faults(draft.to_mesh()) == ()


def test_a_vertex_settles_where_the_samples_have_their_clearance(draft):
    middle = vertex_at(draft, (1, 0, 0))
    edit = settle(draft, move_vertex(draft, middle, np.array([0.91, 0, 0])))
    assert draft.keeps_clear(edit)
    assert 0.95 <= edit.position[0] < 1


def test_the_least_move_is_the_shortest_that_is_enough():
    directions = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]])
    np.testing.assert_allclose(
        find_least_move(directions, np.array([1.0, 2, -5])), [1, 2, 0], atol=1e-12
    )
    against = np.array([[1.0, 0, 0], [-1, 0, 0]])
    np.testing.assert_array_equal(find_least_move(against, np.array([1.0, 1])), np.zeros(3))


def test_a_sample_that_an_edit_sweeps_over_lacks_its_distance_and_the_clearance(draft):
    """The middle of a side of the cube goes to 0.5; one sample is left outside, one keeps clear."""
    middle = vertex_at(draft, (1, 0, 0))
    edit = move_vertex(draft, middle, np.array([0.5, 0, 0]))
    directions, lack = draft.offsets(edit, np.array([[0.9, 0, 0], [0.2, 0, 0]]))
    distances = draft.measure_distances(edit, np.array([[0.9, 0, 0], [0.2, 0, 0]]))
    np.testing.assert_allclose(lack, draft.clearance + distances * [1, -1], rtol=1e-12)
    assert (directions[:, 0] > 0).all()
    assert np.linalg.norm(directions, axis=1).max() <= 1 + 1e-12


def test_faces_without_area_give_no_offsets():
    cage = ball(1, 1.0)
    draft = Draft(cage, np.array([[0.0, 0.0, 0.9]]), 0.2)
    start, stop = cage.edges.ends[0].tolist()
    edit = collapse_edge(draft, start, stop, cage.vertices[start])
    flat = Edit(edit.removed, np.array([[start, stop, stop]]), start, edit.position)
    directions, lack = draft.offsets(flat, np.array([[0.0, 0.0, 0.9]]))
    assert np.isfinite(directions).all()
    assert np.isfinite(lack).all()


@pytest.mark.parametrize("kind", ["move", "collapse", "flip"])
def test_an_edit_grows_the_cage_by_the_volume_that_it_adds(draft, kind):
    start, stop = draft.to_mesh().edges.ends[0].tolist()
    edit = {
        "move": move_vertex(draft, start, np.array([1.2, 1.1, 0.9])),
        "collapse": collapse_edge(draft, start, stop, draft.vertices[start] * 1.1),
        "flip": flip_edge(draft, start, stop),
    }[kind]
    before, grown = draft.to_mesh().volume, draft.growth(edit)
    draft.apply(edit)
    assert draft.to_mesh().volume - before == pytest.approx(grown, rel=1e-9, abs=1e-12)


def test_rounding_does_not_choose_between_edits_that_mend_a_needle_alike():
    """On a plane, many moves of a vertex make its angles as large as they are wanted."""
    cube = finer(box(), 2)
    cage = TriMesh(
        cube.vertices + 0.45 * (cube.vertices == [1, 0, 0]).all(axis=1)[:, None] * [0, 1, 0],
        cube.faces,
    )
    found = []
    for seed in range(5):
        noise = 1e-8 * np.random.default_rng(seed).uniform(-1, 1, cage.vertices.shape)
        draft = Draft(cage.move(cage.vertices + noise), ball(2, 0.2).vertices, 0.05)
        assert improve_angles(draft, draft.count) > 0
        found.append(draft.vertices)
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=0, atol=1e-6)


def test_rounding_does_not_choose_between_the_faces_at_an_edge_that_is_nearest_to_samples():
    """Inside an L, points before its inner edge are as near to one face there as to the other."""
    side = np.linspace(0.55, 0.75, 5)
    samples = np.stack(np.meshgrid(side, side, 4 * side - 2), axis=-1).reshape(-1, 3)
    found = []
    for seed in range(4):
        noise = 1e-8 * np.random.default_rng(seed).uniform(-1, 1, samples.shape)
        draft = Draft(finer(concave(), 1), samples + noise, 0.05)
        assert tighten(draft, draft.samples) > 0
        found.append(draft.vertices)
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=0, atol=1e-6)
