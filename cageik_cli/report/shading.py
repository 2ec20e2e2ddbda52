"""Models drawn without a graphics card: a depth buffer, light, colours and lines.

Pixels are counted from the upper left corner, x to the right and y downwards, and pixel (k, l) has
its middle at (k + ½, l + ½). Depths grow away from the viewer. The projection is parallel.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from cageik_cli.mesh import Floats, Integers

SAMPLES = 2
"""Of a pixel, across and down."""
MARGIN = 0.03
"""Of the picture, free on each side."""
BLOCK = 1 << 21
"""Pixels in the boxes around triangles that are gone through at once."""
EDGE_ON = 1e-9
"""A triangle whose normal's share along the view is below this has one depth."""

KEY, FILL = np.array([-0.42, 0.66, 0.62]), np.array([0.85, 0.05, 0.52])
"""Towards the lights: right, up, towards the viewer; both of length one, nearly."""
AMBIENT, KEY_LIGHT, FILL_LIGHT, RIM = 0.46, 0.54, 0.12, 0.30


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A parallel projection onto a square picture.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: to the right, upwards, and towards the viewer, of length one.
    centre : (3,) float64
        What is in the middle of the picture.
    extent : float
        Half of what the picture's width shows, in the points' units.
    size : int
        Pixels across and down.
    """

    axes: Floats
    centre: Floats
    extent: float
    size: int

    @classmethod
    def fitted(cls, axes: Floats, points: Floats, size: int) -> Self:
        """The camera that shows all points, (k, 3), as large as they fit; nan is left out."""
        seen = points[np.isfinite(points).all(axis=1)] @ axes.T
        low, high = (seen.min(axis=0), seen.max(axis=0)) if len(seen) else np.zeros((2, 3))
        half = 0.5 * high - 0.5 * low
        extent = float(half[:2].max()) or float(half[2]) or 1.0
        return cls(axes, axes.T @ (0.5 * low + 0.5 * high), extent / (1 - 2 * MARGIN), size)

    def project(self, points: Floats) -> Floats:
        """Where points are seen, (k, 3): x, y and depth, all in pixels."""
        seen = (points - self.centre) / self.extent @ self.axes.T
        return np.asarray(0.5 * self.size * (seen * (1, -1, -1) + (1, 1, 0)))


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What is nearest in each pixel.

    Attributes
    ----------
    face : (s, s) int64
        -1 where there is none.
    depth : (s, s) float64
        Infinite where there is none.
    """

    face: Integers
    depth: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """What is seen of a mesh, pixel by pixel.

    Attributes
    ----------
    pixels : (p,) int64
        Those with a face, row by row.
    corners : (3, p) int64
        Vertices of the face there.
    shares : (3, p) float64
        Of those corners in the pixel's middle; they sum to one.
    normals : (3, p) float64
        Right, up, towards the viewer; of length one, on the side that is seen.
    depth : (s, s) float64
    """

    pixels: Integers
    corners: Integers
    shares: Floats
    normals: Floats
    depth: Floats

    def interpolated(self, values: Floats) -> Floats:
        """Values of the vertices, (m,), in each pixel."""
        return _mixed(self.shares, values[self.corners])


def rasterised(corners: Floats, size: int) -> Seen:
    """The nearest of triangles, (t, 3, 3) as projected, in each pixel of a square of `size`.

    A pixel belongs to a triangle when its middle does; triangles that meet in an edge share none
    and leave none out. Those that are not finite are not seen.
    """
    depth = np.full(size * size, np.inf)
    face = np.full(size * size, -1)
    first, second, third = (corners[:, k] for k in range(3))
    least = np.minimum(np.minimum(first, second), third)[:, :2]
    most = np.maximum(np.maximum(first, second), third)[:, :2]
    low, high = (np.clip(np.ceil(ends - 0.5), 0, size) for ends in (least, most))
    total = (first + second + third) @ np.ones(3)
    usable = np.isfinite(total) & (high[:, 0] > low[:, 0]) & (high[:, 1] > low[:, 1])
    kept = np.flatnonzero(usable)
    boxes = np.stack([low[kept, 1], high[kept, 1]], axis=1).astype(np.int64)
    areas = (high[kept, 0] - low[kept, 0]) * (high[kept, 1] - low[kept, 1])
    for block in _blocks(areas):
        _draw(corners[kept[block]], boxes[block], kept[block], Seen(face, depth), size)
    return Seen(face.reshape(size, size), depth.reshape(size, size))


