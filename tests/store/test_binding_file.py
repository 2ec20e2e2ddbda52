"""Binding files: the schema, the same bytes for the same binding, and no damage taken for sound."""

import json
from dataclasses import asdict, replace

import h5py
import numpy as np
import pytest

from cageik_cli import __version__
from cageik_cli.cages.bind import bind
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.store import binding_file as store
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.util.errors import InputError
from cageik_cli.util.messages import Note
from tests.shapes import TETRAHEDRON, ball, box
from tests.store.bindings import barycentric_binding
from tests.store.damages import assert_refused, attribute, replaced, value, without_attribute
from tests.texts import texts

SETTINGS = BindSettings(accuracy="fine", outside="project")
SOURCES = {"cage": {"name": "é.obj", "sha256": "0"}, "rest": {"name": "rest.obj", "sha256": "1"}}


BINDING = barycentric_binding(
    settings=SETTINGS, panels=944, estimated_error=7e-4, notes=(Note("a nöte"),)
)
STORED = StoredBinding(BINDING, SOURCES)


@pytest.fixture
def path(tmp_path):
    store.write_binding(tmp_path / "binding.h5", STORED, overwrite=False)
    return tmp_path / "binding.h5"


def test_the_schema(path):
    expected = {
        "rest/verts": ("f8", BINDING.rest.vertices),
        "rest/tris": ("i4", BINDING.rest.faces),
        "cage/verts": ("f8", BINDING.cage.vertices),
        "cage/partners": ("i4", [0, 2, 1, 3]),
        "tris": ("i4", BINDING.cage.faces),
        "weights": ("f8", BINDING.weights),
    }
    with h5py.File(path) as file:
        held = []
        file.visititems(lambda name, item: held.append(name) if hasattr(item, "shape") else None)
        assert sorted(held) == sorted(expected)
        for name, (kind, values) in expected.items():
            assert file[name].dtype == np.dtype(kind), name
            np.testing.assert_array_equal(file[name][:], values)
        assert file["weights"].compression == "gzip"
        attributes = dict(file.attrs)
    assert attributes.pop("format") == "cageik.binding"
    assert attributes.pop("schema") == 1
    assert not attributes.pop("has_offsets")
    assert attributes.pop("version") == __version__
    assert {name: json.loads(text) for name, text in attributes.items()} == {
        "settings": {"coordinates": "harmonic", "accuracy": "fine", "outside": "project"},
        "quality": asdict(BINDING.quality),
        "notes": [{"kind": "note", "place": "", "text": ["a nöte"]}],
        "sources": SOURCES,
    }


def test_what_is_written_is_read(path):
    stored = store.read_binding(path)
    found = stored.binding
    assert (stored.sources, stored.version) == (SOURCES, __version__)
    np.testing.assert_array_equal(found.weights, BINDING.weights)
    for read, mesh in ((found.rest, BINDING.rest), (found.cage, BINDING.cage)):
        np.testing.assert_array_equal(read.vertices, mesh.vertices)
        np.testing.assert_array_equal(read.faces, mesh.faces)
    assert (found.settings, texts(found.notes)) == (SETTINGS, ("a nöte",))
    assert found.quality == BINDING.quality
    assert store.is_binding(path)
    assert store.read_bind_settings(path) == SETTINGS


def test_the_same_binding_gives_the_same_bytes_under_any_name(tmp_path, path):
    store.write_binding(tmp_path / "another name.h5", STORED, overwrite=False)
    assert (tmp_path / "another name.h5").read_bytes() == path.read_bytes()


def test_a_binding_of_a_projected_model_is_accepted(tmp_path, coarse_panels):
    settings = BindSettings(outside="project")
    bound = bind(ball(1, 1.1), box(), settings)
    assert bound.quality.linear_precision > 0.01
    store.write_binding(tmp_path / "b.h5", StoredBinding(bound, SOURCES), overwrite=False)
    found = store.read_binding(tmp_path / "b.h5").binding
    assert found.quality == bound.quality
    assert found.projected > 0


def test_an_old_binding_stays_unless_it_may_be_replaced(path):
    before = path.read_bytes()
    other = replace(STORED, sources=SOURCES | {"more": {}})
    with pytest.raises(InputError, match=r"binding\.h5"):
        store.write_binding(path, other, overwrite=False)
    assert path.read_bytes() == before
    store.write_binding(path, other, overwrite=True)
    assert store.read_binding(path).sources["more"] == {}
    assert [item.name for item in path.parent.iterdir()] == ["binding.h5"]


def quality(**changes):
    return attribute("quality", json.dumps(asdict(BINDING.quality) | changes))


