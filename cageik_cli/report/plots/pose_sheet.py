"""A picture of a result to send: the cage, and four poses of the clip, as a PNG file.

Lengths are in points of the figure, 72 per inch, x to the right and y downwards. It is drawn
without pyplot; the same result gives the same bytes.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cageik_cli.formats.timeline import format_frame_number
from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.report.figures import format_briefly, format_scene_length
from cageik_cli.report.plots.style import (
    PLOT_COLOURS,
    make_drawable,
    measure_text_width,
    use_fixed_style,
)
from cageik_cli.report.record import Report
from cageik_cli.report.render.model_views import (
    VIEW_TURN,
    overlay_cage,
    project_surface,
    render_with_cage,
    view_axes,
)
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import (
    SAMPLES_PER_PIXEL,
    downsample,
    parse_colour,
    render,
)
from cageik_cli.report.views.front import find_worst_frame
from cageik_cli.store.result import Result, load_binding, read_cages, read_rotations
from cageik_cli.util.arrays import Floats, Integers, spread_evenly

SHEET_POSES = 4
"""Poses of the clip on a sheet, beside the rest cage."""

SOLID_CAGE_COLOUR = "#cfe0f5"
"""Of the faces of a cage that is drawn without its model."""

SHEET_SIDE, SHEET_TITLE_HEIGHT, SHEET_CAPTION_HEIGHT = 172.8, 30.0, 22.0
"""Width and height of a picture of a sheet, and of the texts above and below it."""


@dataclass(frozen=True, slots=True, eq=False)
class SheetPose:
    """A pose of a sheet: its caption, its cage (n, 3), and its mesh (m, 3), if that is drawn."""

    caption: str
    cage: Floats
    mesh: Floats | None = None


def render_sheet_png(result: Result, report: Report, pixels: int = 360) -> bytes:
    """Render the rest cage, and four poses in their cages, side by side, each `pixels` wide.

    Raises
    ------
    SettingError
        When the result was written without weights.
    """
    binding = load_binding(result, "a picture")
    cage = SheetPose(f"the cage, {len(binding.cage.vertices)} vertices", binding.cage.vertices)
    poses = [cage, *_load_frames(result, report, binding)]
    width = SHEET_SIDE * len(poses)
    height = SHEET_TITLE_HEIGHT + SHEET_SIDE + SHEET_CAPTION_HEIGHT
    per_point, stream = pixels / SHEET_SIDE, io.BytesIO()
    with use_fixed_style():
        # Slightly larger, because matplotlib rounds the number of pixels down.
        size = ((width + 1e-3) / 72, (height + 1e-3) / 72)
        figure = Figure(size, dpi=72 * per_point, facecolor="white")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0), zorder=1)
        axes.set_axis_off()
        below = round(SHEET_CAPTION_HEIGHT * per_point)
        for number, picture in enumerate(_draw_poses(result, binding, poses, pixels)):
            figure.figimage(picture, number * pixels, below)
        for number, pose in enumerate(poses):
            middle = (number + 0.5) * SHEET_SIDE
            place = (middle, height - 0.6 * SHEET_CAPTION_HEIGHT)
            _write(axes, place, pose.caption, size=9.0, room=SHEET_SIDE - 12, ha="center")
        title = f"{report.result}: {describe_verdict(report)}"
        _write(axes, (12, 0.55 * SHEET_TITLE_HEIGHT), title, size=11.0, room=width - 24)
        figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def describe_verdict(report: Report) -> str:
    """Say in a line how good a result is, or how far an edit moved the mesh."""
    rms = report.counted.rms_percent
    word = "moved" if report.verdict is None else f"{report.verdict},"
    length = format_scene_length(report.clip, rms)
    text = f"{word} {format_briefly(rms)} % of the size on average ({length})"
    frames, cage = report.clip.frames, report.clip.cage_vertices
    return f"{text}  ·  {frames} frames, a cage of {cage}"


def choose_sheet_frames(count: int, worst: int) -> list[int]:
    """Choose the frames of a sheet, in order: evenly spread, but the nearest one is the worst.

    The first frame is kept, unless it is the only other one.
    """
    chosen: Integers = spread_evenly(count, SHEET_POSES)
    away = np.abs(chosen - worst)
    away[0] = count if len(chosen) > 1 and worst > 0 else away[0]
    chosen[away.argmin()] = worst
    return sorted(set(chosen.tolist()))


def _load_frames(result: Result, report: Report, binding: Binding) -> list[SheetPose]:
    """Load the poses of the chosen frames."""
    record, error = find_worst_frame(report, "rms")
    worst = report.frames.index(record)
    rotations = read_rotations(result) if binding.has_offsets else None
    poses = []
    for frame in choose_sheet_frames(len(report.frames), worst):
        cages = next(read_cages(result, 1, frame))
        turns = None if rotations is None else rotations[frame : frame + 1]
        mesh = reconstruct_frames(binding, cages, turns)[0]
        caption = f"frame {format_frame_number(report.frames[frame].number)}"
        if frame == worst:
            caption += f", {report.vocabulary.worst}: {format_briefly(error)} %"
        poses.append(SheetPose(caption, cages[0], mesh))
    return poses


def _draw_poses(
    result: Result, binding: Binding, poses: list[SheetPose], pixels: int
) -> Iterator[NDArray[np.uint8]]:
    """Draw all poses at one scale, each in the middle of its picture, (p, p, 4)."""
    axes = view_axes(result.scene.up_axis, VIEW_TURN)
    drawn, size = np.unique(binding.rest.faces), SAMPLES_PER_PIXEL * pixels
    shown = [
        pose.cage if pose.mesh is None else np.concatenate([pose.mesh[drawn], pose.cage])
        for pose in poses
    ]
    cameras = [ParallelCamera.fit(axes, points, size) for points in shown]
    extent = max(camera.extent for camera in cameras)
    for pose, camera in zip(poses, cameras, strict=True):
        scaled, cage = replace(camera, extent=extent), binding.cage.move(pose.cage)
        if pose.mesh is not None:
            surface = project_surface(scaled, pose.mesh, binding.rest.faces)
            picture = render_with_cage(surface, scaled, cage)
        else:  # the cage as a solid
            surface = project_surface(scaled, cage.vertices, cage.faces)
            solid = render(surface, parse_colour(SOLID_CAGE_COLOUR))
            picture = overlay_cage(solid, scaled, surface, cage)
        # Without the two lowest bits of its colours the file is smaller.
        levels = np.rint(255 * np.clip(downsample(picture), 0, 1)).astype(np.uint8)
        levels &= np.uint8(0xFC)
        yield levels.transpose(1, 2, 0)


def _write(
    axes: Axes, place: tuple[float, float], text: str, *, size: float, room: float, ha: str = "left"
) -> None:
    """Write a line, smaller if it does not fit."""
    line = make_drawable(text, 120)
    fitting = size * min(1.0, room / max(measure_text_width(line, size), 1.0))
    axes.text(*place, line, size=fitting, ha=ha, va="center", color=PLOT_COLOURS["ink"], gid="text")
