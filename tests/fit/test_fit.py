from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.cages.bind import bind
from cageik_cli.fit.fit import MAX_HELD_OUT_ROUNDS, Fitter
from cageik_cli.fit.problem import estimate_memory
from cageik_cli.fit.settings import FitSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import normalize_weights
from cageik_cli.method.weights.binding import Binding
from cageik_cli.run.api import extract
from cageik_cli.util.errors import CageError, ConnectivityError, SettingError
from tests.fitted import Frames, clip_of, small_binding, true_weights
from tests.shapes import rotation

BINDING = small_binding()
CLIP = clip_of(BINDING, true_weights(BINDING), 24)


def fit(frames=CLIP, binding=BINDING, conditions=None, **settings_):
    """The fitted weights; conditions are those of a `Fitter`."""
    return Fitter(binding, FitSettings(**settings_), **(conditions or {})).fit([Frames(frames)])


def report_of(*arguments, **settings_):
    return fit(*arguments, **settings_).report


EXPECTED = fit().binding


def test_fitted_weights_are_nearer_and_affine_exact():
    found = fit()
    quality = found.binding.quality
    assert quality.partition_of_unity < 1e-12
    assert quality.linear_precision < 1e-12
    before, after = extract(CLIP, BINDING).rms_percent, extract(CLIP, found.binding).rms_percent
    assert after < 0.6 * before
    assert found.report.fitted.fitted.rms == pytest.approx(after, rel=1e-6)
    assert found.report.fitted.unfitted.rms == pytest.approx(before, rel=1e-6)


def test_frames_of_known_weights_are_reproduced_as_the_regularization_vanishes():
    """Weights and cages are found together, so only their products are unique."""
    solve = {"solve": SolveSettings(alpha=1e-9)}
    errors = [
        report_of(CLIP, conditions=solve, regularization=s, smoothness=s).fitted.fitted.rms
        for s in (1e-1, 1e-3, 1e-5)
    ]
    assert errors[1] < errors[0] / 5
    assert errors[2] < errors[1] / 5


def test_the_report_describes_the_weights():
    found = fit()
    report, weights = found.report, found.binding.weights
    largest = np.abs(extract(CLIP, found.binding).max_deviation).max() / BINDING.rest.diagonal
    assert report.fitted.fitted.largest == pytest.approx(100 * largest, rel=1e-5)
    assert report.fitted.fitted.percentile < report.fitted.fitted.largest
    assert report.negative_per_row == pytest.approx(-np.minimum(weights, 0).sum() / len(weights))
    assert report.min_weight == weights.min()
    assert report.fixed_floats == weights.size
    assert (report.frames, report.fitted_frames) == (24, 24)
    assert report.held_out_blocks.fitted.rms > report.fitted.fitted.rms
    assert report.unseen_third.frames == 8
    assert report.needed_memory is None


def test_held_out_frames_do_not_change_what_is_fitted_to_the_others(monkeypatch):
    """The error on the last third is that of a fit which never had it."""
    reported = report_of().unseen_third.fitted.rms
    monkeypatch.setattr("cageik_cli.fit.fit.MAX_ROUNDS", MAX_HELD_OUT_ROUNDS)
    seen = fit(CLIP[:16])
    # The sample of the whole clip has the same frames, so the fits are the same.
    assert extract(CLIP[16:], seen.binding).rms_percent == pytest.approx(reported, rel=1e-6)


def test_one_frame_cannot_be_held_out():
    report = report_of(CLIP[:1])
    assert report.held_out_blocks is None
    assert report.unseen_third is None


def test_a_clip_that_does_not_move_leaves_the_weights():
    still = np.repeat(BINDING.rest.vertices[None], 4, axis=0)
    found = fit(still)
    np.testing.assert_allclose(found.binding.weights, BINDING.weights, rtol=0, atol=1e-9)


@settings(max_examples=8, deadline=None)
@given(st.floats(0.01, 100), st.integers(0, 100))
def test_similarity_transforms_of_the_input_do_not_change_the_weights(scale, seed):
    turn, shift = rotation(seed), np.array([3.0, -1, 2])

    def move(points):
        return scale * points @ turn.T + shift

    moved = Binding(
        TriMesh(move(BINDING.rest.vertices), BINDING.rest.faces),
        TriMesh(move(BINDING.cage.vertices), BINDING.cage.faces),
        BINDING.weights,
    )
    found = fit(move(CLIP), moved)
    np.testing.assert_allclose(found.binding.weights, EXPECTED.weights, rtol=0, atol=1e-7)


def test_a_word_of_the_command_line_is_no_number():
    """There `auto` stands for None."""
    with pytest.raises(SettingError, match="`regularization=` is 'auto', expected a finite"):
        FitSettings("auto")


@pytest.mark.parametrize("kind", [{}, {"rank": 3}, {"influences": 4}])
def test_missing_vertices_are_ignored(kind):
    counts = np.ones(len(BINDING.rest.vertices))
    counts[10:20] = 0
    conditions = {"vertex_weights": normalize_weights(counts, len(counts))}
    damaged = CLIP.copy()
    damaged[:, 10:20] += np.random.default_rng(0).normal(size=(len(CLIP), 10, 3))
    found, expected = (fit(c, conditions=conditions, **kind) for c in (damaged, CLIP))
    np.testing.assert_array_equal(found.binding.weights, expected.binding.weights)
    assert found.report == expected.report
    assert np.abs(found.binding.weights - fit(**kind).binding.weights).max() > 1e-6


@pytest.mark.parametrize("kind", [{}, {"rank": 3}, {"influences": 4}, {"use": "play"}])
def test_threads_do_not_change_a_bit(kind):
    one, three = (fit(conditions={"jobs": jobs}, **kind) for jobs in (1, 3))
    np.testing.assert_array_equal(one.binding.weights, three.binding.weights)
    assert one.report == three.report


