"""Vertices of a cage that hardly move anything: take them away, and put others elsewhere."""

import numpy as np

from cageik_cli.cages.building.draft import Draft
from cageik_cli.cages.building.judge import Demand
from cageik_cli.cages.building.polish import collapse_in_shape, refill
from cageik_cli.cages.building.refine import AIM
from cageik_cli.coordinates.harmonic import harmonic_weights
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Integers

SAFE_WEIGHT = 0.08
"""Vertices with smaller weights everywhere are weak; a check warns of those below 0.05."""

MAX_POINTS = 1500
"""Points of the model at which weights are computed."""


def replace_weak_vertices(cage: TriMesh, demand: Demand) -> TriMesh:
    """Collapse the vertices of a sound cage that are weak, and split long edges instead.

    The cage itself is returned if none is weak.
    """
    weak = find_weak(cage, demand)
    if len(weak) == 0:
        return cage
    draft = Draft(cage, demand.samples, AIM * demand.clearance)
    for vertex in weak:
        around = draft.neighbours(int(vertex))
        lengths = np.linalg.norm(draft.vertices[around] - draft.vertices[vertex], axis=1)
        for other in around[np.argsort(lengths, kind="stable")]:
            if collapse_in_shape(draft, int(other), int(vertex), share=0):
                break
    refill(draft, demand.most)
    return draft.to_mesh()


def find_weak(cage: TriMesh, demand: Demand) -> Integers:
    """Return the vertices whose weights are small on all of the model, the weakest first."""
    step = max(1, -(-len(demand.samples) // MAX_POINTS))
    largest = harmonic_weights(cage, demand.samples[::step], "preview").values.max(axis=0)
    order = np.argsort(largest, kind="stable")
    return np.asarray(order[largest[order] < SAFE_WEIGHT])
