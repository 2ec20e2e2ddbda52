"""A cage and the model in it from two sides, with the faults coloured and numbered, as a PNG file.

Lengths are in points of the figure, 72 per inch, x to the right and y downwards.
"""

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.plots.cage_marks import FaultMark
from cageik_cli.report.plots.pose_marks import place_names
from cageik_cli.report.plots.style import INK, make_drawable, measure_text_width, use_fixed_style
from cageik_cli.report.render.colouring import parse_colour
from cageik_cli.report.render.model_views import project_surface, render_with_cage
from cageik_cli.report.render.raster import ParallelCamera, rasterize
from cageik_cli.report.render.shading import SAMPLES_PER_PIXEL, Picture, downsample, overlay
from cageik_cli.report.render.viewpoints import VIEW_TURN, view_axes
from cageik_cli.util.arrays import Floats

PANEL_SIDE, ROW_HEIGHT, EDGE = 345.6, 15.0, 12.0
"""Size of a panel; height of a row of the list below; free space around the list."""

NUMBER_SIZE, LIST_SIZE = 11.0, 9.0
"""Font sizes."""

DOT_SIZE, SMALL_DOT_SIZE, MANY_DOTS = 3.2, 1.3, 500
"""Diameters of marked vertices; the small ones are of faults with many."""

MAX_TEXT_LENGTH = 110
"""Characters of a row that are shown."""

MAX_DRAWN_POINTS = 4000
"""Vertices of one fault that are drawn; more are thinned evenly."""

FACE_OPACITY = 0.45
"""Opacity of the colour over faces of the cage that have a fault."""

VIEW_TURNS = (VIEW_TURN, VIEW_TURN + 180)
"""Viewpoints, degrees to the right of the front."""


def render_check_png(
    cage: TriMesh, rest: TriMesh | None, marks: tuple[FaultMark, ...], pixels: int = 720
) -> bytes:
    """Render a cage and its model from the front and from behind; each panel is `pixels` wide."""
    rows = [(f"{mark.number}", mark.text, mark.colour) for mark in marks]
    rows = rows or [("", "no fault that has a place", INK)]
    per_point = pixels / PANEL_SIDE
    height = PANEL_SIDE + 2 * EDGE + ROW_HEIGHT * len(rows)
    width = PANEL_SIDE * len(VIEW_TURNS)
    stream = io.BytesIO()
    with use_fixed_style():
        # Slightly larger, because matplotlib rounds the number of pixels down.
        size = ((width + 1e-3) / 72, (height + 1e-3) / 72)
        figure = Figure(size, dpi=72 * per_point, facecolor="white")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0), zorder=1)
        axes.set_axis_off()
        for number, turn in enumerate(VIEW_TURNS):
            camera = _fit_camera(cage, rest, turn, SAMPLES_PER_PIXEL * pixels)
            picture = _draw_meshes(camera, cage, rest, marks)
            levels = np.rint(255 * np.clip(downsample(picture), 0, 1)).astype(np.uint8)
            below = round(figure.bbox.height) - pixels
            figure.figimage(levels.transpose(1, 2, 0), number * pixels, below)
            _draw_numbers(axes, camera, marks, number * PANEL_SIDE)
        _draw_list(axes, rows)
        figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _fit_camera(cage: TriMesh, rest: TriMesh | None, turn: float, size: int) -> ParallelCamera:
    points = [cage.vertices] if rest is None else [cage.vertices, rest.vertices]
    return ParallelCamera.fit(view_axes("Y", turn), np.concatenate(points), size)


def _draw_meshes(
    camera: ParallelCamera, cage: TriMesh, rest: TriMesh | None, marks: tuple[FaultMark, ...]
) -> Picture:
    """Draw the model, the faulty faces of the cage over it, and the edges of the cage."""
    model = cage if rest is None else rest
    surface = project_surface(camera, model.vertices, model.faces)
    picture = render_with_cage(surface, camera, cage.vertices, cage.faces)
    return _tint_faces(picture, camera, cage, marks)


def _tint_faces(
    picture: Picture, camera: ParallelCamera, cage: TriMesh, marks: tuple[FaultMark, ...]
) -> Picture:
    """Lay the colours of faults over the faces of the cage."""
    for mark in reversed(marks):
        faces = cage.faces[mark.cage_faces]
        if len(faces):
            depth = rasterize(camera.project(cage.vertices)[faces], camera.size).depth
            opacity = np.where(np.isfinite(depth), FACE_OPACITY, 0.0)
            picture = overlay(picture, parse_colour(mark.colour), opacity)
    return picture


def _draw_numbers(
    axes: Axes, camera: ParallelCamera, marks: tuple[FaultMark, ...], left: float
) -> None:
    """Dot the places of each fault, and put its number beside the middle one of them."""
    scale = PANEL_SIDE / camera.size
    dots = [camera.project(mark.points)[:, :2] * scale for mark in marks]
    for mark, places in zip(marks, dots, strict=True):
        size = DOT_SIZE if len(places) <= MANY_DOTS else SMALL_DOT_SIZE
        drawn = places[:: -(-len(places) // MAX_DRAWN_POINTS)]
        axes.plot(
            drawn[:, 0] + left, drawn[:, 1], "o", ms=size, color=mark.colour, mec="white",
            mew=0.1 * size, alpha=0.85, zorder=3, gid="fault",
        )  # fmt: skip
    if not marks:
        return
    anchors = np.array([_choose_anchor(places) for places in dots])
    widths = [measure_text_width(str(mark.number), NUMBER_SIZE) for mark in marks]
    sizes = np.array([(width, 1.1 * NUMBER_SIZE) for width in widths])
    boxes = place_names(anchors, sizes, anchors, PANEL_SIDE)
    for mark, box in zip(marks, boxes, strict=True):
        if box is not None:
            axes.text(
                left + box[0], (box[1] + box[3]) / 2, str(mark.number), size=NUMBER_SIZE,
                weight="bold", color=mark.colour, va="center_baseline", zorder=6, gid="number",
                path_effects=[withStroke(linewidth=3, foreground="white")],
            )  # fmt: skip


def _choose_anchor(places: Floats) -> Floats:
    """The place nearest to the middle of all."""
    away = np.linalg.norm(places - places.mean(axis=0), axis=1)
    return np.asarray(places[away.argmin()])


def _draw_list(axes: Axes, rows: list[tuple[str, str, str]]) -> None:
    """List the faults below the pictures, in their colours."""
    for row, (number, text, colour) in enumerate(rows):
        height = PANEL_SIDE + EDGE + (row + 0.5) * ROW_HEIGHT
        style: dict[str, Any] = {"size": LIST_SIZE, "va": "center_baseline"}
        axes.text(EDGE, height, number, color=colour, weight="bold", **style)
        axes.text(3 * EDGE, height, make_drawable(text, MAX_TEXT_LENGTH), gid="row", **style)