def _blocks(areas: Floats) -> Iterator[slice]:
    """Runs of triangles whose boxes hold some `BLOCK` pixels together."""
    ends = np.searchsorted(np.cumsum(areas), np.arange(BLOCK, areas.sum() + BLOCK, BLOCK))
    start = 0
    for end in np.unique(np.minimum(ends + 1, len(areas))).tolist():
        yield slice(start, end)
        start = end


def _draw(corners: Floats, rows: Integers, names: Integers, seen: Seen, size: int) -> None:
    """Add triangles whose boxes span `rows` to what is seen, by the stretches of each row."""
    count = rows[:, 1] - rows[:, 0]
    triangle, row = np.repeat(np.arange(len(rows)), count), _counted(rows[:, 0], count)
    start, end = _stretches(corners, triangle, row, size)
    slope, depth = _planes(corners)
    first = corners[triangle, 0]
    depth_there = (
        depth[triangle]
        + slope[triangle, 0] * (start + 0.5 - first[:, 0])
        + slope[triangle, 1] * (row + 0.5 - first[:, 1])
    )
    width = np.maximum(end - start, 0)
    stretch, step = np.repeat(np.arange(len(width)), width), _counted(np.zeros_like(width), width)
    pixel = (row * size + start)[stretch] + step
    depths = depth_there[stretch] + slope[triangle, 0][stretch] * step
    np.minimum.at(seen.depth, pixel, depths)
    nearest = np.flatnonzero(depths == seen.depth[pixel])
    seen.face[pixel[nearest]] = names[triangle[stretch[nearest]]]


def _counted(starts: Integers, counts: Integers) -> Integers:
    """start, start + 1, ... of each, so many as its count, one after the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - ends + counts, counts)


def _stretches(
    corners: Floats, triangle: Integers, row: Integers, size: int
) -> tuple[Integers, Integers]:
    """The first pixel of a triangle in a row, and the one after its last."""
    middle = row + 0.5
    left, right = np.full(len(middle), np.inf), np.full(len(middle), -np.inf)
    for k in range(3):
        # From the lower end whichever triangle asks, so that neighbours find the same place.
        one, other = corners[:, k, :2], corners[:, (k + 1) % 3, :2]
        is_lower = (one[:, 1] <= other[:, 1])[:, None]
        low, high = np.where(is_lower, one, other), np.where(is_lower, other, one)
        height = high[:, 1] - low[:, 1]
        slope = (high[:, 0] - low[:, 0]) / np.where(height > 0, height, 1.0)
        low_y = low[triangle, 1]
        x = low[triangle, 0] + slope[triangle] * (middle - low_y)
        meets = (low_y <= middle) & (middle < high[triangle, 1])
        left = np.where(meets, np.minimum(left, x), left)
        right = np.where(meets, np.maximum(right, x), right)
    pixels = [np.clip(np.ceil(x - 0.5), 0, size).astype(np.int64) for x in (left, right)]
    return pixels[0], pixels[1]


def _planes(corners: Floats) -> tuple[Floats, Floats]:
    """How the depth of triangles grows with x and y, (t, 2), and what it is at their corner 0."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, two)
    edge_on = np.abs(normal[:, 2]) <= EDGE_ON * np.abs(normal).sum(axis=1)
    slope = -normal[:, :2] / np.where(edge_on, np.inf, normal[:, 2])[:, None]
    return slope, np.where(edge_on, corners[:, :, 2].mean(axis=1), corners[:, 0, 2])


