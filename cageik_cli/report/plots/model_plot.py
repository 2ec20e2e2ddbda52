"""A model in its cage, twice side by side, as a PNG file: before and after an edit, or its faults.

Lengths are in points of the figure, 72 per inch, x to the right and y downwards from the upper left
corner. It is drawn without pyplot; the same models give the same bytes.
"""

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from cageik_cli.editing.summary import PoseSnapshot
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.figures import format_percent
from cageik_cli.report.plots.style import (
    PANEL_SIDE,
    PLOT_COLOURS,
    Box,
    make_drawable,
    measure_text_width,
    place_names,
    use_fixed_style,
)
from cageik_cli.report.render.model_views import (
    DEPTH_TOL,
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
from cageik_cli.report.views.cage import FaultMark
from cageik_cli.report.views.pose_text import format_miss
from cageik_cli.util.arrays import Floats, Mask

MAX_NAMED_ANCHORS = 12
"""Anchors that are labelled with their names; those that move farthest come first."""

ANCHOR_STYLES = ((False, PLOT_COLOURS["handle"], "o"), (True, PLOT_COLOURS["ink"], "s"))
"""Whether an anchor is pinned, its colour and its marker."""

ANCHOR_SIZE, TARGET_SIZE = 6.0, 11.0
"""Diameters of the marks of anchors, and of the rings of targets."""

MIN_DRAWN_LENGTH = 1.0
"""Shorter arrows (for example towards the viewer) and smaller misses of pins are not drawn."""

LIST_MARGIN, LIST_ROW_HEIGHT = 12.0, 15.0
"""Free space around the list of faults below the pictures, and the height of its rows."""


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One of the two pictures.

    Attributes
    ----------
    vertices, cage : (m, 3) and (n, 3) float64
    anchors : (l, 3) float64
        Positions of the anchors.
    has_arrows : bool
        Whether arrows lead to the targets; otherwise the targets are ringed.
    """

    vertices: Floats
    cage: Floats
    anchors: Floats
    has_arrows: bool
    title: str


def render_pose_png(view: PoseSnapshot, pixels: int = 720) -> bytes:
    """Render a pose before and after as a PNG file; each panel is `pixels` wide."""
    with use_fixed_style():
        return _encode_png(draw_pose(view, build_panels(view), pixels))


def build_panels(view: PoseSnapshot) -> tuple[Panel, Panel]:
    """Build the panels before and after, with their captions."""
    title_before = f"{view.frame}, before" if view.frame else "before"
    title_after = f"after: mesh moved {format_percent(view.rms_percent)} %"
    if view.names:
        title_after += f", largest miss of a target {format_miss(view.max_residual_percent)} %"
    return (
        Panel(view.before, view.cage_before, view.starts, True, title_before),
        Panel(view.after, view.cage_after, view.ends, False, title_after),
    )


def draw_pose(view: PoseSnapshot, panels: Sequence[Panel], pixels: int) -> Figure:
    """Draw panels of one model from one viewpoint, with the anchors and targets of a view."""
    points = [points for panel in panels for points in (panel.vertices, panel.cage, panel.anchors)]
    camera = _choose_camera(
        view, np.concatenate([*points, view.starts, view.targets]), SAMPLES_PER_PIXEL * pixels
    )
    per_point, legend_height = pixels / PANEL_SIDE, PANEL_SIDE / 8
    size = np.array([len(panels) * pixels, pixels + round(legend_height * per_point)])
    width, height = (float(value) for value in (size + 1e-3) / per_point)
    figure, axes = _open_figure(width, height, per_point)
    for number, panel in enumerate(panels):
        _PanelDrawing(axes, camera, view, panel, number).draw()
    _draw_legend(figure, view.pinned)
    return figure


def _open_figure(width: float, height: float, per_point: float) -> tuple[Figure, Axes]:
    """Open a figure of this size, with axes in points over all of it.

    It has to be slightly larger than its pixels, as matplotlib rounds the number of these down.
    """
    figure = Figure((width / 72, height / 72), dpi=72 * per_point)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0), zorder=1)
    axes.set_axis_off()
    return figure, axes


def _encode_png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _place_picture(axes: Axes, picture: Picture, number: int, mask: int = 0xFF) -> None:
    """Draw a picture as panel `number`, from the left, with the bits of its colours in a mask."""
    levels = np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8) & np.uint8(mask)
    pixels, figure = picture.shape[1], axes.get_figure()
    assert isinstance(figure, Figure)
    below = round(figure.bbox.height) - pixels
    figure.figimage(levels.transpose(1, 2, 0), number * pixels, below)


def _write_names(
    axes: Axes,
    names: Iterable[tuple[str, str, Box | None]],
    left: float,
    outline: float,
    **style: Any,
) -> None:
    """Write names, in their colours, into boxes where there was room for them."""
    style["path_effects"] = [withStroke(linewidth=outline, foreground="white")]
    for name, colour, box in names:
        if box is not None:
            place = left + box[0], (box[1] + box[3]) / 2
            axes.text(*place, name, color=colour, va="center_baseline", zorder=6, **style)


def _choose_camera(view: PoseSnapshot, points: Floats, size: int) -> ParallelCamera:
    """Choose a camera that shows all points, from a viewpoint where the arrows are long.

    The first viewpoint, that of pages, is taken if its arrows have 0.8 of the longest total length.
    """
    arrows = _arrow_vectors(view)
    turns = (VIEW_TURN, -VIEW_TURN, 75.0, -75.0)
    views = [view_axes(view.up_axis, turn) for turn in turns]
    lengths = [float(np.linalg.norm(arrows @ axes[:2].T, axis=1).sum()) for axes in views]
    chosen = next(k for k, length in enumerate(lengths) if length >= 0.8 * max(lengths))
    return ParallelCamera.fit(views[chosen], points, size)


def _arrow_vectors(view: PoseSnapshot) -> Floats:
    """Return the vectors from the anchors to their targets, (l, 3); zero for pins."""
    return np.where(view.pinned[:, None], 0.0, view.targets - view.starts)


class _PanelDrawing:
    """Panel `number`, from the left, on its way into the figure, all of which the axes cover."""

    def __init__(
        self, axes: Axes, camera: ParallelCamera, view: PoseSnapshot, panel: Panel, number: int
    ) -> None:
        self.axes, self.camera, self.view, self.panel = axes, camera, view, panel
        self.number, self.left = number, number * PANEL_SIDE
        self.dots, self.targets = self._place(panel.anchors), self._place(view.targets)

    def draw(self) -> None:
        """Draw the model in its cage, then the marks, the names and the caption over it."""
        depth = self._draw_model()
        if self.panel.has_arrows:
            self._draw_arrows()
        else:
            self._draw_targets()
        self._draw_anchors(depth)
        self._draw_names()
        self._draw_title()

    def _place(self, points: Floats) -> Floats:
        """Project points, (k, 3), into the figure, (k, 2)."""
        seen = self.camera.project(points)[:, :2] * (PANEL_SIDE / self.camera.size)
        return np.asarray(seen + np.array([self.left, 0]))

    def _draw_model(self) -> Floats:
        """Draw the model and its cage; return the depths of its surface."""
        surface = project_surface(self.camera, self.panel.vertices, self.view.faces)
        cage = self.view.cage.move(self.panel.cage)
        picture = downsample(render_with_cage(surface, self.camera, cage))
        # Without the two lowest bits of its colours the file is a sixth smaller.
        _place_picture(self.axes, picture, self.number, 0xFC)
        return surface.depth

    def _draw_arrows(self) -> None:
        """Draw an arrow from each handle to its target."""
        shaft_width, head_length, head_width = 1.9, 9.0, 7.0
        is_free = ~self.view.pinned
        for start, end in zip(self.dots[is_free], self.targets[is_free], strict=True):
            along = end - start
            length = float(np.hypot(*along))
            if length < MIN_DRAWN_LENGTH:
                continue
            head = min(head_length, 0.6 * length)
            share = head / head_length
            along = along / length
            neck = end - head * along
            across = share * np.array([-along[1], along[0]])
            shaft, barb = shaft_width / 2 * across, head_width / 2 * across
            outline = [start + shaft, neck + shaft, neck + barb, end]
            outline += [neck - barb, neck - shaft, start - shaft]
            arrow = Polygon(
                np.array(outline), facecolor=PLOT_COLOURS["handle"], zorder=3, gid="arrow"
            )
            arrow.set(edgecolor="white", linewidth=0.6, joinstyle="miter")
            self.axes.add_patch(arrow)

    def _draw_targets(self) -> None:
        """Ring the targets, with a dashed line to their anchors if those are outside the ring.

        Targets of pins are ringed only if they are missed.
        """
        misses = np.linalg.norm(self.dots - self.targets, axis=1)
        lines = np.stack([self.dots, self.targets], axis=1)
        for is_pin, colour, marker in ANCHOR_STYLES:
            is_drawn = (self.view.pinned == is_pin) & (
                misses >= (MIN_DRAWN_LENGTH if is_pin else 0)
            )
            self.axes.plot(
                *self.targets[is_drawn].T, marker, markersize=TARGET_SIZE, markerfacecolor="none",
                markeredgecolor=colour, markeredgewidth=1.1,
                path_effects=[withStroke(linewidth=2.8, foreground="white")], zorder=4, gid="goal",
            )  # fmt: skip
            for line in lines[is_drawn & (misses > TARGET_SIZE / 2)]:
                self.axes.plot(
                    *line.T, color=colour, linewidth=1.0, dashes=(3, 1.5), zorder=4, gid="miss"
                )

    def _draw_anchors(self, depth: Floats) -> None:
        """Mark the anchors; those behind a surface of these depths, (s, s), are paler."""
        pinned, seen = self.view.pinned, self.camera.project(self.panel.anchors)
        columns, rows = np.clip(seen[:, :2], 0, self.camera.size - 1).astype(np.int64).T
        covered = seen[:, 2] > depth[rows, columns] + DEPTH_TOL * self.camera.size
        for is_pin, colour, marker in ANCHOR_STYLES:
            for is_covered in (True, False):
                self.axes.plot(
                    *self.dots[(pinned == is_pin) & (covered == is_covered)].T, marker,
                    markersize=ANCHOR_SIZE, color=colour, markeredgecolor="white",
                    markeredgewidth=0.7, alpha=0.5 if is_covered else 1.0, zorder=5,
                    gid="pin" if is_pin else "dot",
                )  # fmt: skip

    def _draw_names(self) -> None:
        """Label up to `MAX_NAMED_ANCHORS` where there is room, those that move farthest first."""
        size, max_length = 8.5, 28  # of the font, points; characters of a name that are shown
        far = np.linalg.norm(_arrow_vectors(self.view), axis=1)
        order = np.argsort(-far, kind="stable")[:MAX_NAMED_ANCHORS]
        names = [make_drawable(self.view.names[k], max_length) for k in order]
        sizes = np.array([(measure_text_width(name, size), 1.1 * size) for name in names])
        offset = np.array([self.left, 0])
        dots = self.dots[order] - offset
        boxes = place_names(dots, sizes.reshape(-1, 2), self._list_marked() - offset, PANEL_SIDE)
        ink = PLOT_COLOURS["ink"]
        written = [(name, ink, box) for name, box in zip(names, boxes, strict=True)]
        _write_names(self.axes, written, self.left, 2.4, size=size, gid="name")

    def _list_marked(self) -> Floats:
        """List points of rings and arrows, (p, 2), which names should not cover."""
        sides, spacing = (-1, 0, 1), 4.0  # points between samples of an arrow
        corners = TARGET_SIZE / 2 * np.array([(x, y) for x in sides for y in sides])
        counts = np.ceil(np.hypot(*(self.targets - self.dots).T) / spacing).astype(np.int64) + 1
        arrows = map(np.linspace, self.dots, self.targets, counts)
        return np.concatenate([*(self.dots + corner for corner in corners), *arrows])

    def _draw_title(self) -> None:
        """Write the caption below the panel, smaller if it does not fit."""
        font_size, max_length = 10.0, 76  # points; characters that are shown
        title = make_drawable(self.panel.title, max_length)
        width = max(measure_text_width(title, font_size), 1.0)
        size = font_size * min(1.0, (PANEL_SIDE - 2 * font_size) / width)
        middle, below = self.left + PANEL_SIDE / 2, PANEL_SIDE + font_size
        self.axes.text(middle, below, title, size=size, ha="center", va="center", gid="title")


def _draw_legend(figure: Figure, pinned: Mask) -> None:
    """Explain the marks below all panels."""
    handle, ink = PLOT_COLOURS["handle"], PLOT_COLOURS["ink"]
    marks = []
    if not pinned.all():
        marks += [
            (handle, "o", ANCHOR_SIZE, handle, "handle"),
            (handle, "o", TARGET_SIZE, "none", "target"),
        ]
    if pinned.any():
        marks += [(ink, "s", ANCHOR_SIZE, ink, "pin")]
    figure.legend(
        [
            Line2D([], [], linestyle="", color=colour, marker=marker, ms=size, mfc=inside)
            for colour, marker, size, inside, _ in marks
        ],
        [label for *_, label in marks],
        loc="lower center",
        ncols=len(marks) or 1,
        fontsize=8.0,
        labelcolor=PLOT_COLOURS["muted"],
        frameon=False,
        handletextpad=0.1,
        columnspacing=1.4,
        borderpad=0.5,
        borderaxespad=0.5,
    )


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
    with use_fixed_style():
        figure, axes = _open_figure(width + 1e-3, height + 1e-3, per_point)
        axes.set(xlim=(0, width), ylim=(height, 0))
        for number, turn in enumerate(turns):
            camera = ParallelCamera.fit(view_axes("Y", turn), points, SAMPLES_PER_PIXEL * pixels)
            _place_picture(axes, downsample(_draw_meshes(camera, cage, rest, marks)), number)
            _draw_numbers(axes, camera, marks, number * PANEL_SIDE)
        for row, (number_text, text, colour) in enumerate(rows):  # below, in their colours
            middle = PANEL_SIDE + LIST_MARGIN + (row + 0.5) * LIST_ROW_HEIGHT
            style: Any = {"size": 9.0, "va": "center_baseline"}
            axes.text(LIST_MARGIN, middle, number_text, color=colour, weight="bold", **style)
            axes.text(3 * LIST_MARGIN, middle, make_drawable(text, 110), gid="row", **style)
        return _encode_png(figure)


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
    written = [(str(mark.number), mark.colour, box) for mark, box in zip(marks, boxes, strict=True)]
    _write_names(axes, written, left, 3.0, size=font_size, weight="bold", gid="number")
