"""Runs in which the largest deviations are lowered: what they give, record, resume and refuse."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli import bind, fit_weights, load_clip, load_mesh, read_result
from cageik_cli import extract as extract_arrays
from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.method.solve.settings import FITTED_NORM, SolveSettings
from cageik_cli.run.bind import bind_files
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import BindRunSettings, ExtractSettings
from cageik_cli.util.errors import CheckpointError, SettingError
from tests.refusals import refused

SIX = SolveSettings(norm=6)


@pytest.fixture(scope="module")
def walker(fixtures_folder, weights_cache, tmp_path_factory):
    """Settings for every fourth frame of the walking figure."""
    frames = fixtures_folder / "walker" / "frames"
    return ExtractSettings(
        frames=tuple(str(frames / f"walker_{k}.obj") for k in range(1, 49, 4)),
        cage=fixtures_folder / "walker" / "cage.obj",
        output=tmp_path_factory.mktemp("walker") / "cages.h5",
        cache=weights_cache,
        overwrite=True,
    )


def test_the_largest_deviation_of_a_clip_falls(walker):
    plain = extract(walker).metrics
    even = extract(replace(walker, solve=SIX)).metrics
    assert even.max_deviation.max() < 0.85 * plain.max_deviation.max()
    assert (even.max_deviation <= plain.max_deviation).all()
    rms = [np.sqrt(np.mean(one.rms**2)) for one in (plain, even)]
    assert rms[0] < rms[1] < 1.05 * rms[0]


def test_the_norm_is_recorded_where_it_is_stated(walker):
    assert extract(replace(walker, solve=SIX)).settings["norm"] == 6
    assert extract(replace(walker, solve=SolveSettings(norm=2))).settings["norm"] == 2
    assert "norm" not in extract(walker).settings


def test_threads_and_memory_do_not_change_a_byte(walker):
    settings = replace(walker, solve=SIX)
    first = extract(settings).path.read_bytes()
    assert extract(replace(settings, jobs=3, memory=1)).path.read_bytes() == first


def test_another_norm_is_another_result(walker):
    settings = replace(walker, solve=SIX, output=walker.output.with_name("six.h5"))
    extract(settings)
    again = replace(settings, overwrite=False, resume=True)
    assert extract(again).settings["norm"] == 6
    with refused(CheckpointError, "is the result of other settings"):
        extract(replace(again, solve=SolveSettings(norm=4)))


def test_the_arrays_of_the_api_have_it(walker):
    result = extract(replace(walker, solve=SIX))
    clip = load_clip(list(walker.frames))
    binding = bind(clip.first, load_mesh(walker.cage))
    even, plain = (extract_arrays(clip, binding, norm=norm) for norm in (6, 2))
    assert even.metrics.max_deviation.max() < 0.85 * plain.metrics.max_deviation.max()
    np.testing.assert_allclose(even.metrics.rms, result.metrics.rms, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    "options",
    [
        {"capture": CaptureSettings(robust=True)},
        {"capture": CaptureSettings(smooth=0.2)},
        {"capture": CaptureSettings(fill_gaps=True)},
        {"clip": ClipSettings(missing=True)},
    ],
)
def test_captured_data_is_refused(walker, options):
    with refused(SettingError, "norm is 6, but the data may be noisy or missing"):
        replace(walker, solve=SIX, **options)
    assert replace(walker, **options).solve.norm is None


def test_weights_per_frame_are_refused(walker, tmp_path):
    np.save(tmp_path / "weights.npy", np.ones((12, 1570)))
    settings = replace(walker, vertex_weights=tmp_path / "weights.npy")
    with refused(SettingError, "norm is 6, but the data may be noisy or missing"):
        extract(replace(settings, solve=SIX))
    assert read_result(extract(settings).path).settings["vertex_weights"] is True


def test_the_command_names_its_option(run, folder):
    words = ("extract", "frames", "--cage", "cage.obj", "-o", "a.h5", "--norm", "6")
    outcome = run(*words, "--robust")
    assert outcome.code == 2
    assert "leave out --norm" in outcome.err
    assert not Path("a.h5").exists()
    assert run(*words).code == 0
    assert "norm 6" in run("info", "a.h5").out


@pytest.fixture
def fitted(walker, tmp_path):
    """Settings for a quick fit."""
    return replace(walker, fit=FitSettings(regularization=0.1), output=tmp_path / "fitted.h5")


def test_the_norm_of_a_fit_is_that_of_least_squares_only_if_asked_for(fitted):
    even = extract(fitted)
    assert (even.settings["norm"], even.fit.solve.norm) == (FITTED_NORM, FITTED_NORM)
    plain = extract(replace(fitted, solve=SolveSettings(norm=2)))
    assert (plain.settings["norm"], plain.fit.solve.norm) == (2, 2)
    assert even.metrics.max_deviation.max() < 0.9 * plain.metrics.max_deviation.max()
    rms = [np.sqrt(np.mean(one.metrics.rms**2)) for one in (even, plain)]
    assert rms[0] < 1.03 * rms[1]


def test_a_cage_that_is_built_has_it_too(walker, tmp_path):
    frames = {"frames": walker.frames[:4], "cage": None, "output": tmp_path / "built.h5"}
    assert extract(replace(walker, **frames)).settings["norm"] == FITTED_NORM
    assert "norm" not in extract(replace(walker, fit=False, **frames)).settings


@pytest.mark.parametrize("settings", [FitSettings(rank=3), FitSettings(influences=4)])
def test_weights_of_few_numbers_have_cages_of_least_squares(fitted, settings):
    result = extract(replace(fitted, fit=settings))
    assert "norm" not in result.settings
    assert result.fit.solve.norm is None


def test_outliers_are_not_followed_without_being_asked_for(fitted, monkeypatch):
    monkeypatch.setattr("cageik_cli.run.fit.has_outlier_vertices", lambda *_: True)
    assert "norm" not in extract(fitted).settings
    assert extract(replace(fitted, solve=SIX)).settings["norm"] == 6


def test_a_fitted_binding_brings_the_norm_of_its_fit(fitted, tmp_path):
    expected = extract(fitted)
    path = tmp_path / "binding.h5"
    words = {"fit": fitted.fit, "overwrite": True}
    bound = BindRunSettings(fitted.cage, Path(fitted.frames[0]), path, clips=fitted.frames, **words)
    assert bind_files(bound).fit.solve.norm == FITTED_NORM
    through = replace(fitted, fit=None, cage=None, binding=path, rest=Path(fitted.frames[0]))
    result = extract(through)
    assert result.settings["norm"] == FITTED_NORM
    np.testing.assert_allclose(result.metrics.rms, expected.metrics.rms, rtol=0.05, atol=1e-9)
    robust = extract(replace(through, capture=CaptureSettings(robust=True)))
    assert "norm" not in robust.settings
    bind_files(replace(bound, solve=SolveSettings(norm=2)))
    assert "norm" not in extract(through).settings


@pytest.mark.parametrize("form", [FitSettings(), FitSettings(rank=3)])
def test_a_binding_brings_its_own_norm(fitted, tmp_path, form):
    own = SolveSettings(norm=3)
    path = tmp_path / "own.h5"
    bind_files(
        BindRunSettings(
            fitted.cage,
            Path(fitted.frames[0]),
            path,
            clips=(str(Path(fitted.frames[0]).parent),),
            fit=form,
            solve=own,
        )
    )
    words = {"cage": None, "fit": None, "binding": path}
    assert extract(replace(fitted, **words)).settings["norm"] == 3
    two = replace(fitted, **words, solve=SolveSettings(norm=2))
    assert extract(two).settings["norm"] == 2


@pytest.mark.parametrize("power", [6.0, 8.0])
def test_a_spike_does_not_make_a_norm_diverge(walker, power):
    """Beyond a norm of 8 the rounds would: the largest deviation stays near that of the spike."""
    clip = load_clip(list(walker.frames))
    frames = np.stack([clip.read_frame(k) for k in range(len(clip))])
    frames[::3, 700] += (1.0, 0.5, 0.2)
    binding = bind(clip.first, load_mesh(walker.cage), accuracy="preview")
    plain, even = (extract_arrays(frames, binding, norm=p) for p in (2.0, power))
    assert (even.max_deviation <= 1.01 * plain.max_deviation).all()


def test_the_api_chooses_the_same(fitted):
    expected = extract(fitted)
    clip = load_clip(list(fitted.frames))
    binding = bind(clip.first, load_mesh(fitted.cage))
    animation = extract_arrays(clip, binding, fit=fitted.fit)
    np.testing.assert_allclose(animation.metrics.rms, expected.metrics.rms, rtol=1e-6, atol=1e-9)
    found = fit_weights(binding, [clip], fitted.fit)
    assert found.fit.solve.norm == FITTED_NORM
    np.testing.assert_array_equal(found.binding.weights, animation.binding.weights)
    plain = extract_arrays(clip, binding, fit=fitted.fit, norm=2)
    assert animation.metrics.max_deviation.max() < 0.9 * plain.metrics.max_deviation.max()
