"""Vertices of a cage that move to where a motion needs them."""

import numpy as np
import pytest

from cageik_cli.cages.builder.build import build_cage
from cageik_cli.cages.builder.collapse import Motion
from cageik_cli.cages.builder.judge import Demand, judge
from cageik_cli.cages.builder.shift import EditGains, count_rounds, shift_vertices
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import box, changed, finer


@pytest.fixture
def rod(coarse_grids):
    """A rod, a cage around it, and a motion of its upper half alone."""
    model = finer(changed(box(), vertices=box().vertices * [0.2, 0.2, 1]), 3)
    settings = BuildSettings(40, 0.01)
    cage = build_cage(model, settings).cage
    demand = Demand(model, settings)
    rest = demand.frame.to_units(model.vertices)
    x, y, z = rest.T
    bend = np.maximum(z - z.mean(), 0)
    posed = np.stack([x + 2 * bend**2, y, z - bend**2], axis=1)[None]
    cage = TriMesh(demand.frame.to_units(cage.vertices), cage.faces)
    return cage, demand, rest, posed


@pytest.mark.slow
def test_the_error_falls_and_the_cage_stays_valid(rod):
    cage, demand, rest, posed = rod
    motion = Motion(rest, posed)
    shifted, moved = shift_vertices(cage, demand, motion)
    assert moved > 0
    assert judge(shifted, demand).faults == ()
    assert EditGains(shifted, motion).error < 0.9 * EditGains(cage, motion).error


@pytest.mark.slow
def test_nothing_moves_when_the_motion_is_rigid(rod):
    cage, demand, rest, _ = rod
    still = Motion(rest, rest[None])
    # What rounding leaves is no motion.
    still.displacements = np.zeros_like(still.displacements)
    assert shift_vertices(cage, demand, still)[1] == 0


def test_large_cages_get_fewer_rounds_for_their_time():
    assert count_rounds(8) == count_rounds(300) == 80
    assert count_rounds(600) == 10
    assert count_rounds(2000) == 1
