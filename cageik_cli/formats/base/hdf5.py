"""HDF5 files from strangers: opened and looked into with every claim checked before it is used."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli.util.errors import FileAccessError, FormatError, OutputError, error_context

MAX_COMPRESSION_RATIO = 1100
"""Most that HDF5's filters compress; a dataset that claims more than it can hold is damaged."""

HDF5_SUFFIXES = (".h5", ".hdf5")
_KIND_NAMES = {"f": "floating-point numbers", "iu": "integers", "O": "text"}


def check_hdf5_suffix(path: Path) -> None:
    """Refuse to write HDF5 to a file whose name says that it is something else.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    if path.suffix.lower() not in HDF5_SUFFIXES:
        raise OutputError(
            f"{path}: is to be an HDF5 file, expected a name that ends in "
            f"{' or '.join(HDF5_SUFFIXES)} "
            "(cageik export writes cages in other formats)"
        )


def open_file(path: Path) -> h5py.File:
    """Open a file for reading, to be closed by the caller."""
    if not path.is_file():
        raise FileAccessError("is a folder, expected a file" if path.is_dir() else "no such file")
    if not h5py.is_hdf5(path):
        raise FormatError("is not an HDF5 file; name one, or write it again")
    return h5py.File(path, "r")


@contextmanager
def open_checked(path: Path) -> Iterator[h5py.File]:
    """Open a file for reading; whatever fails inside is an InputError that names it."""
    with wrap_hdf5_errors(path), open_file(path) as file:
        yield file


@contextmanager
def wrap_hdf5_errors(path: Path) -> Iterator[None]:
    """Make of whatever HDF5 raises inside an InputError that names the file."""
    with error_context(path):
        try:
            yield
        except (OSError, RuntimeError, KeyError, TypeError, ValueError, MemoryError) as error:
            raise FormatError(
                f"is not a sound HDF5 file ({error}); it may be cut short, write it again"
            ) from error


def get_dataset(
    file: h5py.File, name: str, kinds: str, shape: tuple[int | None, ...]
) -> h5py.Dataset:
    """A dataset of the expected type and shape.

    Parameters
    ----------
    file : h5py.File
    name : str
        Path within the file.
    kinds : str
        Numpy's kind letters that are taken: "f", "iu", or "O" for text.
    shape : tuple
        Expected lengths; None takes any above zero.

    Raises
    ------
    InputError
        When it is missing, leads out of the file, or is of another type, shape or size.
    """
    parent = ""
    for part in name.split("/"):
        parent = f"{parent}/{part}"
        if not isinstance(file.get(parent, getlink=True), h5py.HardLink):
            raise FormatError(f"has no dataset `{name}`")
    found = file[name]
    if not isinstance(found, h5py.Dataset) or found.is_virtual or found.external:
        raise FormatError(f"`{name}` is not a dataset held in this file")
    if found.dtype.kind not in kinds:
        raise FormatError(f"`{name}` holds {found.dtype} values, expected {_KIND_NAMES[kinds]}")
    fits = found.shape is not None and len(found.shape) == len(shape)
    if not fits or any(
        n == 0 or e not in (None, n) for n, e in zip(found.shape, shape, strict=True)
    ):
        wanted = " x ".join("any" if length is None else str(length) for length in shape)
        raise FormatError(f"`{name}` has shape {found.shape}, expected {wanted}")
    if found.nbytes > MAX_COMPRESSION_RATIO * max(found.id.get_storage_size(), 1):
        raise FormatError(f"`{name}` claims {found.nbytes} bytes and holds next to none of them")
    return found


def read_array(file: h5py.File, name: str, kinds: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """All of a small dataset, checked as by `get_dataset`."""
    return np.asarray(get_dataset(file, name, kinds, shape)[()])


def list_numeric_shapes(file: h5py.File, kinds: str) -> dict[str, tuple[int, ...]]:
    """Shapes of the datasets of numbers of these kinds that lie at the top of a file, by name."""
    held = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
    found = {name: file[name] for name in held if file.get(name, getclass=True) is h5py.Dataset}
    return {
        name: each.shape
        for name, each in found.items()
        if each.dtype.kind in kinds and each.shape is not None
    }


def scalar_attributes(file: h5py.File, names: tuple[str, ...]) -> dict[str, Any]:
    """The attributes of these names that are one value each."""
    held = [name for name in names if name in file.attrs]
    return {name: file.attrs[name] for name in held if file.attrs.get_id(name).shape == ()}
