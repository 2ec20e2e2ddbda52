"""Vertices of a cage that move to where a motion needs them."""

import numpy as np
import pytest

from cageik_cli.cages.build import BuildSettings, build_cage
from cageik_cli.cages.building.job import Job
from cageik_cli.cages.building.judge import judge
from cageik_cli.cages.building.motion import Motion, measure_edits
from cageik_cli.cages.building.shift import MAX_ROUNDS, count_rounds, shift_vertices
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import box, changed, finer


@pytest.fixture
def rod(coarse_grids):
    """A rod, a cage around it, and a motion of its upper half alone."""
    model = finer(changed(box(), vertices=box().vertices * [0.2, 0.2, 1]), 3)
    settings = BuildSettings(40, 0.01)
    cage = build_cage(model, settings).cage
    job = Job.start(model, settings, None)
    rest = job.unit.to_units(model.vertices)
    x, y, z = rest.T
    bend = np.maximum(z - z.mean(), 0)
    posed = np.stack([x + 2 * bend**2, y, z - bend**2], axis=1)[None]
    return (
        TriMesh(job.unit.to_units(cage.vertices), cage.faces),
        job.demand,
        Motion.reduce(rest, posed),
    )


@pytest.mark.slow
def test_the_error_falls_and_the_cage_stays_valid(rod):
    cage, demand, motion = rod
    shifted, moved = shift_vertices(cage, demand, motion)
    assert moved > 0
    assert judge(shifted, demand).faults == ()
    assert measure_edits(shifted, motion).error < 0.9 * measure_edits(cage, motion).error


@pytest.mark.slow
def test_nothing_moves_when_the_motion_is_rigid(rod):
    cage, demand, motion = rod
    still = Motion(motion.points, np.zeros((len(motion.points), 3)))
    assert shift_vertices(cage, demand, still)[1] == 0


def test_large_cages_get_fewer_rounds_for_their_time():
    assert count_rounds(8) == count_rounds(300) == MAX_ROUNDS
    assert count_rounds(600) == MAX_ROUNDS // 8
    assert count_rounds(2000) == 1
