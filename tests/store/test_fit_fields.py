"""Fitted weights in bindings and results: each form comes back, and no damage is used."""

import json
from dataclasses import asdict, replace

import h5py
import numpy as np
import pytest

from cageik_cli.fit.settings import FitSettings, StrengthLimit
from cageik_cli.method.solve.summary import VertexBound
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.store import binding_file
from cageik_cli.store import result as results
from cageik_cli.util.errors import FormatError, InputError
from tests.store.bindings import as_fitted, record
from tests.store.damages import assert_refused, attribute, replaced, rewritten, value
from tests.store.test_binding_file import BINDING, SOURCES
from tests.store.test_result import BINDING as MODEL
from tests.store.test_result import CAGES, ENDING, ROTATIONS, written, written_with_gaps

FORMS = ("dense", "low rank", "few")


def write_binding(path, form):
    stored = as_fitted(BINDING, form, SOURCES)
    binding_file.write_binding(path, stored, overwrite=True)
    return stored


def write_result(path, form, **options):
    summary = ENDING | {"bound": VertexBound(0.01, 4, 18)}
    return written(path, stored=as_fitted(MODEL, form), summary=summary, overwrite=True, **options)


def assert_same_weights(found, expected):
    assert found.has_offsets == expected.has_offsets
    np.testing.assert_array_equal(found.weights, expected.weights)


def assert_same_change(found, expected):
    for name in ("columns", "basis"):
        one, other = (getattr(change, name, None) for change in (found, expected))
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("form", FORMS)
def test_a_fitted_binding_comes_back(tmp_path, form):
    path = tmp_path / "binding.h5"
    stored = write_binding(path, form)
    found = binding_file.read_binding(path)
    assert found.fit == stored.fit
    assert_same_weights(found.binding, stored.binding)
    assert_same_change(found.low_rank, stored.low_rank)
    with h5py.File(path) as file:
        assert ("weights" in file) == (form != "few")


@pytest.mark.parametrize("form", FORMS)
def test_a_fitted_result_comes_back(tmp_path, form):
    result = results.read_result(write_result(tmp_path / "cages.h5", form))
    assert results.has_weights(result)
    assert result.bound == VertexBound(0.01, 4, 18)
    stored = as_fitted(MODEL, form)
    assert result.fit == stored.fit
    assert_same_weights(results.read_binding(result), stored.binding)
    assert_same_change(results.read_low_rank(result), stored.low_rank)
    assert result.has_offsets == (form == "few")
    np.testing.assert_array_equal(results.read_rotations(result), ROTATIONS)


def test_key_frames_have_turned_offsets(tmp_path):
    result = results.read_result(write_result(tmp_path / "cages.h5", "few"))
    binding = results.read_binding(result)
    found = results.read_key_frames(result, binding)
    offsets = MODEL.rest.vertices - binding.weights @ MODEL.cage.vertices
    expected = binding.weights @ CAGES[4] + offsets @ ROTATIONS[4]
    np.testing.assert_allclose(found.reconstructed[0], expected, rtol=0, atol=1e-13)


def test_without_weights_only_a_change_of_low_rank_is_kept(tmp_path):
    for form in FORMS:
        path = write_result(tmp_path / "cages.h5", form, keep_weights=False)
        result = results.read_result(path)
        assert not results.has_weights(result)
        assert results.read_binding(result) is None
        assert (results.read_low_rank(result) is not None) == (form == "low rank")


def test_weights_that_are_not_fitted_have_no_fit(tmp_path):
    binding_file.write_binding(
        tmp_path / "b.h5", binding_file.StoredBinding(BINDING, SOURCES), overwrite=False
    )
    assert binding_file.read_binding(tmp_path / "b.h5").fit is None


