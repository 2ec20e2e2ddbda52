"""Models drawn without a graphics card: a depth buffer, light, colours and lines.

Pixels are counted from the upper left corner, x to the right and y downwards, and pixel (k, l) has
its middle at (k + ½, l + ½). Depths grow away from the viewer. The projection is parallel.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cageik_cli.mesh import Floats, Integers

Picture = NDArray[np.float32]
"""(4, s, s): red, green and blue, each times the opacity, and the opacity, 0 to 1."""

SAMPLES = 2
"""Of a pixel, across and down."""
MARGIN = 0.03
"""Of the picture, free on each side."""
BLOCK = 1 << 18
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
    places = np.ascontiguousarray(corners.T)
    ends = (places[:2].min(axis=1), places[:2].max(axis=1))
    low, high = (np.clip(np.ceil(end - 0.5), 0, size) for end in ends)
    usable = np.isfinite(places).all(axis=(0, 1)) & (high > low).all(axis=0)
    kept = np.flatnonzero(usable)
    places, low, high = places[..., kept], low[:, kept], high[:, kept]
    rows = np.stack([low[1], high[1]]).astype(np.int64)
    for block in _blocks((high - low).prod(axis=0)):
        _draw(places[..., block], rows[:, block], kept[block], Seen(face, depth), size)
    return Seen(face.reshape(size, size), depth.reshape(size, size))


def _blocks(areas: Floats) -> Iterator[slice]:
    """Runs of triangles whose boxes hold some `BLOCK` pixels together."""
    ends = np.searchsorted(np.cumsum(areas), np.arange(BLOCK, areas.sum() + BLOCK, BLOCK))
    start = 0
    for end in np.unique(np.minimum(ends + 1, len(areas))).tolist():
        yield slice(start, end)
        start = end


def _draw(places: Floats, rows: Integers, names: Integers, seen: Seen, size: int) -> None:
    """Add triangles to what is seen, by the stretches of each of their rows, (2, t).

    `places`, (3, 3, t), are x, y and depth of their three corners.
    """
    count = rows[1] - rows[0]
    triangle, row = np.repeat(np.arange(len(count)), count), _counted(rows[0], count)
    start, end = _stretches(places, triangle, row, size)
    slopes, depth = _planes(places)
    slope = slopes[0, triangle]
    depth_there = (
        depth[triangle]
        + slope * (start + 0.5 - places[0, 0, triangle])
        + slopes[1, triangle] * (row + 0.5 - places[1, 0, triangle])
    )
    width = np.maximum(end - start, 0)
    stretch, step = np.repeat(np.arange(len(width)), width), _counted(np.zeros_like(width), width)
    pixel = (row * size + start)[stretch] + step
    depths = depth_there[stretch] + slope[stretch] * step
    np.minimum.at(seen.depth, pixel, depths)
    nearest = np.flatnonzero(depths == seen.depth[pixel])
    seen.face[pixel[nearest]] = names[triangle[stretch[nearest]]]


def _counted(starts: Integers, counts: Integers) -> Integers:
    """start, start + 1, ... of each, so many as its count, one after the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - ends + counts, counts)


def _stretches(
    places: Floats, triangle: Integers, row: Integers, size: int
) -> tuple[Integers, Integers]:
    """The first pixel of a triangle in a row, and the one after its last.

    A row that a triangle has meets its longest edge upright, and one of the others.
    """
    # From the lower end whichever triangle asks, so that neighbours find the same place.
    x, y = np.take_along_axis(places[:2], np.argsort(places[1], axis=0)[None], axis=1)
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


def _planes(places: Floats) -> tuple[Floats, Floats]:
    """How the depth of triangles grows with x and y, (2, t), and what it is at their corner 0."""
    normal = _crossed(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    edge_on = np.abs(normal[2]) <= EDGE_ON * np.abs(normal).sum(axis=0)
    slopes = -normal[:2] / np.where(edge_on, np.inf, normal[2])
    return slopes, np.where(edge_on, places[2].mean(axis=0), places[2, 0])


def _crossed(one: Floats, two: Floats) -> Floats:
    """The cross products of vectors, (3, t)."""
    return np.stack([one[k - 2] * two[k - 1] - one[k - 1] * two[k - 2] for k in range(3)])


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
    first, second, third = (projected[corner].T for corner in faces.T)
    normals = _crossed(second - first, third - first) * np.array([[1], [-1], [-1]])
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
    key, fill = (np.maximum(_mixed(light, normals), 0) for light in (KEY, FILL))
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


def painted(surface: Surface, colours: Floats) -> Picture:
    """A surface of these colours, (p, 3), in light."""
    size = len(surface.depth)
    picture = np.zeros((4, size * size), np.float32)
    bright = lit(surface.normals)
    for plane, colour in zip(picture[:3], colours.T, strict=True):
        plane[surface.pixels] = np.clip(colour * bright, 0, 1)
    picture[3, surface.pixels] = 1
    return picture.reshape(4, size, size)


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


def drawn_over(picture: Picture, colour: Floats, opacity: Floats) -> Picture:
    """A picture under a colour, (3,), of an opacity in each pixel, (s, s)."""
    drawn = np.flatnonzero(opacity)
    over = picture.reshape(4, -1).copy()
    for plane, share in zip(over, (*colour, 1), strict=True):
        plane[drawn] += opacity.ravel()[drawn] * (share - plane[drawn])
    return over.reshape(picture.shape)


def reduced(picture: Picture) -> Picture:
    """A picture with the means of `SAMPLES` by `SAMPLES` pixels; its colours without opacity."""
    samples = [picture[:, k::SAMPLES, j::SAMPLES] for k in range(SAMPLES) for j in range(SAMPLES)]
    means = sum(samples[1:], start=samples[0]) / np.float32(SAMPLES**2)
    means[:3] /= np.where(means[3] > 0, means[3], 1)
    return means
