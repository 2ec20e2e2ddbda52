"""The compiled functions on frames against their bodies in numpy."""

import numpy as np
import pytest

from cageik_cli.geometry.points import place_columns
from cageik_cli.method.solve.alignment import best_motions, move_to_rest
from cageik_cli.method.solve.metrics import METRIC_TYPES, measure
from cageik_cli.util import compiled
from tests.shapes import ball, box

COUNTS = (1, 7, 8, 9, 63, 64, 65, 200)


@pytest.fixture
def in_numpy(monkeypatch):
    """Call a function without the compiled body."""
    if compiled.kernel is None:
        pytest.skip("the core was not compiled")

    def call(function, *arguments):
        with monkeypatch.context() as patch:
            patch.setattr(compiled, "kernel", None)
            return function(*arguments)

    return call


def make_frames(count, frames=3, far=0.0):
    generator = np.random.default_rng(count)
    return generator.normal(size=(frames, count, 3)) + far


@pytest.mark.parametrize("count", COUNTS)
def test_motions_and_columns_are_those_of_numpy(count, in_numpy):
    frames, rest = make_frames(count), make_frames(count, 1)[0]
    weights = np.random.default_rng(1).uniform(0, 2, count)
    centres, rotations = best_motions(frames, rest, weights)
    expected, turns = in_numpy(best_motions, frames, rest, weights)
    np.testing.assert_allclose(centres, expected, atol=1e-14)
    if count > 3:  # fewer points leave a rotation free
        np.testing.assert_allclose(rotations, turns, atol=1e-12)
    columns, in_python = np.full((2, count, 9), np.nan)
    move_to_rest(frames, centres, rotations, rest, columns)
    in_numpy(move_to_rest, frames, centres, rotations, rest, in_python)
    np.testing.assert_allclose(columns, in_python, atol=1e-14)
    placed, in_python = np.full((2, *frames.shape), np.nan)
    place_columns(columns, centres, placed)
    in_numpy(place_columns, columns, centres, in_python)
    np.testing.assert_array_equal(placed, in_python)


@pytest.mark.parametrize("first", [0, 3, 136])
def test_some_points_are_placed_and_the_others_kept(first, in_numpy):
    frames, centres = make_frames(200), make_frames(3, 1)[0]
    columns = np.random.default_rng(3).normal(size=(64, 9))
    placed, in_python = frames.copy(), frames.copy()
    place_columns(columns, centres, placed, first)
    in_numpy(place_columns, columns, centres, in_python, first)
    np.testing.assert_array_equal(placed, in_python)
    is_placed = np.isin(np.arange(200), np.arange(first, first + 64))
    np.testing.assert_array_equal(placed[:, ~is_placed], frames[:, ~is_placed])
    np.testing.assert_array_equal(placed[2, first + 5], columns[5, 6:] + centres[2])


def assert_measured_as_in_numpy(in_numpy, rest, frames, rebuilt, data):
    found, squares = measure(rest, frames, rebuilt, data)
    expected, squares_in_numpy = in_numpy(measure, rest, frames, rebuilt, data)
    np.testing.assert_allclose(squares, squares_in_numpy, rtol=1e-14)
    for name in METRIC_TYPES:
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-13, err_msg=name
        )
    return found, squares


@pytest.mark.parametrize("far", [0.0, 1e4])
def test_measures_are_those_of_numpy(far, in_numpy):
    rest = ball(2)
    noise = 0.1 * make_frames(len(rest.vertices), 4)
    frames = rest.vertices + noise[:2] + far
    found, _ = assert_measured_as_in_numpy(in_numpy, rest, frames, frames + noise[2:], slice(None))
    assert np.isfinite(found.volume).all()


@pytest.mark.parametrize("count", COUNTS)
def test_measures_of_any_number_of_data_vertices_are_those_of_numpy(count, in_numpy):
    rest = ball(2)
    frames, rebuilt = make_frames(2 * len(rest.vertices)).reshape(2, -1, len(rest.vertices), 3)
    chosen = np.sort(np.random.default_rng(count).permutation(len(rest.vertices))[:count])
    found, squares = assert_measured_as_in_numpy(in_numpy, rest, frames, rebuilt, chosen)
    assert np.isin(found.worst_vertex, chosen).all()
    assert np.isnan(found.volume).all() == (count < len(rest.vertices))
    assert np.isnan(squares).sum() == 3 * (len(rest.vertices) - len(chosen))


def test_no_data_vertex_measures_nothing(in_numpy):
    rest = box()
    frames = np.stack([rest.vertices, rest.vertices])
    with np.errstate(invalid="ignore"):
        found, squares = assert_measured_as_in_numpy(
            in_numpy, rest, frames, frames + 1, np.zeros(0, int)
        )
    assert np.isnan(found.rms).all()
    assert np.isnan(found.max_deviation).all()
    assert np.isnan(squares).all()


