"""Triangles and lines in a depth buffer, without a graphics card.

Pixels are counted from the upper left corner, x to the right and y downwards; the centre of pixel
(k, l) is at (k + ½, l + ½). Depths grow away from the viewer, and are affine in a picture.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats, Integers

VIEW_EDGE_TOL = 1e-9
"""Triangles whose normal has less along the view, as a share, are seen edge-on."""

NEAR_SHARE = 0.02
"""Of the distance of a perspective camera, as in the player: what is nearer is not drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class ParallelCamera:
    """A parallel projection onto a square picture.

    It is separate from `method.pose.camera.Camera`, which validates matrices of users, casts rays
    through pixels, and refuses points that are not finite. Here depths are in pixels, and points
    that are not finite are left out.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: right, up, and towards the viewer, of length one.
    centre : (3,) float64
        The point in the middle of the picture.
    extent : float
        Half of the width that the picture shows, in the units of the points.
    size : int
        Width and height, pixels.
    """

    axes: Floats
    centre: Floats
    extent: float
    size: int

    @classmethod
    def fit(cls, axes: Floats, points: Floats, size: int, margin: float = 0.03) -> Self:
        """Fit a camera to points, (k, 3), as large as possible; points of nan are left out.

        `margin` is the free share of the picture on each side.
        """
        seen = points[np.isfinite(points).all(axis=1)] @ axes.T
        low, high = (seen.min(axis=0), seen.max(axis=0)) if len(seen) else np.zeros((2, 3))
        half = 0.5 * high - 0.5 * low
        extent = float(half[:2].max()) or float(half[2]) or 1.0
        return cls(axes, axes.T @ (0.5 * low + 0.5 * high), extent / (1 - 2 * margin), size)

    def project(self, points: Floats) -> Floats:
        """Project points, (k, 3), to x, y and depth, all in pixels."""
        seen = (points - self.centre) / self.extent @ self.axes.T
        return np.asarray(0.5 * self.size * (seen * (1, -1, -1) + (1, 1, 0)))


@dataclass(frozen=True, slots=True, eq=False)
class PerspectiveCamera:
    """A perspective projection onto a square window of a picture.

    Points nearer than a `NEAR_SHARE` of the distance, and those behind the camera, have no place.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: right, up, and towards the viewer, of length one.
    centre : (3,) float64
        The point in the middle of the picture that is looked at.
    distance : float
        Of the camera from that point.
    unit : float
        Size of a pixel at the distance.
    middle : (float, float)
        The middle of the picture, in pixels of the window.
    size : int
        Width and height of the window, pixels.
    """

    axes: Floats
    centre: Floats
    distance: float
    unit: float
    middle: tuple[float, float]
    size: int

    def project(self, points: Floats) -> Floats:
        """Project points, (k, 3), to x, y and depth, in pixels; those without a place are nan."""
        seen = self.shape(points)
        away = self.distance + seen[:, 2]
        share = self.distance / np.where(away > NEAR_SHARE * self.distance, away, np.nan)
        # Of depths, only those of this form lie in a plane where a triangle is.
        seen = seen * share[:, None] / self.unit
        return np.asarray(seen + np.array([*self.middle, 0]))

    def shape(self, points: Floats) -> Floats:
        """Turn points, (k, 3), to right, down and away from the viewer: normals are of these."""
        return np.asarray((points - self.centre) @ self.axes.T * (1, -1, -1))


Camera = ParallelCamera | PerspectiveCamera


def rasterize(corners: Floats, size: int) -> tuple[Integers, Floats]:
    """Find the nearest of projected triangles, (t, 3, 3), in each pixel of a square of `size`.

    A pixel belongs to a triangle if its centre does; each pixel along a common edge belongs to
    exactly one of the two triangles. Triangles that are not finite are left out.

    Returns
    -------
    face : (s, s) int64
        -1 where there is none.
    depth : (s, s) float64
        Infinite where there is none.
    """
    face, depth = np.full((size, size), -1), np.full((size, size), np.inf)
    if compiled.kernel is not None:
        places = np.ascontiguousarray(corners, np.float64)
        compiled.kernel.draw_triangles(places, face, depth)
    else:
        _draw_in_numpy(corners, face, depth)
    return face, depth


def _draw_in_numpy(corners: Floats, face: Integers, depth: Floats) -> None:
    """Draw triangles, (t, 3, 3), where nothing is compiled: the reference."""
    size, flat = len(face), (face.reshape(-1), depth.reshape(-1))
    places = np.ascontiguousarray(corners.T)
    ends = (places[:2].min(axis=1), places[:2].max(axis=1))
    low, high = (np.clip(np.ceil(end - 0.5), 0, size) for end in ends)
    usable = np.isfinite(places).all(axis=(0, 1)) & (high > low).all(axis=0)
    kept = np.flatnonzero(usable)
    places, low, high = places[..., kept], low[:, kept], high[:, kept]
    rows = np.stack([low[1], high[1]]).astype(np.int64)
    for block in _split_blocks((high - low).prod(axis=0)):
        _draw_triangles(places[..., block], rows[:, block], kept[block], *flat, size)


