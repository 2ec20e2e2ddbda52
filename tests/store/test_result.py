"""Result files: the schema, one run the same bytes as the next, and nothing half written."""

import json
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise

import h5py
import numpy as np
import pytest

from cageik_cli import __version__
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.method.solve.dual_laplacian import SolveQuality
from cageik_cli.method.solve.metrics import FrameMetrics, check_finite
from cageik_cli.method.weights.binding import Poses
from cageik_cli.store import hdf5_fields
from cageik_cli.store import result as store
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import Edit, Result, open_animation_writer, read_key_frames
from cageik_cli.store.result_fields import declare_field, export_fields, list_field_rows
from cageik_cli.util.errors import FormatError, InputError, NumericalError
from cageik_cli.util.messages import Hint, Note, Text, spell
from tests.shapes import ball, rotation
from tests.store.bindings import barycentric_binding
from tests.store.damages import (
    assert_refused,
    attribute,
    replaced,
    rewritten,
    value,
    without_attribute,
)
from tests.texts import texts

SCENE = Scene(30.0, 101.0, "Z", 0.01)
FRAMES, SETTINGS, SOURCES = 5, {"alpha": 0.5, "align": True}, {"cage": {"name": "é", "sha256": ""}}
NAMES = tuple(f"frame_{k}_é.obj" for k in range(FRAMES))
GENERATOR = np.random.default_rng(1)
CAGES = GENERATOR.normal(size=(FRAMES, 4, 3))
ROTATIONS = np.array([rotation(k) for k in range(FRAMES)])


BINDING = barycentric_binding()
FIGURES = FrameMetrics(
    *(
        np.arange(FRAMES) if field.name == "worst_vertex" else GENERATOR.uniform(1, 2, FRAMES)
        for field in fields(FrameMetrics)
    )
)


MISSES = GENERATOR.normal(size=(3, len(ball(1).vertices), 3))
VERTEX_RMS = GENERATOR.uniform(1, 2, len(ball(1).vertices))
ENDING = {"vertex_rms": VERTEX_RMS, "sources": SOURCES, "skipped": {}}
KEY_FRAMES = {"key_frames": np.array([4, 1, 0]), "key_frame_errors": MISSES}

QUALITY = SolveQuality(1e-15, 2e-15, -0.5, 944, 4e-3, 0, 123.0)


def part(rows):
    return FrameMetrics(*(getattr(FIGURES, field.name)[rows] for field in fields(FrameMetrics)))


HEADER = {"scene": SCENE, "settings": SETTINGS, "notes": (Note("a note"),), "quality": QUALITY}


def open_writer(path, header=HEADER, kind=Result, **options):
    """A writer of a result of five frames."""
    usual = {"stored": StoredBinding(BINDING, {}), "frames": NAMES, "overwrite": True}
    return open_animation_writer(path, kind, header, **usual | options)


def written(path, cuts=(0, 2, 5), summary=ENDING, unfitted=None, **options):
    with open_writer(path, **{"overwrite": False} | options) as result:
        for first, last in pairwise(cuts):
            result.append(Poses(CAGES, ROTATIONS)[first:last], part(slice(first, last)))
        result.complete(summary, **KEY_FRAMES, unfitted=unfitted)
    return path


def written_with_gaps(path, gaps, order=(*range(FRAMES),), **options):
    """A result of some frames; those in `gaps` are skipped, and have neither cage nor metrics."""
    cages, rotations, figures = CAGES[[*order]], ROTATIONS[[*order]], part([*order])
    columns = {field.name: getattr(figures, field.name) for field in fields(FrameMetrics)}
    for name, column in columns.items():
        column[list(gaps)] = -1 if name == "worst_vertex" else np.nan
    cages[list(gaps)] = rotations[list(gaps)] = np.nan
    with open_writer(path, **options) as writer:
        writer.append(Poses(cages, rotations), FrameMetrics(**columns))
        writer.complete(ENDING | {"skipped": gaps}, **KEY_FRAMES)
    return path


