"""The cache of weights: what it gives is what would be computed, whatever happens to its folder."""

import errno
import hashlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.cages.bind import JudgedBinding, bind, judge_binding
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Binding
from cageik_cli.method.weights.settings import COORDINATES, BindSettings
from cageik_cli.store import cache as cache_module
from cageik_cli.store import cache as module
from cageik_cli.store.cache import WEIGHTS, EntryCache, compute_weight_key, find_binding
from cageik_cli.util import compiled
from cageik_cli.util.files import open_locked, remove_locked
from tests.shapes import TETRAHEDRON, ball, box
from tests.store.entries import entry, same
from tests.texts import texts

SETTINGS = BindSettings()
KEY, OTHER = "1" * 64, "2" * 64
ROOT = hasattr(os, "geteuid") and os.geteuid() == 0


def path_of(cache, key=KEY):
    return cache.folder / f"{key}.weights"


def names_in(cache):
    return sorted(path.name for path in cache.folder.iterdir())


def test_what_is_written_is_read(kept, said):
    assert kept.read(WEIGHTS, KEY) is None
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    assert same(kept.read(WEIGHTS, KEY), entry())
    assert kept.read(WEIGHTS, OTHER) is None
    assert said == []
    assert names_in(kept) == [f"{KEY}.weights"]


@pytest.mark.skipif(os.name != "posix", reason="permissions are others there")
def test_only_the_owner_may_read_entries(kept):
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    assert kept.folder.stat().st_mode & 0o777 == 0o700
    assert path_of(kept).stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("name", COORDINATES)
@pytest.mark.parametrize("shape", ["sound", "inward", "projected"])
def test_a_hit_gives_the_binding_that_was_computed(kept, said, coarse_panels, name, shape):
    cage = box().flip() if shape == "inward" else box()
    rest = ball(1, 1.1 if shape == "projected" else 0.9)
    settings = BindSettings(name, outside="project")

    def never():
        raise AssertionError("it is in the cache")

    given = rest, cage, settings
    judged = find_binding(kept, *given, lambda: judge_binding(bind(*given)))
    assert said == []
    held = find_binding(kept, *given, never)
    found, computed = held.binding, judged.binding
    (remark,) = said
    assert remark.startswith("cache hit, saved ")
    assert remark.endswith(" s")
    np.testing.assert_array_equal(found.weights, computed.weights)
    assert found.weights.flags.c_contiguous == computed.weights.flags.c_contiguous
    np.testing.assert_array_equal(found.cage.faces, computed.cage.faces)
    np.testing.assert_array_equal(found.cage.vertices, computed.cage.vertices)
    assert found.quality == computed.quality
    assert (texts(found.notes), found.settings) == (texts(computed.notes), settings)
    assert held.has_loose_cage is judged.has_loose_cage is not None
    assert held.cage_warnings == judged.cage_warnings
    assert len(texts(found.notes)) == (0 if shape == "sound" else 1)
    assert (found.projected > 0) == (shape == "projected")


def test_the_seconds_saved_are_those_of_the_computation(kept, said, monkeypatch):
    # Looked for, and again when nobody else computes it; computed; found.
    clock = iter([0.0, 5.0, 10.0, 12.5, 20.0, 20.5])
    monkeypatch.setattr(module.time, "perf_counter", lambda: next(clock))
    bound = JudgedBinding(Binding(TETRAHEDRON, TETRAHEDRON, np.eye(4)), (), None)
    for _ in range(2):
        find_binding(kept, TETRAHEDRON, TETRAHEDRON, SETTINGS, lambda: bound)
    assert said == ["cache hit, saved 2.0 s"]


def test_nothing_is_kept_when_binding_fails(kept):
    def refuse():
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        find_binding(kept, ball(1), box(), SETTINGS, refuse)
    assert list(kept.folder.iterdir()) == []


