"""A pose before and after it was edited by anchors, side by side from one place, as a PNG file.

Lengths in the figure are points, 72 to the inch, x to the right and y downwards from its upper left
corner. It is drawn without pyplot; the same view gives the same bytes.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from cageik_cli.posing.edits import Layer, acting, anchors_of
from cageik_cli.posing.summary import Posed
from cageik_cli.report.figures import percent_text
from cageik_cli.report.plots.pose_marks import (
    AROUND,
    Flags,
    draw_arrows,
    draw_dots,
    draw_goals,
    draw_legend,
    name_places,
)
from cageik_cli.report.plots.style import drawable, own_style, text_width
from cageik_cli.report.render.model_views import CLEARANCE, TURN, caged, seen_surface, view_axes
from cageik_cli.report.render.raster import Camera
from cageik_cli.report.render.shading import SAMPLES, reduced
from cageik_cli.report.views.pose_text import miss_text
from cageik_cli.util.arrays import Floats, Integers

SIDE, STRIP = 345.6, 43.2
"""Of a panel, and of what stands below all of them."""

CAPTION, NAME = 10.0, 8.5
"""Sizes of letters: of captions, and of names."""

LONGEST, LONGEST_NAME = 76, 28
"""Characters of a caption and of a name that are shown."""

NAMED = 12
"""Up to so many anchors have their names beside them, those first that go farthest."""

TURNS = (TURN, -TURN, 75.0, -75.0)
"""Degrees to the right of the front that a viewer may stand; the first is what pages show."""

ENOUGH = 0.8
"""Share of the longest arrows of all places that suffices for one named before."""

LEVELS = np.uint8(0xFC)
"""Bits of colours that are kept, which makes the file a sixth smaller."""

STEP = 4.0
"""Between points of an arrow that names keep clear of."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseView:
    """A pose before and after.

    Attributes
    ----------
    faces, cage_faces : (t, 3) and (f, 3) int64
    before, after : (m, 3) float64
        The model.
    cage_before, cage_after : (n, 3) float64
    starts, targets, ends : (l, 3) float64
        Where the anchors were, were to go, and are.
    names : tuple of str
        Of the l anchors.
    pinned : (l,) bool
        Whether they were to stay.
    up_axis : str
        "Y" or "Z".
    title_before, title_after : str
        A line each.
    """

    faces: Integers
    cage_faces: Integers
    before: Floats
    after: Floats
    cage_before: Floats
    cage_after: Floats
    starts: Floats
    targets: Floats
    ends: Floats
    names: tuple[str, ...]
    pinned: Flags
    up_axis: str
    title_before: str
    title_after: str


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One of the pictures side by side.

    Attributes
    ----------
    vertices, cage : (m, 3) and (n, 3) float64
    anchors : (l, 3) float64
        Where they are.
    has_arrows : bool
        Whether arrows lead to the targets; otherwise they are ringed.
    title : str
    """

    vertices: Floats
    cage: Floats
    anchors: Floats
    has_arrows: bool
    title: str


def as_png(view: PoseView, pixels: int = 720) -> bytes:
    """Draw a pose before and after, each so many pixels across, as a PNG file."""
    panels = (
        Panel(view.before, view.cage_before, view.starts, True, view.title_before),
        Panel(view.after, view.cage_after, view.ends, False, view.title_after),
    )
    stream = io.BytesIO()
    with own_style():
        figure_of(view, panels, pixels).savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def figure_of(view: PoseView, panels: Sequence[Panel], pixels: int) -> Figure:
    """Panels of one model, seen from one place, with the anchors and targets of a view."""
    points = [points for panel in panels for points in (panel.vertices, panel.cage, panel.anchors)]
    camera = _camera(view, np.concatenate([*points, view.starts, view.targets]), SAMPLES * pixels)
    per_point = pixels / SIDE
    size = np.array([len(panels) * pixels, pixels + round(STRIP * per_point)])
    # A little more, since matplotlib rounds the number of pixels down.
    width, height = (float(value) for value in (size + 1e-3) / per_point)
    figure = Figure((width / 72, height / 72), dpi=72 * per_point)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0), zorder=1)
    axes.set_axis_off()
    for number, panel in enumerate(panels):
        _draw_panel(_Place(figure, axes, camera, number), view, panel)
    draw_legend(figure, view.pinned)
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Where a panel is drawn.

    Attributes
    ----------
    figure : Figure
    axes : Axes
        Over all of it.
    camera : Camera
    number : int
        Of the panel, from the left.
    """

    figure: Figure
    axes: Axes
    camera: Camera
    number: int

    def __call__(self, points: Floats) -> Floats:
        """Where points, (k, 3), are seen in the figure, (k, 2)."""
        seen = self.camera.project(points)[:, :2] * (SIDE / self.camera.size)
        return np.asarray(seen + np.array([self.left, 0]))

    @property
    def left(self) -> float:
        return self.number * SIDE


def _camera(view: PoseView, points: Floats, size: int) -> Camera:
    """One that shows all points, from where the arrows are long."""
    arrows = _arrows(view)
    places = [view_axes(view.up_axis, turn) for turn in TURNS]
    lengths = [float(np.linalg.norm(arrows @ axes[:2].T, axis=1).sum()) for axes in places]
    chosen = next(k for k, length in enumerate(lengths) if length >= ENOUGH * max(lengths))
    return Camera.fitted(places[chosen], points, size)


