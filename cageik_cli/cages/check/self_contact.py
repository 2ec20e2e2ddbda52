"""How much of a model touches itself in a pose: parts near in space and far along the surface."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from cageik_cli.geometry.mesh import Edges, TriMesh
from cageik_cli.util.arrays import Floats, Integers

MAX_CONTACT_DISTANCE = 0.03
"""Parts touch when they are nearer to each other than this, in diagonals."""

MIN_SURFACE_DISTANCE = 0.12
"""Points that are nearer along the surface, in diagonals, are of one part, and do not touch."""

MAX_SOURCES = 500
"""Samples whose distances along the surface are held at once."""

MAX_DIVIDED_EDGE = 0.03
"""Faces with longer edges are divided, in diagonals, while there is room for more faces."""

MAX_DIVIDED_FACES = 60_000
"""Faces of a divided surface, at most."""

MAX_CONTACT_SAMPLES = 3000
"""Points that stand for the surface, at most: about 0.02 diagonals apart on a body."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactMeter:
    """Measures poses of one model.

    Attributes
    ----------
    points : (s, m) sparse
        The sampled points of the surface, from the m vertices of a pose.
    shares : (s,) float64
        The share of the surface that each point stands for; their sum is one.
    joined : (p,) int64
        Pairs of points that are near along the surface, as `i s + j` with i < j, ascending.
    reach : float
        Points of other parts nearer than this touch, file units.
    """

    points: sparse.csr_array
    shares: Floats
    joined: Integers
    reach: float

    def measure(self, frame: Floats) -> float:
        """Return how much of the surface touches another part, from 0 to 1.

        A point counts fully at distance 0 from another part, and less up to the reach.

        Parameters
        ----------
        frame : (m, 3)
            Positions of the model's vertices, file units.
        """
        points = np.asarray(self.points @ frame)
        pairs = cKDTree(points).query_pairs(self.reach, output_type="ndarray")
        keys = pairs[:, 0] * len(points) + pairs[:, 1]
        # `np.isin` would sort again what is sorted, and take ten times as long.
        after = np.searchsorted(self.joined, keys, side="right")
        pairs = pairs[after == np.searchsorted(self.joined, keys)]
        gaps = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
        nearest = np.full(len(points), self.reach)
        np.minimum.at(nearest, pairs, gaps[:, None])
        return float(self.shares @ (1 - nearest / self.reach))


def make_contact_meter(model: TriMesh) -> ContactMeter | None:
    """Sample the surface of a model, and find which samples are near along it.

    Vertices at one place count as joined, so that seams do not part the surface.

    Returns
    -------
    The meter, or None for a model without area.
    """
    _, first, places = np.unique(model.vertices, axis=0, return_index=True, return_inverse=True)
    faces = places.reshape(-1)[model.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    if len(faces) == 0:
        return None
    weights = sparse.csr_array(sparse.eye_array(len(model.vertices), format="csr")[first])
    weights, faces = _divide_edges(model, weights, faces)
    surface = TriMesh(np.asarray(weights @ model.vertices), faces)
    areas = np.cumsum(surface.face_areas)
    if not areas[-1] > 0:
        return None
    # Up to `MAX_CONTACT_SAMPLES` vertices evenly by area, and the share that each stands for.
    steps = (np.arange(MAX_CONTACT_SAMPLES) + 0.5) / MAX_CONTACT_SAMPLES
    chosen = np.searchsorted(areas, steps * areas[-1])
    samples, counts = np.unique(surface.faces[chosen, 0], return_counts=True)
    links, count, joined = _link_samples(surface, samples), len(samples), []
    for start in range(0, count, MAX_SOURCES):
        sources = np.arange(start, min(start + MAX_SOURCES, count))
        limit = MIN_SURFACE_DISTANCE * model.diagonal
        distances = csgraph.dijkstra(links, False, sources, limit=limit)
        first, second = np.nonzero(np.isfinite(distances))
        first += start
        joined.append((first * count + second)[first < second])
    return ContactMeter(
        weights[samples],
        counts / MAX_CONTACT_SAMPLES,
        np.concatenate(joined),
        MAX_CONTACT_DISTANCE * model.diagonal,
    )


def _divide_edges(
    model: TriMesh, weights: sparse.csr_array, faces: Integers
) -> tuple[sparse.csr_array, Integers]:
    """Divide each face in four until edges are short, up to `MAX_DIVIDED_EDGE` diagonals.

    Returns
    -------
    weights : (k, m) sparse
        The vertices after that, from those of the model.
    faces : (t, 3) int64
    """
    while 4 * len(faces) <= MAX_DIVIDED_FACES:
        edges = Edges.from_faces(faces)
        ends, sides = edges.ends, edges.side_edges
        vertices = weights @ model.vertices
        lengths = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
        if lengths.max() <= MAX_DIVIDED_EDGE * model.diagonal:
            break
        middles = sides + weights.shape[0]
        weights = sparse.vstack([weights, 0.5 * (weights[ends[:, 0]] + weights[ends[:, 1]])])
        weights = sparse.csr_array(weights)
        (a, b, c), (p, q, r) = faces.T, middles.T
        quarters = ((a, r, q), (b, p, r), (c, q, p), (p, q, r))
        faces = np.concatenate([np.stack(corners, axis=1) for corners in quarters])
    return weights, faces


def _link_samples(surface: TriMesh, samples: Integers) -> sparse.csr_array:
    """Return the graph of the samples: those whose regions meet, and the way between them."""
    ends = surface.edges.ends
    corners = surface.vertices[ends]
    lengths = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
    distances, _, owners = csgraph.dijkstra(
        _make_graph(ends, lengths, len(surface.vertices)),
        False,
        samples,
        return_predecessors=True,
        min_only=True,
    )
    reached = (owners[ends] >= 0).all(axis=1)
    ends, lengths = ends[reached], lengths[reached] + distances[ends[reached]].sum(axis=1)
    linked = np.sort(np.searchsorted(samples, owners[ends]), axis=1)
    order = np.lexsort((lengths, linked[:, 1], linked[:, 0]))
    linked, lengths = linked[order], lengths[order]
    linked, first = np.unique(linked, axis=0, return_index=True)
    apart = linked[:, 0] != linked[:, 1]
    return _make_graph(linked[apart], lengths[first[apart]], len(samples))


def _make_graph(ends: Integers, lengths: Floats, count: int) -> sparse.csr_array:
    """Return the graph of `count` nodes, whose edges are named once each."""
    lengths = np.maximum(lengths, np.finfo(np.float64).tiny)  # an entry of 0 is no edge
    return sparse.csr_array((lengths, (ends[:, 0], ends[:, 1])), shape=(count, count))