def test_one_process_at_a_time_computes_an_entry(kept, monkeypatch):
    """Who waits takes what the other has written."""
    bound = Binding(TETRAHEDRON, TETRAHEDRON, np.eye(4))
    given = (TETRAHEDRON, TETRAHEDRON, SETTINGS)
    path = kept.folder / f"{compute_weight_key(*given)}.lock.partial"
    kept.folder.mkdir(parents=True)
    other, waited = open_locked(path), []

    def wait(seconds):
        waited.append(seconds)
        if len(waited) == 2:
            kept.write(
                WEIGHTS,
                compute_weight_key(*given),
                entry() | {"faces": bound.cage.faces, "weights": bound.weights},
                1.0,
            )
            remove_locked(path, other)

    monkeypatch.setattr(module.time, "sleep", wait)

    def compute():
        raise AssertionError("computed")

    found = find_binding(kept, *given, compute).binding
    np.testing.assert_array_equal(found.weights, bound.weights)
    assert waited == [module.LOCK_POLL_SECONDS] * 2
    assert [path.suffix for path in kept.folder.iterdir()] == [".weights"]


def test_no_process_waits_in_a_folder_that_cannot_be_written(kept, monkeypatch):
    def full(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "open_locked", full)
    bound = JudgedBinding(Binding(TETRAHEDRON, TETRAHEDRON, np.eye(4)), (), None)
    assert find_binding(kept, TETRAHEDRON, TETRAHEDRON, SETTINGS, lambda: bound) is bound


def moved(mesh, vertex, by):
    vertices = mesh.vertices.copy()
    vertices[vertex, 1] += by
    return TriMesh(vertices, mesh.faces)


NEXT = np.spacing(ball(1).vertices[2, 1])
ZERO = np.where(ball(1).vertices == 0, -0.0, ball(1).vertices)
INGREDIENTS = {
    "a rest vertex by its last digit": (moved(ball(1), 2, NEXT), box(), SETTINGS),
    "a zero's sign": (TriMesh(ZERO, ball(1).faces), box(), SETTINGS),
    "the order of rest vertices": (
        TriMesh(ball(1).vertices[::-1], ball(1).faces), box(), SETTINGS
    ),
    "one rest vertex less": (TriMesh(ball(1).vertices[:-1], [[0, 1, 2]]), box(), SETTINGS),
    "a cage vertex": (ball(1), moved(box(), 0, 1e-9), SETTINGS),
    "a cage turned inward": (ball(1), box().flip(), SETTINGS),
    "cage faces that begin elsewhere": (
        ball(1), TriMesh(box().vertices, np.roll(box().faces, 1, axis=1)), SETTINGS
    ),
    "accuracy": (ball(1), box(), BindSettings(accuracy="fine")),
    "outside": (ball(1), box(), BindSettings(outside="project")),
    "a vertex of the one is one of the other": (
        TriMesh(ball(1).vertices[:-1], [[0, 1, 2]]),
        TriMesh(np.concatenate([ball(1).vertices[-1:], box().vertices]), box().faces),
        SETTINGS,
    ),
}  # fmt: skip


def test_the_key_covers_all_that_weights_depend_on(monkeypatch):
    keys = {name: compute_weight_key(*things) for name, things in INGREDIENTS.items()}
    keys |= {name: compute_weight_key(ball(1), box(), BindSettings(name)) for name in COORDINATES}
    keys["rest faces"] = compute_weight_key(TriMesh(ball(1).vertices, [[2, 1, 0]]), box(), SETTINGS)
    known = COORDINATES["harmonic"]
    monkeypatch.setitem(COORDINATES, "harmonic", replace(known, version=known.version + 1))
    keys["algorithm"] = compute_weight_key(ball(1), box(), SETTINGS)
    monkeypatch.undo()
    monkeypatch.setattr(cache_module, "__version__", "0.0.0")
    keys["version"] = compute_weight_key(ball(1), box(), SETTINGS)
    monkeypatch.undo()
    other = None if compiled.kernel else object()
    monkeypatch.setattr(compiled, "kernel", other)
    keys["the other core"] = compute_weight_key(ball(1), box(), SETTINGS)
    assert len(set(keys.values())) == len(keys)


