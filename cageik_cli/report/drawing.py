"""A model in its cage, drawn as a viewer sees it who stands before it, somewhat above."""

import numpy as np

from cageik_cli.report.raster import Camera, lines, rasterised
from cageik_cli.report.shading import SAMPLES, Picture, Surface, drawn_over, painted, surface_of
from cageik_cli.util.arrays import Floats, Integers

PALE, LINE = "#f0ede8", "#1f6fd0"
"""Of a model in its cage, and of the cage."""
TURN, TILT = 32.0, 14.0
"""Degrees that the viewer stands to the right of the front, and above it."""
UPRIGHT = {"Y": np.eye(3), "Z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])}
"""Rows: to the right, upwards, and to the front, by the axis that points up."""

THICKNESS = 1.3
"""Of lines, pixels."""
CLEARANCE = 0.006
"""Of the picture: what is no deeper than this behind a surface is before it."""
NEAR, FAR = 0.95, 0.28
"""Opacity of lines before all surfaces, and behind one."""


def view_axes(up_axis: str, turn: float) -> Floats:
    """Rows: right, up and towards a viewer who stands `turn` degrees to the right of the front."""
    turned, tilted = np.radians((turn, TILT))
    (c, s), (d, e) = ((np.cos(angle), np.sin(angle)) for angle in (turned, tilted))
    around = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    over = np.array([[1, 0, 0], [0, d, -e], [0, e, d]])
    return np.asarray(over @ around @ UPRIGHT[up_axis])


def seen_surface(camera: Camera, vertices: Floats, faces: Integers) -> Surface:
    """What a camera sees of a mesh."""
    return surface_of(camera.project(vertices), faces, camera.size)


def caged(surface: Surface, camera: Camera, cage: Floats, cage_faces: Integers) -> Picture:
    """A pale model with its cage's edges over it, fainter where they are behind."""
    projected, size = camera.project(cage), camera.size
    edges = np.unique(np.sort(cage_faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)
    depth = lines(projected, edges, THICKNESS * SAMPLES, size)
    before = np.minimum(surface.depth, rasterised(projected[cage_faces], size).depth)
    opacity = np.where(depth <= before + CLEARANCE * size, NEAR, FAR)
    picture = painted(surface, colour(PALE))
    return drawn_over(picture, colour(LINE), np.where(np.isfinite(depth), opacity, 0))


def colour(text: str) -> Floats:
    """Red, green and blue, 0 to 1, of #rrggbb."""
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)]) / 255
