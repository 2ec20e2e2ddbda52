"""Clips in `.npz`: names and layouts that are in use, and what must not be loaded."""

import gc
import sys
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.errors import InputError
from cageik_cli.sequence import open_sequence
from cageik_cli.sequence.readers.arrays import FACE_NAMES, VERTEX_NAMES
from tests.clips import frames_of

FACES = np.array([[0, 1, 2], [0, 2, 3]])
FRAMES = np.arange(2 * 4 * 3, dtype=float).reshape(2, 4, 3) ** 2


@pytest.fixture
def opened(tmp_path):
    """Write arrays to a file and open it as a clip."""

    def through(**arrays):
        np.savez_compressed(tmp_path / "clip.npz", **arrays)
        return open_sequence([str(tmp_path / "clip.npz")])

    return through


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [*((name, "faces") for name in VERTEX_NAMES), *(("verts", name) for name in FACE_NAMES)],
)
def test_the_usual_names_are_found(opened, vertices, faces):
    sequence = opened(**{vertices: FRAMES, faces: FACES, "fps": 24})
    assert sequence.names == ("clip.npz[0]", "clip.npz[1]")
    np.testing.assert_array_equal(sequence.first.faces, FACES)
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)


@pytest.mark.parametrize("kind", ["f2", "f4", "f8", ">f8"])
def test_positions_are_kept_to_the_bit(opened, kind):
    frames = FRAMES.astype(kind)
    found = frames_of(opened(verts=frames, faces=FACES.astype("u2")))
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, frames.astype(float))


@given(st.integers(1, 6), st.integers(4, 6))
def test_both_layouts_give_the_same_frames_or_are_refused(tmp_path_factory, count, vertices):
    """Of (3, 3, ...) shapes only those are refused in which either axis could be the vertices."""
    frames = np.random.default_rng(count).normal(size=(count, vertices, 3))
    path = tmp_path_factory.mktemp("layouts") / "clip.npz"
    for stored in (frames, frames.transpose(1, 2, 0)):
        np.savez(path, verts=stored, faces=FACES)
        np.testing.assert_array_equal(frames_of(open_sequence([str(path)])), frames)


def test_either_layout_possible_is_refused(opened):
    with pytest.raises(InputError, match="could be either"):
        opened(verts=np.zeros((4, 3, 3)), faces=np.array([[0, 1, 2]]))


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"verts": FRAMES}, "holds none of the arrays faces, tris"),
        ({"faces": FACES}, "holds none of the arrays vertices, verts"),
        ({"verts": FRAMES, "v": FRAMES, "f": FACES}, "holds verts, v of the arrays"),
        ({"verts": FRAMES, "f": FACES, "tris": FACES}, "holds tris, f of the arrays"),
        ({"verts": FRAMES.astype(int), "faces": FACES}, "`verts` is int64 of shape (2, 4, 3)"),
        ({"verts": FRAMES[:0], "faces": FACES}, "`verts` is float64 of shape (0, 4, 3)"),
        ({"verts": FRAMES, "faces": FACES.astype(float)}, "`faces` is float64"),
        ({"verts": FRAMES, "faces": FACES.ravel()}, "faces have shape (6,)"),
        ({"verts": FRAMES, "faces": np.zeros((2, 4), int)}, "faces have shape (2, 4)"),
        ({"verts": FRAMES[0], "faces": FACES}, "shape (4, 3) is neither"),
        ({"verts": FRAMES[:, :, :2], "faces": FACES}, "shape (2, 4, 2) is neither"),
        ({"verts": FRAMES, "faces": FACES + 1}, "faces counted from 1 must have 1 taken off"),
        ({"verts": FRAMES, "faces": FACES - 1}, "face 0 names vertices -1, 0, 1"),
        ({"verts": FRAMES * np.nan, "faces": FACES}, "vertex 0 is (nan, nan, nan)"),
        ({"poses": FRAMES, "betas": FRAMES, "trans": FRAMES}, "holds body parameters (AMASS)"),
        ({"verts": np.array([None]), "faces": FACES}, "is not a sound .npz of plain arrays"),
    ],
)
def test_other_arrays_are_refused_with_what_was_found(opened, tmp_path, arrays, says):
    with pytest.raises(InputError) as caught:
        opened(**arrays)
    assert str(caught.value).startswith(f"{tmp_path / 'clip.npz'}: ")
    assert says in str(caught.value)


def test_a_later_frame_that_is_not_finite_is_named(opened):
    frames = FRAMES.copy()
    frames[1, 2, 0] = np.inf
    with pytest.raises(InputError, match=r"clip\.npz\[1\]: vertex 2 is"):
        frames_of(opened(verts=frames, faces=FACES))


def _with(data: bytes, old: bytes, new: bytes) -> bytes:
    assert old in data
    return data.replace(old, new)


def _foreign(path, **members):
    with zipfile.ZipFile(path, "w") as file:
        for name, text in members.items():
            file.writestr(name, text)
    return path.read_bytes()


def _array_file(path):
    np.save(path.with_suffix(".npy"), FRAMES)
    return path.with_suffix(".npy").read_bytes()


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda data, path: b"", id="empty"),
        pytest.param(lambda data, path: b"no archive", id="text"),
        pytest.param(lambda data, path: data[:-30], id="cut short"),
        pytest.param(lambda data, path: data[: len(data) // 2], id="half"),
        pytest.param(lambda data, path: b"\x80\x04N.", id="pickle"),
        pytest.param(lambda data, path: _with(data, b"(2, 4, 3)", b"(9, 9, 9)"), id="claim"),
        pytest.param(lambda data, path: _with(data, b"{'descr'", b"({descr'"), id="header"),
        pytest.param(lambda data, path: _array_file(path), id="npy"),
        pytest.param(lambda data, path: _foreign(path, vertices="a", faces="b"), id="text"),
        pytest.param(
            lambda data, path: _with(data, b"PK\1\2\x2d\3\x2d\0\0\0", b"PK\1\2\x2d\3\x2d\0\1\0"),
            id="encrypted",
        ),
    ],
)
def test_a_damaged_or_foreign_file_is_refused_and_closed(tmp_path, monkeypatch, damage):
    left = []
    monkeypatch.setattr(sys, "unraisablehook", left.append)
    path = tmp_path / "clip.npz"
    np.savez(path, verts=FRAMES, faces=FACES)
    path.write_bytes(damage(path.read_bytes(), path))
    with pytest.raises(InputError) as caught:
        open_sequence([str(path)])
    assert str(caught.value).startswith(f"{path}: ")
    del caught
    gc.collect()
    assert not left