def test_the_key_covers_nothing_else():
    """Not of how arrays lie in memory."""
    key = compute_weight_key(ball(1), box(), SETTINGS)
    columns = np.asfortranarray(ball(1).vertices)
    columns.flags.writeable = False
    strided = TriMesh(columns, ball(1).faces)
    assert not strided.vertices.flags.c_contiguous
    assert compute_weight_key(strided, box(), SETTINGS) == key


def damaged(kept, said, data):
    """Put `data` in place of an entry; whether that is noticed, deleted and then kept anew."""
    path_of(kept).write_bytes(data)
    noticed = kept.read(WEIGHTS, KEY) is None
    (remark,) = said
    assert remark.startswith(f"{path_of(kept)}: is ")
    assert remark.endswith("; it is deleted and the weights are computed")
    assert not path_of(kept).exists()
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    return noticed and same(kept.read(WEIGHTS, KEY), entry())


def whole(kept, key=KEY):
    kept.write(WEIGHTS, key, entry(), 1.5)
    return path_of(kept, key).read_bytes()


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda data: b"", id="empty"),
        pytest.param(lambda data: data[:10], id="a few bytes"),
        pytest.param(lambda data: data[:100], id="in the header"),
        pytest.param(lambda data: data[:-8], id="short by a number"),
        pytest.param(lambda data: data[:-1], id="short by a byte"),
        pytest.param(lambda data: data + b"\0", id="long by a byte"),
        pytest.param(lambda data: data[:-64] + bytes(64), id="never reached the disk"),
        pytest.param(lambda data: bytes(len(data)), id="zeros"),
        pytest.param(lambda data: b"\x89HDF\r\n\x1a\n" + data, id="another program's"),
        pytest.param(lambda data: data[:49] + b"\xff" * 8 + data[57:], id="claims a long header"),
    ],
)
def test_a_damaged_entry_is_not_used(kept, said, change):
    assert damaged(kept, said, change(whole(kept)))


def forge(data, change):
    """An entry with another header, whose digest is right."""
    start, size = WEIGHTS.file_start, WEIGHTS.file_start.size
    length = start.unpack(data[:size])[2]
    header = change(json.loads(data[size : size + length]))
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    packed = start.pack(WEIGHTS.magic, hashlib.sha256(text).digest(), len(text))
    return packed + text + data[size + length :]


FORGED = {
    "no JSON": lambda header: b"no JSON",
    "no text": lambda header: b"\xff\xfe",
    "nested": lambda header: b"[" * 100_000,
    "a list": lambda header: [header],
    "no key": lambda header: {k: v for k, v in header.items() if k != "key"},
    "a digest that is none": lambda header: header | {"digest": "xyz"},
    "a digest that is a number": lambda header: header | {"digest": 7},
    "a shape below zero": lambda header: header | {"weights": [-5, -8]},
    "a shape that is a text": lambda header: header | {"weights": "5, 8"},
    "a huge shape": lambda header: header | {"weights": [1 << 40, 1 << 20]},
    "the shape of another array": lambda header: header | {"faces": [1 << 36]},
    "seconds that are a text": lambda header: header | {"seconds": "long"},
    "panels that are a text": lambda header: header | {"panels": "many"},
    "notes that are a number": lambda header: header | {"notes": 3},
}


@pytest.mark.parametrize("change", FORGED.values(), ids=FORGED)
def test_a_wrong_header_with_a_right_digest_is_not_used(kept, said, change):
    assert damaged(kept, said, forge(whole(kept), change))