@pytest.mark.parametrize(
    ("gaps", "nearest"),
    [
        ([1], [0, 0, 2, 3, 4]),
        ([0, 1], [2, 2, 2, 3, 4]),
        ([3, 4], [0, 1, 2, 2, 2]),
        ([1, 2, 3], [0, 0, 0, 4, 4]),
    ],
)
def test_the_rotation_of_a_skipped_frame_is_that_of_the_nearest(tmp_path, gaps, nearest):
    path = written_with_gaps(tmp_path / "cages.h5", dict.fromkeys(gaps, "gone"))
    found = results.read_rotations(results.read_result(path))
    np.testing.assert_array_equal(found, ROTATIONS[nearest])


def fit_attribute(path, value):
    def damage(file):
        held = json.loads(file.attrs["fit"])
        *steps, last = path
        place = held
        for step in steps:
            place = place[step]
        if value is None:
            del place[last]
        else:
            place[last] = value
        file.attrs["fit"] = json.dumps(held)

    return damage


CSR_DAMAGES = [
    (value("weights_csr/indices", 3, 4), "weights_csr/indices` name vertices"),
    (value("weights_csr/indices", 3, -1), "weights_csr/indices` name vertices"),
    (value("weights_csr/indices", 0, 3), "do not ascend"),
    (rewritten("weights_csr/indices", lambda held: held[:-1]), "weights_csr/indices` has shape"),
    (rewritten("weights_csr/indices", lambda held: held.astype(float)), "holds float64"),
    (value("weights_csr/indptr", -1, 10**9), "does not divide"),
    (value("weights_csr/indptr", 0, 1), "does not divide"),
    (value("weights_csr/indptr", 4, 0), "does not divide"),
    (value("weights_csr/indptr", 4, 2**62), "does not divide"),
    (rewritten("weights_csr/indptr", lambda held: held[:-1]), "weights_csr/indptr` has shape"),
    (value("weights_csr/data", 5, np.nan), "not finite, or too large, at vertex 2"),
    (value("weights_csr/data", 5, 1e200), "not finite, or too large, at vertex 2"),
    (rewritten("weights_csr/data", lambda held: held[:, None]), "weights_csr/data` has shape"),
    (replaced("weights_csr/data"), "weights_csr/data`"),
    (attribute("has_offsets", "yes"), "`has_offsets` is 'yes'"),
]
RECORD_DAMAGES = [
    (fit_attribute(["report", "min_weight"], "x"), '`fit.report.min_weight` is "x"'),
    (fit_attribute(["report", "min_weight"], True), "`fit.report.min_weight` is true"),
    (fit_attribute(["report", "frames"], 1.5), "`fit.report.frames` is 1.5"),
    (fit_attribute(["report", "roughness"], None), "`fit.report` does not hold roughness"),
    (fit_attribute(["report", "more"], 1), "`fit.report` holds more"),
    (fit_attribute(["settings", "more"], 1), "a newer version of cageik; update"),
    (fit_attribute(["report", "fitted"], 1), "`fit.report.fitted` does not hold"),
    (fit_attribute(["report", "ladder"], [[1]]), "`fit.report.ladder[0]` does not hold"),
    (fit_attribute(["report", "ladder"], 3), "`fit.report.ladder` is 3"),
    (fit_attribute(["report", "limit"], "taste"), '`fit.report.limit` is "taste", expected one of'),
    (fit_attribute(["report", "edits", "smooth"], -1.0), "smooth is -1.0"),
    (fit_attribute(["settings", "use"], "look"), '`fit.settings.use` is "look", expected one of e'),
    (fit_attribute(["settings", "smoothness"], -1.0), "`smoothness=` is -1.0"),
    (fit_attribute(["settings", "influences"], [1]), "`fit.settings.influences` is a list"),
    (fit_attribute(["clips", 0, "name"], 3), "`fit.clips[0].name` is 3"),
    (attribute("fit", "{"), "`fit` is not a JSON dict"),
]
RANK_DAMAGES = [
    (value("fit/columns", (2, 1), np.inf), "`fit/columns` are not finite"),
    (value("fit/basis", (2, 1), np.nan), "`fit/basis` are not finite"),
    (rewritten("fit/basis", lambda held: held[:, :1]), "`fit/basis` has shape"),
    (rewritten("fit/columns", lambda held: held[1:]), "`fit/columns` has shape"),
    (replaced("fit/basis"), "`fit/basis`"),
    (fit_attribute(["settings", "rank"], 0), "`rank=` is 0"),
]


