"""The pictures of a page: the poses, the worst region, and the error on the rest pose."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class PosePictures:
    """Pictures of a pose from one viewpoint, as PNG files.

    Attributes
    ----------
    label, name : str
        As in `Pose`; of a moved vertex, the viewpoint.
    files : dict of str to bytes
        By what they show. Of a pose: the `original`, its `reconstruction`, coloured by deviation,
        and that in its `cage`. Of a fit: `unfitted` and `fitted` beside the original, if any.
    """

    label: str
    name: str
    files: dict[str, bytes]


@dataclass(frozen=True, slots=True)
class Pictures:
    """All pictures of a result, and their colour scales.

    Attributes
    ----------
    rest_views : tuple of bytes
        The rest pose from the front and from behind, coloured by the vertices' rms.
    max_deviation_percent, max_rms_percent : float
        Ends of the colour scales of the poses and of the rest views, percent of the diagonal;
        larger values are clamped.
    colours : tuple of str
        Colours of both scales, from 0 to their ends in even steps, as #rrggbb. Missing data is
        grey.
    region : PosePictures, optional
        The worst region, close up.
    """

    poses: tuple[PosePictures, ...]
    rest_views: tuple[bytes, ...]
    max_deviation_percent: float
    max_rms_percent: float
    colours: tuple[str, ...]
    region: PosePictures | None = None


def render_pictures(poses: PoseSet, pixels: int = 360) -> Pictures:
    """Draw the poses and the error on the rest pose, in squares of `pixels`."""
    known = np.isfinite(poses.vertex_rms)
    max_deviation = choose_scale_end(
        np.concatenate([pose.deviation[known] for pose in poses.poses])
    )
    samples = SAMPLES_PER_PIXEL * pixels
    max_rms = choose_scale_end(poses.vertex_rms[known])

    def render_pose(pose: Pose) -> PosePictures:
        return _render_pose(poses, pose, max_deviation, _fit_pose(poses, pose, samples))

    def render_rest(turn: float) -> bytes:
        return _render_rest(poses, turn, max_rms, pixels)

    with ThreadPoolExecutor(count_processors()) as pool:
        drawn_poses = pool.map(render_pose, poses.poses)
        rest_views = pool.map(render_rest, (VIEW_TURN, VIEW_TURN + 180))
        region = pool.submit(_render_close_up, poses, max_deviation, samples)
        return Pictures(
            poses=tuple(drawn_poses),
            rest_views=tuple(rest_views),
            max_deviation_percent=max_deviation,
            max_rms_percent=max_rms,
            colours=COLOUR_SCALE,
            region=region.result(),
        )


def _fit_pose(poses: PoseSet, pose: Pose, size: int) -> ParallelCamera:
    """Fit a camera to a pose, on the side of the worst region."""
    drawn = poses.drawn
    points = np.concatenate([pose.original[drawn], pose.reconstruction[drawn], pose.cage])
    return ParallelCamera.fit(view_axes(poses.up_axis, poses.turn), points, size)


def _render_close_up(poses: PoseSet, top: float, size: int) -> PosePictures | None:
    """Draw the worst region, from where it is seen."""
    view = poses.region
    if view is None:
        return None
    axes = view_axes(poses.up_axis, view.turn)
    camera = ParallelCamera(axes, view.centre, view.extent, size)
    return _render_pose(poses, view.pose, top, camera)


def _render_pose(poses: PoseSet, pose: Pose, top: float, camera: ParallelCamera) -> PosePictures:
    original = project_surface(camera, pose.original, poses.faces)
    reconstruction = project_surface(camera, pose.reconstruction, poses.faces)
    deviation = np.where(np.isfinite(poses.vertex_rms), pose.deviation, np.nan)
    drawn = {
        "original": render(original, parse_colour(MESH_COLOURS["input"])),
        "reconstruction": render(reconstruction, colour_pixels(reconstruction, deviation, top)),
        "cage": render_with_cage(reconstruction, camera, pose.cage, poses.cage_faces),
    }
    files = {name: encode_png(picture) for name, picture in drawn.items()}
    return PosePictures(pose.label, pose.name, files)


def _render_rest(poses: PoseSet, turn: float, top: float, pixels: int) -> bytes:
    rest = poses.poses[0].reconstruction
    axes, size = view_axes(poses.up_axis, turn), SAMPLES_PER_PIXEL * pixels
    camera = ParallelCamera.fit(axes, rest[poses.drawn], size)
    surface = project_surface(camera, rest, poses.faces)
    return encode_png(render(surface, colour_pixels(surface, poses.vertex_rms, top)))


def build_picture_values(pictures: Pictures, words: Vocabulary) -> dict[str, Any]:
    """Collect the pictures of a page with their titles, captions and descriptions."""
    frames = {"worst": words.worst, "median": "median", "best": words.best}
    titles = {label: f"{text.capitalize()} frame" for label, text in frames.items()}
    titles["rest"] = "Rest pose"
    sides = zip(("From the front", "From behind"), pictures.rest_views, strict=True)
    return {
        "poses": [
            {
                "title": titles[pose.label],
                "name": "" if pose.label == "rest" else pose.name,
                "views": _list_pose_views(pose, titles[pose.label], words),
            }
            for pose in pictures.poses
        ],
        "close_up": []
        if pictures.region is None
        else _list_pose_views(pictures.region, "Worst region, close up", words),
        "is_turned": pictures.region is not None,
        "rest_views": [
            (
                side,
                make_png_url(picture),
                f"The rest pose {side.lower()}, coloured by the RMS of each vertex",
            )
            for side, picture in sides
        ],
        "pose_ticks": format_ticks(pictures.max_deviation_percent),
        "rms_ticks": format_ticks(pictures.max_rms_percent),
    }


def _list_pose_views(
    pose: PosePictures, title: str, words: Vocabulary
) -> list[tuple[str, str, str]]:
    """List the caption, the picture and the description of each view of a pose."""
    original, reconstruction = words.original, words.reconstruction
    coloured = f"{title}: the {reconstruction}, coloured by {words.distance}"
    return [
        (original.capitalize(), make_png_url(pose.files["original"]), f"{title}: the {original}"),
        (reconstruction.capitalize(), make_png_url(pose.files["reconstruction"]), coloured),
        ("Cage", make_png_url(pose.files["cage"]), f"{title}: the cage"),
    ]
