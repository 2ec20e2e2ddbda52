"""Frames at their places in a file, read in runs by threads that go forward."""

import io
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.base import readers
from cageik_cli.formats.base.readers import (
    BinaryFile,
    ChunkedFrames,
    StoredFrames,
    check_file_size,
)
from cageik_cli.util.errors import FileAccessError, FormatError

VALUES = np.arange(24, dtype=">f8")


def open_stored(file, order):
    return StoredFrames(file, 4, VALUES.dtype, frame_count=2, vertex_count=4, axis_order=order)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "numbers.bin"
    path.write_bytes(b"head" + VALUES.tobytes())
    return path


@pytest.mark.parametrize("order", ["fvx", "vxf", "fxv", "xvf"])
@pytest.mark.parametrize("whole", [True, False])
def test_every_order_of_axes(path, monkeypatch, order, whole):
    if not whole:
        monkeypatch.setattr(readers, "MAX_CHUNK_BYTES", 1)
    sizes = {"f": 2, "v": 4, "x": 3}
    array = VALUES.reshape([sizes[axis] for axis in order])
    expected = np.einsum(f"{order}->fvx", array)
    stored = open_stored(BinaryFile.open(path), order)
    assert (stored.frame_count, stored.vertex_count) == (2, 4)
    for k in (1, 0):
        np.testing.assert_array_equal(stored.read_frame(k), expected[k])


def test_a_file_that_shrinks_is_refused(path):
    file = BinaryFile.open(path)
    with path.open("r+b") as stream:
        stream.truncate(100)
    with pytest.raises(FileAccessError, match="shorter"):
        file.read_array(4, VALUES.dtype, VALUES.shape)


def test_more_than_memory_holds_is_refused(path):
    with pytest.raises(FileAccessError, match="36028797018963968 bytes"):
        BinaryFile.open(path).read_array(4, VALUES.dtype, (1 << 52,))


def test_what_cannot_be_opened_or_read_is_refused(tmp_path):
    with pytest.raises(FileAccessError, match="folder"):
        BinaryFile.open(tmp_path)
    with pytest.raises(FileAccessError, match="no such file"):
        BinaryFile.open(tmp_path / "none")

    class Torn(io.BytesIO):
        def readinto(self, buffer):
            raise OSError(5, "Input/output error")

    with pytest.raises(FileAccessError, match="Input/output error"):
        BinaryFile(Torn(bytes(100))).read_array(0, VALUES.dtype, (2,))


def test_the_file_is_closed_with_its_last_user(path):
    stream = path.open("rb")
    frames = open_stored(BinaryFile(stream), "vxf")
    assert not stream.closed
    del frames
    assert stream.closed


def test_counts_and_size_are_compared(path):
    file = BinaryFile.open(path)
    check_file_size(file, 196, {"frames": 1})
    with pytest.raises(FormatError, match="0 frames, 2 faces"):
        check_file_size(file, 196, {"frames": 0, "faces": 2})
    with pytest.raises(FormatError, match=r"195 bytes.* 196; it is damaged"):
        check_file_size(file, 195, {"frames": 1})
    with pytest.raises(FormatError, match=r"197 bytes.* 196; it is cut short"):
        check_file_size(file, 197, {"frames": 1})


class Counted(ChunkedFrames):
    """Frames that are their own number, of one vertex of 3 bytes."""

    def __init__(self, count, layer):
        self.reads = []
        super().__init__(count, 1, layer, 1)

    def read_chunk(self, start, stop):
        self.reads.append((start, stop))
        return np.arange(start, stop)


@given(st.integers(1, 40), st.integers(1, 50))
def test_each_frame_is_given_and_each_run_read_once(count, size):
    frames = Counted(count, size)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(frames.read_frame, range(count))) == list(range(count))
    assert len(frames.reads) <= 3 * -(-count // size)
    assert {k for run in frames.reads for k in range(*run)} == set(range(count))
    assert max(stop - start for start, stop in frames.reads) <= size


def test_both_sides_of_a_border_are_kept():
    frames = Counted(20, 5)
    for k in (4, 5, 4, 6, 3, 9, 0):
        assert frames.read_frame(k) == k
    assert frames.reads == [(0, 5), (5, 10)]
    frames.read_frame(10)
    frames.read_frame(0)
    assert frames.reads == [(0, 5), (5, 10), (10, 15), (0, 5)]


@pytest.mark.parametrize(("layer", "bound", "size"), [(7, 1000, 7), (70, 30, 10), (70, 1, 1)])
def test_a_run_has_a_layer_and_no_more_bytes_than_the_bound(monkeypatch, layer, bound, size):
    monkeypatch.setattr(readers, "MAX_CHUNK_BYTES", bound)
    frames = Counted(70, layer)
    frames.read_frame(0)
    assert frames.reads == [(0, size)]
