"""Pictures of a model and its cage, and from where they are seen: the front, or a worst region."""

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.notes import MAX_FAIR_DEVIATION
from cageik_cli.report.render.raster import (
    Camera,
    ParallelCamera,
    PerspectiveCamera,
    rasterize,
    rasterize_lines,
)
from cageik_cli.report.render.shading import (
    MESH_COLOURS,
    SAMPLES_PER_PIXEL,
    Picture,
    VisibleSurface,
    colour_pixels,
    downsample,
    overlay,
    parse_colour,
    rasterize_surface,
    render,
)
from cageik_cli.store.result import KeyFrames, StoredAnimation, read_binding, read_key_frames
from cageik_cli.util.arrays import Floats, Integers

FRAME_LABELS = ("worst", "median", "best")

VIEW_TURN = 32.0
"""Degrees of the usual viewpoint to the right of the front."""

REGION_TURNS = tuple(VIEW_TURN + turn for turn in (0, -64, 58, -122, 103, -167, 148, 180))
"""From where the worst region may be looked at, the usual view first."""

DEPTH_TOL = 0.006
"""Share of the picture's size; lines at most this far behind a surface count as before it."""

VIEW_TILT = 14.0
"""Degrees that views are from above."""

MIN_SEEN_SHARE = 0.8
"""The first turn is chosen that shows this share of the pixels of the best one."""


def project_surface(camera: Camera, vertices: Floats, faces: Integers) -> VisibleSurface:
    """Rasterize what a camera sees of a mesh."""
    shape = camera.shape(vertices) if isinstance(camera, PerspectiveCamera) else None
    return rasterize_surface(camera.project(vertices), faces, camera.size, shape)


def render_model(surface: VisibleSurface) -> Picture:
    """Draw a pale model."""
    return render(surface, parse_colour(MESH_COLOURS["model"]))


def render_with_cage(surface: VisibleSurface, camera: Camera, cage: TriMesh) -> Picture:
    """Draw a pale model and the lines of its cage, fainter where they are behind a surface."""
    return overlay_cage(render_model(surface), camera, surface, cage)


def overlay_cage(
    picture: Picture, camera: Camera, surface: VisibleSurface, cage: TriMesh
) -> Picture:
    """Draw the lines of a cage over a picture: its polygons, fainter where a surface is before."""
    line_width, front_opacity, hidden_opacity = 1.3 * SAMPLES_PER_PIXEL, 0.95, 0.28
    projected, size = camera.project(cage.vertices), camera.size
    depth = rasterize_lines(projected, cage.polygon_sides, line_width, size)
    _, cage_depth = rasterize(projected[cage.faces], size)
    before = np.minimum(surface.depth, cage_depth)
    opacity = np.where(depth <= before + DEPTH_TOL * size, front_opacity, hidden_opacity)
    return overlay(
        picture, parse_colour(MESH_COLOURS["cage"]), np.where(np.isfinite(depth), opacity, 0)
    )


def view_axes(up_axis: str, turn: float, tilt: float = VIEW_TILT) -> Floats:
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

    `deviation` is nan for missing data, and `size`, that of the region, is in the units of `rest`.
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
) -> float:
    """Choose from which of `REGION_TURNS` the chosen vertices, (m,), are seen best.

    Small pictures are compared. It is the first turn from which nearly as many pixels
    of their faces are seen as from the best: at least `MIN_SEEN_SHARE` of them.
    """
    pixels = 64  # width and height of pictures that are only counted
    wanted = np.asarray(chosen[faces].any(axis=1))
    if not wanted.any():  # vertices in no face are seen from nowhere
        return REGION_TURNS[0]
    points = vertices[faces[wanted]].reshape(-1, 3)
    centre = 0.5 * points.min(axis=0) + 0.5 * points.max(axis=0)
    radius = float(np.linalg.norm(points - centre, axis=1).max()) or 1.0
    seen = []
    for turn in REGION_TURNS:
        camera = ParallelCamera(view_axes(up_axis, turn), centre, radius, pixels)
        face, _ = rasterize(camera.project(vertices)[faces], pixels)
        seen.append(int(wanted[face[face >= 0]].sum()))
    enough = MIN_SEEN_SHARE * max(seen)
    return next(turn for turn, count in zip(REGION_TURNS, seen, strict=True) if count >= enough)


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
class RegionView:
    """How to look at the worst region.

    Attributes
    ----------
    pose : Pose
        The frame in which it deviates most.
    centre : (3,) float64
        Middle of the region in that frame.
    extent : float
        Half the width of a close-up, file units.
    turn : float
        Degrees to the right of the front from which it is seen.
    """

    pose: Pose
    centre: Floats
    extent: float
    turn: float