@pytest.fixture
def path(tmp_path):
    return written(tmp_path / "cages.h5")


def test_the_schema(path):
    rest, cage = BINDING.rest, BINDING.cage
    expected = {
        "verts": ("f8", CAGES),
        "rotations": ("f8", ROTATIONS),
        "tris": ("i4", cage.faces),
        "cage/verts": ("f8", cage.vertices),
        "cage/partners": ("i4", [0, 2, 1, 3]),
        "rest/verts": ("f8", rest.vertices),
        "rest/tris": ("i4", rest.faces),
        "weights": ("f8", BINDING.weights),
        "frames/name": ("O", np.array(NAMES, object)),
        "metrics/worst_vertex": ("i8", FIGURES.worst_vertex),
        "metrics/vertex_rms": ("f8", VERTEX_RMS),
        "poses/frame": ("i8", [4, 1, 0]),
        "poses/misses": ("f4", (MISSES / BINDING.rest.diagonal).astype("f4")),
    } | {
        f"metrics/{name}": ("f8", getattr(FIGURES, name))
        for name in ("rms", "max_deviation", "volume", "volume_reconstructed", "spread")
    }
    with h5py.File(path) as file:
        held = []
        file.visititems(lambda name, item: held.append(name) if hasattr(item, "shape") else None)
        assert sorted(held) == sorted(expected)
        for name, (kind, values) in expected.items():
            assert file[name].dtype == np.dtype(kind), name
            found = file[name].asstr()[:] if kind == "O" else file[name][:]
            np.testing.assert_array_equal(found, values)
        assert file["weights"].compression == "gzip"
        attributes = dict(file.attrs)
    assert attributes["format"] == "cageik.result"
    assert attributes["schema"] == 1
    assert attributes["version"] == __version__
    scene = {name: attributes[name] for name in ("fps", "start", "up_axis", "metres_per_unit")}
    assert scene == {"fps": 30.0, "start": 101.0, "up_axis": "Z", "metres_per_unit": 0.01}
    assert attributes["frame_step"] == 1
    assert attributes["complete"]
    assert json.loads(attributes["settings"]) == SETTINGS
    assert json.loads(attributes["sources"]) == SOURCES
    assert json.loads(attributes["notes"]) == [{"kind": "note", "place": "", "text": ["a note"]}]
    assert json.loads(attributes["quality"])["condition_number"] == 123.0
    assert set(attributes) == {
        "format", "schema", "version", "fps", "start", "up_axis", "metres_per_unit", "settings",
        "frame_step", "sources", "skipped", "notes", "quality", "complete", "has_offsets"
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["f2", "f4", ">f8", "g"])
def test_metrics_of_another_precision_are_read(path, kind):
    """Another program may have rewritten the file."""
    with h5py.File(path, "r+") as file:
        for name in ("rms", "spread", "volume"):
            rewritten(f"metrics/{name}", lambda column: column.astype(kind))(file)
    figures = store.read_result(path).metrics
    assert figures.rms.dtype == np.float64
    np.testing.assert_allclose(figures.rms, FIGURES.rms, rtol=1e-3)


@pytest.mark.skipif(np.finfo(np.longdouble).max == np.finfo(float).max, reason="no such numbers")
@pytest.mark.parametrize("name", ["rms", "volume"])
def test_metrics_that_overflow_are_refused(path, name):
    damage = replaced(f"metrics/{name}", np.full(FRAMES, np.finfo(np.longdouble).max))
    assert_refused(path, damage, f"`metrics/{name}`", store.read_result)


