"""The JSON Schema that `report --schema` prints: every run keeps it, and no changed record does."""

import json
from copy import deepcopy
from pathlib import Path

import h5py
import numpy as np
import pytest
from jsonschema import Draft202012Validator

from cageik_cli.report.views.schema import format_schema
from tests.conftest import run_in_process

SCHEMA = json.loads(format_schema())
EXTRACT = ("extract", "frames", "--cage", "cage.obj", "-o", "a.h5", "-q")
HANDLES = {
    "handles": [{"name": "top", "vertex": 0, "offset": [0, 0.1, 0]}],
}


def validator(name: str = "") -> Draft202012Validator:
    """Check the whole document, or what one of its definitions describes."""
    return Draft202012Validator(
        SCHEMA | ({"$ref": f"#/$defs/{name}", "anyOf": [{}]} if name else {})
    )


def read_attributes(path: str) -> dict:
    """Return the attributes of a result that are JSON, by name."""
    names = SCHEMA["$defs"]["ResultAttributes"]["properties"].keys()
    names |= SCHEMA["$defs"]["EditAttributes"]["properties"].keys()
    found = {}
    with h5py.File(path) as file:
        for name, value in file.attrs.items():
            if isinstance(value, str) and value[:1] in ("{", "["):
                assert name in names
                found[name] = json.loads(value)
    return found