@pytest.mark.parametrize(
    ("form", "damage", "says"),
    [
        *(("few", *one) for one in CSR_DAMAGES),
        *(("dense", *one) for one in RECORD_DAMAGES),
        *(("low rank", *one) for one in RANK_DAMAGES),
    ],
)
def test_a_damaged_fit_is_refused(tmp_path, form, damage, says):
    path = tmp_path / "binding.h5"
    write_binding(path, form)
    assert_refused(path, damage, says, binding_file.read_binding, FormatError)


def test_fields_that_an_older_file_lacks_take_their_defaults(tmp_path):
    path = tmp_path / "binding.h5"
    fit = write_binding(path, "dense").fit
    with h5py.File(path, "r+") as file:
        fit_attribute(["settings", "smoothness"], None)(file)
        for name in ("limit", "ladder", "edits", "distinct_frames"):
            fit_attribute(["report", name], None)(file)
        fit_attribute(["report", "curve"], [[1.0, 0.3], [0.3, 0.2]])(file)  # of an older version
        file.attrs["settings"] = "{}"
    found = binding_file.read_binding(path)
    assert found.binding.settings == BindSettings()
    assert found.fit.settings == replace(fit.settings, smoothness=FitSettings().smoothness)
    assert found.fit.report == replace(
        fit.report, limit=StrengthLimit.GIVEN, ladder=(), edits=None, distinct_frames=None
    )


def test_a_form_that_the_record_does_not_state_is_refused(tmp_path):
    path = tmp_path / "binding.h5"
    for form, option in (("low rank", "rank"), ("few", "influences")):
        write_binding(path, form)
        with h5py.File(path, "r+") as file:
            file.attrs["fit"] = json.dumps(asdict(record()))
        with pytest.raises(FormatError, match=option):
            binding_file.read_binding(path)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (value("rotations", (2, 0, 0), np.nan), "`rotations` of "),
        (value("rotations", (2, 0, 0), 1e300), "`rotations` of "),
        (value("rotations", 3, -np.eye(3)), "`rotations` of "),
        (rewritten("rotations", lambda held: held[1:]), "`rotations` has shape"),
        (replaced("rotations"), "`rotations`"),
    ],
)
def test_damaged_rotations_are_refused(tmp_path, damage, says):
    path = write_result(tmp_path / "cages.h5", "few")
    assert_refused(
        path, damage, says, lambda path: results.read_rotations(results.read_result(path))
    )


@pytest.mark.parametrize("bad", ["{}", '{"rms_percent": "x", "points": 4, "vertices": 5}', "["])
def test_a_damaged_bound_is_refused(tmp_path, bad):
    path = write_result(tmp_path / "cages.h5", "dense")
    with h5py.File(path, "r+") as file:
        file.attrs["bound"] = bad
    with pytest.raises(FormatError, match="bound"):
        results.read_result(path)


def test_any_changed_bytes_of_indices_give_a_matrix_or_an_error(tmp_path):
    """Random places and bounds: never an index that is not in the matrix."""
    path = tmp_path / "binding.h5"
    generator = np.random.default_rng(11)
    write_binding(path, "few")
    data = path.read_bytes()
    for _ in range(30):
        path.write_bytes(data)
        with h5py.File(path, "r+") as file:
            name = generator.choice(["weights_csr/indices", "weights_csr/indptr"])
            held = file[name][:]
            held[generator.integers(len(held))] = generator.integers(-5, 40)
            file[name][:] = held
        try:
            found = binding_file.read_binding(path).binding.weights
        except InputError:
            continue
        assert found.shape == BINDING.weights.shape
