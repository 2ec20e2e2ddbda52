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
from cageik_cli.report.marks import FaultMark
from cageik_cli.report.plots.style import (
    PANEL_SIDE,
    PLOT_COLOURS,
    make_drawable,
    measure_text_width,
    place_names,
    use_fixed_style,
)
from cageik_cli.report.render.model_views import (
    VIEW_TURN,
    project_surface,
    render_with_cage,
    view_axes,
)
from cageik_cli.report.render.raster import ParallelCamera, rasterize
from cageik_cli.report.render.shading import (
    SAMPLES_PER_PIXEL,
    Picture,
    downsample,
    overlay,
    parse_colour,
)

LIST_MARGIN, LIST_ROW_HEIGHT = 12.0, 15.0
"""Free space around the list of faults below the pictures, and the height of its rows."""


def render_check_png(
    cage: TriMesh, rest: TriMesh | None, marks: tuple[FaultMark, ...], pixels: int = 720
) -> bytes:
    """Render a cage and its model from the front and from behind; each panel is `pixels` wide."""
    rows = [(f"{mark.number}", mark.text, mark.colour) for mark in marks]
    rows = rows or [("", "no fault that has a place", PLOT_COLOURS["ink"])]
    turns = (VIEW_TURN, VIEW_TURN + 180)
    per_point, width = pixels / PANEL_SIDE, PANEL_SIDE * len(turns)
    height = PANEL_SIDE + 2 * LIST_MARGIN + LIST_ROW_HEIGHT * len(rows)
    points = np.concatenate([mesh.vertices for mesh in (cage, rest) if mesh is not None])
    stream = io.BytesIO()
    with use_fixed_style():
        # Slightly larger, because matplotlib rounds the number of pixels down.
        size = ((width + 1e-3) / 72, (height + 1e-3) / 72)
        figure = Figure(size, dpi=72 * per_point, facecolor="white")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0), zorder=1)
        axes.set_axis_off()
        for number, turn in enumerate(turns):
            camera = ParallelCamera.fit(view_axes("Y", turn), points, SAMPLES_PER_PIXEL * pixels)
            picture = _draw_meshes(camera, cage, rest, marks)
            levels = np.rint(255 * np.clip(downsample(picture), 0, 1)).astype(np.uint8)
            below = round(figure.bbox.height) - pixels
            figure.figimage(levels.transpose(1, 2, 0), number * pixels, below)
            _draw_numbers(axes, camera, marks, number * PANEL_SIDE)
        for row, (number_text, text, colour) in enumerate(rows):  # below, in their colours
            middle = PANEL_SIDE + LIST_MARGIN + (row + 0.5) * LIST_ROW_HEIGHT
            style: Any = {"size": 9.0, "va": "center_baseline"}
            axes.text(LIST_MARGIN, middle, number_text, color=colour, weight="bold", **style)
            axes.text(3 * LIST_MARGIN, middle, make_drawable(text, 110), gid="row", **style)
        figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _draw_meshes(
    camera: ParallelCamera, cage: TriMesh, rest: TriMesh | None, marks: tuple[FaultMark, ...]
) -> Picture:
    """Draw the model and the edges of the cage, then tint the faulty faces of the cage."""
    model = cage if rest is None else rest
    surface = project_surface(camera, model.vertices, model.faces)
    picture = render_with_cage(surface, camera, cage)
    for mark in reversed(marks):
        faces = cage.faces[mark.cage_faces]
        if len(faces):
            _, depth = rasterize(camera.project(cage.vertices)[faces], camera.size)
            opacity = np.where(np.isfinite(depth), 0.45, 0.0)
            picture = overlay(picture, parse_colour(mark.colour), opacity)
    return picture


def _draw_numbers(
    axes: Axes, camera: ParallelCamera, marks: tuple[FaultMark, ...], left: float
) -> None:
    """Dot the places of each fault, and put its number beside the middle one of them."""
    scale, font_size = PANEL_SIDE / camera.size, 11.0
    dots = [camera.project(mark.points)[:, :2] * scale for mark in marks]
    max_drawn = 4000  # more dots cover each other
    for mark, places in zip(marks, dots, strict=True):
        size = 3.2 if len(places) <= 500 else 1.3
        x, y = places[:: -(-len(places) // max_drawn)].T
        axes.plot(
            left + x, y, "o", ms=size, color=mark.colour, mec="white", mew=0.1 * size, alpha=0.85,
            zorder=3, gid="fault",
        )  # fmt: skip
    if not marks:
        return
    away = [np.linalg.norm(places - places.mean(axis=0), axis=1) for places in dots]
    anchors = np.array([places[far.argmin()] for places, far in zip(dots, away, strict=True)])
    widths = [measure_text_width(str(mark.number), font_size) for mark in marks]
    sizes = np.array([(width, 1.1 * font_size) for width in widths])
    boxes = place_names(anchors, sizes, anchors, PANEL_SIDE)
    for mark, box in zip(marks, boxes, strict=True):
        if box is not None:
            axes.text(
                left + box[0], (box[1] + box[3]) / 2, str(mark.number), size=font_size,
                weight="bold", color=mark.colour, va="center_baseline", zorder=6, gid="number",
                path_effects=[withStroke(linewidth=3, foreground="white")],
            )  # fmt: skip
