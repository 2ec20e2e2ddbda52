"""Polygons that a fan would fold over, cut into triangles by clipping ears."""

from collections import deque
from itertools import pairwise

import numpy as np

from cageik_cli.geometry.attributes import (
    find_folded_triangles,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.text import format_count

MAX_STEPS = 200_000_000
"""Steps that all polygons of a mesh may take, of ten nanoseconds."""

MAX_CORNER_STEPS = 10_000
"""Steps that they may take besides for each of their corners."""

TEST_STEPS = 2000
"""Steps of a test of an ear, apart from one for each corner that is compared with it."""


def replace_folded_fans(mesh: TriMesh) -> TriMesh:
    """Cut the polygons again whose fans fold over, by clipping ears.

    Ears are found in the plane of the polygon's area vector (Newell). A polygon that crosses itself
    and has none keeps its fan, as does one that would take too long. A polygon's triangles stay
    where its fan was.
    """
    if mesh.attributes is None:
        return mesh
    counts = mesh.attributes.corner_counts - 2
    starts = np.cumsum(counts) - counts
    folded, whole = find_folded_triangles(mesh.vertices, mesh.faces, counts)
    if not folded.any():
        return mesh
    faces = mesh.faces.copy()
    polygons = np.unique(mesh.attributes.triangle_polygons[folded])
    steps = MAX_STEPS + MAX_CORNER_STEPS * int(counts[polygons].sum())
    for k in polygons:
        fan = slice(starts[k], starts[k] + counts[k])
        ring = np.concatenate([faces[fan][0, :2], faces[fan][:, 2]])
        clipping = _EarClipping(_project_to_plane(mesh.vertices[ring], whole[k]))
        ears = clipping.cut(steps)
        steps -= clipping.steps
        if ears is not None:
            faces[fan] = ring[ears]
    return TriMesh(mesh.vertices, faces, mesh.attributes)


def describe_folded(mesh: TriMesh) -> list[str]:
    """Return a note on the polygons whose triangles fold over, if there are any."""
    if mesh.attributes is None:
        return []
    folded, _ = find_folded_triangles(mesh.vertices, mesh.faces, mesh.attributes.corner_counts - 2)
    count = len(np.unique(mesh.attributes.triangle_polygons[folded]))
    return [
        f"of {format_count(count, 'polygon')}, some triangles lie over others: sides cross, or "
        "wind too much to be cut well"
    ] * (count > 0)


def _project_to_plane(points: Floats, normal: Floats) -> Floats:
    """Project points (k, 3) along `normal`, (k, 2); counter-clockwise seen against it."""
    direction = normal / np.abs(normal).max()  # first, since tiny squares would be zeros
    direction /= np.linalg.norm(direction)
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    across /= np.linalg.norm(across)
    return np.asarray((points - points[0]) @ np.stack([across, np.cross(direction, across)]).T)


class _EarClipping:
    """Cuts a polygon (k, 2), counter-clockwise, into triangles (Meisters 1975).

    A triangle of neighbours is an ear if it turns left and holds no other corner. Only corners that
    do not turn left can lie in one; those near a triangle are found along x.
    """

    def __init__(self, points: Floats) -> None:
        count = len(points)
        self._xy = points.tolist()
        self._before, self._after = [count - 1, *range(count - 1)], [*range(1, count), 0]
        reflex = [corner for corner in range(count) if not self._turns_left(corner)]
        reflex.sort(key=points[:, 0].__getitem__)
        self._places = {corner: place for place, corner in enumerate(reflex)}
        self._x, self._y = np.ascontiguousarray(points[reflex].T)
        self.steps = 0

    def cut(self, most: int) -> list[list[int]] | None:
        """Return the triangles; None if there is no ear, or that takes more than `most` steps."""
        count, known = len(self._xy), -1
        ears: dict[int, list[int]] = {}
        waiting: deque[int] = deque()
        while len(ears) < count - 3:
            if not waiting and known < len(ears):
                known = len(ears)
                waiting.extend(corner for corner in range(count) if corner not in ears)
            if not waiting or self.steps > most:
                return None
            corner = waiting.popleft()
            if corner not in ears and self._turns_left(corner) and self._is_ear(corner):
                before, after = self._before[corner], self._after[corner]
                self._after[before], self._before[after] = after, before
                self._forget_if_left(before)
                self._forget_if_left(after)
                ears[corner] = [before, corner, after]
                # Either may be an ear now. They wait, so that ears are no fan of thin triangles.
                waiting += (before, after)
        last = [corner for corner in range(count) if corner not in ears]
        return [*ears.values(), last]

    def _turns_left(self, corner: int) -> bool:
        (ax, ay), (bx, by), (cx, cy) = self._list_triangle(corner)
        return (bx - ax) * (cy - by) - (by - ay) * (cx - bx) > 0

    def _list_triangle(self, corner: int) -> list[list[float]]:
        return [self._xy[k] for k in (self._before[corner], corner, self._after[corner])]

    def _forget_if_left(self, corner: int) -> None:
        """Keep a corner that turns left from being found in triangles: nan lies in none."""
        if corner in self._places and self._turns_left(corner):
            self._y[self._places.pop(corner)] = np.nan

    def _is_ear(self, corner: int) -> bool:
        triangle = self._list_triangle(corner)
        xs = [x for x, _ in triangle]
        first, last = self._x.searchsorted(min(xs)), self._x.searchsorted(max(xs), "right")
        self.steps += TEST_STEPS + int(last - first)
        return not _holds_any(triangle, self._x[first:last], self._y[first:last])


def _holds_any(triangle: list[list[float]], x: Floats, y: Floats) -> bool:
    """Return whether points lie in a triangle that turns left, apart from its corners."""
    for (ax, ay), (bx, by) in pairwise([*triangle, triangle[0]]):
        is_left = (bx - ax) * (y - ay) >= (by - ay) * (x - ax)
        x, y = x[is_left], y[is_left]
    return any([cx, cy] not in triangle for cx, cy in zip(x.tolist(), y.tolist(), strict=True))
