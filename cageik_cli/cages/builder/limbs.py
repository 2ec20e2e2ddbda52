"""Limbs of a shell: where its surface goes away from the middle, as a tube, up to a tip."""

import igl
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

MIN_LIMB_LENGTH = 0.06
"""How far a limb goes, in diagonals, at least."""

MIN_LIMB_SLENDERNESS = 1.1
"""The length of a limb over its mean width, at least."""

BASE_MARGIN = 0.05
"""What part of a limb is left between its base and what it meets, which may be another limb."""

MAX_DEPTH_SOURCES = 100
"""Vertices from which distances over a shell are measured, at most."""

DEPTH_SMOOTHINGS = 3
"""How often depths are averaged with those beside them: distances along edges are uneven."""

LINE_POINTS = 24
"""Points of the centre line of a limb."""


class CentreLine:
    """A polyline that goes on straight at both ends. Heights are lengths along it from its start.

    Parameters
    ----------
    points : (j, 3) float64
    """

    def __init__(self, points: Floats) -> None:
        self._points, self._sides = points[:-1], np.diff(points, axis=0)
        self._lengths = np.linalg.norm(self._sides, axis=1)
        self._starts = np.concatenate([[0], np.cumsum(self._lengths)[:-1]])

    def measure_heights(self, points: Floats) -> Floats:
        """Return the heights of the places on the line that are nearest to points, (k,)."""
        between = points[:, None] - self._points
        share = (between * self._sides).sum(axis=2) / self._lengths**2
        low, high = np.zeros(len(self._sides)), np.ones(len(self._sides))
        low[0], high[-1] = -np.inf, np.inf
        share = np.clip(share, low, high)
        away = np.linalg.norm(between - share[..., None] * self._sides, axis=2)
        heights = self._starts + share * self._lengths
        return np.asarray(heights[np.arange(len(points)), away.argmin(axis=1)])

    def place(self, heights: Floats) -> Floats:
        """Return places on the line, (k, 3)."""
        k = np.clip(np.searchsorted(self._starts, heights) - 1, 0, len(self._sides) - 1)
        share = (heights - self._starts[k]) / self._lengths[k]
        return np.asarray(self._points[k] + share[:, None] * self._sides[k])

    def find_directions(self, heights: Floats, step: float) -> Floats:
        """Return unit directions of the line, (k, 3), between places a step below and above."""
        ways = self.place(heights + step) - self.place(heights - step)
        return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


class Limb:
    """A part of a shell up to a tip.

    Parameters
    ----------
    members : (k,) int64
        Vertices of the shell.
    depth : (m,) float64
        Of all vertices: its level sets go around the limb.

    Attributes
    ----------
    line : CentreLine
    beyond : (k,) int64
        The vertices beyond the base.
    base, tip : float
        The heights between which its sections are closed.
    diameter : float
        Mean, from the girths.
    """

    def __init__(self, shell: TriMesh, members: Integers, depth: Floats) -> None:
        self._shell = shell
        self._faces = shell.faces[np.isin(shell.faces, members).any(axis=1)]
        levels = np.linspace(depth[members].min(), depth[members].max(), 2 * LINE_POINTS + 1)[1::2]
        centres = np.array([find_centre(part) for part in self._cut(depth, levels) if len(part)])
        for _ in range(2):
            centres[1:-1] = (centres[:-2] + 2 * centres[1:-1] + centres[2:]) / 4
        self.line = CentreLine(centres)
        self._heights = self.line.measure_heights(shell.vertices)
        border = float(self._heights[np.setdiff1d(self._faces, members)].max())
        self.tip = float(self._heights[members].max())
        self.base = border + BASE_MARGIN * (self.tip - border)
        self.beyond = members[self._heights[members] > self.base]
        middle = np.linspace(self.base, self.tip, 9)[1:-2]
        sections = [part for part in self._cut(self._heights, middle) if len(part)]
        self.diameter = float(np.mean([measure_length(part) for part in sections]) / np.pi)
        radii = [np.linalg.norm(part - find_centre(part), axis=2).max() for part in sections]
        self._width = 2 * float(np.mean(radii))

    @property
    def is_slender(self) -> bool:
        """Return whether it is a limb rather than a bump."""
        least = max(MIN_LIMB_LENGTH, MIN_LIMB_SLENDERNESS * self._width)
        return self.tip - self.base >= least

    def cut(self, heights: Floats) -> list[Floats]:
        """Return the segments of the sections at heights, (s, 2, 3) each."""
        return self._cut(self._heights, heights)

    def _cut(self, values: Floats, levels: Floats) -> list[Floats]:
        points, ends, level = igl.isolines(self._shell.vertices, self._faces, values, levels)
        return [points[ends[level == k]] for k in range(len(levels))]


