"""Where the camera of a picture is: the usual view, and those that show a region of a model."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cageik_cli.report.render.raster import ParallelCamera, rasterize
from cageik_cli.util.arrays import Floats, Integers

VIEW_TURN, VIEW_TILT = 32.0, 14.0
"""Degrees of the viewpoint to the right of the front, and above it."""

REGION_TURNS = tuple(VIEW_TURN + turn for turn in (0, -64, 58, -122, 103, -167, 148, 180))
"""From where the worst region may be looked at, the usual view first."""

UPRIGHT_AXES = {"Y": np.eye(3), "Z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])}
"""Rows: right, up and front of an upright model, by its up axis."""

PIXELS = 64
"""Width and height of the pictures that choose a view."""

MIN_SHARE = 0.8
"""A view is as good as the best if it shows so much of what that shows."""

CLOSE_UP_WIDTH = 2.0
"""Width of a close-up, in sizes of the region,"""

MIN_CLOSE_UP = 0.25
"""but at least so many diagonals of the model."""


def view_axes(up_axis: str, turn: float) -> Floats:
    """Return right, up and backward of a view from `turn` degrees right of the front, as rows."""
    turn_angle, tilt_angle = np.radians((turn, VIEW_TILT))
    (c, s), (d, e) = ((np.cos(angle), np.sin(angle)) for angle in (turn_angle, tilt_angle))
    around = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    over = np.array([[1, 0, 0], [0, d, -e], [0, e, d]])
    return np.asarray(over @ around @ UPRIGHT_AXES[up_axis])


def find_region_vertices(
    rest: Floats, deviation: Floats, worst: int, size: float
) -> NDArray[np.bool_]:
    """The vertices around the worst one that deviate more than half as much in a frame, (m,).

    Parameters
    ----------
    rest : (m, 3) float64
    deviation : (m,) float64
        Of the frame; nan for missing data.
    size : float
        Of the region, in the units of `rest`.
    """
    near = np.linalg.norm(rest - rest[worst], axis=1) <= size
    chosen = np.asarray(near & (deviation >= 0.5 * deviation[worst]))
    chosen[worst] = True
    return chosen


def fit_close_up(points: Floats, size: float, diagonal: float) -> tuple[Floats, float]:
    """Return the centre and half the width of a close-up of points, (k, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    width = max(CLOSE_UP_WIDTH * max(size, float(np.linalg.norm(high - low))),
                MIN_CLOSE_UP * diagonal)  # fmt: skip
    return np.asarray(0.5 * low + 0.5 * high), 0.5 * width


def choose_view(
    vertices: Floats, faces: Integers, chosen: NDArray[np.bool_], views: Mapping[float, Floats]
) -> float:
    """Choose from which of several directions vertices are seen best.

    Parameters
    ----------
    vertices : (m, 3) float64
    faces : (t, 3) int64
    chosen : (m,) bool
        The vertices to be seen.
    views : mapping of float to (3, 3) float64
        The axes of each view, by its name; earlier ones are preferred.

    Returns
    -------
    float
        The name of the first view that shows nearly as many pixels of their faces as the best.
    """
    wanted = np.asarray(chosen[faces].any(axis=1))
    if not wanted.any():  # vertices in no face are seen from nowhere
        return next(iter(views))
    points = vertices[faces[wanted]].reshape(-1, 3)
    centre = 0.5 * points.min(axis=0) + 0.5 * points.max(axis=0)
    radius = float(np.linalg.norm(points - centre, axis=1).max()) or 1.0
    cameras = [ParallelCamera(axes, centre, radius, PIXELS) for axes in views.values()]
    seen = [_count_pixels(camera, vertices, faces, wanted) for camera in cameras]
    enough = MIN_SHARE * max(seen)
    return next(name for name, count in zip(views, seen, strict=True) if count >= enough)


def _count_pixels(
    camera: ParallelCamera, vertices: Floats, faces: Integers, wanted: NDArray[np.bool_]
) -> int:
    """Count the pixels that show one of the wanted faces."""
    face = rasterize(camera.project(vertices)[faces], camera.size).face
    return int(wanted[face[face >= 0]].sum())