def test_what_is_written_is_read(path):
    result = store.read_result(path)
    assert (result.path, result.version, result.scene) == (path, __version__, SCENE)
    assert (result.settings, result.sources) == (SETTINGS, SOURCES)
    assert (texts(result.notes), result.frames) == (("a note",), NAMES)
    for read, mesh in ((result.rest, BINDING.rest), (result.cage, BINDING.cage)):
        np.testing.assert_array_equal(read.vertices, mesh.vertices)
        np.testing.assert_array_equal(read.faces, mesh.faces)
    for field in fields(FrameMetrics):
        found, put = (getattr(figures, field.name) for figures in (result.metrics, FIGURES))
        np.testing.assert_array_equal(found, put)
    assert store.is_result(path)
    np.testing.assert_array_equal(result.vertex_rms, VERTEX_RMS)
    posed = read_key_frames(result, BINDING)
    np.testing.assert_array_equal(posed.indices, [4, 1, 0])
    np.testing.assert_array_equal(posed.cages, CAGES[[4, 1, 0]])
    np.testing.assert_allclose(posed.errors, MISSES / BINDING.rest.diagonal, rtol=1e-7)
    for cage, rebuilt in zip(posed.cages, posed.reconstructed, strict=True):
        np.testing.assert_allclose(rebuilt, BINDING.weights @ cage, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("poses/frame", [5, 1, 0], "`poses/frame` names frames that are not in the clip (5 frames"),
        ("poses/frame", [4, -1, 0], "`poses/frame` names frames that are not in the clip"),
        ("poses/misses", np.full(MISSES.shape, np.nan, "f4"), "`poses` are not finite"),
        ("poses/misses", np.full(MISSES.shape, -1e61), "`poses`"),
        ("poses/misses", MISSES[:2], "poses/misses"),
        ("verts", np.full(CAGES.shape, np.inf), "`poses` are not finite"),
        ("verts", np.full(CAGES.shape, 1e61), "`poses`"),
    ],
)
def test_impossible_key_frames_are_refused(path, name, values, says):
    def read(path):
        return read_key_frames(store.read_result(path), BINDING)

    assert_refused(path, replaced(name, values), says, read)


def test_the_cages_are_a_clip_of_the_splocs_layout(path):
    sequence = open_sequence([str(path)])
    block = next(sequence.blocks(FRAMES, 1))
    np.testing.assert_array_equal(block.positions, CAGES)
    np.testing.assert_array_equal(sequence.first.faces, BINDING.cage.faces)


@pytest.mark.parametrize("cuts", [(0, 5), (0, 1, 2, 3, 4, 5), (0, 3, 5)])
def test_the_same_run_gives_the_same_bytes_under_any_name(tmp_path, path, cuts):
    other = written(tmp_path / "another name.h5", cuts)
    assert other.read_bytes() == path.read_bytes()


def test_weights_can_be_left_out(tmp_path, path):
    smaller = written(tmp_path / "small.h5", keep_weights=False)
    with h5py.File(smaller) as file:
        assert "weights" not in file
        assert "poses" not in file
    assert smaller.stat().st_size < path.stat().st_size
    np.testing.assert_array_equal(store.read_result(smaller).metrics.rms, FIGURES.rms)


def test_an_old_result_is_replaced_when_the_new_one_is_complete(tmp_path):
    path = tmp_path / "cages.h5"
    path.write_text("old")
    with open_writer(path) as result:
        result.append(Poses(CAGES, ROTATIONS), FIGURES)
        result.complete(ENDING, **KEY_FRAMES)
        assert path.read_text() == "old"
    assert store.read_result(path).frames == NAMES
    assert [item.name for item in tmp_path.iterdir()] == ["cages.h5"]


def test_a_result_written_by_another_run_is_not_replaced(tmp_path):
    path = tmp_path / "cages.h5"

    def race():
        with open_writer(path, overwrite=False) as result:
            result.append(Poses(CAGES, ROTATIONS), FIGURES)
            result.complete(ENDING, **KEY_FRAMES)
            path.write_text("somebody else's")

    with pytest.raises(InputError, match=r"cages\.h5"):
        race()
    assert path.read_text() == "somebody else's"
    assert [item.name for item in tmp_path.iterdir()] == ["cages.h5"]


@pytest.mark.parametrize("kind", [InputError, ValueError, KeyboardInterrupt, MemoryError])
def test_an_error_leaves_the_old_result_and_nothing_else(tmp_path, kind):
    path = tmp_path / "cages.h5"
    path.write_text("old")

    def fail_in_the_middle():
        with open_writer(path) as result:
            result.append(Poses(CAGES, ROTATIONS)[:2], part(slice(2)))
            raise kind("in the middle")

    with pytest.raises(kind):
        fail_in_the_middle()
    assert path.read_text() == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["cages.h5"]


