"""Cages with quads, by the diagonals that they have and by the others."""

import numpy as np

from cageik_cli.cages.builder.judge import Demand
from cageik_cli.cages.builder.pairing import Pairing
from cageik_cli.cages.builder.quads import (
    find_failing,
    find_near_cuts,
    find_near_quads,
    fit_cuts,
    join_quads,
    push_cuts,
    turn_diagonals,
)
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from tests.shapes import ball, box, changed, finer, merged, moved


def pair(cage):
    return Pairing(cage, 0.3).choose(set(), set())


def make_demand(cage, model):
    """The cage in the units of a demand of the model, and that."""
    demand = Demand(model, BuildSettings(len(cage.vertices), 0.005))
    return TriMesh(demand.frame.to_units(cage.vertices), cage.faces), demand


def ridge(share):
    """A box whose one side is a ridge, its quads, and a model with a ball below the ridge.

    Where the ball is, is told as the share of the way from the other diagonal to the ridge.
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
