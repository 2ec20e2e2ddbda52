"""The picture to send: which frames it shows, and that it is a picture of them."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from cageik_cli.report.plots.pose_sheet import (
    SHEET_POSES,
    choose_sheet_frames,
    describe_verdict,
    render_sheet_png,
)

PIXELS = 60


@pytest.mark.parametrize(
    ("count", "worst", "wanted"),
    [
        (100, 50, [0, 33, 50, 99]),
        (100, 0, [0, 33, 66, 99]),
        (100, 99, [0, 33, 66, 99]),
        (100, 3, [0, 3, 66, 99]),
        (5, 2, [0, 2, 3, 4]),
        (3, 1, [0, 1, 2]),
        (2, 1, [0, 1]),
        (1, 0, [0]),
    ],
)
def test_the_first_and_the_worst_frame_are_among_those_shown(count, worst, wanted):
    found = choose_sheet_frames(count, worst)
    assert {0, worst} <= set(found)
    assert found == sorted(set(found))
    assert len(found) == min(count, SHEET_POSES)
    if count != 5:
        assert found == wanted


def test_the_picture_shows_the_cage_and_four_poses(closed, report):
    data = render_sheet_png(closed.result, report, PIXELS)
    with Image.open(io.BytesIO(data)) as image:
        width, height = image.size
        pixels = np.asarray(image.convert("RGB")).astype(int)
    shown = 1 + len(choose_sheet_frames(len(report.frames), 0))
    assert width == shown * PIXELS
    assert height > PIXELS
    blue = pixels[..., 2] - pixels[..., 0] > 60
    counts = [blue[:, k * PIXELS : (k + 1) * PIXELS].sum() for k in range(shown)]
    assert min(counts) > 20
    assert (pixels[:8] < 200).any(), "the title"
    assert render_sheet_png(closed.result, report, PIXELS) == data


def test_a_name_of_any_length_and_letters_is_drawn(closed, report):
    for name in ("a" * 300, "$x^2 \U0001f9d1 \\frac"):
        assert render_sheet_png(closed.result, replace(report, result=name), PIXELS)


def test_the_title_says_how_good_it_is(report):
    assert f"{report.quality}, " in describe_verdict(report)
    assert describe_verdict(replace(report, quality=None)).startswith("moved ")
