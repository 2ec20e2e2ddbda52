"""Numpy's files are looked into without being loaded, and no claim of theirs is believed."""

import io
import os
import struct
import tempfile
import tracemalloc
import zipfile
from collections import namedtuple

import numpy as np
import pytest

from cageik_cli.formats import npz
from cageik_cli.formats.base import files
from cageik_cli.formats.npz import NpzArchive, open_npy
from cageik_cli.util.errors import FileAccessError, FormatError

VALUES = np.random.default_rng(0).normal(size=(6, 5, 3))


def npy(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def zipped(path, data, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("verts.npy", data)
    return path


def claiming(path, size, compressed=None):
    """The archive with other sizes of its member in its directory."""
    data = bytearray(path.read_bytes())
    entry = data.index(b"PK\1\2")
    struct.pack_into("<I", data, entry + 24, size)
    if compressed is not None:
        struct.pack_into("<I", data, entry + 20, compressed)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize(
    "array", [VALUES, np.asfortranarray(VALUES), VALUES[:, :, 0].astype(">i2")]
)
def test_arrays_are_what_numpy_saved(tmp_path, save, array):
    save(tmp_path / "a.npz", other=[1, 2], verts=array)
    archive = NpzArchive(tmp_path / "a.npz")
    assert archive.names == {"other", "verts"}
    np.testing.assert_array_equal(archive.open_array("verts").read(), array)
    np.save(tmp_path / "a.npy", array)
    np.testing.assert_array_equal(open_npy(tmp_path / "a.npy").read(), array)


def test_a_lone_value_is_given_and_nothing_else(tmp_path):
    np.savez(tmp_path / "a.npz", one=2.5, text="Z", many=[1, 2], void=np.array(None))
    archive = NpzArchive(tmp_path / "a.npz")
    assert (archive.read_scalar("one"), str(archive.read_scalar("text"))) == (2.5, "Z")
    assert [archive.read_scalar(name) for name in ("many", "void", "absent")] == [None] * 3
    empty = npy(np.array("Z"))[:-4].replace(b"<U1", b"<U0")
    assert NpzArchive(zipped(tmp_path / "a.npz", empty)).read_scalar("verts") is None


def test_what_is_unpacked_has_no_name_and_does_not_stay(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    np.savez_compressed(tmp_path / "a.npz", verts=VALUES)
    array = NpzArchive(tmp_path / "a.npz").open_array("verts")
    np.testing.assert_array_equal(array.read(), VALUES)
    assert os.listdir(tmp_path / "temporary") == []


def test_an_array_is_unpacked_in_blocks(tmp_path, monkeypatch):
    """2 MiB of it, in 32."""
    monkeypatch.setattr(npz, "_COPY_BYTES", 1 << 16)
    values = np.random.default_rng(0).integers(0, 256, 1 << 18).astype(float)
    np.savez_compressed(tmp_path / "a.npz", verts=values)
    tracemalloc.start()
    assert NpzArchive(tmp_path / "a.npz").open_array("verts").file.size > 1 << 21
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1 << 20


def _sparse(path):
    """An array of 24 TB by its header, in a file that is long enough but for a byte."""
    with path.open("wb") as stream:
        np.lib.format.write_array_header_2_0(
            stream, {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6, 3)}
        )
        stream.truncate(stream.tell() + (1 << 40))
    return path


def test_a_huge_claim_is_refused_without_room_for_it(tmp_path):
    tracemalloc.start()
    with pytest.raises(FormatError, match=r"24000000000128 bytes.* 1099511627904"):
        open_npy(_sparse(tmp_path / "a.npy"))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1 << 20


UNSOUND = {
    "text": b"no array",
    "empty": b"",
    "pickle": b"\x80\x04N.",
    "header cut": npy(VALUES)[:60],
    "call": npy(VALUES).replace(b"(6, 5, 3)", b"exit(  )."),
    "long": b"\x93NUMPY\1\0" + struct.pack("<H", 11000) + b" " * 11000,
    "kind": npy(VALUES).replace(b"<f8", b"<q8"),
}
HEADERS = {name: (data, "is not a sound .npy of plain numbers") for name, data in UNSOUND.items()}
HEADERS |= {
    "cut": (npy(VALUES)[:-1], "takes 848 bytes, but has 847"),
    "longer": (npy(VALUES) + b"\0", "takes 848 bytes, but has 849"),
    "negative": (npy(VALUES).replace(b"(6, 5, 3)", b"(-6,-5,3)"), "shape (-6, -5, 3)"),
    "version": (npy(VALUES).replace(b"Y\1\0", b"Y\3\0"), "is a .npy of version (3, 0), expected"),
    "python 2": (npy(VALUES).replace(b"(6, 5, 3)", b"(9L,9, 9)"), "takes 5960 bytes"),
}


@pytest.mark.parametrize(("data", "says"), HEADERS.values(), ids=HEADERS)
@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_header_that_cannot_be_is_refused(tmp_path, data, says, method):
    path = tmp_path / "a"
    path.write_bytes(data)
    with pytest.raises(FormatError) as lone:
        open_npy(path)
    assert (says if data else "the file is empty") in str(lone.value)
    with pytest.raises(FormatError) as member:
        NpzArchive(zipped(path, data, method)).open_array("verts")
    assert says.replace(".npy of plain numbers", "member of a .npz") in str(member.value)
    assert str(member.value).startswith("`verts`: ")
    assert "\n" not in str(lone.value) + str(member.value)


def test_a_claim_beyond_the_limit_is_refused(tmp_path):
    path = claiming(zipped(tmp_path / "a.npz", npy(VALUES)), 2**32 - 2)
    with pytest.raises(FormatError, match="4294967294 bytes, packed in"):
        NpzArchive(path).open_array("verts")


def test_a_bomb_is_refused_and_what_just_fits_is_not(tmp_path, monkeypatch):
    path = zipped(tmp_path / "a.npz", npy(np.zeros(1 << 17)))  # and a header of 128 bytes
    monkeypatch.setattr(files, "MIN_UNPACKED_LIMIT", (1 << 20) + 128)
    assert NpzArchive(path).open_array("verts").shape == (1 << 17,)
    monkeypatch.setattr(files, "MIN_UNPACKED_LIMIT", (1 << 20) + 127)
    with pytest.raises(FormatError, match="`verts`: takes at least 1048704 bytes, packed in"):
        NpzArchive(path).open_array("verts")


def test_whole_numbers_count_as_wide_as_they_are_computed_with(tmp_path, monkeypatch):
    path = zipped(tmp_path / "a.npz", npy(np.zeros(1 << 17, np.int8)))
    monkeypatch.setattr(files, "MIN_UNPACKED_LIMIT", 1 << 20)
    assert NpzArchive(path).open_array("verts").shape == (1 << 17,)
    monkeypatch.setattr(files, "MIN_UNPACKED_LIMIT", (1 << 20) - 1)
    with pytest.raises(FormatError, match="`verts`: takes at least 1048576 bytes, packed in"):
        NpzArchive(path).open_array("verts")


@pytest.mark.parametrize(
    ("size", "says"), [(800, "is not a sound member"), (849, "ends after 848 of 849 bytes")]
)
def test_a_member_of_another_length_is_refused(tmp_path, size, says):
    with pytest.raises(FormatError, match=says):
        NpzArchive(claiming(zipped(tmp_path / "a.npz", npy(VALUES)), size)).open_array("verts")


def test_no_room_on_the_disk_is_said_before_it_is_written(tmp_path, monkeypatch):
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(npz.shutil, "disk_usage", lambda folder: usage(847))
    path = zipped(tmp_path / "a.npz", npy(VALUES))
    with pytest.raises(FileAccessError, match=r"848 bytes unpacked.* 847 free"):
        NpzArchive(path).open_array("verts")
    monkeypatch.setattr(npz.shutil, "disk_usage", lambda folder: usage(848))
    np.testing.assert_array_equal(NpzArchive(path).open_array("verts").read(), VALUES)


def test_a_disk_that_fills_all_the_same_is_no_fault_of_the_file(tmp_path, monkeypatch):
    class Full(io.BytesIO):
        def write(self, data):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(npz.tempfile, "TemporaryFile", Full)
    path = zipped(tmp_path / "a.npz", npy(VALUES))
    with pytest.raises(
        FileAccessError, match=r"`verts`: cannot be unpacked into .* \(\[Errno 28\] No"
    ):
        NpzArchive(path).open_array("verts")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_another_compression_is_refused(tmp_path, method):
    path = zipped(tmp_path / "a.npz", npy(VALUES), method)
    with pytest.raises(FormatError, match=f"is compressed by method {method}, expected deflate"):
        NpzArchive(path).open_array("verts")


def test_an_encrypted_member_is_refused(tmp_path):
    path = zipped(tmp_path / "a.npz", npy(VALUES), zipfile.ZIP_STORED)
    data = bytearray(path.read_bytes())
    data[data.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(data)
    with pytest.raises(FormatError, match="`verts`: is encrypted"):
        NpzArchive(path).open_array("verts")


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data.replace(b"PK\3\4", b"PK\3\5"),
        lambda data: (
            data[: (place := data.index(b"PK\1\2") + 24)] + b"\xff\xff\xff\x7f" + data[place + 4 :]
        ),
    ],
)
def test_a_stored_member_that_is_not_where_the_archive_says_is_refused(tmp_path, damage):
    path = zipped(tmp_path / "a.npz", npy(VALUES), zipfile.ZIP_STORED)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(FormatError, match="is not at byte 0, as the archive says"):
        NpzArchive(path).open_array("verts")
