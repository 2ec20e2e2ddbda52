"""Quads in the place of triangles."""

import numpy as np
import pytest

from cageik_cli.cages.building import quads as quads_module
from cageik_cli.cages.building.judge import Demand, judge
from cageik_cli.cages.building.polish import move_vertex
from cageik_cli.cages.building.quads import QuadDraft, make_quads, pair_triangles
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import TETRAHEDRON, ball, box, changed, finer, merged, moved, octahedron


def list_quads(cage):
    counts, corners = cage.polygons.corner_counts, cage.polygons.corners
    return [ring for ring in np.split(corners, np.cumsum(counts)[:-1]) if len(ring) == 4]


def make_demand(cage, model):
    """A demand of the model, and the cage in its units."""
    demand = Demand(model, BuildSettings(len(cage.vertices), 0.005))
    return TriMesh(demand.frame.to_units(cage.vertices), cage.faces), demand


def test_the_triangles_of_a_box_are_paired_to_its_sides():
    quads = pair_triangles(box())
    assert len(quads) == 6
    # All corners of a side have a coordinate in common.
    assert (np.ptp(box().vertices[quads], axis=1).min(axis=1) == 0).all()


def test_no_triangle_is_in_two_quads_and_vertices_keep_three_edges():
    cage = ball(2)
    quads = pair_triangles(cage)
    halves = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    faces = {tuple(sorted(face)) for face in cage.faces.tolist()}
    named = [tuple(sorted(half)) for half in halves.tolist()]
    assert len(set(named)) == len(named)
    assert set(named) <= faces
    lost = np.bincount(quads[:, [0, 2]].ravel(), minlength=len(cage.vertices))
    assert (np.bincount(cage.faces.ravel()) - lost >= 3).all()
    assert len(quads) >= 0.35 * len(faces)


def test_sharp_edges_and_diagonals_that_are_edges_make_no_quad():
    assert len(pair_triangles(TETRAHEDRON)) == 0
    flat = changed(octahedron(), vertices=octahedron().vertices * [1, 1, 0.02])
    sides = flat.vertices[pair_triangles(flat)]
    assert (np.sign(sides[:, :, 2]).min(axis=1) * np.sign(sides[:, :, 2]).max(axis=1) >= 0).all()


@pytest.fixture(scope="module")
def quad_cage():
    """A cage of quads around a ball."""
    cage, demand = make_demand(changed(ball(2), vertices=1.25 * ball(2).vertices), ball(3))
    return make_quads(cage, demand), demand


def test_most_faces_are_quads_and_the_cage_is_closed(quad_cage):
    cage, demand = quad_cage
    assert judge(TriMesh(cage.vertices, cage.faces), demand).faults == ()
    counts = cage.polygons.corner_counts
    assert (counts == 4).mean() >= 0.7
    np.testing.assert_array_equal(cage.fan_triangulated.faces, cage.faces)


@pytest.mark.slow
def test_either_diagonal_of_any_quad_holds_the_model(quad_cage):
    """All of them at once, and six choices for each quad."""
    cage, demand = quad_cage
    quads = list_quads(cage)
    kept = cage.faces[2 * len(quads) :]
    generator = np.random.default_rng(0)
    choices = [np.zeros(len(quads), int), np.ones(len(quads), int)]
    choices += [generator.integers(0, 2, len(quads)) for _ in range(6)]
    for chosen in choices:
        turned = [np.roll(ring, -turn) for ring, turn in zip(quads, chosen, strict=True)]
        halves = [[r[[0, 1, 2]], r[[0, 2, 3]]] for r in turned]
        faces = np.concatenate([np.reshape(halves, (-1, 3)), kept])
        cut = TriMesh(cage.vertices, faces)
        assert judge(cut, demand).faults == ()


def test_quads_that_fail_are_left_as_triangles(monkeypatch):
    cage, demand = make_demand(changed(ball(2), vertices=1.25 * ball(2).vertices), ball(3))
    whole = pair_triangles(cage)
    monkeypatch.setattr(quads_module, "_clear_quads", lambda cage, _, __, samples: (cage, samples))
    monkeypatch.setattr(quads_module, "_tighten", lambda cage, *_: cage)
    tests = iter([np.arange(len(whole)) < 3, np.zeros(len(whole) - 3, bool)])
    monkeypatch.setattr(quads_module, "_find_failing", lambda *_: next(tests))
    assert len(list_quads(make_quads(cage, demand))) == len(whole) - 3
    monkeypatch.setattr(quads_module, "_find_failing", lambda _, quads, *__: quads[:, 0] >= 0)
    assert make_quads(cage, demand) is cage


def test_a_quad_whose_other_diagonal_cuts_the_model_is_found():
    """A ridge of the cage holds a bar below it; the other diagonal of its two faces does not."""
    quads = pair_triangles(box())
    lifted = box().vertices.copy()
    lifted[quads[0][[0, 2]]] *= 1.6
    cage = TriMesh(lifted, box().faces)
    middle = 0.95 * lifted[quads[0][[0, 2]]].mean(axis=0)
    model = merged(moved(ball(2), middle, 0.02), box(0.5))
    placed, demand = make_demand(cage, model)
    failing = quads_module._find_failing(placed, quads[:1], demand, 0.0)
    assert failing.all()


def test_a_move_is_made_only_if_both_cuts_stay_sound():
    """The corner of a cube goes in: one cut of a side is over it then, the other one below."""
    cage = finer(box(), 1)
    quads = pair_triangles(cage)
    cuts = cage, quads_module._turn_diagonals(cage, quads)
    draft = QuadDraft(cuts, np.full((1, 3), 50.0), 0.01)
    corner = int(np.linalg.norm(draft.vertices - [1, 1, 1], axis=1).argmin())
    assert draft.take(move_vertex(draft, corner, np.array([0.9, 0.9, 0.9])))
    assert not draft.take(move_vertex(draft, corner, np.array([-3.0, 0.1, 0.2])))
