"""Strangers' HDF5 files: every claim is checked, and every refusal names the file."""

import errno
import os
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.formats.base.hdf5 import check_hdf5_suffix, get_dataset, open_checked, read_array
from cageik_cli.util.errors import FileAccessError, FormatError, InputError
from tests.refusals import refused

VALUES = np.arange(12.0).reshape(4, 3)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "some.h5"
    with h5py.File(path, "w") as file:
        file["values"] = file["group/values"] = VALUES
        file["group/count"] = np.array([1, 2, 3])
        file["text"] = ["a", "b"]
        file["none"] = np.zeros((0, 3))
        file["scalar"] = 3.0
        file["soft"] = h5py.SoftLink("/values")
        file["soft_group"] = h5py.SoftLink("/group")
        file["out"] = h5py.ExternalLink("other.h5", "/values")
        file.create_dataset("claim", (10**5, 10**5), "f8", chunks=(100, 100))
        file.create_dataset("zeros", data=np.zeros((300, 300)), compression="gzip")
    return path


@pytest.mark.parametrize(
    ("name", "kinds", "shape"),
    [
        ("values", "f", (4, 3)),
        ("values", "iuf", (None, 3)),
        ("group/values", "f", (None, None)),
        ("group/count", "iu", (3,)),
        ("text", "O", (2,)),
        ("scalar", "f", ()),
        ("zeros", "f", (None, None)),
    ],
)
def test_what_is_as_expected_is_given(path, name, kinds, shape):
    with open_checked(path) as file, h5py.File(path) as plain:
        assert get_dataset(file, name, kinds, shape).name == f"/{name}"
        np.testing.assert_array_equal(read_array(file, name, kinds, shape), plain[name][()])


@pytest.mark.parametrize(
    ("name", "kinds", "shape", "says"),
    [
        ("nothing", "f", (None, 3), "has no dataset `nothing`"),
        ("group/nothing", "f", (None, 3), "has no dataset `group/nothing`"),
        ("values/inside", "f", (None, 3), "has no dataset `values/inside`"),
        ("soft", "f", (None, 3), "has no dataset `soft`"),
        ("soft_group/values", "f", (None, 3), "has no dataset `soft_group/values`"),
        ("out", "f", (None, 3), "has no dataset `out`"),
        ("group", "f", (None, 3), "`group` is not a dataset"),
        ("values", "iu", (None, 3), "`values` holds float64 values, expected integers"),
        ("values", "f", (5, 3), "`values` has shape (4, 3), expected 5 x 3"),
        ("values", "f", (None,), "`values` has shape (4, 3), expected any"),
        ("scalar", "f", (None,), "`scalar` has shape (), expected any"),
        ("none", "f", (None, 3), "`none` has shape (0, 3), expected any x 3"),
        ("claim", "f", (None, None), "`claim`: takes at least 80000000000 bytes"),
    ],
)
def test_what_is_not_as_expected_is_refused(path, name, kinds, shape, says):
    with refused(FormatError, says, at=path), open_checked(path) as file:
        read_array(file, name, kinds, shape)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: path.unlink(), "no such file"),
        (lambda path: (path.unlink(), path.mkdir()), "is a folder"),
        (lambda path: path.write_bytes(b""), "the file is empty"),
        (lambda path: path.write_text("hello"), "is not an HDF5 file"),
        (lambda path: path.write_bytes(path.read_bytes()[:3000]), "is not a sound HDF5 file"),
    ],
)
def test_what_is_no_hdf5_file_is_refused(path, make, says):
    make(path)
    with refused(InputError, says, at=path), open_checked(path):
        pytest.fail("opened")


@pytest.mark.parametrize(
    ("name", "is_taken"),
    [
        ("cages.h5", True),
        ("CAGES.H5", True),
        ("cages.0001.hdf5", True),
        ("cages.npz", False),
        ("cages", False),
        ("cages.h5.partial", False),
    ],
)
def test_a_name_says_the_kind(name, is_taken):
    try:
        check_hdf5_suffix(Path(name))
    except InputError as error:
        said = str(error)
    else:
        said = ""
    refused = rf"{name}: the output is an HDF5 file, .* \.h5 or \.hdf5"
    assert re.match("$" if is_taken else refused, said)


@pytest.mark.parametrize("error", [OSError("x"), RuntimeError("x"), KeyError("x"), ValueError("x")])
def test_what_the_library_raises_inside_is_refused_too(path, error):
    with pytest.raises(FormatError, match="is not a sound HDF5 file"), open_checked(path):
        raise error


def test_a_signal_while_the_file_is_opened_does_no_harm(path, monkeypatch):
    left, open_it = [InterruptedError(errno.EINTR, "Interrupted system call")], h5py.File

    def interrupt(*words):
        if left:
            raise left.pop()
        return open_it(*words)

    monkeypatch.setattr(h5py, "File", interrupt)
    with open_checked(path) as file:
        assert "values" in file
    assert not left


@pytest.mark.parametrize("code", [errno.EIO, errno.EMFILE])
def test_an_error_of_the_system_is_not_taken_for_a_damaged_file(path, monkeypatch, code):
    def fail(*_):
        raise OSError(code, "unable to open file (a library said much more)")

    monkeypatch.setattr(h5py, "File", fail)
    with pytest.raises(FileAccessError) as caught, open_checked(path):
        pytest.fail("opened")
    assert str(caught.value) == f"{path}: cannot be read: {os.strerror(code)}"
