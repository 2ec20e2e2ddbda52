"""Quads in the place of triangles: drafts under edit, and cuts by either diagonal."""

import numpy as np
import pytest

from cageik_cli.cages.builder import quads as quads_module
from cageik_cli.cages.builder.draft import move_vertex
from cageik_cli.cages.builder.frame import find_partners, reflect
from cageik_cli.cages.builder.judge import Demand, judge
from cageik_cli.cages.builder.quads import (
    PairedQuadDraft,
    Pairing,
    QuadDraft,
    find_failing,
    find_near_cuts,
    find_near_quads,
    fit_cuts,
    join_quads,
    make_quads,
    measure_folds,
    name_diagonals,
    push_cuts,
    turn_diagonals,
)
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.surface import closest_points
from tests.shapes import ball, box, changed, finer, merged, moved

FAR = np.full((1, 3), 50.0)


def pair(cage):
    return Pairing(cage, 0.3).choose(set(), set())


def list_quads(cage):
    counts, corners = cage.polygons.corner_counts, cage.polygons.corners
    return [ring for ring in np.split(corners, np.cumsum(counts)[:-1]) if len(ring) == 4]


def make_demand(cage, model):
    """A demand of the model, and the cage in its units."""
    demand = Demand(model, BuildSettings(len(cage.vertices), 0.005))
    return TriMesh(demand.frame.to_units(cage.vertices), cage.faces), demand


def make_small():
    """A coarse cage of triangles around a ball."""
    return make_demand(changed(ball(1), vertices=1.5 * ball(1).vertices), ball(2))


def leave_loose(monkeypatch):
    """Leave out what takes most of the time, and makes no quads."""
    monkeypatch.setattr(quads_module, "tighten", lambda *_: 0)
    monkeypatch.setattr(quads_module, "PAIRED_COSINES", (0.3,))
    monkeypatch.setattr(quads_module, "fit_cuts", lambda cage, *_: cage)


@pytest.fixture(scope="module")
def quad_cage():
    """A cage of quads around a ball."""
    cage, demand = make_demand(changed(ball(2), vertices=1.25 * ball(2).vertices), ball(3))
    return make_quads(cage, demand), demand


@pytest.mark.slow
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


@pytest.mark.slow
def test_no_quad_folds_by_more_than_45_degrees_by_either_diagonal(quad_cage):
    cage, _ = quad_cage
    for ring in map(np.array, list_quads(cage)):
        for turned in (ring, np.roll(ring, 1)):
            a, b, c, d = cage.vertices[turned]
            one, other = np.cross(b - a, c - a), np.cross(c - a, d - a)
            cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
            assert cosine >= np.cos(np.pi / 4) - 1e-9


@pytest.mark.parametrize("angle", [0, 30, 44, 46, 120])
@pytest.mark.parametrize("turn", [0, 1])
def test_a_fold_is_the_angle_between_the_halves_by_the_worse_diagonal(angle, turn):
    """A square that is folded along its first diagonal folds less along the other."""
    up = np.radians(180 - angle)
    corners = np.array([[0, -1, 0], [1, 0, 0], [0, 1, 0], [np.cos(up), 0, np.sin(up)]], dtype=float)
    (fold,) = measure_folds(corners, np.roll([[0, 1, 2, 3]], turn, axis=1))
    assert fold == pytest.approx(angle, abs=1e-6)


def test_quads_that_fold_stay_triangles(monkeypatch):
    leave_loose(monkeypatch)
    cage, demand = make_small()
    monkeypatch.setattr(quads_module, "MAX_FOLD", 180.0)
    made = make_quads(cage, demand)
    loose = list_quads(made)
    limit = float(np.median(measure_folds(made.vertices, np.array(loose))))
    monkeypatch.setattr(quads_module, "MAX_FOLD", limit)
    kept = make_quads(cage, demand)
    assert 0 < len(list_quads(kept)) < len(loose)
    assert measure_folds(kept.vertices, np.array(list_quads(kept))).max() <= limit


def test_quads_that_fail_are_left_as_triangles(monkeypatch):
    cage, demand = make_small()
    found = []

    def fail_first(_, quads, *__):
        found.append(quads)
        return np.arange(len(quads)) < (3 if len(found) == 1 else 0)

    leave_loose(monkeypatch)
    monkeypatch.setattr(quads_module, "find_failing", fail_first)
    assert len(list_quads(make_quads(cage, demand))) == len(found[0]) - 3


