"""From a shell to a cage: stages of decimation and push, then polish, then the whole clearance.

If no shell gives a valid cage, an ellipsoid is drawn in.
"""

import igl
import numpy as np
from scipy.spatial import ConvexHull

from cageik_cli.cages.builder.collapse import Motion, collapse_edges, list_stages, simplify_shell
from cageik_cli.cages.builder.draft import Draft, PairedDraft
from cageik_cli.cages.builder.frame import add_image, average_sides, cut_half, reflect
from cageik_cli.cages.builder.judge import Demand, find_near_points, keep_one_per_cell
from cageik_cli.cages.builder.loops import NO_LOOPS, Loops, place_edge_loops
from cageik_cli.cages.builder.polish import (
    collapse_in_shape,
    improve_angles,
    lower_valences,
    refill,
    tighten,
)
from cageik_cli.cages.push import Contacts, move_to_neighbours, push
from cageik_cli.cages.surface_points import take_evenly
from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.method.weights.harmonic import harmonic_weights
from cageik_cli.util.arrays import Floats, Integers, Mask

MAX_RELAXED_PUSHES = 5
"""Rounds of pushing a cage and relaxing the faces that then cross."""

MAX_CROSSING_PAIRS = 60
"""Pairs of faces that cross, above which a cage is not worth untangling."""

MAX_TANGLED_PAIRS = 24
"""Pairs of faces that cross after a stage, above which a shell is given up: of shells whose cages
became sound, none had more than 8."""

MIN_SAFE_WEIGHT = 0.08
"""Vertices with smaller weights everywhere are weak; it is safely above `MIN_INFLUENCE`."""

MAX_OPPOSITE_COSINE = -0.99
"""Between the outward directions of two sheets of a cage around a thin part of a model, at most."""


def refine_shell(
    shell: TriMesh, demand: Demand, motion: Motion | None, *, has_loops: bool = False
) -> tuple[TriMesh, Loops]:
    """Make a cage of a shell, with its loops; the judge decides whether it is valid.

    A shell that tangles is given up, and left with more vertices than are asked for.
    """
    stages = list_stages(demand.most)
    # A fine shell hardly tangles: down to this number of vertices, collapses need no test.
    cage, evenness = simplify_shell(shell, max(1200, 2 * stages[0]))
    if demand.axis is not None:
        cage = add_image(cut_half(cage, demand.axis), demand.axis)
    loops = NO_LOOPS
    if has_loops:
        cage, loops = place_edge_loops(cage, demand.most, motion)
    for count in stages:
        cage = collapse_edges(
            cage, count, motion, evenness, fixed=loops.vertex_count, axis=demand.axis
        )
        cage, crossings = _push_and_relax(cage, demand)
        if crossings > MAX_TANGLED_PAIRS:
            break
    # What crosses now is not disentangled by any edit that follows.
    if len(cage.vertices) > demand.most or crossings:
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


def _push_and_relax(cage: TriMesh, demand: Demand) -> tuple[TriMesh, int]:
    """Push, and relax what then crosses, in turn, until nothing crosses or the rounds are over.

    A cage with more than `MAX_CROSSING_PAIRS` of crossing faces is not worth it. Returned is how
    many are left, too.
    """
    cage = push_off(cage, demand.samples, demand)
    pairs, before = self_intersections(cage), MAX_CROSSING_PAIRS + 1
    for _ in range(MAX_RELAXED_PUSHES):
        if len(pairs) == 0 or len(pairs) >= before:
            break
        before = len(pairs)
        relaxed = cage.move(move_to_neighbours(cage, np.unique(cage.faces[pairs]), 0.5))
        if demand.axis is not None:
            relaxed = average_sides(relaxed, cage, demand.axis)
        cage = push_off(relaxed, demand.samples, demand)
        pairs = self_intersections(cage)
    return cage, len(pairs)


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