def test_a_result_that_lacks_frames_is_never_complete(tmp_path):
    with pytest.raises(ValueError, match="2 of 5 frames"):
        written(tmp_path / "cages.h5", cuts=(0, 2))
    assert not list(tmp_path.iterdir())


SEQUENCES = h5py.vlen_dtype(np.dtype("i4"))
NUMBERS_FOR_NAMES = np.empty(FRAMES, object)
for k in range(FRAMES):
    NUMBERS_FOR_NAMES[k] = np.arange(2, dtype="i4")

DAMAGES = [
    (attribute("format", "other"), "is not a result of cageik extract"),
    (without_attribute("format"), "is not a result of cageik extract"),
    *[
        (attribute("format", bad), "is not a result of cageik extract")
        for bad in (np.void(b"abc"), h5py.Empty("f8"), ["cageik.result"] * 2, 1)
    ],
    *[
        (attribute("schema", bad), "schema")
        for bad in (np.void(b"abc"), h5py.Empty("f8"), [1, 1], "1")
    ],
    (attribute("schema", 2), "schema 2, expected 1"),
    (without_attribute("schema"), "schema None"),
    (attribute("complete", False), "is not complete: the run that wrote it was interrupted"),
    (without_attribute("complete"), "is not complete"),
    *[
        (attribute("complete", bad), "complete")
        for bad in ("False", "True", 1, h5py.Empty("?"), [True, True])
    ],
    *[(attribute("fps", bad), "attribute `fps` is") for bad in ("24", [24.0, 24.0], 1 + 1j, True)],
    *[(attribute("fps", bad), f"{bad:g} ") for bad in (0.0, -1.0, np.nan, np.inf)],
    *[(attribute("up_axis", bad), "axis") for bad in ("X", "", 1.0)],
    (without_attribute("fps"), "attribute `fps` is None, expected a number"),
    *[(attribute("frame_step", bad), "attribute `frame_step` is") for bad in ("1", [1.0, 1.0])],
    *[(attribute("frame_step", bad), "step of frame numbers") for bad in (0.0, -1.0, np.nan)],
    *[
        (change, f"`{name}` is not a JSON {kind}")
        for name, kind in {
            "settings": "dict",
            "sources": "dict",
            "quality": "dict",
            "notes": "list",
        }.items()
        for change in (
            without_attribute(name),
            attribute(name, "{"),
            attribute(name, "[" * 20_000 + "]" * 20_000),
            attribute(name, '{"a":' * 17 + "1" + "}" * 17),
            attribute(name, "3"),
            attribute(name, 3),
        )
    ],
    *[
        (replaced(name), f"`{name}`")
        for name in (
            "verts",
            "tris",
            "cage/verts",
            "rest/verts",
            "rest/tris",
            "frames/name",
            "metrics/rms",
            "metrics/worst_vertex",
            "metrics/spread",
        )
    ],
    (replaced("verts", CAGES[0]), "`verts` has shape (4, 3)"),
    (replaced("verts", CAGES.astype(int)), "`verts` holds int64 values"),
    (replaced("verts", CAGES[:3]), "expected 3"),
    (replaced("verts", CAGES[:, :3]), "`verts` has shape (5, 3, 3)"),
    (replaced("tris", BINDING.cage.faces.astype(float)), "`tris` holds float64 values"),
    (value("tris", (0, 0), 4), "face 0"),
    (value("rest/tris", (0, 0), -1), "face 0"),
    (value("rest/verts", (2, 1), np.nan), "vertex 2"),
    (value("cage/verts", (3, 0), np.inf), "vertex 3"),
    (value("cage/partners", 0, 1), "`cage/partners`"),
    (value("cage/partners", 0, 4), "`cage/partners`"),
    (replaced("cage/partners", np.arange(4)), "`cage/partners`"),
    (replaced("cage/partners", np.arange(3)), "`cage/partners` has shape (3,)"),
    (replaced("metrics/rms", FIGURES.rms[:4]), "`metrics/rms` has shape (4,)"),
    (replaced("metrics/worst_vertex", FIGURES.rms), "`metrics/worst_vertex` holds float64 values"),
    (replaced("frames/name", NAMES[:4]), "`frames/name` has shape (4,)"),
    (replaced("frames/name", np.arange(5)), "`frames/name` holds int64 values"),
    (replaced("frames/name", NUMBERS_FOR_NAMES, dtype=SEQUENCES), "frames/name"),
    *[
        (value(f"metrics/{name}", 3, bad), f"metrics/{name}")
        for name, bad in (
            ("rms", np.nan),
            ("rms", -1.0),
            ("rms", 1e300),
            ("max_deviation", 1e300),
            ("spread", 1e300),
            ("volume", np.inf),
            ("volume", -1e200),
            ("volume_reconstructed", -np.inf),
            ("max_deviation", np.inf),
            ("spread", np.nan),
            ("worst_vertex", 18),
            ("worst_vertex", -1),
        )
    ],
    (attribute("settings", '{"alpha": NaN}'), "settings"),
    (attribute("settings", '{"alpha": 1' + "0" * 400 + "}"), "settings"),
    (attribute("settings", '{"\\ud800": 1}'), "settings"),
    (attribute("notes", '["\\ud800"]'), "notes"),
    (attribute("notes", "[1]"), "not a note"),
    (attribute("notes", '[{"kind": "error", "place": "", "text": []}]'), "not a note"),
    (attribute("notes", '[{"kind": "note", "place": "", "text": [["a"]]}]'), "not a note"),
    (attribute("notes", b'["\xff"]'), "notes"),
    (attribute("sources", '{"cage": {"name": "\\udcff"}}'), "sources"),
    (value("rest/verts", (2, 1), 1e308), "vertex 2"),
    (value("cage/verts", (2, 1), -1e308), "vertex 2"),
    (attribute("quality", '{"min_weight": 1e999}'), "quality"),
    (attribute("quality", '{"min_weight": 0.1}'), "quality"),
    (attribute("quality", json.dumps(dict.fromkeys(asdict(QUALITY), "good"))), "quality"),
    (attribute("sources", '{"cage": "cage.obj"}'), "sources"),
    (attribute("edited_from", 3), "`edited_from` is not text"),  # an edit of an older version
    (attribute("format", "cageik.edit"), "`edited_from` is not text"),
    (value("rest/verts", ..., 0.0), "rest"),
    *[
        (value("metrics/vertex_rms", place, bad), "`metrics/vertex_rms`")
        for place, bad in ((3, -1.0), (3, np.inf), (slice(None), np.nan))
    ],
    *[
        (attribute("skipped", bad), "attribute `skipped`")
        for bad in (
            "[]",
            '{"5": "out of the clip"}',
            '{"-1": "a"}',
            '{"a": "b"}',
            '{"0": 1}',
            '{"0": [1]}',
            '{"0": [["a"]]}',
        )
    ],
    (attribute("skipped", '{"0": "a"}'), "`metrics/rms` has values for skipped frames"),
    (attribute("skipped", json.dumps({str(k): "a" for k in range(FRAMES)})), "every frame"),
]


