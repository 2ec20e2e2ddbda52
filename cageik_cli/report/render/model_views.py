"""Pictures of a model and its cage, seen from the front, slightly from the right and above."""

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image

from cageik_cli.report.render.raster import ParallelCamera, rasterize, rasterize_lines
from cageik_cli.report.render.shading import (
    SAMPLES_PER_PIXEL,
    Picture,
    VisibleSurface,
    downsample,
    map_colours,
    overlay,
    rasterize_surface,
    render,
)
from cageik_cli.store.result import Result
from cageik_cli.store.result_frames import read_binding, read_key_frames
from cageik_cli.util.arrays import Floats, Integers

MODEL_COLOUR, CAGE_COLOUR = "#f0ede8", "#1f6fd0"
"""Colours of a model drawn in its cage, and of the cage."""

VIEW_TURN, VIEW_TILT = 32.0, 14.0
"""Degrees of the viewpoint to the right of the front, and above it."""

UPRIGHT_AXES = {"Y": np.eye(3), "Z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])}
"""Rows: right, up and front of an upright model, by its up axis."""

LINE_WIDTH = 1.3
"""Pixels."""

DEPTH_TOL = 0.006
"""Share of the picture's size; lines at most this far behind a surface count as before it."""

FRONT_OPACITY, HIDDEN_OPACITY = 0.95, 0.28
"""Opacity of lines before all surfaces, and behind one."""


def view_axes(up_axis: str, turn: float) -> Floats:
    """Return right, up and backward of a view from `turn` degrees right of the front, as rows."""
    turn_angle, tilt_angle = np.radians((turn, VIEW_TILT))
    (c, s), (d, e) = ((np.cos(angle), np.sin(angle)) for angle in (turn_angle, tilt_angle))
    around = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    over = np.array([[1, 0, 0], [0, d, -e], [0, e, d]])
    return np.asarray(over @ around @ UPRIGHT_AXES[up_axis])


def project_surface(camera: ParallelCamera, vertices: Floats, faces: Integers) -> VisibleSurface:
    """Rasterize what a camera sees of a mesh."""
    return rasterize_surface(camera.project(vertices), faces, camera.size)


def render_with_cage(
    surface: VisibleSurface, camera: ParallelCamera, cage: Floats, cage_faces: Integers
) -> Picture:
    """Draw a pale model and the edges of its cage, fainter where they are behind a surface."""
    projected, size = camera.project(cage), camera.size
    edges = np.unique(np.sort(cage_faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)
    depth = rasterize_lines(projected, edges, LINE_WIDTH * SAMPLES_PER_PIXEL, size)
    before = np.minimum(surface.depth, rasterize(projected[cage_faces], size).depth)
    opacity = np.where(depth <= before + DEPTH_TOL * size, FRONT_OPACITY, HIDDEN_OPACITY)
    picture = render(surface, parse_colour(MODEL_COLOUR))
    return overlay(picture, parse_colour(CAGE_COLOUR), np.where(np.isfinite(depth), opacity, 0))


def parse_colour(text: str) -> Floats:
    """Return red, green and blue, 0 to 1, of #rrggbb."""
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)]) / 255


FRAME_LABELS = ("worst", "median", "best")


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """The original model, its reconstruction from the cage, and the cage.

    Attributes
    ----------
    label : str
        "rest", "worst", "median" or "best".
    name : str
        Name of the frame; "rest pose" for the rest pose.
    original, reconstruction : (m, 3) float64
    cage : (n, 3) float64
    deviation : (m,) float64
        |v̂ − v|, percent of the diagonal.
    """

    label: str
    name: str
    original: Floats
    reconstruction: Floats
    cage: Floats
    deviation: Floats


@dataclass(frozen=True, slots=True, eq=False)
class PoseSet:
    """The meshes that a page draws.

    Attributes
    ----------
    faces, cage_faces : (t, 3) and (f, 3) int64
    poses : tuple of Pose
        The rest pose first.
    vertex_rms : (m,) float64
        RMS of each vertex over the frames, percent of the diagonal; nan for missing data.
    up_axis : str
        "Y" or "Z".
    """

    faces: Integers
    cage_faces: Integers
    poses: tuple[Pose, ...]
    vertex_rms: Floats
    up_axis: str


def load_poses(result: Result) -> PoseSet | None:
    """Load the poses of a result; None if it was written without weights.

    Raises
    ------
    InputError
        When the file is damaged.
    """
    binding = read_binding(result)
    if binding is None:
        return None
    rest, cage, diagonal = result.rest, result.cage, result.rest.diagonal
    reconstruction = binding.weights @ cage.vertices
    if binding.has_offsets:
        reconstruction = rest.vertices
    deviation = _deviation_percent((reconstruction - rest.vertices) / diagonal)
    poses = [Pose("rest", "rest pose", rest.vertices, reconstruction, cage.vertices, deviation)]
    key_frames = read_key_frames(result, binding)
    for k, label in enumerate(FRAME_LABELS):
        name, reconstruction, misses = (
            result.frames[key_frames.indices[k]],
            key_frames.reconstructed[k],
            key_frames.errors[k],
        )
        original = reconstruction + diagonal * misses
        poses.append(
            Pose(
                label,
                name,
                original,
                reconstruction,
                key_frames.cages[k],
                _deviation_percent(misses),
            )
        )
    vertex_rms = 100 * result.vertex_rms / diagonal
    return PoseSet(rest.faces, cage.faces, tuple(poses), vertex_rms, result.scene.up_axis)