def test_low_rank_weights_are_of_that_rank_and_exact():
    found = fit(rank=3)
    change = found.binding.weights - BINDING.weights
    assert np.linalg.matrix_rank(change, tol=1e-10) == 3
    model = found.low_rank
    np.testing.assert_allclose(change, model.columns @ model.basis.T, rtol=0, atol=1e-14)
    m, n = change.shape
    assert found.report.fixed_floats == 3 * (m + n)
    assert found.binding.quality.linear_precision < 1e-12
    assert report_of().fitted.fitted.rms < found.report.fitted.fitted.rms
    assert found.report.fitted.fitted.rms < found.report.fitted.unfitted.rms


def test_a_refit_is_better_than_the_truncation():
    whole = fit().binding.weights
    vectors = np.linalg.svd(whole - BINDING.weights, full_matrices=False)[2][:5]
    cut = BINDING.weights + (whole - BINDING.weights) @ vectors.T @ vectors
    truncated = extract(CLIP, replace(BINDING, weights=cut)).rms_percent
    assert report_of(rank=5).fitted.fitted.rms < 0.99 * truncated


def test_the_largest_rank_is_the_whole_change():
    freedom = len(BINDING.cage.vertices) - 4
    found = report_of(rank=freedom).fitted.fitted.rms
    assert found == pytest.approx(report_of().fitted.fitted.rms, rel=0.05)


@pytest.mark.parametrize(
    ("kind", "named"),
    [({"rank": 15}, "rank is 15.*give 14"), ({"influences": 19}, "influences is 19.*give 18")],
)
def test_more_than_the_cage_has_vertices_for_is_refused(kind, named):
    with pytest.raises(SettingError, match=named):
        fit(**kind)


def test_a_cage_of_four_vertices_is_refused():
    cage = TriMesh(
        np.array([[-4.0, -4, -4], [12, -4, -4], [-4, 12, -4], [-4, -4, 12]]),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    )
    with pytest.raises(CageError, match="4 vertices, which determine the weights"):
        fit(binding=bind(BINDING.rest, cage))


def test_a_low_rank_change_of_weights_with_offsets_is_refused():
    with pytest.raises(SettingError, match="do not reproduce the rest pose"):
        fit(binding=fit(influences=4).binding, rank=2)


def test_weights_are_not_fitted_to_rounding():
    """A rigid motion in files of few digits."""
    still = np.repeat(BINDING.rest.vertices[None], 12, axis=0)
    report = report_of(still + 1e-6 * np.random.default_rng(0).normal(size=still.shape))
    assert report.roughness == pytest.approx(1, abs=0.1)
    assert not report.is_overfitted
    assert not report.is_gainless


def test_a_fit_to_noise_gains_nothing_on_other_frames():
    still = np.repeat(BINDING.rest.vertices[None], 12, axis=0)
    report = report_of(still + 1e-2 * np.random.default_rng(0).normal(size=still.shape))
    assert report.is_gainless


def test_few_influences_are_sparse_and_reproduce_the_rest_pose():
    found = fit(influences=4)
    assert np.count_nonzero(found.binding.weights, axis=1).max() <= 4
    assert found.binding.weights.min() == 0
    np.testing.assert_allclose(found.binding.weights.sum(axis=1), 1, rtol=0, atol=1e-12)
    stored = (
        2 * np.count_nonzero(found.binding.weights) + found.binding.rest.vertices.size
    )  # with their places
    assert found.report.fixed_floats == stored
    turned = BINDING.rest.vertices @ rotation(1).T + [1, 2, 3]
    assert extract(turned[None], found.binding).rms_percent < 1e-10
    rms = extract(CLIP, found.binding).rms_percent
    assert found.report.fitted.fitted.rms == pytest.approx(rms, rel=1e-6)
    assert found.report.min_weight >= 0
    animation = extract(CLIP, found.binding)
    error = animation.reconstruct(7) - CLIP[7]
    assert np.sqrt(np.square(error).sum(axis=1).mean()) == pytest.approx(animation.rms[7])


def test_more_influences_are_better():
    rms = [report_of(influences=k).fitted.fitted.rms for k in (2, 4, 8)]
    assert rms[0] > rms[1] > rms[2]


def test_several_clips_are_fitted_together():
    clips = [Frames(CLIP[:10]), Frames(CLIP[10:])]
    report = Fitter(BINDING).fit(clips).report
    assert report.frames == 24
    assert report.unseen_third.frames == 3 + 4


def test_frames_of_another_model_are_refused():
    with pytest.raises(ConnectivityError, match="frame 0 of clip 0"):
        fit(CLIP[:, :-1])


@pytest.mark.parametrize("jobs", [1, 3])
def test_threads_take_no_memory_from_the_sample(jobs):
    """A model for which the limit has room for one thread."""
    m, n = BINDING.weights.shape
    memory = estimate_memory(m, n, 1) + 10 * 2 * 3 * 4 * m
    report = report_of(conditions={"memory": memory, "jobs": jobs})
    assert report.fitted_frames == 10
    assert report.needed_memory == estimate_memory(m, n, 1) + 24 * 2 * 3 * 4 * m


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"regularization": 0.0}, "`regularization=` is 0.0"),
        ({"regularization": np.nan}, "`regularization=` is nan"),
        ({"smoothness": -1.0}, "`smoothness=` is -1.0"),
        ({"rank": 0}, "`rank=` is 0"),
        ({"influences": 0}, "`influences=` is 0"),
        ({"rank": 2, "influences": 4}, "rank is 2"),
    ],
)
def test_settings_that_mean_nothing_are_refused(wrong, named):
    with pytest.raises(SettingError, match=named):
        FitSettings(**wrong)
