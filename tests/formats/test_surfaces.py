"""Surfaces in every format: what is written is read as it was, but for what is not kept."""

from dataclasses import fields, replace

import numpy as np
import pytest

from cageik_cli.formats.alembic import PARAMETERS
from cageik_cli.formats.base.hdf5 import DATASETS
from cageik_cli.formats.gltf.document import ACCESSORS
from cageik_cli.formats.obj.frames import KEYWORDS
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.ply import COLUMNS
from cageik_cli.formats.usd.reader import PRIMVARS
from cageik_cli.geometry.attributes import (
    LABEL_NAMES,
    LAYERS,
    FaceLabels,
    Subdivision,
    SurfaceAttributes,
    UvMap,
    number_normal_fans,
)
from cageik_cli.geometry.parts import list_part_names
from tests.formats.clips import faults_of, written
from tests.surfaces import ASSET, CREASES, assert_same, change

SMOOTH = number_normal_fans(*[ASSET.attributes.corners] * 2)
COLOURS = np.rint(np.linspace(0, 255, 120)).reshape(30, 4) / 255
NO_LABELS = {"groups": None, "objects": None, "smoothing": None, "material_library": ""}
LOST = {
    "a.usda": {"objects": None, "smoothing": None},
    "a.usdc": {"objects": None, "smoothing": None},
    "a.usdz": {"objects": None, "smoothing": None},
    "a.abc": {**NO_LABELS, "colours": None, "subdivision": Subdivision()},
    "a/a_#.ply": {**NO_LABELS, "materials": None, "subdivision": Subdivision()},
    "a/a_#.obj": {"subdivision": Subdivision()},
}
"""What is not kept, by the name of an output."""

PART_NAMES = {".usd": ("/hero/tube",), ".abc": ("/tube",), ".obj": ("tube",), ".ply": ()}
"""Where the one object of the asset is."""

PARTS = {
    "whole": {},
    "creases": {"subdivision": CREASES, "normal_fans": None},
    "bilinear": {"subdivision": Subdivision("bilinear"), "normal_fans": None},
    "colours": {"colours": COLOURS[:, :3]},
    "opacity": {"colours": COLOURS},
    "smooth": {"normal_fans": SMOOTH},
    "normals alone": {"uvs": None, "materials": None},
    "some UVs": {"uvs": UvMap(np.eye(2), np.arange(110) % 3 - 1)},
    "some names": {"materials": FaceLabels(("a", "b"), np.arange(27) % 3 - 1)},
    "one material": {"materials": FaceLabels(("a b",), np.zeros(27, int))},
    "names alike": {"materials": FaceLabels(("a b", "a_b", "a-b"), np.arange(27) % 4 - 1)},
    "names of the mesh": {"groups": FaceLabels(("hero", "cloth"), np.arange(27) % 2)},
    "polygons": {"uvs": None, "materials": None, "normal_fans": None},
}


TABLES = (ACCESSORS, PRIMVARS, PARAMETERS, COLUMNS, KEYWORDS, DATASETS)


@pytest.mark.parametrize("places", TABLES, ids=["glTF", "USD", "Alembic", "PLY", "OBJ", "HDF5"])
def test_formats_keep_layers_that_there_are(places):
    names = {field.name for field in fields(SurfaceAttributes)}
    assert set(LAYERS) <= names
    assert set(places) - {"material_colours"} <= set(LAYERS)
    assert places is not DATASETS or set(LAYERS) <= set(places)  # a result loses nothing


def list_texts(labels):
    """The name of each face, empty for none, as OBJ says by the word `default`."""
    names = labels and [labels.names[k] if k >= 0 else "" for k in labels.indices]
    return names and ["" if name == "default" else name for name in names]


def assert_alike(found, expected):
    """The same but for the order of names and UVs, in single precision."""
    for name in LABEL_NAMES:
        assert list_texts(getattr(found, name)) == list_texts(getattr(expected, name))
    for name in ("uvs", "colours"):
        assert (getattr(found, name) is None) == (getattr(expected, name) is None)
    if expected.uvs is not None:
        corners = (
            np.vstack([each.uvs.values, [np.nan] * 2])[each.uvs.indices]
            for each in (found, expected)
        )
        np.testing.assert_allclose(*corners, atol=1e-7)
        assert len(found.uvs.values) == len(expected.uvs.values)
    if expected.colours is not None:
        np.testing.assert_allclose(found.colours, expected.colours, atol=1e-7)
    compared = dict.fromkeys(("uvs", "colours", "parts", *LABEL_NAMES))
    assert_same(replace(found, **compared), replace(expected, **compared))


@pytest.mark.parametrize("name", LOST)
@pytest.mark.parametrize("part", PARTS)
def test_what_is_written_is_read(tmp_path, name, part):
    if part == "some UVs" and name in ("a.abc", "a/a_#.ply"):
        pytest.skip("all corners of a face have UVs there, or none")
    mesh = change(ASSET, **PARTS[part])
    path = written(tmp_path / name, mesh.vertices[None], mesh)
    read = open_sequence([str(path if path.is_file() else path.parent)]).first
    np.testing.assert_allclose(read.vertices, mesh.vertices, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    expected = replace(mesh.attributes, **LOST[name])
    if name.endswith(".ply") and expected.normal_fans is not None:
        expected = replace(expected, normal_fans=SMOOTH)  # they are of vertices
    assert_alike(read.attributes, expected)
    assert list_part_names(read) == PART_NAMES[path.suffix[:4]]
    if name.startswith("a.usd"):
        assert faults_of(path) == []
