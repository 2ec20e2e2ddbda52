"""The small picture of a clip: what it shows, and its size."""

import io

import numpy as np
from PIL import Image

from cageik_cli.report.render.model_views import draw_thumbnail
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings


def draw(result):
    """The pixels of the picture, red, green, blue and opacity, 0 to 1."""
    data = draw_thumbnail(result)
    assert data == draw_thumbnail(result)  # the same result gives the same page
    assert len(data) < 4000
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGBA")) / 255


def test_the_model_fills_the_picture_and_is_darker_where_it_is_wrong(closed, fitted):
    wrong, right = draw(closed.result), draw(fitted)
    for pixels in (wrong, right):
        assert pixels.shape == (96, 96, 4)
        assert 0.3 < (pixels[..., 3] > 0.5).mean() < 0.95
    darkness = [1 - pixels[pixels[..., 3] > 0.5][:, 2].mean() for pixels in (wrong, right)]
    assert darkness[0] > darkness[1] + 0.1


def test_a_result_without_weights_has_no_picture(folder):
    settings = ExtractSettings(
        ("frames",), folder / "cage.obj", folder / "c.h5", keep_weights=False
    )
    assert draw_thumbnail(extract(settings)) is None
