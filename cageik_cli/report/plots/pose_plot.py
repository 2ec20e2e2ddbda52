"""A pose before and after an edit, side by side from one viewpoint, as a PNG file.

Lengths are in points of the figure, 72 per inch, x to the right and y downwards from the upper left
corner. It is drawn without pyplot; the same view gives the same bytes.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from cageik_cli.posing.snapshot import PoseSnapshot
from cageik_cli.report.figures import format_percent
from cageik_cli.report.plots.pose_marks import (
    MARK_OFFSETS,
    Flags,
    draw_anchors,
    draw_arrows,
    draw_legend,
    draw_targets,
    place_names,
)
from cageik_cli.report.plots.style import make_drawable, measure_text_width, use_fixed_style
from cageik_cli.report.render.model_views import (
    DEPTH_TOL,
    project_surface,
    render_with_cage,
)
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import SAMPLES_PER_PIXEL, downsample
from cageik_cli.report.render.viewpoints import VIEW_TURN, view_axes
from cageik_cli.report.views.pose_text import format_miss
from cageik_cli.util.arrays import Floats

PANEL_SIDE, LEGEND_HEIGHT = 345.6, 43.2
"""Size of a panel, and height of the strip below the panels."""

CAPTION_SIZE, NAME_SIZE = 10.0, 8.5
"""Font sizes of captions and of names."""

MAX_CAPTION_LENGTH, MAX_NAME_LENGTH = 76, 28
"""Characters of a caption and of a name that are shown."""

MAX_NAMED_ANCHORS = 12
"""Anchors that are labelled with their names; those that move farthest come first."""

VIEW_TURNS = (VIEW_TURN, -VIEW_TURN, 75.0, -75.0)
"""Possible viewpoints, degrees to the right of the front; the first is that of pages."""

MIN_ARROW_SHARE = 0.8
"""The first viewpoint is taken whose arrows have this share of the longest total length."""

COLOUR_BIT_MASK = np.uint8(0xFC)
"""Bits of colours that are kept; the file is a sixth smaller."""

ARROW_SAMPLE_SPACING = 4.0
"""Distance between the points of an arrow that names should not cover."""


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
    stream = io.BytesIO()
    with use_fixed_style():
        draw_pose(view, build_panels(view), pixels).savefig(
            stream, format="png", metadata={"Software": None}
        )
    return stream.getvalue()


def build_panels(view: PoseSnapshot) -> tuple[Panel, Panel]:
    """Build the panels before and after, with their captions."""
    title_before = f"{view.frame}, before" if view.frame else "before"
    title_after = (
        f"after: mesh moved {format_percent(view.rms_percent)} %, "
        f"largest miss of a target {format_miss(view.max_residual_percent)} %"
    )
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
    per_point = pixels / PANEL_SIDE
    size = np.array([len(panels) * pixels, pixels + round(LEGEND_HEIGHT * per_point)])
    # Slightly larger, because matplotlib rounds the number of pixels down.
    width, height = (float(value) for value in (size + 1e-3) / per_point)
    figure = Figure((width / 72, height / 72), dpi=72 * per_point)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0), zorder=1)
    axes.set_axis_off()
    for number, panel in enumerate(panels):
        _draw_panel(_PanelPlace(figure, axes, camera, number), view, panel)
    draw_legend(figure, view.pinned)
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class _PanelPlace:
    """The place of a panel in the figure.

    Attributes
    ----------
    axes : Axes
        Cover the whole figure.
    number : int
        Index of the panel, from the left.
    """

    figure: Figure
    axes: Axes
    camera: ParallelCamera
    number: int

    def __call__(self, points: Floats) -> Floats:
        """Project points, (k, 3), into the figure, (k, 2)."""
        seen = self.camera.project(points)[:, :2] * (PANEL_SIDE / self.camera.size)
        return np.asarray(seen + np.array([self.left, 0]))

    @property
    def left(self) -> float:
        return self.number * PANEL_SIDE


def _choose_camera(view: PoseSnapshot, points: Floats, size: int) -> ParallelCamera:
    """Choose a camera that shows all points, from a viewpoint where the arrows are long."""
    arrows = _arrow_vectors(view)
    views = [view_axes(view.up_axis, turn) for turn in VIEW_TURNS]
    lengths = [float(np.linalg.norm(arrows @ axes[:2].T, axis=1).sum()) for axes in views]
    chosen = next(k for k, length in enumerate(lengths) if length >= MIN_ARROW_SHARE * max(lengths))
    return ParallelCamera.fit(views[chosen], points, size)


def _arrow_vectors(view: PoseSnapshot) -> Floats:
    """Return the vectors from the anchors to their targets, (l, 3); zero for pins."""
    return np.where(view.pinned[:, None], 0.0, view.targets - view.starts)


def _draw_panel(place: _PanelPlace, view: PoseSnapshot, panel: Panel) -> None:
    surface = project_surface(place.camera, panel.vertices, view.faces)
    picture = downsample(render_with_cage(surface, place.camera, panel.cage, view.cage_faces))
    pixels = picture.shape[1]
    below = round(place.figure.bbox.height) - pixels
    levels = np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8) & COLOUR_BIT_MASK
    place.figure.figimage(levels.transpose(1, 2, 0), place.number * pixels, below)
    covered = _are_covered(place.camera, panel.anchors, surface.depth)
    dots, targets = place(panel.anchors), place(view.targets)
    if panel.has_arrows:
        draw_arrows(place.axes, dots[~view.pinned], targets[~view.pinned])
    else:
        draw_targets(place.axes, dots, targets, view.pinned)
    draw_anchors(place.axes, dots, view.pinned, covered)
    _draw_names(place, view, dots, targets)
    _draw_title(place, make_drawable(panel.title, MAX_CAPTION_LENGTH))


def _draw_title(place: _PanelPlace, title: str) -> None:
    """Write a caption below a panel, smaller if it does not fit."""
    size = CAPTION_SIZE * min(
        1.0, (PANEL_SIDE - 2 * CAPTION_SIZE) / max(measure_text_width(title, CAPTION_SIZE), 1.0)
    )
    middle = place.left + PANEL_SIDE / 2
    place.axes.text(
        middle, PANEL_SIDE + CAPTION_SIZE, title, size=size, ha="center", va="center", gid="title"
    )


def _are_covered(camera: ParallelCamera, points: Floats, depth: Floats) -> Flags:
    """Whether points, (k, 3), are behind a surface of these depths, (s, s)."""
    seen = camera.project(points)
    columns, rows = np.clip(seen[:, :2], 0, camera.size - 1).astype(np.int64).T
    return np.asarray(seen[:, 2] > depth[rows, columns] + DEPTH_TOL * camera.size)


def _draw_names(place: _PanelPlace, view: PoseSnapshot, dots: Floats, targets: Floats) -> None:
    """Label up to `MAX_NAMED_ANCHORS` anchors where there is room, the farthest moving first."""
    far = np.linalg.norm(_arrow_vectors(view), axis=1)
    order = np.argsort(-far, kind="stable")[:MAX_NAMED_ANCHORS]
    names = [make_drawable(view.names[k], MAX_NAME_LENGTH) for k in order]
    sizes = np.array(
        [(measure_text_width(name, NAME_SIZE), 1.1 * NAME_SIZE) for name in names]
    ).reshape(-1, 2)
    offset = np.array([place.left, 0])
    kept_clear = np.concatenate(
        [*(dots + corner for corner in MARK_OFFSETS), *map(_sample_segment, dots, targets)]
    )
    boxes = place_names(dots[order] - offset, sizes, kept_clear - offset, PANEL_SIDE)
    for name, box in zip(names, boxes, strict=True):
        if box is not None:
            place.axes.text(
                place.left + box[0],
                (box[1] + box[3]) / 2,
                name,
                size=NAME_SIZE,
                va="center_baseline",
                path_effects=[withStroke(linewidth=2.4, foreground="white")],
                zorder=6,
                gid="name",
            )


def _sample_segment(start: Floats, end: Floats) -> Floats:
    """Sample a segment, (k, 2), at most `ARROW_SAMPLE_SPACING` apart."""
    count = int(np.ceil(np.hypot(*(end - start)) / ARROW_SAMPLE_SPACING)) + 1
    return np.linspace(start, end, count)