@pytest.mark.parametrize(("damage", "says"), DAMAGES)
def test_a_damaged_result_is_refused_by_name(path, damage, says):
    assert_refused(path, damage, says, store.read_result)


@pytest.fixture
def edited(tmp_path):
    return written(tmp_path / "edited.h5", header=HEADER | {"edited_from": "ä.h5"}, kind=Edit)


def test_an_edit_is_a_kind_of_its_own(path, edited):
    found = store.read_animation(edited)
    assert isinstance(found, Edit)
    assert found.edited_from == "ä.h5"
    assert not hasattr(found, "regions")
    assert repr(found).startswith("<Edit: edited.h5, 5 frames")
    with h5py.File(edited) as file:
        assert (file.attrs["format"], file.attrs["schema"]) == ("cageik.edit", 1)
    assert isinstance(store.read_animation(path), Result)
    assert (store.is_result(path), store.is_result(edited)) == (True, False)
    assert (store.is_animation(path), store.is_animation(edited)) == (True, True)


def test_what_takes_results_refuses_an_edit(edited):
    with pytest.raises(FormatError, match=r"edited.h5: is an edit by cageik pose, expected a res"):
        store.read_result(edited)


def test_an_edit_of_an_older_version_is_read(edited):
    expected = store.read_animation(edited)
    with h5py.File(edited, "r+") as file:
        file.attrs["format"] = "cageik.result"
    found = store.read_animation(edited)
    assert isinstance(found, Edit)
    assert not store.is_result(edited)
    assert (found.edited_from, found.notes) == (expected.edited_from, expected.notes)
    np.testing.assert_array_equal(found.metrics.rms, expected.metrics.rms)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Rated(Result):
    """A result with a field of its own, which is only declared here."""

    stars: tuple[int, ...] | None = declare_field(
        lambda file, _: read_record_of_stars(file),
        default=None,
        show=lambda result: [("stars", f"{sum(result.stars)} of 5")],
        export="stars",
    )