def test_a_cage_of_which_no_quad_passes_is_left_as_it_is(monkeypatch):
    leave_loose(monkeypatch)
    cage, demand = make_small()
    monkeypatch.setattr(quads_module, "find_failing", lambda _, quads, *__: quads[:, 0] >= 0)
    assert make_quads(cage, demand) is cage


def test_a_quad_that_fails_takes_its_mirror_image_along(monkeypatch):
    """Else the cage would be lopsided."""
    leave_loose(monkeypatch)
    demand = Demand(ball(2), BuildSettings(18, 0.005), Mirror(np.eye(3)[0], np.zeros(3)))
    cage = TriMesh(demand.frame.to_units(1.5 * ball(1).vertices), ball(1).faces)
    plane, found = Mirror(np.eye(3)[demand.axis], np.zeros(3)), []

    def fail_one(moved, quads, *_):
        found.append(quads)
        is_beside = (moved.vertices[quads[:, [0, 2]], demand.axis] != 0).any(axis=1)
        return (np.arange(len(quads)) == np.flatnonzero(is_beside)[0]) & (len(found) == 1)

    monkeypatch.setattr(quads_module, "find_failing", fail_one)
    made = make_quads(cage, demand)
    assert len(list_quads(made)) == len(found[0]) - 2
    assert plane.mirrors_polygons(made)


def test_pairs_are_chosen_again_without_those_that_fail(monkeypatch):
    """The first pair never holds the model, and leaves its triangles to others."""
    leave_loose(monkeypatch)
    cage, demand = make_small()
    asked = []

    def find(_, quads, __):
        asked.append(name_diagonals(quads))
        return np.array([edge == asked[0][0] for edge in asked[-1]], bool)

    monkeypatch.setattr(quads_module, "find_near_quads", find)
    quads = np.array(list_quads(make_quads(cage, demand)))
    assert len(quads)
    assert asked[0][0] not in name_diagonals(quads)
    assert not any(asked[0][0] in later for later in asked[1:])


def make_draft(cage, samples=FAR, clearance=0.01):
    """A draft of all quads of a cage."""
    draft = QuadDraft(cage, samples, clearance)
    for quad in pair(cage):
        draft.add(quad)
    return draft


def find_vertex(draft, place):
    return int(np.linalg.norm(draft.vertices - place, axis=1).argmin())


def test_a_move_is_made_only_if_both_cuts_stay_sound():
    """The corner of a cube goes in: one cut of a side is over it then, the other one below."""
    draft = make_draft(finer(box(), 1))
    corner = find_vertex(draft, [1, 1, 1])
    assert draft.take(move_vertex(draft, corner, np.array([0.9, 0.9, 0.9])))
    assert not draft.take(move_vertex(draft, corner, np.array([-3.0, 0.1, 0.2])))


@pytest.mark.parametrize("has_quads", [True, False])
def test_a_sample_is_held_by_both_diagonals(has_quads):
    """Below the middle of a square of triangles whose edge goes past it, in a corner's reach."""
    cage = box(2.0)
    side = Pairing(cage, 0.3).choose(set(), set())
    lone = side[:1]
    low = cage.vertices[lone[0]].mean(axis=0)
    draft = QuadDraft(cage, 0.8 * low[None], 0.1)
    if has_quads:
        draft.add(lone[0])
    # The corner off the own diagonal: with it go the other one's triangles, over the middle.
    corner = int(lone[0][1])
    inwards = cage.vertices[corner] - 0.7 * low
    assert draft.take(move_vertex(draft, corner, inwards)) != has_quads


def test_a_pair_is_held_only_if_its_other_halves_are_clear_and_in_shape():
    cage = box(2.0)
    quad = Pairing(cage, 0.3).choose(set(), set())[0]
    middle = cage.vertices[quad].mean(axis=0)
    faces = len(cage.faces)
    for sample, angle, is_held in ((0.5, 5.0, True), (0.99, 5.0, False), (0.5, 50.0, False)):
        draft = QuadDraft(cage, sample * middle[None], 0.1)
        assert draft.hold(quad, angle) == is_held
        assert len(draft.faces) == faces + 2 * is_held


def test_vertices_walk_to_their_places_or_as_far_as_the_cage_is_sound():
    cage = ball(1)
    draft = make_draft(cage, np.zeros((1, 3)), 0.1)
    draft.walk(0.5 * cage.vertices, 5.0)
    np.testing.assert_allclose(draft.vertices, 0.5 * cage.vertices, rtol=0, atol=1e-12)
    draft.walk(0.1 * cage.vertices, 5.0)
    assert not np.allclose(draft.vertices, 0.1 * cage.vertices)
    distance = closest_points(TriMesh(draft.vertices, draft.faces), np.zeros((1, 3))).distance
    assert distance[0] >= 0.1