def rasterize_lines(projected: Floats, edges: Integers, width: float, size: int) -> Floats:
    """Return the depths of lines between projected vertices, (s, s); infinite elsewhere."""
    ends = projected[edges]
    along = ends[:, 1, :2] - ends[:, 0, :2]
    lengths = np.hypot(along[:, 0], along[:, 1])[:, None]
    along = 0.5 * width * np.where(lengths > 0, along / np.where(lengths > 0, lengths, 1), (1, 0))
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    quads = np.repeat(ends, 2, axis=1)
    for corner, offset in enumerate(
        (-along - across, -along + across, along + across, along - across)
    ):
        quads[:, corner, :2] += offset
    triangles = np.concatenate([quads[:, (0, 1, 2)], quads[:, (0, 2, 3)]])
    return rasterize(triangles, size)[1]


def cross_products(one: Floats, two: Floats) -> Floats:
    """Return the cross products of vectors, (3, t)."""
    return np.stack([one[k - 2] * two[k - 1] - one[k - 1] * two[k - 2] for k in range(3)])


def _split_blocks(areas: Floats, pixels: int = 1 << 18) -> Iterator[slice]:
    """Yield runs of triangles whose bounding boxes have about so many `pixels` in total."""
    ends = np.searchsorted(np.cumsum(areas), np.arange(pixels, areas.sum() + pixels, pixels))
    start = 0
    for end in np.unique(np.minimum(ends + 1, len(areas))).tolist():
        yield slice(start, end)
        start = end


def _draw_triangles(
    places: Floats,
    rows: Integers,
    face_ids: Integers,
    nearest_face: Integers,
    nearest_depth: Floats,
    size: int,
) -> None:
    """Draw triangles into flat buffers, (s²,), span by span of each of their rows, (2, t).

    `places`, (3, 3, t), are x, y and depth of their three corners.
    """
    count = rows[1] - rows[0]
    triangle, row = np.repeat(np.arange(len(count)), count), _concatenate_ranges(rows[0], count)
    start, end = _row_spans(places, triangle, row, size)
    slopes, depth = _depth_planes(places)
    slope = slopes[0, triangle]
    depth_there = (
        depth[triangle]
        + slope * (start + 0.5 - places[0, 0, triangle])
        + slopes[1, triangle] * (row + 0.5 - places[1, 0, triangle])
    )
    width = np.maximum(end - start, 0)
    stretch, step = (
        np.repeat(np.arange(len(width)), width),
        _concatenate_ranges(np.zeros_like(width), width),
    )
    pixel = (row * size + start)[stretch] + step
    depths = depth_there[stretch] + slope[stretch] * step
    np.minimum.at(nearest_depth, pixel, depths)
    nearest = np.flatnonzero(depths == nearest_depth[pixel])
    nearest_face[pixel[nearest]] = face_ids[triangle[stretch[nearest]]]


def _concatenate_ranges(starts: Integers, counts: Integers) -> Integers:
    """Concatenate the ranges start, start + 1, ... of these lengths."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - ends + counts, counts)


def _row_spans(
    places: Floats, triangle: Integers, row: Integers, size: int
) -> tuple[Integers, Integers]:
    """Return the first pixel of a triangle in a row, and the one after its last.

    A row of a triangle crosses its tallest edge and one of the two others.
    """
    # Always from the lower end, so that both neighbours of an edge get the same crossing.
    x, y = _sort_by_height(places)
    starts, ends = (0, 1, 0), (1, 2, 2)
    rise = y[ends, :] - y[starts, :]
    slope = ((x[ends, :] - x[starts, :]) / np.where(rise > 0, rise, 1.0)).ravel()
    x, y, count = x[starts, :].ravel(), y[starts, :].ravel(), len(x[0])
    at = row + 0.5
    edges = (triangle + count * (at >= y[triangle + count]), triangle + 2 * count)
    one, other = (x[edge] + slope[edge] * (at - y[edge]) for edge in edges)
    sides = (np.minimum(one, other), np.maximum(one, other))
    left, right = (np.clip(np.ceil(side - 0.5), 0, size).astype(np.int64) for side in sides)
    return left, right


def _sort_by_height(places: Floats) -> tuple[Floats, Floats]:
    """Return x and y, (3, t), of the corners of triangles, by their y.

    Three exchanges of whole arrays take a fifth of the time of a sort of each triangle.
    """
    x, y = list(places[0]), list(places[1])
    for one, other in ((0, 1), (1, 2), (0, 1)):
        is_above = y[one] > y[other]
        for values in (x, y):
            first, second = values[one], values[other]
            values[one] = np.where(is_above, second, first)
            values[other] = np.where(is_above, first, second)
    return np.stack(x), np.stack(y)


def _depth_planes(places: Floats) -> tuple[Floats, Floats]:
    """Return the slopes of depth along x and y, (2, t), and the depth at corner 0.

    A triangle seen edge-on, as `VIEW_EDGE_TOL` says, has one depth.
    """
    normal = cross_products(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    edge_on = np.abs(normal[2]) <= VIEW_EDGE_TOL * np.abs(normal).sum(axis=0)
    slopes = -normal[:2] / np.where(edge_on, np.inf, normal[2])
    return slopes, np.where(edge_on, places[2].mean(axis=0), places[2, 0])