def test_a_wrong_shape_is_found_where_the_entry_is_used(kept, said):
    settings = BindSettings("mean-value")
    computed = judge_binding(bind(box(), box(2.0), settings))

    def find():
        return find_binding(kept, box(), box(2.0), settings, lambda: computed).binding

    find()
    (path,) = kept.folder.glob("*.weights")
    path.write_bytes(forge(path.read_bytes(), lambda header: header | {"weights": [4, 16]}))
    assert find().weights.shape == (8, 8)
    assert said == [f"{path}: is damaged; it is deleted and the weights are computed"]
    assert find().weights.shape == (8, 8)
    assert "cache hit" in said[-1]


def test_an_entry_under_another_name_is_not_used(kept, said):
    assert damaged(kept, said, whole(kept, OTHER))


@pytest.mark.parametrize("kind", ["folder", "link", "loose link", "pipe"])
def test_only_plain_files_are_used(kept, said, kind):
    data = whole(kept)
    path = path_of(kept)
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("no pipes here")
        os.mkfifo(path)
    else:
        target = kept.folder / "target"
        if kind == "link":
            target.write_bytes(data)
        path.symlink_to(target)
    assert kept.read(WEIGHTS, KEY) is None
    assert said == [f"{path}: is not a plain file; it is deleted and the weights are computed"]
    said.clear()
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    if kind == "folder":
        assert said == [
            f"{kept.folder}: cannot be written (Is a directory); the weights are not kept"
        ]
        assert kept.read(WEIGHTS, KEY) is None
    else:
        assert said == []
        assert same(kept.read(WEIGHTS, KEY), entry())
    if kind == "link":
        assert target.read_bytes() == data
    assert not list(kept.folder.glob("*.partial"))


