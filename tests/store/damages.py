"""Damage to the attributes and datasets of an HDF5 file or a group, and its refusal."""

import h5py
import pytest

from cageik_cli.util.errors import InputError


def attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def without_attribute(name):
    return lambda file: file.attrs.__delitem__(name)


def replaced(name, *values, **how):
    """Another dataset in place of one; none if there are no values."""

    def change(file):
        del file[name]
        if values:
            file.create_dataset(name, data=values[0], **how)

    return change


def rewritten(name, function):
    """A dataset of what a function makes of the values."""
    return lambda file: replaced(name, function(file[name][:]))(file)


def value(name, place, number):
    return lambda file: file[name].__setitem__(place, number)


def assert_refused(path, damage, says, read, kind=InputError):
    """An error that names the file, and says what is wrong."""
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(kind) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert says in str(caught.value)
