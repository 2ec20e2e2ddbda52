"""A second opinion on a cage, by other code than the builder's: trimesh, rationals, solid angles.

Nothing of the package is used but the mesh it hands out. Slow and plain on purpose.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from tests.exact import common_points, meet_improperly


@dataclass(frozen=True)
class Opinion:
    """What was found of a cage around a model; `faults` is empty for a good one."""

    faults: tuple
    genus: int
    clearance: float
    smallest_angle: float
    largest_valence: int
    volume: float


def examine(cage, model, clearance, points=20_000):
    """Look at a cage around a model; the clearance is a share of the model's diagonal.

    Vertices of the model that are in no face may be anywhere.
    """
    vertices, faces = np.array(cage.vertices), np.array(cage.faces)
    centre = vertices.mean(axis=0)
    vertices = vertices - centre
    used, triangles = np.unique(model.faces, return_inverse=True)
    surface, triangles = np.array(model.vertices)[used] - centre, triangles.reshape(-1, 3)
    diagonal = np.linalg.norm(np.ptp(surface, axis=0))
    faults = list(_topology_faults(len(vertices), faces))
    faults += [f"faces {a} and {b} meet" for a, b in _meeting_faces(vertices, faces)]
    samples = _spread_points(surface, triangles, points)
    turns = _winding(vertices, faces, samples)
    if (np.abs(turns - 1) > 1e-6).any():
        faults.append(f"{np.count_nonzero(np.abs(turns - 1) > 1e-6)} points are not inside")
    faults += [
        f"cage face {a} meets model face {b}"
        for a, b in _crossing_faces(vertices, faces, surface, triangles)
    ]
    nearest = _distance(vertices, faces, samples).min() / diagonal
    if nearest < clearance * (1 - 1e-6):
        faults.append(f"clearance {nearest:.6f}, expected {clearance:.6f}")
    edges = {
        tuple(sorted(edge)) for face in faces for edge in zip(face, np.roll(face, 1), strict=True)
    }
    corners = vertices[faces]
    volume = float(np.einsum("fx,fx->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6)
    if volume <= 0:
        faults.append("faces turn inward")
    return Opinion(
        faults=tuple(faults),
        genus=1 - (len(vertices) - len(edges) + len(faces)) // 2,
        clearance=float(nearest),
        smallest_angle=float(np.degrees(trimesh.triangles.angles(corners / diagonal).min())),
        largest_valence=max(Counter(vertex for edge in edges for vertex in edge).values()),
        volume=volume,
    )


def _topology_faults(count, faces):
    """By dictionaries: every half edge once and its opposite, one fan at a vertex, one piece."""
    halves = Counter(
        (int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)
    )
    if any(number != 1 for number in halves.values()):
        yield "a half edge is used twice"
    if any((b, a) not in halves for a, b in halves):
        yield "an edge has one face"
    follow = [{} for _ in range(count)]
    for a, b, c in faces.tolist():
        for at, start, stop in ((a, b, c), (b, c, a), (c, a, b)):
            follow[at][start] = stop
    for at, ring in enumerate(follow):
        if not ring:
            yield f"vertex {at} is in no face"
            continue
        first = next(iter(ring))
        here, steps = ring[first], 1
        while here != first and here in ring and steps <= len(ring):
            here, steps = ring[here], steps + 1
        if here != first or steps != len(ring):
            yield f"vertex {at} has more than one fan"
    seen, left = set(), [0]
    while left:
        vertex = left.pop()
        if vertex not in seen:
            seen.add(vertex)
            left.extend(set(follow[vertex]) - seen)
    if len(seen) < count:
        yield f"{count - len(seen)} vertices are in other components"


def _sides(face):
    a, b, c = face
    return (a, b), (b, c), (c, a)


def _box_pairs(a, b):
    """Pairs of triangles whose boxes meet."""
    low, high = b.min(axis=1), b.max(axis=1)
    for i, triangle in enumerate(a):
        meets = (low <= triangle.max(axis=0)).all(axis=1)
        meets &= (high >= triangle.min(axis=0)).all(axis=1)
        yield from ((i, int(j)) for j in np.flatnonzero(meets))


def _plainly_apart(a, b, slack):
    """Whether rounded arithmetic already shows that a plane of one parts two triangles."""
    for one, other in ((a, b), (b, a)):
        normal = np.cross(one[1] - one[0], one[2] - one[0])
        heights = (other - one[0]) @ normal / max(np.linalg.norm(normal), 1e-300)
        if heights.min() > slack or heights.max() < -slack:
            return True
    edges = [np.roll(t, -1, axis=0) - t for t in (a, b)]
    for u in edges[0]:
        for v in edges[1]:
            axis = np.cross(u, v)
            length = np.linalg.norm(axis)
            if length > 0:
                p, q = a @ axis / length, b @ axis / length
                if p.min() > q.max() + slack or q.min() > p.max() + slack:
                    return True
    return False


def _meeting_faces(vertices, faces):
    """Pairs of faces of the cage that have more in common than what they share; in rationals."""
    corners = vertices[faces]
    slack = 1e-9 * np.ptp(vertices)
    for i, j in _box_pairs(corners, corners):
        if i < j:
            shared = set(faces[i]) & set(faces[j])
            if not shared and _plainly_apart(corners[i], corners[j], slack):
                continue
            if meet_improperly(vertices, faces[i], faces[j]):
                yield i, j


def _crossing_faces(vertices, faces, surface, triangles):
    """Pairs of a cage face and a model face that have a point in common; in rationals."""
    cage, model = vertices[faces], surface[triangles]
    slack = 1e-9 * np.ptp(vertices)
    for i, j in _box_pairs(cage, model):
        apart = _plainly_apart(cage[i], model[j], slack)
        if not apart and common_points(model[j], cage[i]):
            yield i, j


def _spread_points(vertices, faces, count):
    """All vertices, and points spread over the faces by their area, from a fixed seed."""
    generator = np.random.default_rng(7)
    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if area.sum() == 0:
        return vertices
    chosen = generator.choice(len(faces), count, p=area / area.sum())
    weights = generator.dirichlet([1, 1, 1], count)
    return np.concatenate([vertices, np.einsum("pc,pcx->px", weights, corners[chosen])])


def _winding(vertices, faces, points, block=2000):
    """Solid angles of all faces seen from points, over 4π (Van Oosterom and Strackee 1983)."""
    found = []
    for start in range(0, len(points), block):
        seen = points[start : start + block, None]
        a, b, c = (vertices[faces[:, k]][None] - seen for k in range(3))
        la, lb, lc = (np.linalg.norm(t, axis=2) for t in (a, b, c))
        top = (a * np.cross(b, c)).sum(axis=2)
        dots = [(p * q).sum(axis=2) for p, q in ((a, b), (b, c), (c, a))]
        below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
        found.append(np.arctan2(top, below).sum(axis=1) / (2 * np.pi))
    return np.concatenate(found)


def _distance(vertices, faces, points, block=2000):
    """Distance of points from the cage, face by face."""
    corners = vertices[faces]
    best = np.full(len(points), np.inf)
    # Only points that can be among the nearest are measured: others are further from any vertex.
    dense = np.concatenate([_spread_points(vertices, faces, 200_000)])
    upper = cKDTree(dense).query(points)[0]
    spread = np.sqrt(trimesh.triangles.area(corners).sum() / 200_000)
    order = np.flatnonzero(upper < upper.min() + 12 * spread)
    for triangle in corners:
        for start in range(0, len(order), block):
            some = order[start : start + block]
            repeated = np.repeat(triangle[None], len(some), 0)
            near = trimesh.triangles.closest_point(repeated, points[some])
            best[some] = np.minimum(best[some], np.linalg.norm(near - points[some], axis=1))
    return best
