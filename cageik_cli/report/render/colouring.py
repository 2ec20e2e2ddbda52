"""Colours of values on a surface, their scales, and pictures as PNG files."""

import io

import numpy as np
from PIL import Image

from cageik_cli.report.render.shading import Picture, VisibleSurface, downsample, map_colours
from cageik_cli.util.arrays import Floats

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

MISSING_COLOUR = "#a3a8ad"

SCALE_PERCENTILE = 99.5
"""Percent of the vertices that are within a colour scale."""

SCALE_ENDS = (1, 1.5, 2, 3, 4, 5, 6, 8, 10)
"""A colour scale ends at one of these numbers, times a power of ten."""

MIN_SCALE_END = 0.001
"""Percent of the diagonal; no scale ends lower, so that rounding does not look like an error."""


def parse_colour(text: str) -> Floats:
    """Return red, green and blue, 0 to 1, of #rrggbb."""
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def choose_scale_end(values: Floats) -> float:
    """Choose a round end for a scale that holds nearly all values."""
    wanted = max(
        float(np.percentile(values, SCALE_PERCENTILE)) if len(values) else 0.0, MIN_SCALE_END
    )
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(f"{power * next((k for k in SCALE_ENDS if k * power >= wanted), 10):.2g}")


def colour_pixels(surface: VisibleSurface, values: Floats, top: float) -> Floats:
    """Return the colours, (p, 3), of values of vertices, (m,), from 0 to `top`; grey for nan."""
    return _map_to_scale(surface.interpolate(values), top, COLOUR_SCALE)


def colour_signed_pixels(surface: VisibleSurface, values: Floats, top: float) -> Floats:
    """Return the colours, (p, 3), of values of vertices, (m,), from -`top` to `top`."""
    return _map_to_scale(surface.interpolate(values) + top, 2 * top, SIGNED_SCALE)


def _map_to_scale(values: Floats, top: float, scale: tuple[str, ...]) -> Floats:
    stops = np.array([parse_colour(stop) for stop in scale])
    return map_colours(values, top, stops, parse_colour(MISSING_COLOUR))


def encode_png(picture: Picture) -> bytes:
    """Encode a picture as PNG, with colours in 64 levels, which halves the file."""
    stream = io.BytesIO()
    levels = np.rint(255 * np.clip(downsample(picture), 0, 1)).astype(np.uint8)
    levels[:3] &= np.where(levels[3] > 0, 0xFC, 0).astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(levels.transpose(1, 2, 0)), "RGBA")
    # Run lengths are most of what compresses in shaded surfaces: a third of the time, 7 % larger.
    image.save(stream, "PNG", compress_type=Image.RLE)
    return stream.getvalue()