def write_clip(animation, name: str, *, faces=None, change=None, count: int = 5) -> None:
    frames = np.concatenate([animation.frames] * (count // 5))
    if change is not None:
        change(frames)
    faces = animation.rest.faces if faces is None else faces
    np.savez(name, verts=frames, faces=faces)


def hide(frames: np.ndarray) -> None:
    frames[2:4, 3:5] = np.nan
    frames[6, 1] += 2


def report(run, *words: str, results=("a.h5",)):
    outcome = run("report", *results, *words, "--json", "r.json", "--overwrite", "-q")
    assert outcome.code in (0, 3), outcome.err
    return outcome.code, json.loads(Path("r.json").read_text())


def run_harmonic(run, animation):
    assert run(*EXTRACT).code == 0


def run_fitted(run, animation):
    assert run(*EXTRACT, "--fit").code == 0


def run_few_influences(run, animation):
    assert run(*EXTRACT, "--fit", "--influences", "4").code == 0


def run_captured(run, animation):
    write_clip(animation, "c.npz", change=hide, count=15)
    words = ("extract", "c.npz", "--cage", "cage.obj", "-o", "a.h5", "-q")
    done = run(*words, "--missing", "--robust", "--smooth", "auto", "--fill-gaps")
    assert done.code == 0, done.err


def run_open(run, animation):
    write_clip(animation, "o.npz", faces=animation.rest.faces[:-1])
    assert run("extract", "o.npz", "--cage", "cage.obj", "-o", "a.h5", "-q").code == 0


def run_skipped(run, animation):
    Path("frames/frame_3.obj").write_text("v 0 0 0\nv")
    assert run(*EXTRACT, "--on-bad-frame", "skip").code == 0


def run_edit(run, animation):
    assert run(*EXTRACT[:5], "b.h5", "-q").code == 0
    Path("handles.json").write_text(json.dumps(HANDLES))
    done = run("pose", "b.h5", "handles.json", "-o", "a.h5", "-q")
    assert done.code == 0, done.err


RUNS = {
    run.__name__: run
    for run in (
        run_harmonic,
        run_fitted,
        run_few_influences,
        run_captured,
        run_open,
        run_skipped,
        run_edit,
    )
}


def test_the_command_prints_a_schema_that_is_one(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = run("report", "--schema")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out == format_schema()
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    Draft202012Validator.check_schema(SCHEMA)


def list_objects(schema, path=""):
    if isinstance(schema, dict):
        if "properties" in schema:
            yield path, schema
        for key, inner in schema.items():
            yield from list_objects(inner, f"{path}/{key}")


def test_every_field_says_what_it_is():
    objects = dict(list_objects(SCHEMA["$defs"]))
    assert len(objects) > 30
    silent = [
        f"{path}/{name}"
        for path, schema in objects.items()
        for name, field in schema["properties"].items()
        if not field.get("description")
    ]
    assert silent == []
    assert all(schema["additionalProperties"] is False for schema in objects.values())


@pytest.mark.parametrize("make", RUNS.values(), ids=RUNS)
def test_every_kind_of_run_keeps_the_schema(run, folder, animation, make):
    make(run, animation)
    code, record = report(run)
    assert code == 0
    validator().validate(record)
    validator("Report").validate(record)
    kind = "Edit" if make is run_edit else "Result"
    attributes = read_attributes("a.h5")
    validator(f"{kind}Attributes").validate(attributes)
    if make is run_captured:
        assert record["kept"]["missing_percent"] > 0
        assert record["kept"]["most_rejected"] > 0
    if make is run_open:
        assert record["clip"]["closed"] is False
    if make is run_skipped:
        assert record["summary"]["frames_skipped"] == 1
        assert attributes["skipped"].keys() == {"2"}
    if make is run_fitted:
        assert record["unfitted"]["frames"]
        assert attributes["fit"] == record["fit"]


def test_limits_and_several_results_keep_the_schema(run, extracted):
    code, record = report(
        run, "--max-rms", "0.0001%", "--max-deviation", "9units", results=["cages.h5"]
    )
    assert code == 3
    assert [check["passed"] for check in record["gates"]] == [False, True]
    validator().validate(record)
    Path("old.json").write_text(json.dumps(record))
    Path("b.h5").write_bytes(Path("cages.h5").read_bytes())
    code, records = report(run, "--baseline", "old.json", results=("cages.h5", "b.h5"))
    assert code == 3
    assert [len(one["gaps"]) for one in records] == [1, 1]
    validator().validate(records)


def test_parts_keep_the_schema(run, character_result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, record = report(run, results=(str(character_result.path),))
    assert len(record["parts"]) == 4
    validator("Report").validate(record)


def write_batch(run) -> dict:
    Path("all").mkdir()
    Path("frames").rename("all/frames")
    Path("all/broken").mkdir()
    Path("all/broken/f_1.obj").write_text("v 0 0 0\nv")
    Path("all/broken/f_2.obj").write_text("v 0 0 0\nv")
    base = ("batch", "all", "--cage", "cage.obj", "--no-pages", "--jobs", "1", "-q")
    assert run(*base, "-o", "old").code == 4
    old = json.loads(Path("old/report.json").read_text())
    old["clips"].append(old["clips"][1] | {"name": "gone", "sources": {}})
    Path("old.json").write_text(json.dumps(old))
    done = run(*base, "-o", "out", "--max-rms", "0.00001%", "--baseline", "old.json")
    assert done.code == 4
    return json.loads(Path("out/report.json").read_text())


def test_a_batch_keeps_the_schema(run, folder):
    record = write_batch(run)
    assert [clip["fault"] is None for clip in record["clips"]] == [False, True]
    assert [gap["name"] for gap in record["gaps"]] == ["gone"]
    validator().validate(record)
    validator("BatchRecord").validate(record)
    for change in (
        lambda one: one["clips"][0].pop("fault"),
        lambda one: one["clips"][1]["summary"].update(rms="small"),
        lambda one: one["clips"][1].update(gates=None),
        lambda one: one["gaps"][0].update(is_new=1),
        lambda one: one.update(clips={}),
        lambda one: one.update(schema=2),
    ):
        changed = deepcopy(record)
        change(changed)
        assert not validator().is_valid(changed)


@pytest.fixture(scope="module")
def records(tmp_path_factory, animation, tiny_clip):
    """The report and the attributes of a result with skipped frames."""
    import shutil

    place = tmp_path_factory.mktemp("records") / "run"
    shutil.copytree(tiny_clip, place)
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(place)
        run_skipped(run_in_process, animation)
        return report(run_in_process)[1], read_attributes("a.h5")


def list_places(value, place=()):
    """Yield the place of every value in a record, and the value."""
    if isinstance(value, dict | list):
        inner = list(value.items() if isinstance(value, dict) else enumerate(value))
    else:
        inner = []
    for key, one in inner:
        yield (*place, key), one
        yield from list_places(one, (*place, key))


def change_at(record, place, change):
    """Return a copy of a record in which the holder of a value was changed."""
    changed = deepcopy(record)
    holder = changed
    for key in place[:-1]:
        holder = holder[key]
    change(holder, place[-1])
    return changed


@pytest.mark.parametrize("which", [0, 1], ids=["Report", "ResultAttributes"])
def test_no_changed_record_keeps_the_schema(records, which):
    """A field is taken away, named otherwise, or of another type: at every place, one by one."""
    record = records[which]
    name = ("Report", "ResultAttributes")[which]
    check = validator(name)
    check.validate(record)
    if which == 0:
        record = record | {"frames": record["frames"][1:3]}  # the others are like them
    kept = []
    for place, value in list_places(record):
        parents = [key for key in place if isinstance(key, str)]
        wrong = {"no": "such"} if not isinstance(value, dict) else 5
        changes = {"type": lambda at, key, wrong=wrong: at.__setitem__(key, wrong)}
        is_named = isinstance(place[-1], str) and parents[0] not in ("settings", "skipped")
        if is_named and not (parents[0] == "sources" and len(parents) == 2):
            changes["name"] = lambda at, key: at.__setitem__(f"{key}_x", at.pop(key))
        for kind, change in changes.items():
            if check.is_valid(change_at(record, place, change)):
                kept.append((kind, place))
    assert kept == []
    settings = change_at(record, ("settings", "x"), lambda at, key: at.__setitem__(key, 1))
    assert not check.is_valid(settings)