@dataclass(frozen=True, slots=True, eq=False)
class PoseSet:
    """The meshes that a page draws.

    Attributes
    ----------
    faces : (t, 3) int64
    cage : TriMesh
        The rest cage; `cage.move(pose.cage)` is that of a pose.
    poses : tuple of Pose
        The rest pose first.
    vertex_rms : (m,) float64
        RMS of each vertex over the frames, percent of the diagonal; nan for missing data.
    up_axis : str
        "Y" or "Z".
    region : RegionView, optional
        The worst region, which all poses are seen from the side of; None if there is none.
    """

    faces: Integers
    cage: TriMesh
    poses: tuple[Pose, ...]
    vertex_rms: Floats
    up_axis: str
    region: RegionView | None = None

    @property
    def drawn(self) -> Integers:
        """Return the numbers of the vertices in faces: others may be far away."""
        return np.unique(self.faces)

    @property
    def turn(self) -> float:
        """Return the degrees to the right of the front from which poses are seen."""
        return VIEW_TURN if self.region is None else self.region.turn


def load_poses(result: StoredAnimation) -> PoseSet | None:
    """Load the poses of a result; None if it was written without weights."""
    binding = read_binding(result)
    if binding is None:
        return None
    rest, cage, diagonal = result.rest, result.cage, result.rest.diagonal
    reconstruction = binding.rebuilt_rest
    deviation = _deviation_percent((reconstruction - rest.vertices) / diagonal)
    poses = [Pose("rest", "rest pose", rest.vertices, reconstruction, cage.vertices, deviation)]
    key_frames = read_key_frames(result, binding)
    poses += [_make_pose(result, key_frames, k, label) for k, label in enumerate(FRAME_LABELS)]
    return PoseSet(
        faces=rest.faces,
        cage=cage,
        poses=tuple(poses),
        vertex_rms=100 * result.vertex_rms / diagonal,
        up_axis=result.scene.up_axis,
        region=_find_region_view(result, key_frames),
    )


def _make_pose(result: StoredAnimation, key_frames: KeyFrames, k: int, label: str) -> Pose:
    """Make the pose of a frame that is kept in full."""
    misses, reconstruction = key_frames.errors[k], key_frames.reconstructed[k]
    return Pose(
        label=label,
        name=result.frames[key_frames.indices[k]],
        original=reconstruction + result.rest.diagonal * misses,
        reconstruction=reconstruction,
        cage=key_frames.cages[k],
        deviation=_deviation_percent(misses),
    )


def _find_region_view(result: StoredAnimation, key_frames: KeyFrames) -> RegionView | None:
    """Find where to see the worst region from; None if there is none, or its frame is not kept."""
    region = result.worst_region
    kept = key_frames.indices.tolist()
    if region is None or region.frame not in kept:
        return None
    pose, rest = _make_pose(result, key_frames, kept.index(region.frame), "region"), result.rest
    deviation = np.where(np.isfinite(result.vertex_rms), pose.deviation, np.nan)
    chosen = find_region_vertices(rest.vertices, deviation, region.worst_vertex, region.size)
    centre, extent = fit_close_up(pose.reconstruction[chosen], region.size, rest.diagonal)
    turn = choose_turn(pose.reconstruction, rest.faces, chosen, result.scene.up_axis)
    return RegionView(pose, centre, extent, turn)


def _deviation_percent(misses: Floats) -> Floats:
    return np.asarray(100 * np.linalg.norm(misses, axis=1))


def encode_png(picture: Picture, colours: int | None = None) -> bytes:
    """Encode a picture as PNG, with colours in 64 levels, which halves the file.

    With `colours`, it has only so many, and a small file: for small pictures, as this takes longer.
    """
    stream = io.BytesIO()
    levels = np.rint(255 * np.clip(downsample(picture), 0, 1)).astype(np.uint8)
    levels[:3] &= np.where(levels[3] > 0, 0xFC, 0).astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(levels.transpose(1, 2, 0)), "RGBA")
    if colours is not None:
        few = image.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        few.save(stream, "PNG", optimize=True)
    else:
        # Run lengths are most of what compresses in shaded surfaces: a third of the time, 7 %
        # larger.
        image.save(stream, "PNG", compress_type=Image.RLE)
    return stream.getvalue()


def draw_thumbnail(result: StoredAnimation, pixels: int = 96) -> bytes | None:
    """Draw the worst frame of a result as a small PNG; None if it was written without weights.

    The colours are of the deviation, from 0 to `MAX_FAIR_DEVIATION` percent of the diagonal for all
    clips, so that they can be compared at a glance; larger values are clamped.
    """
    binding = read_binding(result)
    if binding is None:
        return None
    worst = _make_pose(result, read_key_frames(result, binding), FRAME_LABELS.index("worst"), "")
    vertices, faces = worst.reconstruction, result.rest.faces
    deviation = np.where(np.isfinite(result.vertex_rms), worst.deviation, np.nan)
    axes = view_axes(result.scene.up_axis, VIEW_TURN)
    camera = ParallelCamera.fit(axes, vertices[np.unique(faces)], SAMPLES_PER_PIXEL * pixels)
    surface = project_surface(camera, vertices, faces)
    picture = render(surface, colour_pixels(surface, deviation, MAX_FAIR_DEVIATION))
    return encode_png(picture, colours=48)