class ContactSearch:
    """The samples that a cage is too near to, while it is pushed off them.

    Each has a contact at its nearest face. Around a thin part of a model a second sheet of the cage
    is near: the face that was the nearest before, on the other side, stays a contact, too. Pushes
    would move both sheets to and fro otherwise.

    Parameters
    ----------
    samples : (s, 3) float64
    clearance : float
        Samples that are nearer, or outside, are too near.
    """

    def __init__(self, samples: Floats, clearance: float) -> None:
        self._samples, self._clearance = samples, clearance
        self._depths = np.full(len(samples), -np.inf)
        # Of the last contact of each sample, and of the last one on the other side of that.
        self._corners = np.zeros((2, len(samples), 3), np.int64)
        self._weights, self._directions = np.zeros((2, 2, len(samples), 3))

    def find(self, cage: TriMesh, longest: float) -> Contacts | None:
        """Return the contacts of the cage, whose vertices moved as far as `longest` at most."""
        # No point of the cage moves further than its vertices: what is deeper is no contact.
        self._depths -= longest
        near = np.flatnonzero(self._depths < self._clearance)
        if len(near) == 0:
            return None
        contacts, self._depths[near] = find_contacts(cage, self._samples[near], self._clearance)
        touched = near[self._depths[near] < self._clearance]
        turned = touched[_are_opposite(self._directions[0, touched], contacts.direction)]
        for kept, found in (
            (self._corners, contacts.corners),
            (self._weights, contacts.weights),
            (self._directions, contacts.direction),
        ):
            kept[1, turned] = kept[0, turned]
            kept[0, touched] = found
        # Those of the other sheets that are too near to these samples are contacts, too.
        corners, weights = self._corners[1, touched], self._weights[1, touched]
        direction = self._directions[1, touched]
        place = (weights[:, :, None] * cage.vertices[corners]).sum(axis=1)
        missing = self._clearance - ((place - self._samples[touched]) * direction).sum(axis=1)
        added = (missing > 0) & _are_opposite(direction, contacts.direction)
        return Contacts(
            np.concatenate([contacts.corners, corners[added]]),
            np.concatenate([contacts.weights, weights[added]]),
            np.concatenate([contacts.direction, direction[added]]),
            np.concatenate([contacts.missing, missing[added]]),
        )


def _are_opposite(first: Floats, second: Floats) -> Mask:
    return np.asarray((first * second).sum(axis=1) < MAX_OPPOSITE_COSINE)


def find_contacts(cage: TriMesh, samples: Floats, clearance: float) -> tuple[Contacts, Floats]:
    """Return the samples with less than the clearance; and how deep inside each sample is, (s,)."""
    signed, face, nearest, normal = igl.signed_distance(
        samples, cage.vertices, cage.faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    )
    # libigl counts the inside negative. Where a cage crosses itself its normals mislead.
    doubtful = np.flatnonzero(signed > 0)
    if len(doubtful):
        inside = winding_numbers(cage, samples[doubtful]) > 0.5
        signed[doubtful[inside]] *= -1
    close = np.flatnonzero(signed > -clearance)
    corners = cage.faces[face[close]]
    a, b, c = (cage.vertices[corners[:, k]] for k in range(3))
    weights = igl.barycentric_coordinates(nearest[close].copy(), a, b, c).reshape(-1, 3)
    direction = (samples[close] - nearest[close]) * np.sign(signed[close])[:, None]
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.where(length > 1e-9, direction / np.maximum(length, 1e-9), normal[close])
    return Contacts(corners, weights, direction, signed[close] + clearance), -signed


def make_draft(cage: TriMesh, demand: Demand, samples: Floats, loops: Loops = NO_LOOPS) -> Draft:
    """Return a draft of the cage, whose edits keep a little more than the clearance."""
    if demand.axis is not None:
        return PairedDraft(cage, samples, 1.01 * demand.clearance, demand.axis)
    return Draft(cage, samples, 1.01 * demand.clearance, loops.edges)


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
    # Points on a spiral over the unit sphere, and their outward faces.
    k = np.arange(demand.most) + 0.5
    z, turn = 1 - 2 * k / demand.most, np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z**2)
    unit = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
    faces = ConvexHull(unit).simplices.astype(np.int64)
    a, b, c = (unit[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
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