def test_a_symmetric_cage_with_quads_stays_its_own_mirror_image():
    cage, axis = ball(2), 0
    partners = find_partners(cage.vertices, axis)
    draft = PairedQuadDraft(cage, FAR, 0.01, axis)
    for quad in Pairing(cage, 0.3, partners).choose(set(), set()):
        draft.add(quad)
    places = cage.vertices * (1 + 0.1 * np.random.default_rng(0).random((len(cage.vertices), 1)))
    draft.walk(places, 5.0)
    assert not np.array_equal(draft.vertices, cage.vertices)
    np.testing.assert_array_equal(draft.vertices[partners], reflect(draft.vertices, axis))


def ridge(share):
    """A box whose one side is a ridge, its quads, and a model with a ball below the ridge.

    `share` says where the ball is: the share of the way from the other diagonal to the ridge.
    """
    quads = pair(box())
    lifted = box().vertices.copy()
    lifted[quads[0][[0, 2]]] *= 1.6
    top, low = lifted[quads[0][[0, 2]]].mean(axis=0), lifted[quads[0][[1, 3]]].mean(axis=0)
    middle = share * top + (1 - share) * low
    model = merged(moved(ball(2), middle, 0.02), box(0.5))
    return *make_demand(TriMesh(lifted, box().faces), model), quads


def test_the_quads_of_a_box_cut_by_either_diagonal_bound_the_same_volume():
    cage, quads = box(), pair(box())
    turned = turn_diagonals(cage, quads)
    assert turned.is_closed
    np.testing.assert_allclose(turned.volume, cage.volume, rtol=1e-12, atol=0)
    own, other = ({tuple(sorted(f)) for f in mesh.faces.tolist()} for mesh in (cage, turned))
    assert not own & other
    joined = join_quads(cage, quads[:4])
    np.testing.assert_array_equal(np.sort(joined.polygons.corner_counts), [3] * 4 + [4] * 4)
    assert {tuple(sorted(face)) for face in joined.faces.tolist()} == own


def test_a_quad_whose_other_diagonal_cuts_the_model_is_found():
    cage, demand, quads = ridge(0.9)
    assert find_failing(cage, quads[:1], demand, 0.0).all()
    assert not find_failing(cage, quads[1:3], demand, 0.0).all()


def test_a_quad_that_is_too_near_by_its_other_diagonal_alone_is_found():
    cage, demand, quads = ridge(0.0)
    np.testing.assert_array_equal(find_near_quads(cage, quads, demand), np.arange(len(quads)) == 0)


def test_a_push_makes_room_for_both_diagonals():
    cage, demand, quads = ridge(0.0)
    assert len(find_near_cuts(cage, quads, demand))
    pushed = push_cuts(cage, quads, demand.samples, 1.5 * demand.clearance)
    assert len(find_near_cuts(pushed, quads, demand)) == 0


def test_quads_whose_halves_meet_by_mixed_diagonals_are_at_fault():
    """A corner of a side is moved through the cube and out of the other end."""
    cage, demand = make_demand(finer(box(), 1), box(0.2))
    quads = pair(cage)
    assert not find_failing(cage, quads, demand, 0.0).any()
    vertices = cage.vertices.copy()
    vertices[quads[0][1]] *= -0.9
    failing = find_failing(TriMesh(vertices, cage.faces), quads, demand, 0.0)
    assert failing[0]


def test_needles_are_at_fault():
    cage, demand = make_demand(box(), box(0.2))
    quads = pair(cage)
    assert not find_failing(cage, quads, demand, 40.0).any()
    assert find_failing(cage, quads, demand, 50.0).all()


def test_a_fit_brings_both_cuts_to_the_clearance():
    """A ball of twice the size shrinks to the model, but for how flat faces are."""
    cage, demand = make_demand(changed(ball(2), vertices=2 * ball(2).vertices), ball(3))
    quads = pair(cage)
    fitted = fit_cuts(cage, quads, demand)
    for cut in (fitted, turn_diagonals(fitted, quads)):
        before = closest_points(cage, demand.samples).distance.mean()
        after = closest_points(cut, demand.samples).distance.mean()
        assert after < 0.15 * before