def read_record_of_stars(file):
    return hdf5_fields.parse_record(
        tuple[int, ...], hdf5_fields.read_json_attr(file, "stars", list), "stars"
    )


def test_a_field_is_declared_once(tmp_path, monkeypatch):
    path = written(tmp_path / "rated.h5", kind=Rated, summary=ENDING | {"stars": (1, 3)})
    monkeypatch.setattr(store, "Result", Rated)
    found = store.read_result(path)
    assert found.stars == (1, 3)
    assert list_field_rows(found)[-1] == ("stars", "4 of 5")
    assert export_fields(found)["stars"] == (1, 3)
    assert_refused(path, attribute("stars", '["a"]'), "`stars[0]` is", store.read_result)


def test_a_version_with_invalid_text_is_shown(path):
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = np.bytes_(b"1.\xff")
    version = store.read_result(path).version
    assert "1." in version
    assert version.encode().decode() == version


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("rms", np.inf),
        ("rms", 1e200),
        ("max_deviation", np.nan),
        ("spread", np.inf),
        ("volume", np.inf),
        ("volume_reconstructed", 1e200),
        ("cages", np.nan),
        ("cages", -1e300),
    ],
)
def test_values_that_could_not_be_read_are_not_written(name, bad):
    cages, figures = CAGES.copy(), part(slice(None))
    if name == "cages":
        cages[3, 1, 2] = bad
    else:
        column = getattr(figures, name).copy()
        column[3] = bad
        figures = replace(figures, **{name: column})
    check_finite(range(5), CAGES, part(slice(None)))
    with pytest.raises(NumericalError, match=f"{name}.* in frames 10 to 18"):
        check_finite(range(10, 20, 2), cages, figures)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_result_cut_short_is_refused(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match="HDF5" if share else "the file is empty"):
        store.read_result(path)


def test_an_interrupted_write_is_not_a_result(tmp_path):
    path = tmp_path / "cages.h5"
    with open_writer(path) as result:
        result.append(Poses(CAGES, ROTATIONS), FIGURES)
        result._file.flush()
        (partial,) = tmp_path.glob("*.partial")
        (tmp_path / "copy.h5").write_bytes(partial.read_bytes())
        result.complete(ENDING, **KEY_FRAMES)
    with pytest.raises(InputError, match=r"copy\.h5"):
        store.read_result(tmp_path / "copy.h5")


@pytest.mark.parametrize("rows", [1, 7, 18, 100])
def test_weights_are_compressed_without_loss(tmp_path, monkeypatch, rows):
    """Any number of chunks, the last one full or not, by HDF5's own reading."""
    monkeypatch.setattr(hdf5_fields, "MAX_STORED_CHUNK_BYTES", rows * BINDING.weights[0].nbytes)
    with h5py.File(written(tmp_path / "cages.h5")) as file:
        weights = file["weights"]
        assert (weights.compression, weights.shuffle) == ("gzip", True)
        assert weights.chunks == (min(rows, len(BINDING.weights)), BINDING.weights.shape[1])
        np.testing.assert_array_equal(weights[:], BINDING.weights)


