"""The plot of a pose: positions of marks and names; any pose can be drawn."""

import io
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from PIL import Image

from cageik_cli.editing.summary import PoseSnapshot
from cageik_cli.report.plots import model_plot
from cageik_cli.report.plots.model_plot import (
    MAX_NAMED_ANCHORS,
    build_panels,
    draw_pose,
    render_pose_png,
)
from cageik_cli.report.plots.style import PANEL_SIDE, PLOT_COLOURS, use_fixed_style
from cageik_cli.report.render.model_views import VIEW_TURN, view_axes
from cageik_cli.report.render.raster import ParallelCamera
from tests.report.hostile import FACTORS, NAMES
from tests.shapes import ball, box

pytestmark = pytest.mark.slow

PIXELS = 240
RIGHT, UP, NEARER = view_axes("Y", VIEW_TURN)


def moved(*motions, missed=0.0, **changes):
    """A ball in a box, with one anchor per motion at its upper right that misses by `missed`.

    None is a pin.
    """
    model, cage = ball(levels=3, size=1.0), box(1.2)
    angles = np.linspace(0.0, 2 * np.pi, len(motions), endpoint=False)
    starts = 0.7 * (np.cos(angles)[:, None] * RIGHT + np.sin(angles)[:, None] * UP + NEARER)
    pinned = np.array([motion is None for motion in motions], bool)
    steps = [np.zeros(3) if motion is None else motion for motion in motions]
    steps = np.array(steps, float).reshape(-1, 3)
    view = PoseSnapshot(
        frame="",
        faces=model.faces,
        cage=cage,
        before=model.vertices,
        after=model.vertices,
        cage_before=cage.vertices,
        cage_after=cage.vertices,
        starts=starts,
        targets=starts + steps,
        ends=starts + (1 - missed) * steps,
        names=tuple(f"anchor {k}" for k in range(len(motions))),
        pinned=pinned,
        up_axis="Y",
        rms_percent=1.0,
        max_residual_percent=0.0,
    )
    return replace(view, **changes)


def drawn(view, pixels=PIXELS):
    """The picture's colours, (rows, columns, 3), 0 to 255."""
    image = Image.open(io.BytesIO(render_pose_png(view, pixels)))
    assert set(image.info) == {"dpi"}
    return np.asarray(image.convert("RGB"), int)


def figure(view, panels=None):
    with use_fixed_style():
        figure = draw_pose(view, panels or build_panels(view), PIXELS)
        figure.canvas.draw()
    return figure


def artists(view, gid, panels=None):
    children = figure(view, panels).axes[0].get_children()
    return [artist for artist in children if artist.get_gid() == gid]


def places(view, gid):
    """Return positions of marks, in points from the figure's upper left corner."""
    return np.concatenate([line.get_xydata() for line in artists(view, gid)])


def seen(view, points, panel, axes=(RIGHT, UP, NEARER)):
    """Return expected positions of points, computed again from the extent of the picture."""
    held = (view.before, view.cage_before, view.cage_after, view.starts, view.targets, view.ends)
    camera = ParallelCamera.fit(np.array(axes), np.concatenate([view.after, *held]), 1000)
    return camera.project(points)[:, :2] * PANEL_SIDE / 1000 + [panel * PANEL_SIDE, 0]


def is_coloured(picture, point, colour, reach=2):
    """Whether a colour is within `reach` pixels of a position in points."""
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    column, row = (point * PIXELS / PANEL_SIDE).astype(int)
    near = picture[row - reach : row + reach + 1, column - reach : column + reach + 1]
    return bool((np.abs(near - wanted).max(axis=2) < 40).any())


@pytest.mark.parametrize("pixels", [100, 181, 240, 719, 720])
def test_two_panels_are_side_by_side_above_their_captions(pixels, monkeypatch):
    view = moved(0.4 * UP)
    panels = [replace(panel, title="caption") for panel in build_panels(view)]
    monkeypatch.setattr(model_plot, "build_panels", lambda _: panels)
    picture = drawn(view, pixels)
    assert picture.shape[1] == 2 * pixels
    assert picture.shape[0] == pytest.approx(pixels * 9 / 8, abs=0.6)
    edge = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    assert (edge == 255).all()
    for half in (picture[:, :pixels], picture[:, pixels:]):
        assert (half[:pixels] < 250).any(axis=2).sum() > 0.2 * pixels**2


@pytest.mark.slow
def test_the_same_view_gives_the_same_bytes(monkeypatch):
    first = render_pose_png(moved(0.4 * UP, None), PIXELS)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1")
    assert render_pose_png(moved(0.4 * UP, None), PIXELS) == first
    assert render_pose_png(moved(0.3 * UP, None), PIXELS) != first