def settings(**changes):
    return attribute("settings", json.dumps(asdict(SETTINGS) | changes))


def with_weights(weights):
    """Other weights, and the figures that they have."""

    def change(file):
        file["weights"][:] = weights
        figures = asdict(replace(BINDING, weights=weights).quality)
        file.attrs["quality"] = json.dumps(figures)

    return change


WEIGHTS = BINDING.weights
DAMAGES = {
    "another format": (
        attribute("format", "cageik.result"),
        "is not a binding of cageik bind",
    ),
    "no format": (without_attribute("format"), "is not a binding of cageik bind"),
    "schema": (
        attribute("schema", 2), "schema 2, expected 1"
    ),
    **{
        f"{name} {change}": (damage, f"`{name}` is not a JSON {kind}")
        for name, kind in (
            ("settings", "dict"), ("quality", "dict"), ("sources", "dict"), ("notes", "list")
        )
        for change, damage in (
            ("missing", without_attribute(name)),
            ("cut", attribute(name, "{")),
            ("a number", attribute(name, "3")),
            ("nan", attribute(name, '{"a": NaN}')),
        )
    },
    **{
        f"no {name}": (replaced(name), f"`{name}`")
        for name in ("weights", "tris", "cage/verts", "rest/verts", "rest/tris")
    },
    "settings of another kind": (settings(more="x"), "`settings` holds more"),
    "settings that are no words": (settings(accuracy=3), "`settings`"),
    "unknown coordinates": (settings(coordinates="x"), "'x'"),
    "unknown accuracy": (settings(accuracy="best"), "'best'"),
    "more figures": (quality(more=1), "`quality` holds more"),
    "no figures": (attribute("quality", "{}"), "`quality` does not hold partition_of_unity"),
    "figures that are words": (quality(panels="many"), "`quality`"),
    "half a panel": (quality(panels=0.5), "`quality.panels` is 0.5"),
    "less than none": (quality(projected=-1), "`quality.projected` is -1"),
    "no source of the cage": (
        attribute("sources", '{"rest": {"name": "a"}}'), "`sources`"
    ),
    "weights cut": (replaced("weights", WEIGHTS[:17]), "`weights` has shape (17, 4)"),
    "weights turned": (replaced("weights", WEIGHTS.T), "`weights` has shape (4, 18)"),
    "weights whole": (replaced("weights", np.eye(18, 4, dtype=int)), "`weights` holds int64"),
    "a weight nan": (value("weights", (7, 2), np.nan), "too large, at vertex 7"),
    "a weight inf": (value("weights", (7, 2), np.inf), "too large, at vertex 7"),
    "a weight other": (
        value("weights", (7, 2), WEIGHTS[7, 2] + 1e-9),
        "partition_of_unity is 1e-09",
    ),
    "two rows for each other": (
        with_weights(WEIGHTS[[2, 1, 0, *range(3, 18)]]), "linear_precision"
    ),
    "rows that do not sum to one": (
        with_weights(2 * WEIGHTS),
        "partition_of_unity of `weights` is 1, expected at most 1e-06",
    ),
    "a moved rest pose": (
        value("rest/verts", 5, [0.2, 0.2, 0.2]), "linear_precision"
    ),
    "another smallest": (quality(min_weight=0.0), "min_weight"),
    "a rest vertex nan": (value("rest/verts", (2, 1), np.nan), "vertex 2"),
    "a rest face": (value("rest/tris", (0, 0), 18), "face 0"),
    "a cage face": (value("tris", (0, 0), -1), "face 0"),
    "a point": (value("rest/verts", ..., 0.0), "`rest/verts` are all one point"),
    "a cage vertex in no face": (
        value("tris", ..., np.tile([0, 1, 2], (4, 1))), "cage vertex 3 is in no face"
    ),
    "an open cage": (replaced("tris", TETRAHEDRON.faces[1:]), "open"),
    "an inward cage": (
        replaced("tris", TETRAHEDRON.faces[:, ::-1]), "inward"
    ),
}  # fmt: skip


@pytest.mark.parametrize(("damage", "says"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_binding_is_refused_by_name(path, damage, says):
    assert_refused(path, damage, says, store.read_binding)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_binding_cut_short_is_refused(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match="HDF5" if share else "the file is empty"):
        store.read_binding(path)


@pytest.mark.parametrize(("name", "says"), [("nowhere.h5", "no such file"), ("", "is a folder")])
def test_missing_files_and_folders_are_refused(tmp_path, name, says):
    for read in (store.read_binding, store.read_bind_settings, store.is_binding):
        with pytest.raises(InputError, match=says):
            read(tmp_path / name)