def _deviation_percent(misses: Floats) -> Floats:
    return np.asarray(100 * np.linalg.norm(misses, axis=1))


COLOUR_SCALE = (
    "#f2eada", "#efd098", "#ecb362", "#e69441", "#e56e38", "#d64d41", "#bb3252",
    "#8f2c64", "#5d2d62",
)  # fmt: skip
"""From light to dark in even steps, so that they can be told apart without colour vision."""

CLAY_COLOUR, MISSING_COLOUR = "#e2d6c8", "#a3a8ad"

SCALE_PERCENTILE = 99.5
"""Percent of the vertices that are within a colour scale."""

SCALE_ENDS = (1, 1.5, 2, 3, 4, 5, 6, 8, 10)
"""A colour scale ends at one of these numbers, times a power of ten."""

MIN_SCALE_END = 0.001
"""Percent of the diagonal; no scale ends lower, so that rounding does not look like an error."""


@dataclass(frozen=True, slots=True)
class PosePictures:
    """Three pictures of a pose from one viewpoint, as PNG files.

    Attributes
    ----------
    label, name : str
        As in `Pose`.
    original, reconstruction, cage : bytes
        The input; the reconstruction, coloured by deviation; the reconstruction in its cage.
    """

    label: str
    name: str
    original: bytes
    reconstruction: bytes
    cage: bytes


@dataclass(frozen=True, slots=True)
class Pictures:
    """All pictures of a result, and their colour scales.

    Attributes
    ----------
    poses : tuple of PosePictures
    rest_views : tuple of bytes
        The rest pose from the front and from behind, coloured by the vertices' rms.
    max_deviation_percent, max_rms_percent : float
        Ends of the colour scales of the poses and of the rest views, percent of the diagonal;
        larger values are clamped.
    colours : tuple of str
        Colours of both scales, from 0 to their ends in even steps, as #rrggbb. Missing data is
        grey.
    """

    poses: tuple[PosePictures, ...]
    rest_views: tuple[bytes, ...]
    max_deviation_percent: float
    max_rms_percent: float
    colours: tuple[str, ...]


def render_pictures(poses: PoseSet, pixels: int = 360) -> Pictures:
    """Draw the poses and the error on the rest pose, in squares of `pixels`."""
    known = np.isfinite(poses.vertex_rms)
    max_deviation = _choose_scale_end(
        np.concatenate([pose.deviation[known] for pose in poses.poses])
    )
    max_rms = _choose_scale_end(poses.vertex_rms[known])
    return Pictures(
        poses=tuple(_render_pose(poses, pose, max_deviation, pixels) for pose in poses.poses),
        rest_views=tuple(
            _render_rest(poses, turn, max_rms, pixels) for turn in (VIEW_TURN, VIEW_TURN + 180)
        ),
        max_deviation_percent=max_deviation,
        max_rms_percent=max_rms,
        colours=COLOUR_SCALE,
    )


def _choose_scale_end(values: Floats) -> float:
    """Choose a round end for a scale that holds nearly all values."""
    wanted = max(
        float(np.percentile(values, SCALE_PERCENTILE)) if len(values) else 0.0, MIN_SCALE_END
    )
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(f"{power * next((k for k in SCALE_ENDS if k * power >= wanted), 10):.2g}")


def _render_pose(poses: PoseSet, pose: Pose, top: float, pixels: int) -> PosePictures:
    points = np.concatenate([pose.original, pose.reconstruction, pose.cage])
    camera = ParallelCamera.fit(
        view_axes(poses.up_axis, VIEW_TURN), points, SAMPLES_PER_PIXEL * pixels
    )
    original = project_surface(camera, pose.original, poses.faces)
    reconstruction = project_surface(camera, pose.reconstruction, poses.faces)
    deviation = np.where(np.isfinite(poses.vertex_rms), pose.deviation, np.nan)
    return PosePictures(
        label=pose.label,
        name=pose.name,
        original=_encode_png(render(original, parse_colour(CLAY_COLOUR))),
        reconstruction=_encode_png(
            render(reconstruction, _colour_pixels(reconstruction, deviation, top))
        ),
        cage=_encode_png(render_with_cage(reconstruction, camera, pose.cage, poses.cage_faces)),
    )


def _render_rest(poses: PoseSet, turn: float, top: float, pixels: int) -> bytes:
    rest = poses.poses[0].reconstruction
    camera = ParallelCamera.fit(view_axes(poses.up_axis, turn), rest, SAMPLES_PER_PIXEL * pixels)
    surface = project_surface(camera, rest, poses.faces)
    return _encode_png(render(surface, _colour_pixels(surface, poses.vertex_rms, top)))


def _colour_pixels(surface: VisibleSurface, values: Floats, top: float) -> Floats:
    stops = np.array([parse_colour(stop) for stop in COLOUR_SCALE])
    return map_colours(surface.interpolate(values), top, stops, parse_colour(MISSING_COLOUR))


def _encode_png(picture: Picture) -> bytes:
    """Encode a picture as PNG, with colours in 64 levels, which halves the file."""
    stream = io.BytesIO()
    levels = np.rint(255 * np.clip(downsample(picture), 0, 1)).astype(np.uint8)
    levels[:3] &= np.where(levels[3] > 0, 0xFC, 0).astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(levels.transpose(1, 2, 0)), "RGBA")
    # Run lengths are most of what compresses in shaded surfaces: a third of the time, 7 % larger.
    image.save(stream, "PNG", compress_type=Image.RLE)
    return stream.getvalue()
