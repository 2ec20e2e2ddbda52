"""Moving images, as Pillow reads them."""

import io

import numpy as np
import pytest
from PIL import Image

from cageik_cli.report.film.film import (
    GIF_COLOURS,
    GifImage,
    WebpImage,
    find_rectangle,
)

SIZE = (37, 21)
KINDS = [GifImage, WebpImage]


def make_pictures(count=5):
    """A square that moves over a plain ground, and stays in the last two."""
    pictures = []
    for number in [*range(count - 1), count - 2]:
        pixels = np.full((SIZE[1], SIZE[0], 3), 255, np.uint8)
        pixels[4:16, 3 + 4 * number : 15 + 4 * number] = (200, 40, 16 * number)
        pictures.append(pixels)
    return pictures


def write(kind, pictures, durations):
    file = io.BytesIO()
    image = kind(file, *SIZE, np.concatenate(pictures))
    for pixels, duration in zip(pictures, durations, strict=True):
        image.add(pixels, duration)
    image.end()
    return file.getvalue()


def read(data):
    """All pictures, and how long each is shown, in milliseconds."""
    pictures, durations = [], []
    with Image.open(io.BytesIO(data)) as image:
        assert image.info.get("loop") == 0
        for number in range(image.n_frames):
            image.seek(number)
            pictures.append(np.asarray(image.convert("RGB")))
            durations.append(image.info["duration"])
    return pictures, durations


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_are_read_back(kind):
    pictures, durations = make_pictures(), [4, 5, 4, 7, 30]
    data = write(kind, pictures, durations)
    found, shown = read(data)
    assert shown == [1000 // kind.PARTS_PER_SECOND * duration for duration in durations]
    assert len(found) == len(pictures)
    for one, other in zip(found, pictures, strict=True):
        assert one.shape == other.shape
        assert np.abs(one.astype(int) - other).mean() < 6
    assert np.abs(found[0].astype(int) - pictures[2]).mean() > 12
    assert write(kind, pictures, durations) == data


def test_few_colours_are_exact_in_a_gif():
    pictures = make_pictures()
    found, _ = read(write(GifImage, pictures, [4] * 5))
    np.testing.assert_array_equal(found, pictures)


def test_many_colours_become_as_many_as_a_gif_has():
    ramp = np.linspace(0, 255, SIZE[0] * SIZE[1]).reshape(SIZE[::-1])
    pixels = np.stack([ramp, ramp[::-1], ramp.T.reshape(ramp.shape)], axis=2).astype(np.uint8)
    found, _ = read(write(GifImage, [pixels, pixels[::-1]], [4, 4]))
    assert len(np.unique(found[0].reshape(-1, 3), axis=0)) <= GIF_COLOURS
    assert np.abs(found[0].astype(int) - pixels).mean() < 20
    assert np.abs(found[1].astype(int) - pixels[::-1]).mean() < 20


def test_a_webp_says_how_long_it_is():
    data = write(WebpImage, make_pictures(), [40] * 5)
    assert int.from_bytes(data[4:8], "little") == len(data) - 8


def test_the_rectangle_holds_all_that_is_new():
    is_new = np.zeros((5, 7), bool)
    assert find_rectangle(is_new) == (slice(0, 1), slice(0, 1))
    is_new[2, 6] = is_new[4, 3] = True
    assert find_rectangle(is_new) == (slice(2, 5), slice(3, 7))