def test_the_first_of_equal_deviations_is_the_worst():
    rest = box()
    frames = np.stack([rest.vertices, rest.vertices])
    rebuilt = frames.copy()
    rebuilt[1, [5, 2, 7]] += [0, 0, 1]
    assert measure(rest, frames, rebuilt, slice(None))[0].worst_vertex.tolist() == [0, 2]
    data = np.array([3, 5, 7])
    assert measure(rest, frames, rebuilt, data)[0].worst_vertex.tolist() == [3, 5]


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("vertex", [0, 6])
def test_what_is_not_finite_is_not_lost(value, vertex):
    rest = box()
    frames = rest.vertices[None].copy()
    rebuilt = frames.copy()
    rebuilt[0, vertex, 1] = value
    with np.errstate(invalid="ignore"):
        assert not np.isfinite(measure(rest, frames, rebuilt, slice(None))[0].rms[0])


def test_the_compiled_functions_refuse_arrays_that_do_not_fit():
    kernel = compiled.kernel
    if kernel is None:
        pytest.skip("the core was not compiled")
    frames, rest = make_frames(8), make_frames(8, 1)[0]
    weights, columns, centres = np.ones(8), np.empty((8, 9)), np.empty((3, 3))
    turns = np.empty((3, 3, 3))
    wrong = [
        lambda: kernel.sum_moments(frames, weights[1:], rest, centres, turns),
        lambda: kernel.sum_moments(frames, weights, rest[1:], centres, turns),
        lambda: kernel.sum_moments(frames[:, :, :2].copy(), weights, rest, centres, turns),
        lambda: kernel.align_frames(frames, centres[1:], turns, rest, columns),
        lambda: kernel.align_frames(frames, centres, turns[1:], rest, columns),
        lambda: kernel.align_frames(frames, centres, turns, rest, columns[:, :6].copy()),
        lambda: kernel.place_columns(columns, centres, frames, 1),
        lambda: kernel.place_columns(columns, centres, frames, -1),
        lambda: kernel.place_columns(columns, centres, frames, 2**63 - 1),
        lambda: kernel.place_columns(columns, centres, frames[:, 1:].copy(), 0),
        lambda: kernel.place_columns(columns[:, 3:].copy(), centres, frames, 0),
        lambda: kernel.place_columns(columns, centres[1:], frames, 0),
    ]
    for call in wrong:
        with pytest.raises(ValueError, match="expected"):
            call()
    with pytest.raises(TypeError, match="weights: expected an array of float64"):
        kernel.sum_moments(frames, np.ones(8, np.float32), rest, centres, turns)
    frames.flags.writeable = False
    with pytest.raises(TypeError, match="frames: expected a C-contiguous array that"):
        kernel.place_columns(columns, centres, frames, 0)


def test_no_frames_are_placed_at_once():
    """However many points they have; a loop over these would not end."""
    if compiled.kernel is None:
        pytest.skip("the core was not compiled")
    count = 2**45
    compiled.kernel.place_columns(
        np.empty((count, 0)), np.empty((0, 3)), np.empty((0, count, 3)), 0
    )


def test_the_compiled_comparison_refuses_faces_out_of_range_and_other_arrays():
    kernel = compiled.kernel
    if kernel is None:
        pytest.skip("the core was not compiled")
    frames = make_frames(8)
    results = (np.empty((3, 8)), np.empty((3, 5)), np.empty(3, np.int64))
    is_data, faces = np.ones(8, np.uint8), np.array([[0, 1, 7]])
    kernel.compare_frames(frames, frames, is_data, faces, *results)
    for face in ([0, 1, 8], [-1, 0, 1]):
        with pytest.raises(ValueError, match="faces: number"):
            kernel.compare_frames(frames, frames, is_data, np.array([face]), *results)
    for spoiled in (
        (frames, frames[:2], is_data, faces, *results),
        (frames, frames, is_data[1:], faces, *results),
        (frames, frames, is_data, faces, results[0][:, 1:].copy(), *results[1:]),
        (frames, frames, is_data, faces, results[0], results[1][:, 1:].copy(), results[2]),
        (frames, frames, is_data, faces, *results[:2], results[2][1:]),
    ):
        with pytest.raises(ValueError, match="expected"):
            kernel.compare_frames(*spoiled)
    with pytest.raises(TypeError, match="data: expected an array of uint8"):
        kernel.compare_frames(frames, frames, np.ones(8), faces, *results)
