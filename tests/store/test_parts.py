"""Parts of a model in results and bindings: kept whole, and no damage taken for sound."""

import h5py
import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.store.binding_file import StoredBinding, read_binding, write_binding
from cageik_cli.store.result import read_result
from tests.character import NAMES, make_cage, make_character
from tests.store.damages import assert_refused, replaced, rewritten, value
from tests.surfaces import assert_same

GROUP = "attributes/rest/parts"
MODEL = make_character()[0]
TEXT = h5py.string_dtype()


@pytest.fixture(scope="module")
def whole():
    binding = bind(MODEL, make_cage(), BindSettings("mean-value"))
    return StoredBinding(binding, {"cage": {"name": "c.obj"}, "rest": {"name": "r.usd"}})


@pytest.fixture
def path(tmp_path, whole):
    write_binding(tmp_path / "b.h5", whole, overwrite=False)
    return tmp_path / "b.h5"


def test_parts_are_read_as_they_were_written(path):
    assert_same(read_binding(path).binding.rest.attributes, MODEL.attributes)


def renamed(*names):
    return replaced("name", np.array(names, object), dtype=TEXT)


def lazy(name, shape, kind):
    """A dataset of many numbers that takes no room in the file."""

    def change(group):
        del group[name]
        group.create_dataset(name, shape, kind, chunks=True, compression="gzip")

    return change


DAMAGES = {
    "no names": (replaced("name"), "name"),
    "fewer names": (renamed(*NAMES[:3]), "parts"),
    "a name twice": (renamed(*NAMES[:3], NAMES[0]), "there twice"),
    "an empty name": (renamed(*NAMES[:3], ""), "0 characters"),
    "a name of two lines": (renamed(*NAMES[:3], "a\nb"), "one line"),
    "a name as long as a book": (renamed(*NAMES[:3], "x" * 100_000), "characters"),
    "numbers for names": (replaced("name", np.arange(4)), "name"),
    "no counts": (replaced("vertex_counts"), "vertex_counts"),
    "too few vertices": (value("vertex_counts", 0, 207), "parts"),
    "too many vertices": (value("vertex_counts", 3, 57), "parts"),
    "a part without vertices": (value("vertex_counts", 1, 0), "vertex_counts"),
    "a negative count": (value("vertex_counts", 1, -112), "vertex_counts"),
    "1e9 vertices": (value("vertex_counts", 1, 10**9), "parts"),
    "counts that overflow": (replaced("vertex_counts", np.full(4, 2**62)), "parts"),
    "1e9 polygons": (value("polygon_counts", 1, 10**9), "parts"),
    "polygons of another part": (
        rewritten("polygon_counts", lambda v: v + np.array([1, -1, 0, 0])),
        "part",
    ),
    "fractions for counts": (rewritten("vertex_counts", lambda v: v + 0.5), "vertex_counts"),
    "1e9 counts": (lazy("vertex_counts", (10**9,), "i8"), "vertex_counts"),
    "1e9 names": (lazy("name", (10**9,), TEXT), "name"),
    "1e9 transforms": (lazy("transforms", (10**9, 4, 4), "f8"), "transforms"),
    "no transforms": (replaced("transforms"), "transforms"),
    "transforms of three rows": (rewritten("transforms", lambda v: v[:, :3]), "transforms"),
    "a transform that is nan": (value("transforms", (1, 0, 0), np.nan), "finite"),
    "an infinite transform": (value("transforms", (1, 3, 0), np.inf), "finite"),
    "a transform that flattens": (value("transforms", (1, 0, 0), 0.0), "inverted"),
    "a transform with perspective": (value("transforms", (1, 0, 3), 1.0), "inverted"),
    "transforms as text": (replaced("transforms", "text"), "transforms"),
}


@pytest.mark.parametrize(("damage", "says"), DAMAGES.values(), ids=DAMAGES)
def test_damaged_parts_are_refused(path, damage, says):
    assert_refused(path, lambda file: damage(file[GROUP]), says, read_binding)


def test_a_result_refuses_them_too(character_result, tmp_path):
    path = tmp_path / "hero.h5"
    path.write_bytes(character_result.path.read_bytes())
    damage = value("vertex_counts", 1, 10**9)
    assert_refused(path, lambda file: damage(file[GROUP]), "parts", read_result)
