"""Shaded and coloured pictures of meshes, and their colour scales.

Pixels and depths are as in `raster`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.report.render.raster import cross_products, rasterize
from cageik_cli.util.arrays import Floats, Integers

Picture = NDArray[np.float32]
"""(4, s, s): red, green and blue, each times the opacity, and the opacity, 0 to 1."""

SAMPLES_PER_PIXEL = 2
"""Samples per pixel, across and down."""

MESH_COLOURS = {"model": "#f0ede8", "cage": "#1f6fd0", "input": "#e2d6c8", "missing": "#a3a8ad"}
"""Colours of a model in its cage, of the cage, of an input, and of missing data."""

COLOUR_SCALE = (
    "#f2eada", "#efd098", "#ecb362", "#e69441", "#e56e38", "#d64d41", "#bb3252",
    "#8f2c64", "#5d2d62",
)  # fmt: skip
"""From light to dark in even steps, so that they can be told apart without colour vision."""

SIGNED_SCALE = (
    "#123a73", "#2f66a8", "#6f9fd0", "#b5cde3", "#ece7df", "#efc08b", "#e08a3c",
    "#b9541c", "#7a2c0c",
)  # fmt: skip
"""From the negative to the positive end; the middle is zero."""

MIN_SCALE_PERCENT = 0.001
"""Percent of the diagonal; no scale or axis ends lower: rounding should not look like an error."""


@dataclass(frozen=True, slots=True, eq=False)
class VisibleSurface:
    """The visible part of a mesh, pixel by pixel.

    Attributes
    ----------
    pixels : (p,) int64
        The pixels with a face, row by row.
    corners : (3, p) int64
        Vertices of the face there.
    barycentric : (3, p) float64
        Coordinates of the pixel's centre in those corners; they sum to one.
    normals : (3, p) float64
        Right, up, towards the viewer; of length one, on the visible side.
    depth : (s, s) float64
    """

    pixels: Integers
    corners: Integers
    barycentric: Floats
    normals: Floats
    depth: Floats

    def interpolate(self, values: Floats) -> Floats:
        """Interpolate values of the vertices, (m,), in each pixel."""
        return _weighted_sum(self.barycentric, values[self.corners])


def rasterize_surface(
    projected: Floats, faces: Integers, size: int, shape: Floats | None = None
) -> VisibleSurface:
    """Rasterize a mesh with projected vertices, (m, 3); both sides of its faces are visible.

    `shape`, (m, 3), is what its normals are of: right, down and away from the viewer, by default as
    projected.
    """
    face, depth = rasterize(projected[faces], size)
    pixels = np.flatnonzero(face >= 0)
    face_ids = face.ravel()[pixels]
    corners = faces.T[:, face_ids]
    shares = _barycentric_coordinates(projected, corners, np.stack([pixels % size, pixels // size]))
    # Right, up, towards the viewer: of faces, of twice their area; of vertices, their sums.
    face_normals = _face_normals(projected if shape is None else shape, faces)
    ends, count = faces.T.ravel(), len(projected)
    sums = [np.bincount(ends, np.tile(along, 3), count) for along in face_normals]
    vertex_normals = _normalize(np.stack(sums))
    normals = np.stack([_weighted_sum(shares, along[corners]) for along in vertex_normals])
    facing = face_normals[2] if shape is None else _face_normals(projected, faces)[2]
    away = facing[face_ids] < 0
    return VisibleSurface(
        pixels, corners, shares, _normalize(np.where(away, -normals, normals)), depth
    )


def _face_normals(points: Floats, faces: Integers) -> Floats:
    """Return the normals of faces, (3, t): right, up and towards the viewer."""
    first, second, third = (points[corner].T for corner in faces.T)
    normals = cross_products(second - first, third - first) * np.array([[1], [-1], [-1]])
    return np.where(np.isfinite(normals), normals, 0)


def _weighted_sum(shares: Floats, values: Floats) -> Floats:
    """Return the sums of values, (3, p), weighted by shares, (3, p)."""
    return np.asarray(shares[0] * values[0] + shares[1] * values[1] + shares[2] * values[2])


def _barycentric_coordinates(projected: Floats, corners: Integers, places: Integers) -> Floats:
    """Return barycentric coordinates, (3, p), of pixels, (2, p), clamped to [0, 1]."""
    x, y = (projected[:, axis][corners] - (places[axis] + 0.5) for axis in range(2))
    areas = np.stack(
        [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    )
    whole = areas[0] + areas[1] + areas[2]
    shares = np.clip(areas / np.where(whole == 0, np.inf, whole), 0, 1)
    total = shares[0] + shares[1] + shares[2]
    return np.where(total > 0, shares / np.where(total > 0, total, 1), 1 / 3)


def _normalize(vectors: Floats) -> Floats:
    """Scale vectors, (3, p), to length one; zero vectors stay."""
    vectors = vectors / np.maximum(np.abs(vectors).max(axis=0), 1e-300)
    lengths = np.sqrt(vectors[0] ** 2 + vectors[1] ** 2 + vectors[2] ** 2)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1))


def shade(normals: Floats) -> Floats:
    """Return the brightness, (p,), for normals, (3, p): about 0.3 to 1."""
    # Towards the lights: right, up, towards the viewer; of length one, nearly.
    directions = np.array([-0.42, 0.66, 0.62]), np.array([0.85, 0.05, 0.52])
    key, fill = (np.maximum(_weighted_sum(light, normals), 0) for light in directions)
    bright = 0.46 + 0.54 * key + 0.12 * fill
    rim = (1 - np.clip(normals[2], 0, 1)) ** 2
    return np.asarray(bright * (1 - 0.30 * rim))


def parse_colour(text: str) -> Floats:
    """Return red, green and blue, 0 to 1, of #rrggbb."""
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def choose_scale_end(values: Floats) -> float:
    """Choose a round end for a scale that holds nearly all values."""
    percentile = 99.5  # single values may be beyond the scale
    wanted = max(float(np.percentile(values, percentile)) if len(values) else 0, MIN_SCALE_PERCENT)
    power = 10.0 ** np.floor(np.log10(wanted))
    ends = (1, 1.5, 2, 3, 4, 5, 6, 8, 10)
    return float(f"{power * next((k for k in ends if k * power >= wanted), 10):.2g}")


