"""Pictures of a model and its cage for a page, as PNG files, drawn without a graphics card."""

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image

from cageik_cli.report.drawing import TURN, caged, colour, seen_surface, view_axes
from cageik_cli.report.poses import Pose, Poses
from cageik_cli.report.raster import Camera
from cageik_cli.report.shading import SAMPLES, Picture, Surface, coloured, painted, reduced
from cageik_cli.util.arrays import Floats

COLOURS = (
    "#f2eada", "#efd098", "#ecb362", "#e69441", "#e56e38", "#d64d41", "#bb3252",
    "#8f2c64", "#5d2d62",
)  # fmt: skip
"""From light to dark in even steps, so that they are told apart without their hue."""

CLAY, UNKNOWN = "#e2d6c8", "#a3a8ad"

SHARE = 99.5
"""Percent of the vertices that a scale of colours is to tell apart."""
STEPS = (1, 1.5, 2, 3, 4, 5, 6, 8, 10)
"""A scale ends at one of these, times a power of ten."""
LEAST = 0.001
"""Percent of the diagonal: no scale ends lower, so that rounding is not made to look like error."""


@dataclass(frozen=True, slots=True)
class PosePictures:
    """A pose, three times from the same place, as PNG files.

    Attributes
    ----------
    label, name : str
        The pose's.
    given, rebuilt, cage : bytes
        The input; its reconstruction, coloured by deviation; the reconstruction in its cage.
    """

    label: str
    name: str
    given: bytes
    rebuilt: bytes
    cage: bytes


@dataclass(frozen=True, slots=True)
class Pictures:
    """All pictures of a result, and their scales of colours.

    Attributes
    ----------
    poses : tuple of PosePictures
    spread : tuple of bytes
        The rest pose from the front and from behind, coloured by the vertices' rms.
    top_percent, spread_top_percent : float
        Where the scales of the poses and of the spread end, percent of the diagonal; what is
        beyond has the last colour.
    colours : tuple of str
        Of both scales, from 0 to their ends in even steps, as #rrggbb. Missing data is grey.
    """

    poses: tuple[PosePictures, ...]
    spread: tuple[bytes, ...]
    top_percent: float
    spread_top_percent: float
    colours: tuple[str, ...]


def pictures_of(poses: Poses, pixels: int = 360) -> Pictures:
    """Draw the poses and the spread of the error, in squares of so many pixels."""
    known = np.isfinite(poses.vertex_rms)
    top = _top(np.concatenate([pose.deviation[known] for pose in poses.poses]))
    spread_top = _top(poses.vertex_rms[known])
    return Pictures(
        poses=tuple(_pose_pictures(poses, pose, top, pixels) for pose in poses.poses),
        spread=tuple(_spread(poses, turn, spread_top, pixels) for turn in (TURN, TURN + 180)),
        top_percent=top,
        spread_top_percent=spread_top,
        colours=COLOURS,
    )


def _top(values: Floats) -> float:
    """A round end for a scale that nearly all values are on."""
    wanted = max(float(np.percentile(values, SHARE)) if len(values) else 0.0, LEAST)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(f"{power * next((k for k in STEPS if k * power >= wanted), 10):.2g}")


def _pose_pictures(poses: Poses, pose: Pose, top: float, pixels: int) -> PosePictures:
    points = np.concatenate([pose.given, pose.rebuilt, pose.cage])
    camera = Camera.fitted(view_axes(poses.up_axis, TURN), points, SAMPLES * pixels)
    given = seen_surface(camera, pose.given, poses.faces)
    rebuilt = seen_surface(camera, pose.rebuilt, poses.faces)
    deviation = np.where(np.isfinite(poses.vertex_rms), pose.deviation, np.nan)
    return PosePictures(
        label=pose.label,
        name=pose.name,
        given=_png(painted(given, colour(CLAY))),
        rebuilt=_png(painted(rebuilt, _colours(rebuilt, deviation, top))),
        cage=_png(caged(rebuilt, camera, pose.cage, poses.cage_faces)),
    )


def _spread(poses: Poses, turn: float, top: float, pixels: int) -> bytes:
    rest = poses.poses[0].rebuilt
    camera = Camera.fitted(view_axes(poses.up_axis, turn), rest, SAMPLES * pixels)
    surface = seen_surface(camera, rest, poses.faces)
    return _png(painted(surface, _colours(surface, poses.vertex_rms, top)))


def _colours(surface: Surface, values: Floats, top: float) -> Floats:
    stops = np.array([colour(stop) for stop in COLOURS])
    return coloured(surface.interpolated(values), top, stops, colour(UNKNOWN))


def _png(picture: Picture) -> bytes:
    """A picture as a PNG file; its colours in 64 levels, which halves it."""
    stream = io.BytesIO()
    levels = np.rint(255 * np.clip(reduced(picture), 0, 1)).astype(np.uint8)
    levels[:3] &= np.where(levels[3] > 0, 0xFC, 0).astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(levels.transpose(1, 2, 0)), "RGBA")
    # Runs are most of what there is to find in shaded surfaces: a third of the time, 7 % larger.
    image.save(stream, "PNG", compress_type=Image.RLE)
    return stream.getvalue()