def _arrows(view: PoseView) -> Floats:
    """How far the anchors were to go, (l, 3)."""
    return np.where(view.pinned[:, None], 0.0, view.targets - view.starts)


def _draw_panel(place: _Place, view: PoseView, panel: Panel) -> None:
    surface = seen_surface(place.camera, panel.vertices, view.faces)
    picture = reduced(caged(surface, place.camera, panel.cage, view.cage_faces))
    pixels = picture.shape[1]
    below = round(place.figure.bbox.height) - pixels
    levels = np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8) & LEVELS
    place.figure.figimage(levels.transpose(1, 2, 0), place.number * pixels, below)
    covered = _are_covered(place.camera, panel.anchors, surface.depth)
    dots, goals = place(panel.anchors), place(view.targets)
    if panel.has_arrows:
        draw_arrows(place.axes, dots[~view.pinned], goals[~view.pinned])
    else:
        draw_goals(place.axes, dots, goals, view.pinned)
    draw_dots(place.axes, dots, view.pinned, covered)
    _draw_names(place, view, dots, goals)
    _draw_title(place, drawable(panel.title, LONGEST))


def _draw_title(place: _Place, title: str) -> None:
    """Write a line below a panel, smaller if it does not fit."""
    size = CAPTION * min(1.0, (SIDE - 2 * CAPTION) / max(text_width(title, CAPTION), 1.0))
    middle = place.left + SIDE / 2
    place.axes.text(middle, SIDE + CAPTION, title, size=size, ha="center", va="center", gid="title")


def _are_covered(camera: Camera, points: Floats, depth: Floats) -> Flags:
    """Which points, (k, 3), are behind a surface of these depths, (s, s)."""
    seen = camera.project(points)
    columns, rows = np.clip(seen[:, :2], 0, camera.size - 1).astype(np.int64).T
    return np.asarray(seen[:, 2] > depth[rows, columns] + CLEARANCE * camera.size)


def _draw_names(place: _Place, view: PoseView, dots: Floats, goals: Floats) -> None:
    """Name up to `NAMED` anchors where there is room, first those that go farthest."""
    far = np.linalg.norm(_arrows(view), axis=1)
    order = np.argsort(-far, kind="stable")[:NAMED]
    names = [drawable(view.names[k], LONGEST_NAME) for k in order]
    sizes = np.array([(text_width(name, NAME), 1.1 * NAME) for name in names]).reshape(-1, 2)
    offset = np.array([place.left, 0])
    kept_clear = np.concatenate(
        [*(dots + corner for corner in AROUND), *map(_stations, dots, goals)]
    )
    boxes = name_places(dots[order] - offset, sizes, kept_clear - offset, SIDE)
    for name, box in zip(names, boxes, strict=True):
        if box is not None:
            place.axes.text(
                place.left + box[0],
                (box[1] + box[3]) / 2,
                name,
                size=NAME,
                va="center_baseline",
                path_effects=[withStroke(linewidth=2.4, foreground="white")],
                zorder=6,
                gid="name",
            )


def _stations(start: Floats, end: Floats) -> Floats:
    """Points from one to the other, (k, 2), no further apart than `STEP`."""
    count = int(np.ceil(np.hypot(*(end - start)) / STEP)) + 1
    return np.linspace(start, end, count)


def view_of(posed: Posed, up_axis: str) -> PoseView:
    """The pose, or the frame that was moved most, with the handles that act in it."""
    snapshot, figures = posed.snapshot, posed.figures
    block, binding = snapshot.block, snapshot.clip.binding
    anchors, chosen = anchors_of(snapshot.layers), _deciding(snapshot.layers, int(block.frames[0]))
    starts, targets = block.edit.starts[0, chosen], block.edit.targets[0, chosen]
    missed = max((figures.anchors[k].residual_percent for k in chosen), default=0.0)
    place = f"{snapshot.frame}, " if snapshot.frame else ""
    return PoseView(
        faces=binding.rest.faces,
        cage_faces=binding.cage.faces,
        before=block.meshes[0],
        after=block.edited[0],
        cage_before=block.cages[0],
        cage_after=block.edit.cages[0],
        starts=block.anchors_before[0, chosen],
        targets=targets,
        ends=block.anchors_after[0, chosen],
        names=tuple(anchors[k].name for k in chosen),
        pinned=(targets == starts).all(axis=1),
        up_axis=up_axis,
        title_before=f"{place}before",
        title_after=f"after: mesh moved {percent_text(figures.rms_percent)} %, "
        f"handles met within {miss_text(missed)} %",
    )


def _deciding(layers: Sequence[Layer], frame: int) -> list[int]:
    """Numbers of the anchors that decide a frame, ascending.

    Those of layers that change nothing in it do not, and of several at one point the last does.
    """
    acts = acting(layers, np.array([frame]))[0]
    points = [anchor.point for anchor in anchors_of(layers)]
    keys = [(point.corners.tobytes(), point.barycentric.tobytes()) for point in points]
    last = {key: k for k, key in enumerate(keys) if acts[k]}
    return sorted(last.values())
