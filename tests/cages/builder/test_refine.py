"""Shells that tangle are given up, and vertices without influence give way to others."""

import numpy as np
import pytest

from cageik_cli.cages.builder import refine
from cageik_cli.cages.builder.collapse import list_stages
from cageik_cli.cages.builder.judge import Demand, judge
from cageik_cli.cages.builder.refine import find_weak, refine_shell, replace_weak_vertices
from cageik_cli.cages.settings import BuildSettings
from tests.shapes import ball, changed


@pytest.fixture
def demand():
    """A small ball that is to be held, in cages of up to 18 vertices."""
    model = ball(3, 0.5)
    demand = Demand(model, BuildSettings(18, 0.01))
    demand.surface, demand.samples, demand.fewest = model, model.vertices, 16
    return demand


def test_a_vertex_far_from_the_model_gives_way(demand):
    cage = ball(1, 1.0)
    far = cage.vertices.copy()
    far[0] *= 4
    cage = changed(cage, vertices=far)
    assert find_weak(cage, demand).tolist() == [0]
    better = replace_weak_vertices(cage, demand)
    assert len(find_weak(better, demand)) == 0
    assert judge(better, demand).faults == ()
    assert len(better.vertices) == len(cage.vertices)
    assert np.linalg.norm(better.vertices, axis=1).max() < 2


def test_a_cage_without_weak_vertices_is_returned_as_it_is(demand):
    cage = ball(1, 0.7)
    assert replace_weak_vertices(cage, demand) is cage


@pytest.mark.parametrize(("crossings", "stages"), [(24, 4), (25, 1)])
def test_a_shell_whose_faces_cross_in_many_pairs_is_given_up(
    demand, monkeypatch, crossings, stages
):
    counts, pairs = [], np.zeros((crossings, 2), np.int64)

    def collapse(cage, count, *_, **__):
        counts.append(count)
        return cage

    monkeypatch.setattr(refine, "collapse_edges", collapse)
    monkeypatch.setattr(refine, "push_off", lambda cage, *_: cage)
    monkeypatch.setattr(refine, "self_intersections", lambda _: pairs)
    cage, _ = refine_shell(ball(2), demand, None)
    assert counts == list_stages(18)[:stages]
    assert len(cage.vertices) == len(ball(2).vertices)
