"""Each vertex has a texel per frame, and none has that of another."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.vat.layout import MAX_SIDE, TextureLayout
from cageik_cli.util.errors import OutputError


@given(st.integers(1, 3000), st.integers(1, 60))
def test_texels_are_apart_and_where_the_rows_are(vertices, frames):
    layout = TextureLayout.choose(vertices, frames)
    size = np.array([layout.width, layout.height])
    assert all(side & (side - 1) == 0 for side in size.tolist())
    texels = layout.locate(np.arange(vertices)).astype(np.float32) * size
    np.testing.assert_array_equal(texels % 1, 0.5)
    x, y = np.floor(texels).astype(int).T
    places = (y[:, None] + np.arange(frames)) * layout.width + x[:, None]
    assert places.max() < layout.width * layout.height
    assert len(np.unique(places)) == vertices * frames
    by_rows = {}
    for row, (frame, start, stop) in enumerate(layout.list_rows()):
        for column, vertex in enumerate(range(start, stop)):
            by_rows[vertex, frame] = row * layout.width + column
    assert all(places[vertex, frame] == place for (vertex, frame), place in by_rows.items())
    assert len(by_rows) == vertices * frames


@pytest.mark.parametrize(
    ("vertices", "frames", "size"),
    [
        (1, 1, (1, 1)),
        (256, 256, (256, 256)),
        (9971, 175, (1024, 2048)),
        (8192, 8192, (8192, 8192)),
        (1, 8192, (1, 8192)),
        (16384, 4096, (8192, 8192)),
    ],
)
def test_sizes(vertices, frames, size):
    layout = TextureLayout.choose(vertices, frames)
    assert (layout.width, layout.height) == size


@pytest.mark.parametrize(
    ("vertices", "frames"), [(1, MAX_SIDE + 1), (8193, 8192), (MAX_SIDE**2 + 1, 1)]
)
def test_what_no_texture_holds_is_refused(vertices, frames):
    with pytest.raises(OutputError, match="have no place in a texture of 8192 times 8192 texels"):
        TextureLayout.choose(vertices, frames)
