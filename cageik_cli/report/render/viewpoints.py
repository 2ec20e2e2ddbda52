"""Where the camera of a picture is: the usual view, and those that show a region of a model."""

import numpy as np
from numpy.typing import NDArray

from cageik_cli.report.render.raster import ParallelCamera, rasterize
from cageik_cli.util.arrays import Floats, Integers

VIEW_TURN = 32.0
"""Degrees of the usual viewpoint to the right of the front."""

REGION_TURNS = tuple(VIEW_TURN + turn for turn in (0, -64, 58, -122, 103, -167, 148, 180))
"""From where the worst region may be looked at, the usual view first."""


def view_axes(up_axis: str, turn: float, tilt: float = 14.0) -> Floats:
    """Return right, up and backward of a view, as rows.

    It is from `turn` degrees right of the front, and `tilt` degrees above it.
    """
    turn_angle, tilt_angle = np.radians((turn, tilt))
    (c, s), (d, e) = ((np.cos(angle), np.sin(angle)) for angle in (turn_angle, tilt_angle))
    around = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    over = np.array([[1, 0, 0], [0, d, -e], [0, e, d]])
    # Rows: right, up and front of an upright model.
    upright = {"Y": np.eye(3), "Z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])}
    return np.asarray(over @ around @ upright[up_axis])


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
    """Return the centre and half the width of a close-up of points, (k, 3).

    It is twice as wide as the region, and at least a quarter of the model's diagonal.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    width = max(2.0 * max(size, float(np.linalg.norm(high - low))), 0.25 * diagonal)
    return np.asarray(0.5 * low + 0.5 * high), 0.5 * width


def choose_turn(
    vertices: Floats,
    faces: Integers,
    chosen: NDArray[np.bool_],
    up_axis: str,
    *,
    pixels: int = 64,
    min_share: float = 0.8,
) -> float:
    """Choose from which of `REGION_TURNS` vertices are seen best.

    Parameters
    ----------
    vertices : (m, 3) float64
    faces : (t, 3) int64
    chosen : (m,) bool
        The vertices to be seen.
    up_axis : str
        "Y" or "Z".
    pixels : int
        Width and height of the small pictures that are compared.
    min_share : float
        A view is as good as the best if it shows so much of what that shows.

    Returns
    -------
    float
        The first turn from which nearly as many pixels of their faces are seen as from the best.
    """
    wanted = np.asarray(chosen[faces].any(axis=1))
    if not wanted.any():  # vertices in no face are seen from nowhere
        return REGION_TURNS[0]
    points = vertices[faces[wanted]].reshape(-1, 3)
    centre = 0.5 * points.min(axis=0) + 0.5 * points.max(axis=0)
    radius = float(np.linalg.norm(points - centre, axis=1).max()) or 1.0
    seen = []
    for turn in REGION_TURNS:
        camera = ParallelCamera(view_axes(up_axis, turn), centre, radius, pixels)
        face = rasterize(camera.project(vertices)[faces], pixels).face
        seen.append(int(wanted[face[face >= 0]].sum()))
    enough = min_share * max(seen)
    return next(turn for turn, count in zip(REGION_TURNS, seen, strict=True) if count >= enough)
