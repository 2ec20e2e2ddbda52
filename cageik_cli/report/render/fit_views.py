"""Pictures of fitted weights beside those before the fit: the same frames, and one vertex moved."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.report.render.model_views import (
    FRAME_LABELS,
    Pose,
    PoseSet,
    encode_png,
    overlay_cage,
    project_surface,
)
from cageik_cli.report.render.raster import ParallelCamera, rasterize_lines
from cageik_cli.report.render.shading import (
    COLOUR_SCALE,
    MESH_COLOURS,
    SAMPLES_PER_PIXEL,
    SIGNED_SCALE,
    Picture,
    choose_scale_end,
    colour_pixels,
    colour_signed_pixels,
    overlay,
    parse_colour,
    render,
)
from cageik_cli.report.render.viewpoints import REGION_TURNS, choose_view, view_axes
from cageik_cli.store.fit_fields import UnfittedClip
from cageik_cli.store.result import Result
from cageik_cli.store.result_frames import read_binding, read_unfitted
from cageik_cli.util.arrays import Floats, Integers

MOVE_SHARE = 0.05
"""How far a cage vertex is moved, in diagonals of the model."""

MOVE_COLOUR, MOVE_WIDTH = "#111418", 4.0
"""Of the line along which the vertex is moved; pixels."""

COMPARED_LABELS = ("worst", "median")

SEEN_SHARE = 0.5
"""The moved vertex is seen from where most vertices are seen that move more than this share."""

CLOSE_SHARE = 0.1
"""A close-up shows the vertices that move more than this share of the largest displacement."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPose:
    """A frame as it is, and from the cages that each kind of weights gives.

    Attributes
    ----------
    pose : Pose
        With fitted weights.
    unfitted : (m, 3) float64
        The reconstruction with the weights before the fit.
    unfitted_deviation : (m,) float64
        Percent of the diagonal.
    """

    pose: Pose
    unfitted: Floats
    unfitted_deviation: Floats


@dataclass(frozen=True, slots=True, eq=False)
class MovedVertex:
    """A vertex of the rest cage that is moved outward.

    Attributes
    ----------
    move : (3,) float64
    unfitted, fitted : (m,) float64
        Its weights, before and after the fit.
    cage_faces : (k, 3) int64
        The faces that meet at the vertex.
    """

    vertex: int
    move: Floats
    unfitted: Floats
    fitted: Floats
    cage_faces: Integers


@dataclass(frozen=True, slots=True, eq=False)
class FitShapes:
    """The meshes that a page draws of a fit, beside its poses."""

    poses: tuple[ComparedPose, ...]
    moved: MovedVertex


@dataclass(frozen=True, slots=True)
class ComparedPictures:
    """Pictures from one viewpoint, as PNG files.

    Attributes
    ----------
    label, name : str
        As in `Pose`; of a moved vertex, the viewpoint.
    original : bytes, optional
        The input, if there is one.
    """

    label: str
    name: str
    original: bytes | None
    unfitted: bytes
    fitted: bytes


@dataclass(frozen=True, slots=True)
class FitPictures:
    """All pictures of a fit, and their colour scales.

    Attributes
    ----------
    poses : tuple of ComparedPictures
        The worst and the median frame, coloured by deviation.
    moved : tuple of ComparedPictures
        The rest pose with a cage vertex moved, coloured by displacement along the move.
    vertex : int
        The vertex.
    max_deviation_percent, max_move_percent : float
        Ends of the colour scales, percent of the diagonal; larger values are clamped. The second
        begins at its negative.
    unfitted_range, fitted_range : (float, float)
        The smallest and the largest displacement, percent of the diagonal.
    colours, signed_colours : tuple of str
        In even steps, as #rrggbb.
    """

    poses: tuple[ComparedPictures, ...]
    moved: tuple[ComparedPictures, ...]
    vertex: int
    max_deviation_percent: float
    max_move_percent: float
    unfitted_range: tuple[float, float]
    fitted_range: tuple[float, float]
    colours: tuple[str, ...] = COLOUR_SCALE
    signed_colours: tuple[str, ...] = SIGNED_SCALE


def load_fit_shapes(result: Result, poses: PoseSet) -> FitShapes | None:
    """Load what is drawn of a fit; None if the result does not hold the weights before it.

    Raises
    ------
    InputError
        When the file is damaged.
    """
    binding = None if result.fit is None else read_binding(result)
    if binding is None:
        return None
    shapes = read_unfitted(result)
    if shapes is None:
        return None
    frames = {pose.label: pose for pose in poses.poses}
    compared = [
        _compare_pose(frames[label], shapes.misses[FRAME_LABELS.index(label)], result.rest.diagonal)
        for label in COMPARED_LABELS
    ]
    fitted = binding.weights[:, shapes.cage_vertex]
    return FitShapes(tuple(compared), _move_vertex(result, shapes, fitted))


def _compare_pose(pose: Pose, misses: Floats, diagonal: float) -> ComparedPose:
    deviation = 100 * np.linalg.norm(misses, axis=1)
    return ComparedPose(pose, pose.original - diagonal * misses, np.asarray(deviation))


