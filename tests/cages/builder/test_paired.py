import numpy as np
import pytest

from cageik_cli.cages.builder.collapse import collapse_edges
from cageik_cli.cages.builder.draft import PairedDraft, collapse_edge, flip_edge, move_vertex
from cageik_cli.cages.builder.frame import add_image, cut_half, find_partners, reflect
from cageik_cli.cages.check.faults import find_cage_faults
from cageik_cli.geometry.mirror import Mirror
from tests.shapes import ball, moved

PLANE = Mirror([1.0, 0, 0], [0.0, 0, 0])


def make_cage(levels=1):
    """A ball that the plane x = 0 cuts along edges, its own mirror image."""
    return add_image(cut_half(moved(ball(levels), turn=4), 0), 0)


def make_draft(cage, samples=((0.0, 0, 0),)):
    return PairedDraft(cage, np.array(samples, float), 0.01, axis=0)


def assert_mirrored(cage):
    assert PLANE.find_pairs(cage.vertices, tolerance=0) is not None
    assert PLANE.mirrors_polygons(cage)
    assert list(find_cage_faults(cage)) == []
    sides = np.sign(cage.vertices[cage.edges.ends, 0])
    assert (sides.prod(axis=1) >= 0).all()  # no edge crosses the plane


@pytest.mark.parametrize("count", [16, 27, 40])
@pytest.mark.parametrize("evenness", [1e-4, 0.03])
def test_pairs_collapse_to_a_cage_that_is_its_own_mirror_image(count, evenness):
    cage = collapse_edges(make_cage(3), count, None, evenness, axis=0)
    assert count - 1 <= len(cage.vertices) <= count
    assert_mirrored(cage)
    assert cage.volume > 0.6 * make_cage(3).volume


def find_vertex(cage, *, on_plane):
    """Return a vertex of the plane, or the one that is farthest from it."""
    heights = np.abs(cage.vertices[:, 0])
    return int((-heights if on_plane else heights).argmax())


def test_partners_move_together():
    cage = make_cage()
    draft, vertex = make_draft(cage), find_vertex(cage, on_plane=False)
    goal = 1.1 * cage.vertices[vertex]
    assert draft.take(move_vertex(draft, vertex, goal))
    partner = find_partners(cage.vertices, 0)[vertex]
    np.testing.assert_array_equal(draft.vertices[[vertex, partner]], [goal, reflect(goal, 0)])
    assert_mirrored(draft.to_mesh())


def test_a_vertex_of_the_plane_stays_on_it():
    cage = make_cage()
    draft, vertex = make_draft(cage), find_vertex(cage, on_plane=True)
    goal = 1.1 * cage.vertices[vertex] + [0.02, 0, 0]
    assert draft.take(move_vertex(draft, vertex, goal))
    np.testing.assert_array_equal(draft.vertices[vertex], goal * [0, 1, 1])
    assert_mirrored(draft.to_mesh())


def test_an_edit_that_one_side_cannot_make_is_made_on_neither():
    """The mirror image of the move would come too near to a sample."""
    cage = make_cage()
    vertex = find_vertex(cage, on_plane=False)
    goal = 1.1 * cage.vertices[vertex]
    draft = make_draft(cage, [reflect(goal, 0)])
    before = draft.vertices.copy(), draft.faces.copy()
    assert not draft.take(move_vertex(draft, vertex, goal))
    np.testing.assert_array_equal(draft.vertices, before[0])
    np.testing.assert_array_equal(draft.faces, before[1])


def test_a_vertex_stays_on_its_side():
    cage = make_cage()
    draft, vertex = make_draft(cage), find_vertex(cage, on_plane=False)
    goal = cage.vertices[vertex] * [1e-9, 1, 1]
    assert not draft.take(move_vertex(draft, vertex, goal))
    assert not draft.take(move_vertex(draft, vertex, reflect(cage.vertices[vertex], 0)))


def list_edges(draft, count):
    """Return some edges with so many ends on the plane."""
    cage = draft.to_mesh()
    ends = cage.edges.ends
    return ends[(cage.vertices[ends, 0] == 0).sum(axis=1) == count][::5].tolist()


@pytest.mark.parametrize("on_plane", [0, 1, 2])
def test_edges_collapse_in_pairs_and_keep_the_plane(on_plane):
    made, cage = 0, make_cage()
    for ends in list_edges(make_draft(cage), on_plane):
        draft = make_draft(cage)
        start, stop = sorted(ends, key=lambda v: cage.vertices[v, 0] != 0)
        edit = collapse_edge(draft, start, stop, 1.02 * cage.vertices[[start, stop]].mean(axis=0))
        if edit is not None and draft.take(edit):
            made += 1
            assert_mirrored(draft.to_mesh())
            assert draft.count == len(cage.vertices) - (1 if on_plane == 2 else 2)
    assert made > 0


def test_the_plane_keeps_its_vertices():
    """To merge one into a vertex beside it would open the line along which the sides meet."""
    cage = make_cage()
    draft = make_draft(cage)
    for start, stop in list_edges(draft, 1):
        beside, at = (start, stop) if cage.vertices[stop, 0] == 0 else (stop, start)
        edit = collapse_edge(draft, beside, at, 1.02 * cage.vertices[beside])
        assert edit is None or not draft.take(edit)


@pytest.mark.parametrize(("on_plane", "is_made"), [(0, True), (2, False)])
def test_edges_flip_in_pairs_but_not_across_the_plane(on_plane, is_made):
    cage, made = make_cage(), 0
    for start, stop in list_edges(make_draft(cage), on_plane):
        draft = make_draft(cage)
        edit = flip_edge(draft, start, stop)
        if edit is not None and draft.take(edit):
            made += 1
            assert_mirrored(draft.to_mesh())
    assert (made > 0) == is_made


@pytest.mark.parametrize(("on_plane", "added"), [(0, 2), (1, 2), (2, 1)])
def test_edges_split_in_pairs(on_plane, added):
    draft = make_draft(make_cage())
    before = draft.count
    start, stop = list_edges(draft, on_plane)[0]
    assert draft.count_split(start, stop) == added
    middle = draft.split(start, stop)
    assert draft.count == before + added
    assert_mirrored(draft.to_mesh())
    assert draft.take(move_vertex(draft, middle, 1.05 * draft.vertices[middle]))
    assert_mirrored(draft.to_mesh())