def surface_of(projected: Floats, faces: Integers, size: int, is_smooth: bool = True) -> Surface:
    """What is seen of a mesh whose vertices, (m, 3), are projected; both sides of its faces."""
    seen = rasterised(projected[faces], size)
    pixels = np.flatnonzero(seen.face >= 0)
    names = seen.face.ravel()[pixels]
    corners = faces.T[:, names]
    shares = _shares(projected, corners, np.stack([pixels % size, pixels // size]))
    facing = _facing(projected, faces)
    normals = facing[:, names]
    away = normals[2] < 0
    if is_smooth:
        of_vertices = _vertex_sums(facing, faces, len(projected))
        normals = np.stack([_mixed(shares, along[corners]) for along in of_vertices])
    return Surface(pixels, corners, shares, _units(np.where(away, -normals, normals)), seen.depth)


def _mixed(shares: Floats, values: Floats) -> Floats:
    """The sum of shares, (3, p), of values, (3, p)."""
    return np.asarray(shares[0] * values[0] + shares[1] * values[1] + shares[2] * values[2])


def _facing(projected: Floats, faces: Integers) -> Floats:
    """Normals of faces, (3, t), right, up and towards the viewer, as long as twice their areas."""
    first, second, third = (projected[faces[:, k]] for k in range(3))
    normals = np.cross(second - first, third - first).T * np.array([[1], [-1], [-1]])
    return np.where(np.isfinite(normals), normals, 0)


def _shares(projected: Floats, corners: Integers, places: Integers) -> Floats:
    """Barycentric coordinates, (3, p), of pixels, (2, p), in their triangles, held to [0, 1]."""
    x, y = (projected[:, axis][corners] - (places[axis] + 0.5) for axis in range(2))
    areas = np.stack(
        [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    )
    whole = areas[0] + areas[1] + areas[2]
    shares = np.clip(areas / np.where(whole == 0, np.inf, whole), 0, 1)
    total = shares[0] + shares[1] + shares[2]
    return np.where(total > 0, shares / np.where(total > 0, total, 1), 1 / 3)


def _vertex_sums(vectors: Floats, faces: Integers, count: int) -> Floats:
    """Of each vertex, (3, m), the sum of the vectors, (3, t), of its faces; of length one."""
    corners = faces.T.ravel()
    sums = [np.bincount(corners, np.tile(along, 3), count) for along in vectors]
    return _units(np.stack(sums))


def _units(vectors: Floats) -> Floats:
    """Vectors, (3, p), of length one; those without length stay."""
    vectors = vectors / np.maximum(np.abs(vectors).max(axis=0), 1e-300)
    lengths = np.sqrt(vectors[0] ** 2 + vectors[1] ** 2 + vectors[2] ** 2)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1))


def lit(normals: Floats) -> Floats:
    """How bright a surface with these normals, (3, p), is, (p,), about 0.3 to 1."""
    key, fill = np.maximum(KEY @ normals, 0), np.maximum(FILL @ normals, 0)
    bright = AMBIENT + KEY_LIGHT * key + FILL_LIGHT * fill
    return np.asarray(bright * (1 - RIM * (1 - np.clip(normals[2], 0, 1)) ** 2))


def coloured(values: Floats, top: float, stops: Floats, missing: Floats) -> Floats:
    """Colours, (p, 3), of values on a scale of colours, (k, 3), from 0 to `top`.

    What is beyond the scale has its last colour, and nan the colour `missing`, (3,).
    """
    places = np.clip(values / top, 0, 1)
    known = np.isfinite(places)
    scale = np.linspace(0, 1, len(stops))
    colours = [np.interp(np.where(known, places, 0), scale, stops[:, k]) for k in range(3)]
    return np.where(known[:, None], np.stack(colours, axis=1), missing)


def painted(surface: Surface, colours: Floats) -> Floats:
    """A picture, (s, s, 4), of a surface in light; red, green, blue and opacity, 0 to 1."""
    size = len(surface.depth)
    picture = np.zeros((size * size, 4))
    picture[surface.pixels, :3] = np.clip(colours * lit(surface.normals)[:, None], 0, 1)
    picture[surface.pixels, 3] = 1
    return picture.reshape(size, size, 4)


def lines(projected: Floats, edges: Integers, width: float, size: int) -> Floats:
    """Depths of lines between projected vertices, (s, s); infinite beside them."""
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
    return rasterised(triangles, size).depth


def drawn_over(picture: Floats, colour: Floats, opacity: Floats) -> Floats:
    """A picture, (s, s, 4), under a colour, (3,), of an opacity in each pixel, (s, s)."""
    alpha, under = opacity[..., None], picture[..., 3:] * (1 - opacity[..., None])
    total = alpha + under
    mixed = (alpha * colour + under * picture[..., :3]) / np.where(total > 0, total, 1)
    return np.concatenate([mixed, total], axis=2)


def reduced(picture: Floats) -> Floats:
    """A picture with the means of `SAMPLES` by `SAMPLES` pixels, weighed by their opacity."""
    weighed = np.concatenate([picture[..., :3] * picture[..., 3:], picture[..., 3:]], axis=2)
    samples = [weighed[k::SAMPLES, j::SAMPLES] for k in range(SAMPLES) for j in range(SAMPLES)]
    means = np.asarray(np.mean(samples, axis=0), np.float64)
    alpha = means[..., 3:]
    return np.concatenate([means[..., :3] / np.where(alpha > 0, alpha, 1), alpha], axis=2)
