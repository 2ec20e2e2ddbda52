"""The pictures of a page: the poses, the worst region, and the error on the rest pose.

Of fitted weights, frames are drawn with these and with those before the fit, and so is the rest
pose with one cage vertex moved.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cageik_cli.geometry.attributes import SurfaceAttributes
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.figures import format_percent
from cageik_cli.report.html.templating import format_ticks, make_png_url
from cageik_cli.report.record import Report
from cageik_cli.report.render.model_views import (
    FRAME_LABELS,
    VIEW_TURN,
    Pose,
    PoseSet,
    RegionView,
    choose_turn,
    encode_png,
    overlay_cage,
    project_surface,
    render_with_cage,
    view_axes,
)
from cageik_cli.report.render.raster import ParallelCamera, rasterize_lines
from cageik_cli.report.render.shading import (
    COLOUR_SCALE,
    MESH_COLOURS,
    SAMPLES_PER_PIXEL,
    SIGNED_SCALE,
    choose_scale_end,
    colour_pixels,
    colour_signed_pixels,
    overlay,
    parse_colour,
    render,
)
from cageik_cli.report.vocabulary import Vocabulary
from cageik_cli.store.result import StoredAnimation, read_baseline_errors, read_binding
from cageik_cli.util.arrays import Floats
from cageik_cli.util.text import format_count
from cageik_cli.util.threads import count_processors

View = tuple[str, str, str]
"""A picture of a page: its caption, its file as a data URL, and what it shows in words."""

DEFAULT_MOVE = 0.05
"""How far a cage vertex is moved, in diagonals of the model."""


def draw_pictures(poses: PoseSet, words: Vocabulary, pixels: int = 360) -> dict[str, Any]:
    """Draw the poses and the error on the rest pose, in squares of `pixels`.

    Returns
    -------
    dict
        Of the page's template: `poses`, each with its title, the name of its frame and its views,
        coloured by deviation; `close_up`, views of the worst region; `rest_views`, from the front
        and from behind, coloured by the vertices' rms; `colours` of both scales from 0 to their
        ends in even steps, and the numbers at their feet. Larger values are clamped.
    """
    known, size = np.isfinite(poses.vertex_rms), SAMPLES_PER_PIXEL * pixels
    top = choose_scale_end(np.concatenate([pose.deviation[known] for pose in poses.poses]))
    rms_top = choose_scale_end(poses.vertex_rms[known])
    frames = {"worst": words.worst, "median": "median", "best": words.best}
    titles = {label: f"{text.capitalize()} frame" for label, text in frames.items()}

    def draw_pose(pose: Pose) -> dict[str, Any]:
        title, name = titles.get(pose.label, "Rest pose"), pose.name if pose.label in titles else ""
        drawn = poses.drawn
        points = np.concatenate([pose.original[drawn], pose.reconstruction[drawn], pose.cage])
        # On the side of the worst region.
        camera = ParallelCamera.fit(view_axes(poses.up_axis, poses.turn), points, size)
        views = _draw_views(poses, pose, top, camera, title, words)
        return {"title": title, "name": name, "views": views}

    def draw_rest(side: str, turn: float) -> View:
        text = f"The rest pose {side.lower()}, coloured by the RMS of each vertex"
        rest = poses.poses[0].reconstruction
        camera = ParallelCamera.fit(view_axes(poses.up_axis, turn), rest[poses.drawn], size)
        surface = project_surface(camera, rest, poses.faces)
        drawn = render(surface, colour_pixels(surface, poses.vertex_rms, rms_top))
        return side, make_png_url(encode_png(drawn)), text

    def draw_close_up(view: RegionView) -> list[View]:
        """Draw the worst region, from where it is seen."""
        camera = ParallelCamera(view_axes(poses.up_axis, view.turn), view.centre, view.extent, size)
        return _draw_views(poses, view.pose, top, camera, "Worst region, close up", words)

    with ThreadPoolExecutor(count_processors()) as pool:
        drawn_poses = pool.map(draw_pose, poses.poses)
        turns = (VIEW_TURN, VIEW_TURN + 180)
        rest_views = pool.map(draw_rest, ("From the front", "From behind"), turns)
        close_up = poses.region and pool.submit(draw_close_up, poses.region)
        return {
            "poses": list(drawn_poses),
            "close_up": close_up.result() if close_up else [],
            "rest_views": list(rest_views),
            "colours": COLOUR_SCALE,
            "ticks": format_ticks(top),
            "rms_ticks": format_ticks(rms_top),
        }


def _draw_views(
    poses: PoseSet, pose: Pose, top: float, camera: ParallelCamera, title: str, words: Vocabulary
) -> list[View]:
    """Draw a pose: the original, the reconstruction coloured by deviation, and its cage."""
    original = project_surface(camera, pose.original, poses.faces)
    reconstruction = project_surface(camera, pose.reconstruction, poses.faces)
    deviation = np.where(np.isfinite(poses.vertex_rms), pose.deviation, np.nan)
    drawn = (
        render(original, parse_colour(MESH_COLOURS["input"])),
        render(reconstruction, colour_pixels(reconstruction, deviation, top)),
        render_with_cage(reconstruction, camera, poses.cage.move(pose.cage)),
    )
    captions = (words.original, words.reconstruction, "cage")
    coloured = ("", f", coloured by {words.distance}", "")
    return [
        (what.capitalize(), make_png_url(encode_png(picture)), f"{title}: the {what}{how}")
        for what, how, picture in zip(captions, coloured, drawn, strict=True)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class FitShapes:
    """The meshes that a page draws of a fit, beside its poses.

    Attributes
    ----------
    poses : tuple of (Pose, Pose)
        The worst and the median frame, from the cages of the weights before the fit, and of the
        fitted ones.
    vertex : int
        A vertex of the rest cage that is moved outward.
    move : (3,) float64
    unfitted, fitted : (m,) float64
        Its weights, before and after the fit.
    faces_around : TriMesh
        The polygons of the rest cage that have the vertex, with all vertices of the cage.
    """

    poses: tuple[tuple[Pose, Pose], ...]
    vertex: int
    move: Floats
    unfitted: Floats
    fitted: Floats
    faces_around: TriMesh


def load_fit_shapes(result: StoredAnimation, poses: PoseSet) -> FitShapes | None:
    """Load what is drawn of a fit; None if the result does not hold the weights before it."""
    binding = None if result.fit is None else read_binding(result)
    clip = None if binding is None else read_baseline_errors(result)
    if binding is None or clip is None:
        return None
    frames, diagonal = {pose.label: pose for pose in poses.poses}, result.rest.diagonal
    compared = []
    for label in ("worst", "median"):
        fitted, misses = frames[label], clip.misses[FRAME_LABELS.index(label)]
        deviation = np.asarray(100 * np.linalg.norm(misses, axis=1))
        rebuilt = fitted.original - diagonal * misses
        compared.append((replace(fitted, reconstruction=rebuilt, deviation=deviation), fitted))
    faces = result.cage.faces[(result.cage.faces == clip.cage_vertex).any(axis=1)]
    first, second, third = (result.cage.vertices[faces] / diagonal).transpose(1, 0, 2)
    normal = np.cross(second - first, third - first).sum(axis=0)
    length = float(np.linalg.norm(normal))
    outward = normal / length if length > 0 else np.array([0.0, 0.0, 1.0])
    return FitShapes(
        poses=tuple(compared),
        vertex=clip.cage_vertex,
        move=DEFAULT_MOVE * diagonal * outward,
        unfitted=clip.influence,
        fitted=binding.weights[:, clip.cage_vertex],
        faces_around=_cut_polygons(result.cage, clip.cage_vertex),
    )


def _cut_polygons(cage: TriMesh, vertex: int) -> TriMesh:
    """Return the polygons of a cage that have a vertex; vertices keep their numbers."""
    polygons = cage.polygons
    owners = polygons.corner_polygons
    chosen = np.unique(owners[polygons.corners == vertex])
    return TriMesh(
        cage.vertices,
        cage.faces[np.isin(polygons.triangle_polygons, chosen)],
        SurfaceAttributes(
            polygons.corner_counts[chosen], polygons.corners[np.isin(owners, chosen)]
        ),
    )


def draw_fit_section(
    report: Report, poses: PoseSet, shapes: FitShapes | None, pixels: int = 360
) -> dict[str, Any] | None:
    """Draw frames and a moved vertex with both kinds of weights, in squares of `pixels`.

    Returns
    -------
    dict, optional
        Of the section's template: a `summary` of both errors; `names` of both kinds of weights;
        `poses`, the worst and the median frame, coloured by deviation; `moved`, the rest pose with
        a cage vertex moved, for each kind, coloured by displacement along the move; `ranges`, the
        smallest and the largest displacement of each; colours of both scales, and the numbers at
        their feet, percent of the diagonal. The second scale begins at the negative of its end.
        None if the result holds nothing to compare.
    """
    unfitted, words = report.unfitted, report.vocabulary
    if unfitted is None or shapes is None:
        return None
    names = (unfitted.coordinates, "fitted")
    titles = (f"{words.worst} frame".capitalize(), "Median frame")
    known, size = np.isfinite(poses.vertex_rms), SAMPLES_PER_PIXEL * pixels
    deviations = [pose.deviation[known] for pair in shapes.poses for pose in pair]
    displaced = 100 * DEFAULT_MOVE * np.stack([shapes.unfitted, shapes.fitted])
    top = choose_scale_end(np.concatenate(deviations))
    reach = choose_scale_end(np.abs(displaced).ravel())
    cameras = _choose_move_views(poses, shapes, size)
    measured, frames = len(unfitted.frames), len(report.frames)
    where = "all frames" if measured == frames else f"{measured} of {format_count(frames, 'frame')}"
    return {
        "summary": f"RMS over {where}: {format_percent(unfitted.mean_rms_percent)} % with "
        f"{unfitted.coordinates} weights, {format_percent(unfitted.fitted_rms_percent)} % with "
        "fitted ones",
        "names": names,
        "poses": [
            (title, pair[1].name, _draw_compared(poses, pair, names, title, top=top, size=size))
            for title, pair in zip(titles, shapes.poses, strict=True)
        ],
        "vertex": shapes.vertex,
        "move": f"{100 * DEFAULT_MOVE:g} %",
        "ranges": [
            (name, _format_move(moves.min()), _format_move(moves.max()))
            for name, moves in zip(names, displaced, strict=True)
        ],
        "moved": [
            (
                f"{name} weights".capitalize(),
                _draw_moved(poses, shapes, influence, cameras, name, top=reach),
            )
            for name, influence in zip(names, (shapes.unfitted, shapes.fitted), strict=True)
        ],
        "colours": COLOUR_SCALE,
        "signed_colours": SIGNED_SCALE,
        "ticks": format_ticks(top),
        "signed_ticks": format_ticks(reach, -reach),
    }


def _draw_compared(
    poses: PoseSet,
    pair: tuple[Pose, Pose],
    names: tuple[str, str],
    title: str,
    *,
    top: float,
    size: int,
) -> list[View]:
    """Draw the input of a frame, and its reconstructions before and after the fit."""
    known, original = np.isfinite(poses.vertex_rms), pair[1].original
    shapes = np.stack([original, *(pose.reconstruction for pose in pair)])
    points = shapes[:, poses.drawn].reshape(-1, 3)
    camera = ParallelCamera.fit(view_axes(poses.up_axis, poses.turn), points, size)
    surface = project_surface(camera, original, poses.faces)
    drawn = encode_png(render(surface, parse_colour(MESH_COLOURS["input"])))
    views = [("Input", make_png_url(drawn), f"{title}: the input")]
    for name, pose in zip(names, pair, strict=True):
        surface = project_surface(camera, pose.reconstruction, poses.faces)
        shown = np.where(known, pose.deviation, np.nan)
        drawn = encode_png(render(surface, colour_pixels(surface, shown, top)))
        text = f"{title} with {name} weights, coloured by deviation"
        views.append((name.capitalize(), make_png_url(drawn), text))
    return views


def _choose_move_views(poses: PoseSet, moved: FitShapes, size: int) -> dict[str, ParallelCamera]:
    """Return the cameras, by name: close up, and the whole model from where the move is seen.

    That is from where most vertices are seen that move more than half the largest displacement; a
    close-up shows those that move more than a tenth of it.
    """
    rest, cage = poses.poses[0].original, poses.poses[0].cage
    largest = np.maximum(np.abs(moved.unfitted), np.abs(moved.fitted))
    chosen = largest > 0.5 * largest.max()
    turn = choose_turn(rest, poses.faces, chosen, poses.up_axis)
    tip = (cage[moved.vertex] + moved.move)[None]
    whole = np.concatenate([rest[poses.drawn], cage[moved.faces_around.used_vertices], tip])
    near = np.concatenate([rest[largest > 0.1 * largest.max()], tip])
    front, behind = (view_axes(poses.up_axis, side) for side in (turn, turn + 180))
    return {
        "close up": ParallelCamera.fit(front, near, size),
        "whole model": ParallelCamera.fit(front, whole, size),
        "from the other side": ParallelCamera.fit(behind, whole, size),
    }


def _draw_moved(
    poses: PoseSet,
    moved: FitShapes,
    influence: Floats,
    cameras: dict[str, ParallelCamera],
    name: str,
    *,
    top: float,
) -> list[View]:
    """Draw the rest pose with the cage vertex moved, by weights of this name."""
    cage = poses.poses[0].cage.copy()
    ends = cage[moved.vertex] + np.array([[0.0], [1.0]]) * moved.move
    cage[moved.vertex] = ends[1]
    vertices = poses.poses[0].original + influence[:, None] * moved.move
    displaced, views = 100 * DEFAULT_MOVE * influence, []
    for place, camera in cameras.items():
        surface = project_surface(camera, vertices, poses.faces)
        picture = render(surface, colour_signed_pixels(surface, displaced, top))
        picture = overlay_cage(picture, camera, surface, moved.faces_around.move(cage))
        # A thick line from where the vertex was to where it is, before all else.
        depth = rasterize_lines(
            camera.project(ends), np.array([[0, 1]]), 4.0 * SAMPLES_PER_PIXEL, camera.size
        )
        opacity = np.where(np.isfinite(depth), 1.0, 0.0)
        drawn = encode_png(overlay(picture, parse_colour("#111418"), opacity))
        what = f"The rest pose with one cage vertex moved, {name} weights, {place}"
        views.append((place.capitalize(), make_png_url(drawn), f"{what}, coloured by displacement"))
    return views


def _format_move(percent: float) -> str:
    """Format a displacement, without the sign of zero."""
    return format_percent(percent + 0.0)