def test_the_least_recently_used_entry_is_deleted(cache, said):
    keys = [f"{k:064x}" for k in range(5)]
    size = len(whole(EntryCache(cache, said.append)))
    path_of(EntryCache(cache, said.append)).unlink()
    kept = EntryCache(cache, said.append, max_bytes=3 * size + size // 2)
    for k, key in enumerate(keys[:3]):
        kept.write(WEIGHTS, key, entry(), 1.5)
        os.utime(path_of(kept, key), (k, k))
    assert kept.read(WEIGHTS, keys[0]) is not None
    kept.write(WEIGHTS, keys[3], entry(), 1.5)
    assert names_in(kept) == sorted(f"{keys[k]}.weights" for k in (0, 2, 3))
    kept.write(WEIGHTS, keys[4], entry(), 1.5)
    assert names_in(kept) == sorted(f"{keys[k]}.weights" for k in (0, 3, 4))
    assert said == []


def test_an_entry_larger_than_the_cache_is_not_kept(cache, said):
    EntryCache(cache, said.append).write(WEIGHTS, OTHER, entry(), 1.5)
    size = path_of(EntryCache(cache, said.append), OTHER).stat().st_size
    kept = EntryCache(cache, said.append, max_bytes=size)
    kept.write(WEIGHTS, KEY, entry(rows=6), 1.5)
    assert names_in(kept) == [f"{OTHER}.weights"]
    (remark,) = said
    assert f"at most {size})" in remark
    kept.write(WEIGHTS, KEY, entry(rows=5), 1.5)
    assert names_in(kept) == [f"{KEY}.weights"]


def test_other_files_in_the_folder_stay(cache, said):
    kept = EntryCache(cache, said.append, max_bytes=10_000)
    cache.mkdir()
    others = ["thesis.tex", "x.weights", f"{KEY}.weights.bak", f"{KEY}.partial", "cages.h5"]
    for name in others:
        (cache / name).write_bytes(bytes(20_000))
        os.utime(cache / name, (0, 0))
    (cache / f"{OTHER}.weights").mkdir()
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    assert names_in(kept) == sorted([*others, f"{KEY}.weights", f"{OTHER}.weights"])


def test_files_of_killed_processes_are_deleted_after_an_hour(kept):
    kept.folder.mkdir()
    old, new = (kept.folder / f"{OTHER}.{name}.partial" for name in ("ab_1", "cd_2"))
    for path, age in (
        (old, module.MAX_UNFINISHED_SECONDS + 60),
        (new, module.MAX_UNFINISHED_SECONDS - 60),
    ):
        path.write_bytes(b"half")
        os.utime(path, (time.time() - age,) * 2)
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    assert names_in(kept) == sorted([new.name, f"{KEY}.weights"])


@pytest.mark.parametrize("place", ["a file", "in a file", "/proc/cageik"])
def test_a_folder_that_cannot_be_created_is_noted_once(tmp_path, said, place):
    (tmp_path / "file").touch()
    folder = {"a file": tmp_path / "file", "in a file": tmp_path / "file" / "in"}.get(place)
    if folder is None and not Path("/proc/self").exists():
        pytest.skip("no such folder")
    kept = EntryCache(folder or Path(place), said.append)
    fast = BindSettings("mean-value")
    given = ball(1), box(), fast
    judged = find_binding(kept, *given, lambda: judge_binding(bind(*given)))
    assert judged.binding.weights.shape == (18, 8)
    (remark,) = said
    assert remark.startswith(f"{kept.folder}: cannot be written (")
    assert remark.endswith("); the weights are not kept")


@pytest.mark.skipif(ROOT or os.name != "posix", reason="root may write anywhere")
def test_a_read_only_folder_can_be_used(kept, said):
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    kept.folder.chmod(0o500)
    try:
        assert same(kept.read(WEIGHTS, KEY), entry())
        kept.write(WEIGHTS, OTHER, entry(), 1.5)
    finally:
        kept.folder.chmod(0o700)
    assert said == [
        f"{kept.folder}: cannot be written (Permission denied); the weights are not kept"
    ]
    assert names_in(kept) == [f"{KEY}.weights"]


def test_a_hit_whose_time_cannot_be_set_is_a_hit(kept, said, monkeypatch):
    def read_only(*_):
        raise OSError(errno.EROFS, "Read-only file system")

    kept.write(WEIGHTS, KEY, entry(), 1.5)
    monkeypatch.setattr(module.os, "utime", read_only)
    assert same(kept.read(WEIGHTS, KEY), entry())
    assert said == []


@pytest.mark.parametrize("call", ["create", "write", "replace"])
def test_a_full_disk_is_noted_and_leaves_nothing(kept, said, monkeypatch, call):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    class Full(io.FileIO):
        def writelines(self, lines):
            super().write(next(iter(lines)))
            full()

    kept.write(WEIGHTS, OTHER, entry(), 1.5)
    if call == "write":
        monkeypatch.setattr(module, "open", Full, raising=False)
    else:
        monkeypatch.setattr(module.os, "open" if call == "create" else call, full)
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    monkeypatch.undo()
    assert said == [
        f"{kept.folder}: cannot be written (No space left on device); the weights are not kept"
    ]
    assert names_in(kept) == [f"{OTHER}.weights"]


def test_an_interrupt_while_writing_leaves_nothing(kept, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(module.os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        kept.write(WEIGHTS, KEY, entry(), 1.5)
    assert names_in(kept) == []


def test_entries_may_vanish(kept, said, monkeypatch):
    """Between the look into the folder and the look at the file, and before the reading."""
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    listed = list(kept.folder.iterdir())
    monkeypatch.setattr(Path, "iterdir", lambda folder: [*listed, kept.folder / f"{OTHER}.weights"])
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    monkeypatch.undo()
    shutil.rmtree(kept.folder)
    assert kept.read(WEIGHTS, KEY) is None
    assert said == []
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    assert same(kept.read(WEIGHTS, KEY), entry())


WORKER = """
import sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from cageik_cli.store.cache import EntryCache
from cageik_cli.store.cache import WEIGHTS

folder, (seed, turns, largest) = Path(sys.argv[1]), map(int, sys.argv[2:])
remarks, hits = [], 0
cache = EntryCache(folder, remarks.append, largest)
generator = np.random.default_rng(seed)
faces = np.zeros((12, 3), np.int64)
values = {
    "panels": 0, "estimated_error": 0.0, "projected": 0,
    "notes": (), "cage_warnings": (), "has_loose_cage": None,
}
print("started", flush=True)
for _ in range(turns):
    k = int(generator.integers(3))
    if generator.random() < 0.5:
        weights = np.full((500, 8 * (k + 1)), float(k))
        entry = {name: values[name] for name in WEIGHTS.values}
        entry |= {"faces": faces, "weights": weights, "panels": k}
        cache.write(WEIGHTS, f"{k:064x}", entry, 1.0)
    else:
        found = cache.read(WEIGHTS, f"{k:064x}")
        if found is not None:
            assert found["panels"] == k and found["weights"].shape == (500, 8 * (k + 1))
            assert (found["weights"] == k).all()
            hits += 1
assert not remarks, remarks
print(hits)
"""


def workers(folder, count, turns, largest):
    return [
        subprocess.Popen(
            [sys.executable, "-c", WORKER, *map(str, (folder, seed, turns, largest))],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for seed in range(count)
    ]  # fmt: skip


@pytest.mark.skipif(os.name != "posix", reason="processes cannot be asked for here")
def test_what_a_killed_process_left_of_an_entry_is_removed_by_the_next(kept):
    script = (
        "import os, sys; from pathlib import Path; "
        "from cageik_cli.util.outputs import make_unfinished_path; "
        "make_unfinished_path(Path(sys.argv[1])).write_text('half'); os._exit(9)"
    )
    kept.folder.mkdir()
    subprocess.run([sys.executable, "-c", script, path_of(kept)], check=False)
    assert [name.endswith(".partial") for name in names_in(kept)] == [True]
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    assert names_in(kept) == [f"{KEY}.weights"]


@pytest.mark.parametrize("is_held", [False, True])
def test_the_lock_of_a_process_that_was_killed_behind_its_entry_is_removed(kept, is_held):
    given = ball(1), box(), SETTINGS
    binding = find_binding(kept, *given, lambda: judge_binding(bind(ball(1), box()))).binding
    path = kept.folder / f"{compute_weight_key(*given)}.lock.partial"
    path.touch()
    file = open_locked(path) if is_held else None
    found = find_binding(kept, *given, lambda: pytest.fail("computed again")).binding
    assert (found.weights == binding.weights).all()
    assert path.exists() == is_held
    if file is not None:
        remove_locked(path, file)


@pytest.mark.slow
def test_processes_do_not_harm_each_other(kept, said):
    """Eight write and read three entries at once, of which two fit at most."""
    hits = 0
    for process in workers(kept.folder, 8, 300, 100_000):
        out, err = process.communicate(timeout=120)
        assert (process.returncode, err) == (0, "")
        hits += int(out.split()[-1])
    assert hits > 0
    assert not list(kept.folder.glob("*.partial"))
    assert sum(path.stat().st_size for path in kept.folder.iterdir()) <= 100_000


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="nothing kills so there")
def test_a_killed_process_leaves_no_damage(kept, said):
    for round_ in range(4):
        (process,) = workers(kept.folder, 1, 10**9, 1 << 30)
        assert process.stdout.readline() == "started\n"
        time.sleep(0.05 * (round_ + 1))
        process.kill()
        process.communicate()
        for k in range(3):
            found = kept.read(WEIGHTS, f"{k:064x}")
            assert found is None or (found["weights"] == k).all()
    assert said == []


def test_an_unfinished_write_leaves_no_entry(kept, said, monkeypatch):
    """What a process leaves that is killed just before the renaming."""
    monkeypatch.setattr(module.os, "replace", lambda *_: None)
    kept.write(WEIGHTS, KEY, entry(), 1.5)
    (left,) = kept.folder.iterdir()
    assert left.suffix == ".partial"
    assert kept.read(WEIGHTS, KEY) is None
    monkeypatch.undo()
    assert said == []
