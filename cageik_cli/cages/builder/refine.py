"""From a shell to a cage: stages of decimation and push, then polish, then the whole clearance.

If no shell gives a valid cage, an ellipsoid is drawn in.
"""

import numpy as np
from scipy.spatial import ConvexHull

from cageik_cli.cages.builder.collapse import collapse_edges, list_stages, simplify_shell
from cageik_cli.cages.builder.contacts import ContactSearch
from cageik_cli.cages.builder.draft import Draft
from cageik_cli.cages.builder.judge import Demand, find_near_points, keep_one_per_cell
from cageik_cli.cages.builder.loops import NO_LOOPS, Loops, collapse_around, place_edge_loops
from cageik_cli.cages.builder.motion import Motion
from cageik_cli.cages.builder.paired import PairedDraft, collapse_pairs
from cageik_cli.cages.builder.polish import (
    collapse_in_shape,
    improve_angles,
    lower_valences,
    refill,
    tighten,
)
from cageik_cli.cages.builder.symmetry import (
    add_image,
    average_sides,
    cut_half,
    reflect,
)
from cageik_cli.cages.push import move_to_neighbours, push
from cageik_cli.cages.surface_points import take_evenly
from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.harmonic import harmonic_weights
from cageik_cli.util.arrays import Floats, Integers

MAX_RELAXED_PUSHES = 5
"""Rounds of pushing a cage and relaxing the faces that then cross."""

MAX_CROSSING_PAIRS = 60
"""Pairs of faces that cross, above which a cage is not worth untangling."""

MIN_SAFE_WEIGHT = 0.08
"""Vertices with smaller weights everywhere are weak; it is safely above `MIN_INFLUENCE`."""


def refine_shell(
    shell: TriMesh, demand: Demand, motion: Motion | None, *, has_loops: bool = False
) -> tuple[TriMesh, Loops]:
    """Make a cage of a shell, with its loops; the judge decides whether it is valid."""
    stages = list_stages(demand.most)
    # A fine shell hardly tangles: down to this number of vertices, collapses need no test.
    cage, evenness = simplify_shell(shell, max(1200, 2 * stages[0]))
    if demand.axis is not None:
        cage = add_image(cut_half(cage, demand.axis), demand.axis)
    loops = NO_LOOPS
    if has_loops:
        cage, loops = place_edge_loops(cage, demand.most, motion)
    for count in stages:
        if loops.count:
            cage = collapse_around(cage, count, motion, evenness, loops)
        elif demand.axis is None:
            cage = collapse_edges(cage, count, motion, evenness)
        else:
            cage = collapse_pairs(cage, count, demand.axis, evenness)
        cage = _push_and_relax(cage, demand)
    # What crosses now is not disentangled by any edit that follows.
    if len(cage.vertices) > demand.most or len(self_intersections(cage)):
        return cage, loops
    cage, samples = complete_clearance(cage, demand, demand.samples, rounds=1)
    draft = make_draft(cage, demand, samples, loops)
    for _ in range(2):
        improve_angles(draft, demand.fewest)
        lower_valences(draft)
        refill(draft, demand.most)
        tighten(draft, samples)
    improve_angles(draft, draft.count)
    return complete_clearance(draft.to_mesh(), demand, samples)[0], loops


def make_draft(cage: TriMesh, demand: Demand, samples: Floats, loops: Loops = NO_LOOPS) -> Draft:
    """Return a draft of the cage, whose edits keep a little more than the clearance."""
    if demand.axis is not None:
        return PairedDraft(cage, samples, 1.01 * demand.clearance, demand.axis)
    return Draft(cage, samples, 1.01 * demand.clearance, loops.edges)


