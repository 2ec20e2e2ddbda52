"""Pairs of triangles that become quads, and flips that make more of them."""

from itertools import islice

import numpy as np
import pytest

from cageik_cli.cages.builder.draft import Draft, flip_edge
from cageik_cli.cages.builder.frame import find_partners
from cageik_cli.cages.builder.quads import Pairing, measure_ridges, name_diagonals
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles
from tests.shapes import TETRAHEDRON, ball, box, changed, finer, octahedron


def pair(cage):
    return Pairing(cage, 0.3).choose(set(), set())


def test_the_triangles_of_a_box_are_paired_to_its_sides():
    quads = pair(box())
    assert len(quads) == 6
    # All corners of a side have a coordinate in common.
    assert (np.ptp(box().vertices[quads], axis=1).min(axis=1) == 0).all()


def test_no_triangle_is_in_two_quads_and_vertices_keep_three_edges():
    cage = ball(2)
    quads = pair(cage)
    halves = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    faces = {tuple(sorted(face)) for face in cage.faces.tolist()}
    named = [tuple(sorted(half)) for half in halves.tolist()]
    assert len(set(named)) == len(named)
    assert set(named) <= faces
    lost = np.bincount(quads[:, [0, 2]].ravel(), minlength=len(cage.vertices))
    assert (np.bincount(cage.faces.ravel()) - lost >= 3).all()
    assert len(quads) >= 0.35 * len(faces)


def test_sharp_edges_and_diagonals_that_are_edges_make_no_quad():
    assert len(pair(TETRAHEDRON)) == 0
    flat = changed(octahedron(), vertices=octahedron().vertices * [1, 1, 0.02])
    sides = flat.vertices[pair(flat)]
    assert (np.sign(sides[:, :, 2]).min(axis=1) * np.sign(sides[:, :, 2]).max(axis=1) >= 0).all()


def bipyramid():
    """Two flat pyramids on a hexagon: vertices 0 to 5 around, 6 above and 7 below."""
    turn = np.pi * np.arange(6) / 3
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    k = np.arange(6)
    above = np.stack([k, (k + 1) % 6, np.full(6, 6)], axis=1)
    below = np.stack([(k + 1) % 6, k, np.full(6, 7)], axis=1)
    return TriMesh(
        np.concatenate([rim, [[0, 0, 0.5], [0, 0, -0.5]]]), np.concatenate([above, below])
    )


@pytest.mark.parametrize("held", [0, 1])
def test_quads_that_hold_the_model_are_kept_where_others_are_as_good(held):
    """Three quads above, and three below that end elsewhere: a vertex around has four edges."""
    quads = Pairing(bipyramid(), 0.3).choose(set(), {(held, 6)})
    above, below = {0, 2, 4}, {1, 3, 5}
    if held == 1:
        above, below = below, above
    assert set(name_diagonals(quads)) == {(k, 6) for k in above} | {(k, 7) for k in below}


def test_a_quad_that_holds_the_model_gives_way_to_two_others():
    """Any quad of which all others could be: none is lost for it."""
    cage = finer(box(), 1)
    whole = set(name_diagonals(pair(cage)))
    assert len(whole) == len(cage.faces) // 2
    for edge in map(tuple, np.sort(cage.edges.ends).tolist()):
        assert len(Pairing(cage, 0.3).choose(set(), {edge})) == len(whole)


def test_what_is_banned_is_not_chosen():
    first = name_diagonals(pair(bipyramid()))
    others = Pairing(bipyramid(), 0.3).choose({first[0]}, set())
    assert first[0] not in name_diagonals(others)
    assert len(others) == 6


def test_quads_are_chosen_with_their_mirror_images():
    cage = ball(2)
    for axis in range(3):
        partners = find_partners(cage.vertices, axis)
        quads = Pairing(cage, 0.3, partners).choose(set(), set())
        assert len(quads) >= 0.35 * len(cage.faces)
        assert set(name_diagonals(partners[quads])) == set(name_diagonals(quads))


def test_a_quad_whose_mirror_image_may_not_be_is_not_chosen():
    """Both together would leave a vertex around the bipyramid two edges."""
    cage = bipyramid()
    assert len(pair(cage)) == 6
    assert len(Pairing(cage, 0.3, np.array([0, 1, 2, 3, 4, 5, 7, 6])).choose(set(), set())) == 0


def flip(cage, edges):
    """The cage with the other diagonals in the place of edges."""
    draft = Draft(cage, np.empty((0, 3)), 0.0)
    for edge in edges:
        draft.apply(flip_edge(draft, *edge))
    return TriMesh(draft.vertices, draft.faces)


def list_bad_flips(cage):
    """What is left of a cage by each flip of an edge, in a flat side, that costs quads."""
    for edge in cage.edges.ends.tolist():
        odd = flip(cage, [edge])
        if abs(odd.volume - cage.volume) < 1e-9 and corner_angles(odd).min() > 5:
            before = len(pair(odd))
            if before < len(pair(cage)):
                yield odd, before


def test_edges_are_flipped_that_keep_triangles_from_finding_a_partner():
    found = list(islice(list_bad_flips(finer(box(), 1)), 3))
    assert found
    for odd, before in found:
        flips = Pairing(odd, 0.3).choose_flips(set())
        assert len(pair(flip(odd, flips))) > before
        assert not set(Pairing(odd, 0.3).choose_flips(set(flips))) & set(flips)


def test_nothing_is_flipped_where_all_triangles_have_a_partner():
    assert Pairing(finer(box(), 1), 0.3).choose_flips(set()) == []


def test_a_ridge_loses_volume_by_its_other_diagonal_and_a_valley_gains_some():
    """A tetrahedron of height 0.1 over diagonals of length 2: (2 · 2 · 0.1) / 6."""
    corners = np.array([[0, -1, 0.1], [1, 0, 0], [0, 1, 0.1], [-1, 0, 0]])
    quad = np.arange(4)[None]
    np.testing.assert_allclose(measure_ridges(corners, quad), 0.4 / 6, rtol=1e-12, atol=0)
    valley = corners * [1, 1, -1]
    np.testing.assert_allclose(measure_ridges(valley, quad), -0.4 / 6, rtol=1e-12, atol=0)