def measure_length(segments: Floats) -> float:
    """Return the total length of segments (s, 2, 3)."""
    return float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())


def find_centre(segments: Floats) -> Floats:
    """Return the centre of the length of segments (s, 2, 3)."""
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    return np.asarray(lengths @ segments.mean(axis=1) / max(lengths.sum(), 1e-300))


def find_limbs(shell: TriMesh) -> list[Limb]:
    """Find the limbs of a shell, the thinnest first.

    The depth of a place is its mean distance over the surface from all of the shell (Hilaga et al.
    2001): it is least in the middle of the shell, and equal all around a limb.
    """
    depth = _measure_depth(shell)
    limbs = [Limb(shell, members, depth) for members in _find_branches(shell, depth)]
    return sorted((limb for limb in limbs if limb.is_slender), key=lambda limb: limb.diameter)


def _measure_depth(shell: TriMesh) -> Floats:
    ends, count = shell.edges.ends, len(shell.vertices)
    lengths = np.linalg.norm(shell.vertices[ends[:, 0]] - shell.vertices[ends[:, 1]], axis=1)
    graph = sparse.csr_array((lengths, (ends[:, 0], ends[:, 1])), shape=(count, count))
    graph = sparse.csr_array(graph + graph.T)
    sources = np.arange(0, count, -(-count // MAX_DEPTH_SOURCES))
    depth = dijkstra(graph, indices=sources).mean(axis=0)
    beside = sparse.csr_array(graph > 0, dtype=np.float64)
    degree = beside.sum(axis=1)
    for _ in range(DEPTH_SMOOTHINGS):
        depth = (depth + (beside @ depth) / degree) / 2
    return np.asarray(depth)


def _find_branches(shell: TriMesh, depth: Floats) -> list[Integers]:
    """Return the vertices of each branch of the join tree of depths that ends in a tip.

    Vertices are added from the deepest. A branch grows until it meets another, where both are
    longer than `MIN_LIMB_LENGTH`; shorter ones are part of what they meet.
    """
    around: list[list[int]] = [[] for _ in depth]
    for a, b in shell.edges.ends.tolist():
        around[a].append(b)
        around[b].append(a)
    branch = np.full(len(depth), -1)  # numbered by the tip
    members: dict[int, list[int]] = {}
    joined: set[int] = set()
    found: list[list[int]] = []
    for vertex in np.argsort(-depth, kind="stable").tolist():
        meeting = set(branch[around[vertex]].tolist()) - {-1}
        first, *others = sorted(meeting, key=lambda tip: -depth[tip]) or [vertex]
        long = [tip for tip in meeting if depth[tip] - depth[vertex] >= MIN_LIMB_LENGTH]
        if len(long) > 1:
            found += [list(members[tip]) for tip in sorted(long) if tip not in joined]
            joined.add(first)
        elif meeting & joined:
            joined.add(first)
        for tip in others:
            branch[members[tip]] = first
            members[first] += members.pop(tip)
        branch[vertex] = first
        members.setdefault(first, []).append(vertex)
    return [np.array(branch) for branch in found]
