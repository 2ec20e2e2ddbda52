"""Frames at their places in a file, read in runs by threads that go forward."""

import gzip
import hashlib
import io
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.base import readers
from cageik_cli.formats.base.files import decompress
from cageik_cli.formats.base.readers import BinaryFile, ChunkedFrames, StoredFrames, check_file_size
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.util.errors import FileAccessError, FormatError
from tests.clips import frames_of
from tests.formats.polygons import MESH_KINDS, encode_polygons

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


@pytest.fixture
def packed(folder):
    """The folder `frames`, with every frame packed."""
    for path in (folder / "frames").iterdir():
        path.with_name(f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes(), mtime=0))
        path.unlink()
    return folder / "frames"


def test_packed_frames_are_the_frames(packed, animation):
    sequence = open_sequence(["frames"])
    assert sequence.names == tuple(f"frame_{k}.obj.gz" for k in range(1, 6))
    np.testing.assert_array_equal(frames_of(sequence), animation.frames)
    data = (packed / "frame_2.obj.gz").read_bytes()
    assert sequence.digest(1) == hashlib.sha256(data).digest()


def test_a_missing_packed_frame_is_named(packed):
    (packed / "frame_3.obj.gz").unlink()
    with pytest.raises(FileAccessError, match=r"frame_3\.obj\.gz: missing between"):
        open_sequence(["frames"])


@pytest.mark.parametrize("kind", MESH_KINDS)
def test_a_packed_mesh_is_the_mesh(tmp_path, kind):
    text = encode_polygons(kind, [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    path = tmp_path / f"mesh.{kind}.gz"
    path.write_bytes(gzip.compress(text[:40]) + gzip.compress(text[40:]))
    loaded = load_mesh(path)
    np.testing.assert_array_equal(loaded.mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(loaded.mesh.faces, [[0, 1, 2]])
    assert loaded.source["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


SOUND = gzip.compress(b"v 0 0 0\n" * 100, mtime=0)


@pytest.mark.parametrize(
    "data",
    [
        SOUND[:-9],
        SOUND[:5],
        b"v 0 0 0\n",
        SOUND[:-8] + bytes(8),
        SOUND[:12] + b"\xff\xff" + SOUND[14:],
        SOUND + b"more",
    ],
)
def test_a_damaged_packed_file_is_refused(tmp_path, data):
    path = tmp_path / "mesh.obj.gz"
    path.write_bytes(data)
    with pytest.raises(FormatError) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"{path}: cannot be unpacked (")


def test_an_empty_packed_file_is_an_empty_mesh(tmp_path):
    path = tmp_path / "mesh.obj.gz"
    path.touch()
    with pytest.raises(FormatError, match="empty"):
        load_mesh(path)


def test_a_bomb_is_refused_and_what_just_fits_is_not(monkeypatch):
    monkeypatch.setattr("cageik_cli.formats.base.files.MIN_UNPACKED_LIMIT", 1000)
    assert len(decompress(gzip.compress(b" " * 1000), ".obj.gz")) == 1000
    bomb = gzip.compress(b" " * 10**6)
    with pytest.raises(FormatError, match=f"packed in {len(bomb)}, .* {40 * len(bomb)};"):
        decompress(bomb, ".obj.gz")
