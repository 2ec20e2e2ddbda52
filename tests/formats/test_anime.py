"""DeformingThings4D clips written byte by byte, as their description says."""

import struct

import numpy as np
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.util.errors import FormatError
from tests.clips import frames_of

FACES = np.array([[0, 1, 2], [0, 2, 3]])
FRAMES = np.random.default_rng(0).integers(-99, 99, (5, 4, 3)) / 8


def anime(frames=FRAMES, faces=FACES, counts=None):
    counts = counts or (len(frames), frames.shape[1], len(faces))
    parts = [(frames[0], "f"), (faces, "i"), (frames[1:] - frames[0], "f")]
    return struct.pack("<iii", *counts) + b"".join(
        struct.pack(f"<{array.size}{letter}", *array.ravel().tolist()) for array, letter in parts
    )


@pytest.fixture
def opened(tmp_path):
    def through(data, how=None):
        (tmp_path / "clip.anime").write_bytes(data)
        return open_sequence([str(tmp_path / "clip.anime")], how)

    return through


@pytest.mark.parametrize("selection", [slice(None), slice(2, 4), slice(None, None, 2), slice(4, 5)])
def test_offsets_are_from_frame_0_whichever_frames_are_chosen(opened, selection):
    sequence = opened(anime(), ClipSettings(selection))
    np.testing.assert_array_equal(sequence.first.faces, FACES)
    np.testing.assert_array_equal(sequence.first.vertices, FRAMES[selection][0])
    np.testing.assert_array_equal(frames_of(sequence), FRAMES[selection])


def test_a_single_frame_has_no_offsets(opened):
    np.testing.assert_array_equal(frames_of(opened(anime(FRAMES[:1]))), FRAMES[:1])


NOT_FINITE = FRAMES.copy()
NOT_FINITE[0, 1] = np.nan

DAMAGES = {
    "empty": (b"", "0 bytes, an .anime file has at least 12"),
    "header cut": (anime()[:11], "11 bytes, an .anime file has at least 12"),
    "cut": (anime()[:-1], "announces 5 frames, 4 vertices, 2 triangles, which take 276 bytes"),
    "longer": (anime() + b"\0", "has 277; it is damaged"),
    "no frame": (anime(counts=(0, 4, 2)), "announces 0 frames, 4 vertices, 2 triangles"),
    "no vertex": (anime(counts=(5, 0, 2)), "announces 5 frames, 0 vertices"),
    "no face": (anime(faces=FACES[:0]), "announces 5 frames, 4 vertices, 0 triangles"),
    "negative": (anime(counts=(5, 4, -2)), "-2 triangles"),
    "huge": (anime(counts=(2**31 - 1,) * 3), "which take 553402321"),
    "counted from 1": (anime(faces=FACES + 1), "faces name vertices 1 to 4 of 4"),
    "other vertices": (anime(faces=FACES + 2), "face 0 names vertices 2, 3, 4 (counted from 0)"),
    "negative vertices": (anime(faces=FACES - 1), "face 0 names vertices -1, 0, 1"),
    "not finite": (anime(NOT_FINITE), "vertex 1 is (nan, nan, nan)"),
}


@pytest.mark.parametrize(("data", "says"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_no_sound_clip_is_refused(tmp_path, opened, data, says):
    with pytest.raises(FormatError) as caught:
        opened(data)
    assert str(caught.value).startswith(f"{tmp_path / 'clip.anime'}: ")
    assert says in str(caught.value)
