"""Quads in the place of triangles."""

import numpy as np
import pytest

from cageik_cli.cages.builder import quads as quads_module
from cageik_cli.cages.builder.judge import Demand, judge
from cageik_cli.cages.builder.pairing import name_diagonals
from cageik_cli.cages.builder.quads import make_quads
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from tests.shapes import ball, changed


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
