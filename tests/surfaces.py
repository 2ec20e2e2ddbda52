"""Surfaces as our reader of OBJ has them, for tests."""

from dataclasses import fields, is_dataclass, replace

import numpy as np

from cageik_cli.formats.obj.frames import Reader
from cageik_cli.formats.obj.text import parse_obj
from cageik_cli.geometry.attributes import Subdivision
from tests.assets import asset_text


def read_obj(text):
    """The mesh of an OBJ text, with all that its faces and corners have."""
    return Reader.read_attributes(text.encode(), parse_obj(text.encode())).make_mesh()


def change(mesh, **parts):
    """The mesh with other attributes."""
    return replace(mesh, attributes=replace(mesh.attributes, **parts))


def assert_same(found, expected):
    """Records that are the same to the last bit, field by field."""
    if is_dataclass(expected):
        for field in fields(expected):
            assert_same(getattr(found, field.name), getattr(expected, field.name))
    elif isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    else:
        assert found == expected


ASSET = read_obj(asset_text())
CREASES = Subdivision(
    "catmullClark", np.array([0, 1, 2, 5, 6]), np.array([3, 2]), np.array([1.5, 2]), np.array([7]),
    np.array([10.0]),
)  # fmt: skip
"""What subdivides the asset with creases and a corner."""