def colour_pixels(surface: VisibleSurface, values: Floats, top: float) -> Floats:
    """Return the colours, (p, 3), of values of vertices, (m,), from 0 to `top`; grey for nan."""
    return map_colours(surface.interpolate(values), top, COLOUR_SCALE)


def colour_signed_pixels(surface: VisibleSurface, values: Floats, top: float) -> Floats:
    """Return the colours, (p, 3), of values of vertices, (m,), from -`top` to `top`."""
    return map_colours(surface.interpolate(values) + top, 2 * top, SIGNED_SCALE)


def map_colours(values: Floats, top: float, scale: tuple[str, ...]) -> Floats:
    """Return the colours, (p, 3), of values on a scale from 0 to `top`; larger ones are clamped."""
    places = np.clip(values / top, 0, 1)
    known = np.isfinite(places)
    stops = np.array([parse_colour(stop) for stop in scale])
    shares = np.linspace(0, 1, len(stops))
    colours = [np.interp(np.where(known, places, 0), shares, stops[:, k]) for k in range(3)]
    missing = parse_colour(MESH_COLOURS["missing"])
    return np.where(known[:, None], np.stack(colours, axis=1), missing)


def render(surface: VisibleSurface, colours: Floats) -> Picture:
    """Shade a surface of these colours, (p, 3)."""
    size = len(surface.depth)
    picture = np.zeros((4, size * size), np.float32)
    bright = shade(surface.normals)
    for plane, colour in zip(picture[:3], colours.T, strict=True):
        plane[surface.pixels] = np.clip(colour * bright, 0, 1)
    picture[3, surface.pixels] = 1
    return picture.reshape(4, size, size)


def overlay(picture: Picture, colour: Floats, opacity: Floats) -> Picture:
    """Lay a colour, (3,), over a picture, with an opacity in each pixel, (s, s)."""
    drawn = np.flatnonzero(opacity)
    over = picture.reshape(4, -1).copy()
    for plane, share in zip(over, (*colour, 1), strict=True):
        plane[drawn] += opacity.ravel()[drawn] * (share - plane[drawn])
    return over.reshape(picture.shape)


def downsample(picture: Picture) -> Picture:
    """Average the samples of each pixel; the colours returned are not times the opacity."""
    samples = [
        picture[:, k::SAMPLES_PER_PIXEL, j::SAMPLES_PER_PIXEL]
        for k in range(SAMPLES_PER_PIXEL)
        for j in range(SAMPLES_PER_PIXEL)
    ]
    means = sum(samples[1:], start=samples[0]) / np.float32(SAMPLES_PER_PIXEL**2)
    means[:3] /= np.where(means[3] > 0, means[3], 1)
    return means
