"""Content of files packed by gzip: sound, damaged, and bombs."""

import gzip
import hashlib

import numpy as np
import pytest

from cageik_cli.formats.base.files import decompress
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.util.errors import FileAccessError, FormatError
from tests.clips import frames_of
from tests.formats.polygons import MESH_KINDS, encode_polygons


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