def test_both_panels_have_one_camera():
    """A ball grows: both panels have the scale of the larger ball."""
    view = moved(0.4 * UP)
    grown = replace(view, after=2 * view.after, cage_after=2 * view.cage_after)
    same, other = drawn(view), drawn(grown)
    height = [
        np.ptp(np.flatnonzero((half[:PIXELS] < 250).any(axis=(1, 2))))
        for half in (same[:, :PIXELS], other[:, :PIXELS], other[:, PIXELS:])
    ]
    assert height[0] == pytest.approx(height[2], abs=2)
    assert height[1] == pytest.approx(height[2] / 2, abs=8)


def test_arrows_lead_from_anchors_to_their_targets():
    view = moved(0.5 * UP - 0.9 * RIGHT, None)
    start, target = seen(view, np.stack([view.starts[0], view.targets[0]]), 0)
    (arrow,) = artists(view, "arrow")
    outline = arrow.get_xy()
    assert np.linalg.norm(outline - target, axis=1).min() < 1e-6
    middle = (outline[0] + outline[6]) / 2
    np.testing.assert_allclose(middle, start, atol=1e-6)
    picture = drawn(view)
    for share in (0.0, 0.3, 0.5, 0.7, 0.9):
        place = start + share * (target - start)
        assert is_coloured(picture, place, PLOT_COLOURS["handle"])
    beside = start + 0.5 * (target - start) + [PANEL_SIDE, 0]
    assert not is_coloured(picture, beside, PLOT_COLOURS["handle"])


def test_marks_are_at_the_anchors():
    view = moved(0.5 * UP, None, -0.2 * RIGHT, missed=0.5)
    is_pin = view.pinned
    for gid, kind in (("dot", ~is_pin), ("pin", is_pin)):
        expected = [seen(view, view.starts[kind], 0), seen(view, view.ends[kind], 1)]
        np.testing.assert_allclose(places(view, gid), np.concatenate(expected), atol=1e-6)
    np.testing.assert_allclose(places(view, "goal"), seen(view, view.targets[~is_pin], 1))
    picture = drawn(view)
    for panel, points in enumerate((view.starts, view.ends)):
        for place, pinned in zip(seen(view, points, panel), is_pin, strict=True):
            assert is_coloured(
                picture, place, PLOT_COLOURS["ink"] if pinned else PLOT_COLOURS["handle"]
            )
            assert not is_coloured(
                picture, place, PLOT_COLOURS["handle"] if pinned else PLOT_COLOURS["ink"]
            )


def test_a_missed_target_has_a_line_to_its_anchor():
    assert artists(moved(0.5 * UP, missed=0.0), "miss") == []
    view = moved(0.5 * UP, missed=0.5)
    (line,) = artists(view, "miss")
    expected = np.concatenate([seen(view, view.ends, 1), seen(view, view.targets, 1)])
    np.testing.assert_allclose(line.get_xydata(), expected)


def test_the_legend_names_handle_target_and_pin():
    (legend,) = figure(moved(RIGHT, None)).legends
    assert [text.get_text() for text in legend.get_texts()] == ["handle", "target", "pin"]


def test_a_pin_is_ringed_only_if_it_misses():
    view = moved(0.5 * UP, None)
    assert len(places(view, "goal")) == 1
    slipped = replace(view, ends=view.ends + np.outer([0.0, 0.3], RIGHT))
    assert len(places(slipped, "goal")) == 2
    assert len(artists(slipped, "miss")) == 1


def test_marks_behind_the_model_are_paler():
    view = moved(None, None)
    behind = view.starts - np.outer([0.0, 1.4], NEARER)
    turned = replace(view, starts=behind, targets=behind, ends=behind)
    shown = {line.get_alpha(): len(line.get_xydata()) for line in artists(turned, "pin")[:2]}
    assert shown == {0.5: 1, 1.0: 1}


@pytest.mark.parametrize("motion", [UP, RIGHT, 0.9 * RIGHT + 0.2 * NEARER])
def test_the_default_viewpoint_is_that_of_pages(motion):
    view = moved(0.5 * motion)
    np.testing.assert_allclose(places(view, "dot")[0], seen(view, view.starts, 0)[0])


