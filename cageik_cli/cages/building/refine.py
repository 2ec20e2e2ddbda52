"""From a shell to a cage: stages of decimation and push, then polish, then the whole clearance."""

import numpy as np

from cageik_cli.cages.building.carry import Poses
from cageik_cli.cages.building.clearance import find_near_points
from cageik_cli.cages.building.collapse import collapse_edges
from cageik_cli.cages.building.decimate import stages
from cageik_cli.cages.building.draft import Draft
from cageik_cli.cages.building.judge import Demand
from cageik_cli.cages.building.polish import lower_valences, mend_angles, refill, tighten
from cageik_cli.cages.building.push import push_outward, untangle
from cageik_cli.cages.building.unit import thin_points
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

AIM = 1.01
"""Clearances that edits keep, and that all points of faces must have."""

POLISHES = 2
"""Rounds of edits."""

COMPLETIONS = 6
"""Rounds in which points that are too near are found and pushed off."""


def refine_shell(shell: TriMesh, demand: Demand, poses: Poses) -> TriMesh:
    """Make a cage of a shell; the judge decides whether it is valid."""
    cage = shell
    for count in stages(demand.most):
        if count < len(cage.vertices):
            cage = collapse_edges(cage, count, poses)
        cage = untangle(cage, demand.samples, demand.clearance)
    return finish(cage, demand)


def finish(cage: TriMesh, demand: Demand) -> TriMesh:
    """Improve the angles and the fit, and complete the clearance on the whole surface."""
    if len(cage.vertices) > demand.most:
        return cage
    cage, samples = complete_clearance(cage, demand, demand.samples, rounds=1)
    draft = Draft(cage, samples, AIM * demand.clearance)
    for _ in range(POLISHES):
        mend_angles(draft, demand.fewest)
        lower_valences(draft)
        refill(draft, demand.most)
        tighten(draft, samples)
    mend_angles(draft, draft.count)
    return complete_clearance(draft.to_mesh(), demand, samples, rounds=COMPLETIONS)[0]


def complete_clearance(
    cage: TriMesh, demand: Demand, samples: Floats, rounds: int
) -> tuple[TriMesh, Floats]:
    """Push off the points of faces that are too near although the samples are not.

    Returns
    -------
    TriMesh
        The cage.
    (s, 3) float64
        The samples, with those points.
    """
    for _ in range(rounds):
        near = find_near_points(demand.surface, cage, AIM * demand.clearance).points
        if len(near) == 0:
            break
        near = thin_points(near, 0.5 * demand.clearance)
        samples = np.concatenate([samples, near])
        cage = push_outward(cage, samples, demand.clearance)
    return cage, samples