def _move_vertex(result: Result, shapes: UnfittedClip, fitted: Floats) -> MovedVertex:
    """Move a cage vertex outward, along the sum of the normals of its faces."""
    cage, vertex = result.cage, shapes.cage_vertex
    faces = cage.faces[(cage.faces == vertex).any(axis=1)]
    first, second, third = cage.vertices[faces].transpose(1, 0, 2) / result.rest.diagonal
    normal = np.cross(second - first, third - first).sum(axis=0)
    length = float(np.linalg.norm(normal))
    outward = normal / length if length > 0 else np.array([0.0, 0.0, 1.0])
    move = MOVE_SHARE * result.rest.diagonal * outward
    return MovedVertex(vertex, move, shapes.influence, fitted, faces)


def render_fit_pictures(poses: PoseSet, shapes: FitShapes, pixels: int = 360) -> FitPictures:
    """Draw frames and a moved vertex with both kinds of weights, in squares of `pixels`."""
    known, size = np.isfinite(poses.vertex_rms), SAMPLES_PER_PIXEL * pixels
    moved = shapes.moved
    deviations = [
        values[known]
        for one in shapes.poses
        for values in (one.unfitted_deviation, one.pose.deviation)
    ]
    displaced = 100 * MOVE_SHARE * np.stack([moved.unfitted, moved.fitted])
    top = choose_scale_end(np.concatenate(deviations))
    reach = choose_scale_end(np.abs(displaced).ravel())
    views = _choose_move_views(poses, moved, size)
    return FitPictures(
        poses=tuple(_render_compared(poses, one, top, size) for one in shapes.poses),
        moved=tuple(_render_moved(poses, moved, reach, name, views[name]) for name in views),
        vertex=moved.vertex,
        max_deviation_percent=top,
        max_move_percent=reach,
        unfitted_range=(float(displaced[0].min()), float(displaced[0].max())),
        fitted_range=(float(displaced[1].min()), float(displaced[1].max())),
    )


def _render_compared(poses: PoseSet, one: ComparedPose, top: float, size: int) -> ComparedPictures:
    pose, known = one.pose, np.isfinite(poses.vertex_rms)
    shapes = np.stack([pose.original, one.unfitted, pose.reconstruction])
    points = shapes[:, poses.drawn].reshape(-1, 3)
    camera = ParallelCamera.fit(view_axes(poses.up_axis, poses.turn), points, size)

    def draw(vertices: Floats, deviation: Floats) -> bytes:
        surface = project_surface(camera, vertices, poses.faces)
        shown = np.where(known, deviation, np.nan)
        return encode_png(render(surface, colour_pixels(surface, shown, top)))

    original = project_surface(camera, pose.original, poses.faces)
    return ComparedPictures(
        label=pose.label,
        name=pose.name,
        original=encode_png(render(original, parse_colour(MESH_COLOURS["input"]))),
        unfitted=draw(one.unfitted, one.unfitted_deviation),
        fitted=draw(pose.reconstruction, pose.deviation),
    )


def _choose_move_views(poses: PoseSet, moved: MovedVertex, size: int) -> dict[str, ParallelCamera]:
    """Return the cameras, by name: the whole model from where the move is seen, and close up."""
    rest, cage = poses.poses[0].original, poses.poses[0].cage
    largest = np.maximum(np.abs(moved.unfitted), np.abs(moved.fitted))
    chosen = largest > SEEN_SHARE * largest.max()
    turns = {turn: view_axes(poses.up_axis, turn) for turn in REGION_TURNS}
    turn = choose_view(rest, poses.faces, chosen, turns) if chosen.any() else REGION_TURNS[0]
    tip = (cage[moved.vertex] + moved.move)[None]
    whole = np.concatenate([rest[poses.drawn], cage[moved.cage_faces.ravel()], tip])
    near = np.concatenate([rest[largest > CLOSE_SHARE * largest.max()], tip])
    behind = view_axes(poses.up_axis, turn + 180)
    return {
        "close up": ParallelCamera.fit(turns[turn], near, size),
        "whole model": ParallelCamera.fit(turns[turn], whole, size),
        "from the other side": ParallelCamera.fit(behind, whole, size),
    }


def _render_moved(
    poses: PoseSet, moved: MovedVertex, top: float, name: str, camera: ParallelCamera
) -> ComparedPictures:
    cage = poses.poses[0].cage.copy()
    ends = cage[moved.vertex] + np.array([[0.0], [1.0]]) * moved.move
    cage[moved.vertex] = ends[1]

    def draw(influence: Floats) -> bytes:
        vertices = poses.poses[0].original + influence[:, None] * moved.move
        surface = project_surface(camera, vertices, poses.faces)
        displaced = 100 * MOVE_SHARE * influence
        picture = render(surface, colour_signed_pixels(surface, displaced, top))
        picture = overlay_cage(picture, camera, surface, cage, moved.cage_faces)
        return encode_png(_overlay_move(picture, camera, ends))

    return ComparedPictures("moved", name, None, draw(moved.unfitted), draw(moved.fitted))


def _overlay_move(picture: Picture, camera: ParallelCamera, ends: Floats) -> Picture:
    """Draw a thick line from where the vertex was to where it is, (2, 3), before all else."""
    width, projected = MOVE_WIDTH * SAMPLES_PER_PIXEL, camera.project(ends)
    depth = rasterize_lines(projected, np.array([[0, 1]]), width, camera.size)
    return overlay(picture, parse_colour(MOVE_COLOUR), np.where(np.isfinite(depth), 1.0, 0.0))
