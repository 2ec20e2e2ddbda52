"""Cages with quads under edit."""

import numpy as np
import pytest

from cageik_cli.cages.builder.pairing import Pairing
from cageik_cli.cages.builder.polish import move_vertex
from cageik_cli.cages.builder.quads import PairedQuadDraft, QuadDraft
from cageik_cli.cages.builder.symmetry import find_partners, reflect
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from tests.shapes import ball, box, finer

FAR = np.full((1, 3), 50.0)


def make_draft(cage, samples=FAR, clearance=0.01):
    """A draft of all quads of a cage."""
    draft = QuadDraft(cage, samples, clearance)
    for quad in Pairing(cage, 0.3).choose(set(), set()):
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