@pytest.mark.parametrize(("motion", "turn"), [(NEARER, -VIEW_TURN), (np.array([0, 0, 1.0]), 75.0)])
def test_the_viewpoint_shows_arrows_at_full_length(motion, turn):
    view = moved(0.5 * motion)
    expected = seen(view, view.starts, 0, view_axes("Y", turn))
    np.testing.assert_allclose(places(view, "dot")[:1], expected)


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_up_is_up(up_axis):
    view = moved(0.8 * np.eye(3)["XYZ".index(up_axis)], up_axis=up_axis)
    (arrow,) = artists(view, "arrow")
    tip, start = arrow.get_xy()[3], (arrow.get_xy()[0] + arrow.get_xy()[6]) / 2
    assert tip[0] == pytest.approx(start[0])
    assert tip[1] < start[1]


def boxes(view):
    """Return the boxes of the names, (left, top, right, bottom) in points."""
    height = PANEL_SIDE * 9 / 8
    extents = [text.get_window_extent() for text in artists(view, "name")]
    scale = PANEL_SIDE / PIXELS
    return [
        (box.x0 * scale, height - box.y1 * scale, box.x1 * scale, height - box.y0 * scale)
        for box in extents
    ]


CROWDS = {
    "one": 1,
    "a dozen": MAX_NAMED_ANCHORS,
    "more than are named": 30,
    "all at one place": -20,
}


@pytest.mark.parametrize("count", CROWDS.values(), ids=CROWDS)
def test_names_do_not_overlap_and_stay_in_their_panel(count):
    view = moved(*(0.1 * (k % 5) * UP for k in range(abs(count))))
    if count < 0:
        view = replace(view, starts=0 * view.starts, targets=0 * view.targets, ends=0 * view.ends)
    named = boxes(view)
    assert len(named) <= 2 * MAX_NAMED_ANCHORS
    if count > 0:
        assert len(named) == 2 * min(count, MAX_NAMED_ANCHORS)
    for left, top, right, bottom in named:
        panel = int(left > PANEL_SIDE)
        assert panel * PANEL_SIDE <= left < right <= (panel + 1) * PANEL_SIDE
        assert 0 <= top < bottom <= PANEL_SIDE
    for (a, b, c, d), (e, f, g, h) in combinations(named, 2):
        assert a >= g or e >= c or b >= h - 1 or f >= d - 1


def test_anchors_that_move_farthest_are_named_first():
    view = moved(*(0.02 * k * UP for k in range(2 * MAX_NAMED_ANCHORS)))
    shown = {text.get_text() for text in artists(view, "name")}
    assert shown == {f"anchor {k}" for k in range(MAX_NAMED_ANCHORS, 2 * MAX_NAMED_ANCHORS)}


HOSTILE = (
    *NAMES,
    "$x^2$ \\frac{",
    "\x00\x07\x1b[31m",
    "x" * 5000,
    "",
    " ",
    "\ud800",
    "手",
    "W" * 60,
)


@pytest.mark.parametrize("name", HOSTILE)
def test_any_name_is_drawn(name):
    view = moved(0.4 * UP, None, frame=name, names=(name, "other"))
    before, after = build_panels(view)
    panels = replace(before, title=name), replace(after, title=3 * name)
    assert len(boxes(view)) == 4
    drawn(view)
    titles = artists(view, "title", panels)
    for number, title in enumerate(titles):
        extent = title.get_window_extent()
        assert number * PIXELS - 1 < extent.x0 <= extent.x1 < (number + 1) * PIXELS + 1


@pytest.mark.parametrize(("model", "cage"), FACTORS.values(), ids=FACTORS)
def test_any_pose_is_drawn(model, cage):
    view = moved(0.4 * UP, None, 0.4 * NEARER)
    names = ("before", "after", "starts", "targets", "ends")
    changes = {name: model * getattr(view, name) for name in names}
    changes |= {name: cage * getattr(view, name) for name in ("cage_before", "cage_after")}
    assert drawn(replace(view, **changes)).std() > 0


MOTIONS = {
    "none": [],
    "pins alone": [None, None],
    "that stand still": [0 * UP],
    "too short to be seen": [1e-9 * UP],
    "towards the viewer, about": [0.5 * NEARER, 0.5 * view_axes("Y", -75.0)[2]],
    "longer than the model": [20 * UP + 30 * RIGHT],
}


@pytest.mark.parametrize("motions", MOTIONS.values(), ids=MOTIONS)
def test_any_motion_is_drawn(motions):
    view = moved(*motions)
    picture = drawn(view)
    assert (picture[[0, -1]] == 255).all()
    far = np.linalg.norm(view.targets - view.starts, axis=1) > 0.01
    assert len(artists(view, "arrow")) == far.sum()
