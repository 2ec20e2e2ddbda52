"""Vertex weights: a number a vertex, from text or a numpy array."""

import hashlib
import os

import numpy as np
import pytest

from cageik_cli.formats.npz import open_frame_weights, read_vertex_weights
from cageik_cli.util.errors import FileAccessError, FormatError, InputError
from tests.refusals import refused

WEIGHTS = [1.0, 0.0, 0.1, 1e-300, 2.5]


@pytest.mark.parametrize("text", ["1\n0\n.1\n1e-300\n2.5\n", "1 0 0.1\r\n1E-300\t2.5"])
def test_text(tmp_path, text):
    path = tmp_path / "weights.txt"
    path.write_bytes(text.encode())
    weights, source = read_vertex_weights(path)
    assert weights.dtype == np.float64
    np.testing.assert_array_equal(weights, WEIGHTS)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert source == {"name": "weights.txt", "sha256": digest}


@pytest.mark.parametrize("kind", ["f8", "f4", "i4", "u1", "?"])
def test_numpy_arrays(tmp_path, kind):
    weights = np.array([1, 0, 1, 1]).astype(kind)
    np.save(tmp_path / "weights.npy", weights)
    found, _ = read_vertex_weights(tmp_path / "weights.npy")
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, weights)


def _saved(path, array, **options):
    np.save(path, array, **options)


def _zip(path):
    np.savez(path.with_suffix(".npz"), a=np.ones(3))
    path.with_suffix(".npz").rename(path)


def _edit(path, change):
    _saved(path, np.ones(99))
    path.write_bytes(change(path.read_bytes()))


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("words.txt", lambda path: path.write_text("1 two 3")),
        ("binary.txt", lambda path: path.write_bytes(b"\xff\xfe\0")),
        ("text.npy", lambda path: path.write_text("1 2 3")),
        ("words.npy", lambda path: _saved(path, np.array(["a", "b"]))),
        ("complex.npy", lambda path: _saved(path, np.array([1 + 1j]))),
        ("objects.npy", lambda path: _saved(path, np.array([{}]), allow_pickle=True)),
        ("archive.npy", _zip),
        ("header.npy", lambda path: _edit(path, lambda data: data.replace(b"{'des", b"({des"))),
        ("short.npy", lambda path: _edit(path, lambda data: data[:200])),
    ],
)
def test_what_is_no_list_of_numbers_is_refused(tmp_path, name, make):
    make(tmp_path / name)
    with refused(FormatError, "is not a list of numbers", at=tmp_path / name):
        read_vertex_weights(tmp_path / name)


@pytest.mark.parametrize("name", ["empty.npy", "empty.txt"])
def test_an_empty_file_is_no_list_of_numbers(tmp_path, name):
    (tmp_path / name).touch()
    with refused(FormatError, "the file is empty", at=tmp_path / name):
        read_vertex_weights(tmp_path / name)


@pytest.mark.parametrize(("name", "says"), [("none.txt", "no such file"), (".", "is a folder")])
def test_what_is_no_file_is_refused(tmp_path, name, says):
    with refused(FileAccessError, says, at=tmp_path / name):
        read_vertex_weights(tmp_path / name)


ROWS = np.array([[1, 0, 0.5], [0.25, 2, 1]])


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["<f4", ">f8", "i4"])
def test_rows_of_frames_are_read_in_parts(tmp_path, order, kind):
    path, rows = tmp_path / "weights.npy", np.asarray(4 * ROWS, kind, order=order)
    np.save(path, rows)
    weights = open_frame_weights(path, 2, 3)
    assert (weights.largest, weights.mean_share) == (8, ROWS.sum() / 5 / 2)
    np.testing.assert_array_equal(weights.read(0, 2), ROWS / 2)
    np.testing.assert_array_equal(weights.read(1, 9), ROWS[1:] / 2)


def test_the_mean_of_the_largest_weights_is_finite(tmp_path):
    path = tmp_path / "weights.npy"
    np.save(path, ROWS / 2 * 1.7e308)
    weights = open_frame_weights(path, 2, 3)
    assert weights.mean_share == pytest.approx(ROWS.sum() / 5 / 2)
    np.testing.assert_allclose(weights.read(0, 2), ROWS / 2)


def test_rows_that_are_cut_off_while_they_are_used_are_refused(tmp_path):
    """A mapped file that is cut off would end the process with SIGBUS."""
    path = tmp_path / "weights.npy"
    np.save(path, np.ones((48, 1570)))
    weights, data = open_frame_weights(path, 48, 1570), path.read_bytes()
    for size in (len(data) - 1, 4096, 60, 0):
        os.truncate(path, size)
        with refused(InputError, "", at=path):
            weights.read(40, 48)
    np.save(path, np.ones((47, 1570)))
    with refused(FileAccessError, "written again", at=path):
        weights.read(40, 48)


def test_a_shape_below_zero_is_no_array(tmp_path):
    path = tmp_path / "weights.npy"
    np.save(path, np.ones((48, 1570)))
    path.write_bytes(path.read_bytes().replace(b"(48, 1570)", b"(48,-1570)"))
    assert open_frame_weights(path, 48, 1570) is None
    with refused(FormatError, "is not a list of numbers", at=path):
        read_vertex_weights(path)


def test_numbers_that_are_too_large_become_infinite_without_a_warning(tmp_path):
    np.save(tmp_path / "weights.npy", np.full(3, np.finfo(np.longdouble).max))
    weights, _ = read_vertex_weights(tmp_path / "weights.npy")
    assert np.isinf(weights).all() or np.finfo(np.longdouble).max == np.finfo(float).max


@pytest.mark.parametrize("name", ["weights.txt", "weights.npy"])
@pytest.mark.parametrize("head", [b"", b"1 2\n", b"\x93NUMPY\x01\x00\x10\x00", b"\xff"])
def test_nothing_of_a_file_that_is_none_is_quoted(tmp_path, name, head):
    """It may be any file that a stranger's options name."""
    path = tmp_path / name
    path.write_bytes(head + b"root:x:0:0:secret ('secret')\n")
    with pytest.raises(FormatError) as caught:
        read_vertex_weights(path)
    assert "is not a list of numbers" in str(caught.value)
    assert "secret" not in str(caught.value)
    assert "root" not in str(caught.value).removeprefix(str(path))