def complete_clearance(
    cage: TriMesh, demand: Demand, samples: Floats, rounds: int = 6
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
        _, near = find_near_points(demand.surface, cage, 1.01 * demand.clearance)
        if len(near) == 0:
            break
        near = keep_one_per_cell(near, 0.5 * demand.clearance)
        if demand.axis is not None:
            near = np.concatenate([near, reflect(near, demand.axis)])
        samples = np.concatenate([samples, near])
        cage = push_off(cage, samples, demand)
    return cage, samples


def push_off(cage: TriMesh, samples: Floats, demand: Demand) -> TriMesh:
    """Push the cage off samples; aim at a little more than the clearance, and end with less of it.

    The stiffness is low, so that parts of the cage move as a whole.
    """
    clearance = demand.clearance
    pushed = push(
        cage,
        ContactSearch(samples, 1.03 * clearance).find,
        smoothness=0.05,
        stiffness=0.005,
        enough=(1.03 - 1.015) * clearance,
    )
    return pushed if demand.axis is None else average_sides(pushed, cage, demand.axis)


def _push_and_relax(cage: TriMesh, demand: Demand) -> TriMesh:
    """Push, and relax what then crosses, in turn, until nothing crosses or the rounds are over.

    A cage with more than `MAX_CROSSING_PAIRS` of crossing faces is not worth it.
    """
    cage = push_off(cage, demand.samples, demand)
    before = MAX_CROSSING_PAIRS + 1
    for _ in range(MAX_RELAXED_PUSHES):
        pairs = self_intersections(cage)
        if len(pairs) == 0 or len(pairs) >= before:
            break
        before = len(pairs)
        relaxed = cage.move(move_to_neighbours(cage, np.unique(cage.faces[pairs]), 0.5))
        if demand.axis is not None:
            relaxed = average_sides(relaxed, cage, demand.axis)
        cage = push_off(relaxed, demand.samples, demand)
    return cage


def replace_weak_vertices(cage: TriMesh, demand: Demand, loops: Loops = NO_LOOPS) -> TriMesh:
    """Collapse the vertices of a sound cage that are weak, and split long edges instead.

    The cage itself is returned if none is weak.
    """
    weak = find_weak(cage, demand)
    if len(weak) == 0:
        return cage
    draft = make_draft(cage, demand, demand.samples, loops)
    for vertex in weak:
        around = draft.neighbours(int(vertex))
        lengths = np.linalg.norm(draft.vertices[around] - draft.vertices[vertex], axis=1)
        for other in around[np.argsort(lengths, kind="stable")]:
            if collapse_in_shape(draft, int(other), int(vertex), share=0):
                break
    refill(draft, demand.most)
    return draft.to_mesh()


def find_weak(cage: TriMesh, demand: Demand) -> Integers:
    """Return the vertices whose weights are small on all of the model, the weakest first.

    A check warns of weights below `MIN_INFLUENCE`; here, they are to be safely above.
    """
    points = take_evenly(demand.samples, 1500)
    largest = harmonic_weights(cage, points, "preview").values.max(axis=0)
    order = np.argsort(largest, kind="stable")
    return np.asarray(order[largest[order] < MIN_SAFE_WEIGHT])


def wrap_ellipsoid(demand: Demand, draws: int) -> TriMesh:
    """Return an ellipsoid of as many vertices as are allowed, drawn in `draws` times.

    Its shortest axis is no less than 0.3 of the longest: flatter faces are needles.
    """
    low, high = demand.surface.vertices.min(axis=0), demand.surface.vertices.max(axis=0)
    axes = np.maximum(high - low, 0.3 * (high - low).max()) / 2
    unit, faces = _divide_sphere(demand.most)
    a, b, c = (unit[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    inner = np.min(np.abs((normal * a).sum(axis=1)) / np.linalg.norm(normal, axis=1))
    middle = (low + high) / 2
    room = 1.05 * demand.clearance
    reach = np.linalg.norm((demand.surface.vertices - middle) / axes, axis=1).max()
    axes = axes * (reach + room / axes.min()) / inner
    draft = Draft(TriMesh(middle + axes * unit, faces), demand.samples, room)
    for _ in range(draws):
        if tighten(draft, demand.samples) == 0:
            break
    return complete_clearance(draft.to_mesh(), demand, demand.samples)[0]


def _divide_sphere(count: int) -> tuple[Floats, Integers]:
    """Spread points over the unit sphere on a spiral; return them and their outward faces."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z**2)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
    faces = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces
