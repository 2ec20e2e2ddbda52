"""Fitted results keep the error of the weights before the fit: right, repeatable, and sparing."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.fit.settings import FitSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.record import build_report
from cageik_cli.run.bind import bind_files
from cageik_cli.run.extraction import extract
from cageik_cli.run.fit import choose_compared_frames, find_changed_vertex
from cageik_cli.run.settings import BindRunSettings, ExtractSettings
from cageik_cli.store.result import read_result
from tests.fitted import clip_of, small_binding, true_weights

BINDING = small_binding()
FRAMES = clip_of(BINDING, true_weights(BINDING), 12)
CAGE = TriMesh(1.6 * BINDING.cage.vertices, BINDING.cage.faces)
MEAN_VALUE = BindSettings("mean-value")


@pytest.fixture
def run(tmp_path, write_obj):
    """A function that extracts the clip, fitted, with mean value weights, which are fast."""
    np.savez(tmp_path / "clip.npz", verts=FRAMES, faces=BINDING.rest.faces)
    write_obj(tmp_path / "cage.obj", CAGE.vertices, CAGE.faces)
    write_obj(tmp_path / "rest.obj", BINDING.rest.vertices, BINDING.rest.faces)

    def start(name="cages.h5", **changes):
        settings = ExtractSettings(
            (str(tmp_path / "clip.npz"),),
            tmp_path / "cage.obj",
            tmp_path / name,
            rest=tmp_path / "rest.obj",
            bind=MEAN_VALUE,
            fit=FitSettings(),
        )
        return extract(replace(settings, **changes))

    return start


def test_errors_and_shapes_are_those_of_a_run_without_a_fit(run):
    """With cages of least squares, as such a run has by default."""
    fitted, plain = run(), run("plain.h5", fit=None)
    binding = bind(plain.rest, plain.cage, MEAN_VALUE)
    with h5py.File(fitted.path) as file, h5py.File(plain.path) as other:
        held = file["unfitted"]
        np.testing.assert_array_equal(held["frame"][:], np.arange(12))
        np.testing.assert_allclose(held["rms"][:], plain.metrics.rms, rtol=1e-9, atol=1e-12)
        assert (plain.metrics.rms > fitted.metrics.rms).mean() > 0.8
        kept = file["poses/frame"][:]
        rebuilt = other["weights"][:] @ other["verts"][:][kept]
        expected = (FRAMES[kept] - rebuilt) / fitted.rest.diagonal
        np.testing.assert_allclose(held["misses"][:], expected, rtol=0, atol=1e-6)
        vertex = int(held["cage_vertex"][0])
        changes = np.linalg.norm(file["weights"][:] - binding.weights, axis=0)
        assert vertex == np.argmax(changes)
        np.testing.assert_allclose(held["influence"][:], binding.weights[:, vertex], atol=1e-12)


@pytest.mark.parametrize(
    "changes", [{"fit": None}, {"fit": FitSettings(rank=2), "keep_weights": False}]
)
def test_nothing_is_kept_without_a_fit_or_without_weights(run, changes):
    result = run(**changes)
    with h5py.File(result.path) as file:
        assert "unfitted" not in file
    assert read_result(result.path).frames == result.frames


@pytest.mark.parametrize(("count", "keys"), [(5, [1]), (64, [3]), (500, [7, 499, 8]), (1, [0])])
def test_chosen_frames_are_spread_and_hold_the_key_frames(count, keys):
    known = 2 * np.arange(count)
    keys = [int(known[k]) for k in keys]
    chosen, most = choose_compared_frames(known, keys), 64
    assert chosen == sorted(set(chosen))
    assert set(keys) <= set(chosen) <= set(known.tolist())
    assert len(chosen) <= most + len(keys)
    assert (chosen[0], chosen[-1]) == (known[0], known[-1])
    assert np.diff(chosen).max(initial=0) <= 2 * max(1, np.ceil((count - 1) / (most - 1)))


@pytest.mark.parametrize(
    ("form", "cache"),
    [
        (FitSettings(), None),
        (FitSettings(rank=2), "cache"),
        (FitSettings(influences=4), "cache"),
    ],
)
def test_a_fitted_binding_file_is_compared_as_its_own_run(run, tmp_path, form, cache):
    """The weights before the fit are not in the file: they are computed again, or cached."""
    cache = cache and tmp_path / cache
    expected = run("own.h5", fit=form)
    plain = run("plain.h5", fit=None)
    bind_files(
        BindRunSettings(
            tmp_path / "cage.obj",
            tmp_path / "rest.obj",
            tmp_path / "binding.h5",
            WeightSettings(MEAN_VALUE, cache),
            clips=(str(tmp_path / "clip.npz"),),
            fit=form,
        )
    )
    words = {"cage": None, "fit": None, "binding": tmp_path / "binding.h5", "cache": cache}
    found = run(**words)
    with h5py.File(expected.path) as own, h5py.File(found.path) as other:
        assert list(own["unfitted"]) == list(other["unfitted"])
        for name, held in own["unfitted"].items():
            np.testing.assert_array_equal(other["unfitted"][name][:], held[:], name)
        np.testing.assert_allclose(own["unfitted/rms"][:], plain.metrics.rms, rtol=1e-9)
    assert build_report(found).unfitted == build_report(expected).unfitted is not None
    bare = run("bare.h5", keep_weights=False, **words)
    with h5py.File(bare.path) as file:
        assert "unfitted" not in file


def test_the_vertex_with_the_largest_change_is_found():
    after = BINDING.weights.copy()
    after[:, 5] += 0.1
    after[0, 3] += 0.2
    assert find_changed_vertex(BINDING.weights, after) == 5