def test_gaps_are_read_in_the_order_of_the_frames(tmp_path):
    """As numbers: the attribute is sorted as text, where 10 is before 9."""
    frames = tuple(f"{k}.obj" for k in range(12))
    gaps = {9: "cut", 10: "cut", 2: "cut"}
    path = written_with_gaps(tmp_path / "cages.h5", gaps, order=[0] * 12, frames=frames)
    assert list(store.read_result(path).skipped) == [2, 9, 10]


def test_why_frames_were_skipped_is_read_as_it_was_said(tmp_path):
    gaps = {
        0: "`rest=`.obj: missing",
        2: Text("cut", " off"),
        3: "bad; " + Hint("missing", True) + " takes it",
    }
    path = written_with_gaps(tmp_path / "cages.h5", gaps)
    found = store.read_result(path).skipped
    said = [spell(one, lambda hint: "--" + hint.name) for one in found.values()]
    assert said == ["`rest=`.obj: missing", "cut off", "bad; --missing takes it"]
    with h5py.File(path) as file:
        assert json.loads(file.attrs["skipped"]) == {
            "0": "`rest=`.obj: missing",
            "2": "cut off",
            "3": ["bad; ", ["missing", "True"], " takes it"],
        }


@pytest.mark.parametrize("size", [1, 2, 5])
def test_gaps_are_interpolated(tmp_path, size):
    """A gap at the start, two within, in blocks that part them."""
    gaps = {0: "missing", 2: "cut", 3: "cut"}
    path = written_with_gaps(tmp_path / "cages.h5", gaps, overwrite=False)
    result = store.read_result(path)
    assert result.skipped == gaps
    found = np.concatenate(list(store.read_cages(result, size)))
    one, four = CAGES[1], CAGES[4]
    expected = [one, one, one + (four - one) / 3, one + (four - one) * 2 / 3, four]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -1e61])
def test_cages_and_weights_are_read_and_must_be_finite(path, wrong):
    result = store.read_result(path)
    np.testing.assert_array_equal(np.concatenate(list(store.read_cages(result, 2))), CAGES)
    np.testing.assert_array_equal(store.read_weights(result), BINDING.weights)
    with h5py.File(path, "r+") as file:
        file["verts"][3, 0, 0] = wrong
        del file["weights"]
        file["weights"] = np.where(np.arange(18)[:, None] == 7, wrong, BINDING.weights)
    with pytest.raises(InputError, match=r"cages\.h5: the cage of .* is not finite"):
        list(store.read_cages(result, 2))
    with pytest.raises(InputError, match=r"`weights`.* vertex 7"):
        store.read_weights(result)


def test_notes_are_read_as_they_were_said(path):
    said = Note("off: " + Hint("fps", 24) + " helps", "warning", "a.glb")
    with h5py.File(path, "r+") as file:
        file.attrs["notes"] = json.dumps([said.pack(), "warning: old; lower `fps=`"])
    new, old = store.read_result(path).notes
    assert (new.pack(), old.kind) == (said.pack(), "warning")
    assert spell(old.text, lambda hint: "--" + hint.name) == "old; lower --fps"


def test_a_note_on_a_file_of_any_name_is_read(tmp_path):
    header = HEADER | {"notes": (Note("turned", place="k\udcff.abc"),)}
    path = written(tmp_path / "named.h5", header=header)
    assert texts(store.read_result(path).notes) == ("k\ufffd.abc: turned",)


def test_notes_stay_on_one_line(path):
    with h5py.File(path, "r+") as file:
        file.attrs["notes"] = json.dumps(["a\nb\x1b[31m"])
    assert texts(store.read_result(path).notes) == ("a b\ufffd[31m",)
