"""The weights before a fit in a result: what is written comes back, and no damage is used."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.store.fit_fields import BaselineErrors
from cageik_cli.store.result import read_baseline_errors, read_result
from cageik_cli.util.errors import FormatError
from tests.store.bindings import as_fitted
from tests.store.damages import assert_refused, replaced, rewritten
from tests.store.test_result import BINDING, FRAMES, written

M, N = BINDING.weights.shape
GENERATOR = np.random.default_rng(4)
CLIP = BaselineErrors(
    frames=np.array([0, 1, 4]),
    rms=np.array([0.5, 0.25, 2.0]),
    misses=GENERATOR.normal(size=(3, M, 3)),
    cage_vertex=2,
    influence=GENERATOR.normal(size=M),
)


def write_result(path, unfitted=CLIP, keep_weights=True):
    fitted = as_fitted(BINDING, "dense")
    return written(path, stored=fitted, keep_weights=keep_weights, unfitted=unfitted)


def test_what_is_written_comes_back(tmp_path):
    found = read_baseline_errors(read_result(write_result(tmp_path / "cages.h5")))
    np.testing.assert_array_equal(found.frames, CLIP.frames)
    np.testing.assert_array_equal(found.rms, CLIP.rms)
    np.testing.assert_array_equal(found.misses, CLIP.misses.astype("f4"))
    np.testing.assert_array_equal(found.influence, CLIP.influence)
    assert found.cage_vertex == 2


@pytest.mark.parametrize("kept", [{"unfitted": None}, {"keep_weights": False}])
def test_a_result_may_hold_nothing(tmp_path, kept):
    assert read_baseline_errors(read_result(write_result(tmp_path / "cages.h5", **kept))) is None


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("frame", np.array([0, 1, FRAMES]), "ascending"),
        ("frame", np.array([-1, 1, 4]), "ascending"),
        ("frame", np.array([0, 4, 1]), "ascending"),
        ("frame", np.array([0, 1, 3]), "ascending"),
        ("frame", np.array([0.0, 1, 4]), "`unfitted/frame`"),
        ("rms", np.array([0.5, np.nan, 2]), "`unfitted/rms`"),
        ("rms", np.array([0.5, -1, 2]), "`unfitted/rms`"),
        ("rms", np.array([0.5, 2]), "`unfitted/rms`"),
        ("misses", np.zeros((2, M, 3)), "`unfitted/misses`"),
        ("misses", np.full((3, M, 3), np.inf), "`unfitted/misses`"),
        ("influence", np.full(M, np.nan), "`unfitted/influence`"),
        ("influence", np.zeros(M + 1), "`unfitted/influence`"),
        ("cage_vertex", np.array([N]), f"is {N}"),
        ("cage_vertex", np.array([-1]), "is -1"),
        ("cage_vertex", np.array([1, 2]), "`unfitted/cage_vertex`"),
    ],
)
def test_damage_is_refused(tmp_path, name, values, words):
    assert_damage_is_refused(tmp_path, replaced(f"unfitted/{name}", values), words)


def assert_damage_is_refused(folder, damage, words):
    """In a result that skipped frame 3."""
    path = write_result(folder / "cages.h5")

    def read(path):
        return read_baseline_errors(replace(read_result(path), skipped={3: "bad"}))

    assert_refused(path, damage, words, read, FormatError)


def test_no_frames_are_refused(tmp_path):
    def damage(file):
        for name in ("frame", "rms"):
            rewritten(f"unfitted/{name}", lambda held: held[:0])(file)

    assert_damage_is_refused(tmp_path, damage, "unfitted/frame")


def test_a_missing_part_is_refused(tmp_path):
    assert_damage_is_refused(tmp_path, replaced("unfitted/influence"), "influence")
