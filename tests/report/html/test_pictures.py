"""The pictures of a page: one camera per pose, one scale; any pose can be drawn."""

import base64
import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from cageik_cli.report.html.pictures import draw_pictures
from cageik_cli.report.render.model_views import Pose, PoseSet
from cageik_cli.report.render.shading import COLOUR_SCALE, MESH_COLOURS
from cageik_cli.report.vocabulary import EXTRACTION_VOCABULARY
from tests.report.hostile import FACTORS
from tests.shapes import ball, box

PIXELS = 60


def draw(poses):
    return draw_pictures(poses, EXTRACTION_VOCABULARY, PIXELS)


def open_png(view):
    """The colours of a view, which has the size and the kind of all."""
    data = base64.b64decode(view[1].removeprefix("data:image/png;base64,"))
    image = Image.open(io.BytesIO(data))
    assert (image.size, image.mode, image.info) == ((PIXELS, PIXELS), "RGBA", {})
    return np.asarray(image, float)


def all_pictures(pictures):
    return [
        *(view for pose in pictures["poses"] for view in pose["views"]),
        *pictures["rest_views"],
    ]


def hue(text):
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)])


def still(vertex_rms, deviation, **changes):
    """Poses of a ball in a box, reconstructed exactly, with made-up deviations."""
    model, cage = ball(levels=3, size=1.0), box(1.2)
    count = len(model.vertices)
    original = Pose(
        "rest",
        "rest pose",
        model.vertices,
        model.vertices,
        cage.vertices,
        np.full(count, deviation),
    )
    poses = PoseSet(model.faces, cage, (original,), np.full(count, vertex_rms), "Y")
    return replace(poses, **changes)


def test_every_pose_has_its_three_pictures(poses):
    pictures = draw(poses)
    assert [(pose["title"], pose["name"]) for pose in pictures["poses"]] == [
        ("Rest pose", ""),
        *((f"{pose.label} frame".capitalize(), pose.name) for pose in poses.poses[1:]),
    ]
    assert [len(pose["views"]) for pose in pictures["poses"]] == [3] * 4
    assert len(pictures["rest_views"]) == 2
    assert pictures["colours"] == COLOUR_SCALE
    for view in all_pictures(pictures):
        opacity = open_png(view)[..., 3]
        assert (opacity == 255).sum() > 50
        assert (opacity == 0).sum() > 50
    assert draw(poses) == pictures


def test_original_and_reconstruction_have_one_camera():
    (pose,) = draw(still(1.0, 1.0))["poses"]
    original, reconstruction, caged = map(open_png, pose["views"])
    np.testing.assert_array_equal(original[..., 3], reconstruction[..., 3])
    assert (caged[..., 3] >= original[..., 3]).all()
    assert (caged[..., 3] > original[..., 3]).sum() > 100


@pytest.mark.parametrize(("share", "expected"), [(0.0, 0), (0.5, 4), (1.0, 8), (5.0, 8)])
def test_colours_show_the_deviation(share, expected):
    """Half of the vertices have a share of the deviation at which the scale ends."""
    poses = still(1.0, 0.0)
    rest = poses.poses[0]
    deviation = np.full(len(rest.original), share * 2.0)
    deviation[rest.original[:, 1] < -0.5] = 2.0
    shown = replace(poses, poses=(replace(rest, deviation=deviation),))
    pictures = draw(shown)
    middle = open_png(pictures["poses"][0]["views"][1])[PIXELS // 2 - 5, PIXELS // 2, :3]
    wanted = hue(COLOUR_SCALE[4 if share == 0.5 else expected])
    if share <= 1:
        assert pictures["ticks"][-1] == "2"
    ratio = middle / wanted
    assert ratio == pytest.approx(np.full(3, ratio.mean()), rel=0.06)


@pytest.mark.parametrize(
    ("rms", "deviation", "ends"),
    [(0.43, 1.1, ("0.5", "1.5")), (0.0, 1e-13, ("0.001",) * 2), (0.0, 9.5e7, ("0.001", "1e+08"))],
)
def test_scales_end_at_round_numbers_above_nearly_all_values(rms, deviation, ends):
    pictures = draw(still(rms, deviation))
    assert (pictures["rms_ticks"][-1], pictures["ticks"][-1]) == ends


def test_missing_data_is_grey():
    pictures = draw(still(np.nan, 5.0))
    assert pictures["ticks"][-1] == "0.001"
    for view in (pictures["poses"][0]["views"][1], *pictures["rest_views"]):
        ratio = open_png(view)[PIXELS // 2, PIXELS // 2, :3] / hue(MESH_COLOURS["missing"])
        assert ratio == pytest.approx(np.full(3, ratio.mean()), rel=0.05)


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_up_is_up(up_axis):
    """A ball is stretched along its up axis: the picture is as high as possible."""
    poses = still(1.0, 1.0, up_axis=up_axis)
    stretch = np.where(np.arange(3) == "XYZ".index(up_axis), 4.0, 1.0)
    rest = poses.poses[0]
    tall = replace(
        rest, original=stretch * rest.original, reconstruction=stretch * rest.reconstruction
    )
    drawn = open_png(draw(replace(poses, poses=(tall,)))["rest_views"][0])[..., 3] > 0
    assert np.ptp(np.flatnonzero(drawn.any(axis=1))) > 2.5 * np.ptp(
        np.flatnonzero(drawn.any(axis=0))
    )


@pytest.mark.parametrize(("model", "cage"), FACTORS.values(), ids=FACTORS)
def test_any_pose_is_drawn(model, cage):
    poses = still(1.0, 1.0)
    rest = poses.poses[0]
    odd = replace(
        rest,
        original=model * rest.original,
        reconstruction=model * rest.reconstruction,
        cage=cage * rest.cage,
    )
    shown = all_pictures(draw(replace(poses, poses=(odd,))))
    assert [open_png(view).shape for view in shown] == [(PIXELS, PIXELS, 4)] * 5
