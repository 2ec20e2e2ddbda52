"""HDF5 files from any source: what they announce is checked before it is used."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.files import check_unpacked_array
from cageik_cli.util.errors import FileAccessError, FormatError, OutputError, error_context
from cageik_cli.util.files import check_input, repeat_if_interrupted

MAX_ATTRIBUTE_VALUES = 16
"""Numbers in an attribute, such as a position or a matrix."""

MAX_TEXT_BYTES = 1 << 28
"""Bytes of texts that are read together; many texts may be one and the same in the file."""

HDF5_SUFFIXES = (".h5", ".hdf5")


def check_hdf5_suffix(
    path: Path, remedy: str = "cageik export writes cages in other formats"
) -> None:
    """Refuse to write HDF5 to a file with the suffix of another format.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    if path.suffix.lower() not in HDF5_SUFFIXES:
        raise OutputError(
            f"{path}: the output is an HDF5 file, expected a name that ends in "
            f"{' or '.join(HDF5_SUFFIXES)}; {remedy}"
        )


def open_file(path: Path) -> h5py.File:
    """Open a file for reading, to be closed by the caller."""
    if not path.exists():
        raise FileAccessError("no such file; check the path")
    check_input(path)
    try:
        return repeat_if_interrupted(lambda: h5py.File(path, "r"))
    except OSError as error:
        if error.errno is None and not h5py.is_hdf5(path):
            raise FormatError("is not an HDF5 file; give one, or write it again") from error
        raise


@contextmanager
def open_checked(path: Path) -> Iterator[h5py.File]:
    """Open a file for reading; errors inside name it."""
    with wrap_hdf5_errors(path), open_file(path) as file:
        yield file


@contextmanager
def wrap_hdf5_errors(path: Path) -> Iterator[None]:
    """Turn what HDF5 raises inside into an InputError that names the file."""
    with error_context(path):
        try:
            yield
        except OSError as error:
            if error.errno is not None:
                raise FileAccessError(f"cannot be read: {os.strerror(error.errno)}") from error
            raise _make_damaged_error(error) from error
        except (RuntimeError, KeyError, TypeError, ValueError, MemoryError) as error:
            raise _make_damaged_error(error) from error


def _make_damaged_error(error: Exception) -> FormatError:
    return FormatError(f"is not a sound HDF5 file ({error}); it may be cut short, write it again")


def is_inside(file: h5py.File, name: str) -> bool:
    """Return whether there is something of this name, and it is in this file and no other."""
    parent = ""
    for part in name.split("/"):
        parent = f"{parent}/{part}"
        if not isinstance(file.get(parent, getlink=True), h5py.HardLink):
            return False
    return True


def get_dataset(
    file: h5py.File, name: str, kinds: str, shape: tuple[int | None, ...]
) -> h5py.Dataset:
    """Return a dataset of the expected type and shape.

    Parameters
    ----------
    name : str
        Path within the file.
    kinds : str
        Numpy's kind letters that are accepted: "f", "iu", or "O" for text.
    shape : tuple
        Expected lengths; None is any above zero.

    Raises
    ------
    InputError
        When it is missing, is in another file, or has another type, shape or size.
    """
    if not is_inside(file, name):
        raise FormatError(f"has no dataset `{name}`")
    found = file[name]
    if not isinstance(found, h5py.Dataset) or found.is_virtual or found.external:
        raise FormatError(f"`{name}` is not a dataset in this file")
    if found.dtype.kind not in kinds:
        nouns = {"f": "floating-point numbers", "iu": "integers", "O": "text"}
        raise FormatError(f"`{name}` holds {found.dtype} values, expected {nouns[kinds]}")
    fits = found.shape is not None and len(found.shape) == len(shape)
    if not fits or any(
        n == 0 or e not in (None, n) for n, e in zip(found.shape, shape, strict=True)
    ):
        wanted = " x ".join("any" if length is None else str(length) for length in shape)
        raise FormatError(f"`{name}` has shape {found.shape}, expected {wanted}")
    with error_context(f"`{name}`"):
        check_unpacked_array(found.shape, found.dtype, found.id.get_storage_size())
    return found


def read_array(file: h5py.File, name: str, kinds: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """Read a whole dataset, checked as by `get_dataset`."""
    return np.asarray(get_dataset(file, name, kinds, shape)[()])


def read_texts(file: h5py.File, name: str, count: int) -> tuple[str, ...]:
    """Read a dataset of `count` texts.

    Raises
    ------
    InputError
        When it is not that, or the texts take more bytes than the file has.
    """
    found = get_dataset(file, name, "O", (count,))
    if h5py.check_string_dtype(found.dtype) is None:
        raise FormatError(f"`{name}` does not hold text; write it again")
    size = file.id.get_filesize()
    step, left, texts = max(1, MAX_TEXT_BYTES // size), size, []
    for start in range(0, count, step):
        part = found[start : start + step]
        left -= sum(map(len, part))
        if left < 0:
            raise FormatError(f"`{name}` holds more text than the file has; write it again")
        texts += [text.decode(errors="replace") for text in part]
    return tuple(texts)


def read_attribute(holder: Any, name: str, default: Any = None) -> Any:
    """Read an attribute of a file or a dataset: one text, or a few numbers.

    Raises
    ------
    FormatError
        When it is something else. Each of many texts may be one and the same in the file, which
        would fill the memory.
    """
    if name not in holder.attrs:
        return default
    if not _is_plain_attribute(holder, name):
        raise FormatError(f"attribute `{name}` is not one text or a few numbers; write it again")
    return holder.attrs[name]


def has_text_attribute(holder: Any, name: str, text: str) -> bool:
    """Return whether an attribute is this text; it may hold anything."""
    if name not in holder.attrs or not _is_plain_attribute(holder, name):
        return False
    value = holder.attrs[name]
    return isinstance(value, str) and value == text


def _is_plain_attribute(holder: Any, name: str) -> bool:
    """Return whether an attribute is one text, or at most `MAX_ATTRIBUTE_VALUES` numbers."""
    found = holder.attrs.get_id(name)
    if found.shape is None:
        return False
    if h5py.check_string_dtype(found.dtype) is not None:
        return bool(found.shape == ())
    return found.dtype.kind in "fiub" and prod(found.shape) <= MAX_ATTRIBUTE_VALUES


def scalar_attributes(file: h5py.File, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the attributes of these names that are single values."""
    held = [name for name in names if name in file.attrs and _is_plain_attribute(file, name)]
    return {name: file.attrs[name] for name in held if file.attrs.get_id(name).shape == ()}
