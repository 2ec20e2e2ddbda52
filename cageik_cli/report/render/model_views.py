"""A model in its cage, drawn as a viewer sees it who stands before it, somewhat above."""

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image

from cageik_cli.report.render.raster import Camera, lines, rasterised
from cageik_cli.report.render.shading import (
    SAMPLES,
    Picture,
    Surface,
    coloured,
    drawn_over,
    painted,
    reduced,
    surface_of,
)
from cageik_cli.store.result import Result, read_posed_frames, read_weights
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


LABELS = ("worst", "median", "best")


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A model as it was given, as its cage rebuilds it, and the cage.

    Attributes
    ----------
    label : str
        "rest", "worst", "median" or "best".
    name : str
        The frame's; "rest pose" for the rest pose.
    given, rebuilt : (m, 3) float64
    cage : (n, 3) float64
    deviation : (m,) float64
        |v̂ − v|, percent of the diagonal.
    """

    label: str
    name: str
    given: Floats
    rebuilt: Floats
    cage: Floats
    deviation: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """What a page draws.

    Attributes
    ----------
    faces, cage_faces : (t, 3) and (f, 3) int64
    poses : tuple of Pose
        The rest pose first.
    vertex_rms : (m,) float64
        Of each vertex over the frames, percent of the diagonal; nan for missing data.
    up_axis : str
        "Y" or "Z".
    """

    faces: Integers
    cage_faces: Integers
    poses: tuple[Pose, ...]
    vertex_rms: Floats
    up_axis: str


def poses_of(result: Result) -> Poses | None:
    """The poses of a result; None if it was written without its weights.

    Raises
    ------
    InputError
        When the file is damaged.
    """
    weights = read_weights(result)
    if weights is None:
        return None
    rest, cage, diagonal = result.rest, result.cage, result.rest.diagonal
    rebuilt = weights @ cage.vertices
    missed = _percent((rebuilt - rest.vertices) / diagonal)
    poses = [Pose("rest", "rest pose", rest.vertices, rebuilt, cage.vertices, missed)]
    held = read_posed_frames(result, weights)
    for k, label in enumerate(LABELS):
        name, rebuilt, misses = result.frames[held.frames[k]], held.rebuilt[k], held.misses[k]
        given = rebuilt + diagonal * misses
        poses.append(Pose(label, name, given, rebuilt, held.cages[k], _percent(misses)))
    vertex_rms = 100 * result.vertex_rms / diagonal
    return Poses(rest.faces, cage.faces, tuple(poses), vertex_rms, result.scene.up_axis)


def _percent(misses: Floats) -> Floats:
    return np.asarray(100 * np.linalg.norm(misses, axis=1))


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
