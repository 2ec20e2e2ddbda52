"""Built cages in the cache: what is found is what was built, for this model and these settings."""

from dataclasses import replace

import numpy as np

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.store import cache as cache_module
from cageik_cli.store.cache import (
    CAGES,
    WEIGHTS,
    EntryCache,
    compute_cage_key,
    compute_rig_key,
    find_cage,
)
from tests.fitted import small_binding
from tests.shapes import ball, box
from tests.store.entries import entry as weights_entry
from tests.store.entries import same

BUILT = {
    "vertices": box().vertices / 3,
    "faces": box().faces,
    "description": "built, of ä shell",
    "notes": ("a note", "another"),
}
SETTINGS = BuildSettings()
KEY = "1" * 64


def never():
    raise AssertionError("it is in the cache")


def test_a_cage_is_built_once(kept, said):
    assert find_cage(kept, ball(1), SETTINGS, lambda: BUILT) is BUILT
    assert said == []
    assert same(find_cage(kept, ball(1), SETTINGS, never), BUILT)
    (remark,) = said
    assert remark.startswith("cache hit, saved ")
    assert [path.suffix for path in kept.folder.iterdir()] == [".cage"]


def test_a_damaged_cage_is_built_again(kept, said):
    find_cage(kept, ball(1), SETTINGS, lambda: BUILT)
    (path,) = kept.folder.iterdir()
    path.write_bytes(path.read_bytes()[:-1] + b"\1")
    assert same(find_cage(kept, ball(1), SETTINGS, lambda: BUILT), BUILT)
    assert said == [f"{path}: is damaged; it is deleted and the cage is computed"]
    assert same(find_cage(kept, ball(1), SETTINGS, never), BUILT)


def test_weights_are_no_cage(kept, said):
    kept.write(WEIGHTS, KEY, weights_entry(), 1.5)
    (kept.folder / f"{KEY}.weights").rename(kept.folder / f"{KEY}.cage")
    assert kept.read(CAGES, KEY) is None
    assert "is damaged" in said[0]


def test_cages_and_weights_share_the_room(cache, said):
    EntryCache(cache, said.append).write(WEIGHTS, KEY, weights_entry(), 1.5)
    room = (cache / f"{KEY}.weights").stat().st_size
    cages = EntryCache(cache, said.append, max_bytes=max(room, 1500))
    find_cage(cages, ball(1), SETTINGS, lambda: BUILT)
    assert [path.suffix for path in cache.iterdir()] == [".cage"]


def test_the_key_covers_the_model_the_settings_and_the_builder(monkeypatch):
    model = ball(1)
    moved = TriMesh(model.vertices + 1e-9, model.faces)
    turned = TriMesh(model.vertices, np.roll(model.faces, 1, axis=0))
    keys = {compute_cage_key(mesh, SETTINGS) for mesh in (model, moved, turned, ball(2))}
    keys |= {compute_cage_key(model, replace(SETTINGS, vertices=99))}
    keys |= {compute_cage_key(model, replace(SETTINGS, clearance=0.003))}
    for name in ("BUILDER_VERSION", "__version__"):
        monkeypatch.setattr(cache_module, name, 99)
        keys.add(compute_cage_key(model, SETTINGS))
    assert len(keys) == 8
    monkeypatch.undo()
    assert compute_cage_key(ball(1), BuildSettings()) in keys


def test_the_key_of_a_rig_covers_the_binding_the_settings_and_the_frames(monkeypatch):
    binding, words = small_binding(), {"influences": 4}
    rest, cage = binding.rest, binding.cage
    moved = TriMesh(rest.vertices + 1e-9, rest.faces)
    turned = TriMesh(rest.vertices, np.roll(rest.faces, 1, axis=0))
    others = (
        binding,
        replace(binding, weights=binding.weights + 1e-9),
        replace(binding, rest=moved),
        replace(binding, rest=turned),
        replace(binding, cage=TriMesh(cage.vertices + 1e-9, cage.faces)),
        replace(binding, has_offsets=True),
    )
    keys = {compute_rig_key(one, words, "1") for one in others}
    keys |= {compute_rig_key(binding, {"influences": 3}, "1"), compute_rig_key(binding, words, "2")}
    for name in ("FIT_VERSION", "__version__"):
        monkeypatch.setattr(cache_module, name, 99)
        keys.add(compute_rig_key(binding, words, "1"))
    assert len(keys) == 10
    monkeypatch.undo()
    assert compute_rig_key(small_binding(), dict(words), "1") in keys
