"""Images are read by other libraries, texel by texel."""

import numpy as np
import pytest

from cageik_cli.formats.vat.images import write_exr, write_png
from tests.formats.vat.shader import read_exr, read_png

pytest.importorskip("png")
pytest.importorskip("OpenEXR")

KINDS = {"png": (write_png, read_png, 0.5 / 65535), "exr": (write_exr, read_exr, 2**-25)}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 8), (8, 1), (64, 32), (1024, 4)])
@pytest.mark.parametrize("content", ["noise", "slope", "black"])
def test_each_texel_is_read(tmp_path, kind, width, height, content):
    write, read, rounding = KINDS[kind]
    slope = np.linspace(0, 1, 3 * width * height).reshape(height, width, 3)
    noise = np.random.default_rng(1).random((height, width, 3))
    image = {"noise": noise, "slope": slope, "black": np.zeros_like(slope)}[content]
    write(tmp_path / f"a.{kind}", (width, height), iter(image))
    np.testing.assert_allclose(
        read(tmp_path / f"a.{kind}"), image, rtol=0, atol=rounding * (1 + 1e-9)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_what_rows_leave_is_black(tmp_path, kind):
    write, read, _ = KINDS[kind]
    write(tmp_path / f"a.{kind}", (4, 4), iter([np.ones((4, 3)), np.ones((3, 3))]))
    expected = np.zeros((4, 4, 3))
    expected[0], expected[1, :3] = 1, 1
    np.testing.assert_array_equal(read(tmp_path / f"a.{kind}"), expected)


@pytest.mark.parametrize("kind", KINDS)
def test_what_lasts_is_small(tmp_path, kind):
    """Rows that are alike, as frames are, and smooth ones."""
    row = np.linspace(0, 1, 3 * 256).reshape(256, 3)
    KINDS[kind][0](tmp_path / "a", (256, 256), iter([row] * 256))
    plain = 256 * 256 * 3 * {"png": 2, "exr": 4}[kind]
    assert (tmp_path / "a").stat().st_size < 0.8 * plain
