"""The pictures of a page: the poses, the worst region, and the error on the rest pose."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from cageik_cli.report.html.templating import format_ticks, make_png_url
from cageik_cli.report.render.model_views import (
    VIEW_TURN,
    Pose,
    PoseSet,
    encode_png,
    project_surface,
    render_with_cage,
    view_axes,
)
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import (
    COLOUR_SCALE,
    MESH_COLOURS,
    SAMPLES_PER_PIXEL,
    choose_scale_end,
    colour_pixels,
    parse_colour,
    render,
)
from cageik_cli.report.vocabulary import Vocabulary
from cageik_cli.util.threads import count_processors

View = tuple[str, str, str]
"""A picture of a page: its caption, its file as a data URL, and what it shows in words."""


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

    with ThreadPoolExecutor(count_processors()) as pool:
        drawn_poses = pool.map(draw_pose, poses.poses)
        turns = (VIEW_TURN, VIEW_TURN + 180)
        rest_views = pool.map(draw_rest, ("From the front", "From behind"), turns)
        close_up = pool.submit(_draw_close_up, poses, top, size, words)
        return {
            "poses": list(drawn_poses),
            "close_up": close_up.result(),
            "rest_views": list(rest_views),
            "colours": COLOUR_SCALE,
            "ticks": format_ticks(top),
            "rms_ticks": format_ticks(rms_top),
        }


def _draw_close_up(poses: PoseSet, top: float, size: int, words: Vocabulary) -> list[View]:
    """Draw the worst region, from where it is seen; nothing if there is none."""
    view = poses.region
    if view is None:
        return []
    axes = view_axes(poses.up_axis, view.turn)
    camera = ParallelCamera(axes, view.centre, view.extent, size)
    return _draw_views(poses, view.pose, top, camera, "Worst region, close up", words)


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
