"""Built cages in the cache: what is found is what was built, for this model and these settings."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.store import cage_cache
from cageik_cli.store.cage_cache import CageCache, CageEntry, compute_cage_key
from cageik_cli.store.weight_cache import WeightCache
from tests.shapes import ball, box
from tests.store.entries import entry as weights_entry

BUILT = CageEntry(box().vertices / 3, box().faces, "built, of ä shell", ("a note", "another"))
SETTINGS = BuildSettings()
KEY = "1" * 64


@pytest.fixture
def said():
    """What the cache remarked."""
    return []


@pytest.fixture
def kept(cache, said):
    return CageCache(cache, said.append)


def same(found):
    np.testing.assert_array_equal(found.vertices, BUILT.vertices)
    np.testing.assert_array_equal(found.faces, BUILT.faces)
    return (found.description, found.notes) == (BUILT.description, BUILT.notes)


def never():
    raise AssertionError("it is in the cache")


def test_a_cage_is_built_once(kept, said):
    assert kept.get_or_build(ball(1), SETTINGS, lambda: BUILT) is BUILT
    assert said == []
    assert same(kept.get_or_build(ball(1), SETTINGS, never))
    (remark,) = said
    assert remark.startswith("cache hit, saved ")
    assert [path.suffix for path in kept.folder.iterdir()] == [".cage"]


def test_a_damaged_cage_is_built_again(kept, said):
    kept.get_or_build(ball(1), SETTINGS, lambda: BUILT)
    (path,) = kept.folder.iterdir()
    path.write_bytes(path.read_bytes()[:-1] + b"\1")
    assert same(kept.get_or_build(ball(1), SETTINGS, lambda: BUILT))
    assert said == [f"{path}: is damaged; it is deleted and the cage is computed"]
    assert same(kept.get_or_build(ball(1), SETTINGS, never))


def test_weights_are_no_cage(kept, said):
    weights = WeightCache(kept.folder, said.append)
    weights.write(KEY, weights_entry())
    (kept.folder / f"{KEY}.weights").rename(kept.folder / f"{KEY}.cage")
    assert kept.read(KEY) is None
    assert "is damaged" in said[0]


def test_cages_and_weights_share_the_room(cache, said):
    weights = WeightCache(cache, said.append)
    weights.write(KEY, weights_entry())
    room = (cache / f"{KEY}.weights").stat().st_size
    cages = CageCache(cache, said.append, max_bytes=max(room, 1500))
    cages.write("2" * 64, BUILT)
    assert [path.suffix for path in cache.iterdir()] == [".cage"]


def test_a_folder_that_cannot_be_written_is_noted(tmp_path, said):
    (tmp_path / "file").touch()
    kept = CageCache(tmp_path / "file", said.append)
    assert kept.get_or_build(ball(1), SETTINGS, lambda: BUILT) is BUILT
    assert said[0].endswith("; the cage is not kept")


def test_the_key_covers_the_model_the_settings_and_the_builder(monkeypatch):
    model = ball(1)
    moved = TriMesh(model.vertices + 1e-9, model.faces)
    turned = TriMesh(model.vertices, np.roll(model.faces, 1, axis=0))
    keys = {compute_cage_key(mesh, SETTINGS) for mesh in (model, moved, turned, ball(2))}
    keys |= {compute_cage_key(model, replace(SETTINGS, vertices=99))}
    keys |= {compute_cage_key(model, replace(SETTINGS, clearance=0.003))}
    for name in ("BUILDER_VERSION", "__version__"):
        monkeypatch.setattr(cage_cache, name, 99)
        keys.add(compute_cage_key(model, SETTINGS))
    assert len(keys) == 8
    monkeypatch.undo()
    assert compute_cage_key(ball(1), BuildSettings()) in keys
