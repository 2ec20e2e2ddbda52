import numpy as np
import pytest
import trimesh

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.method.solve import metrics
from tests.shapes import ball, rotation

REST = ball(1)
ALL = slice(None)


def measure(rest, frames, rebuilt, counted):
    return metrics.measure(rest, frames, rebuilt, counted)[0]


def clip():
    generator = np.random.default_rng(0)
    frames = np.stack([REST.vertices * (1 + 0.1 * k) + k for k in range(3)])
    return frames, frames + 0.01 * generator.normal(size=frames.shape)


def test_metrics_equal_their_definitions():
    frames, rebuilt = clip()
    metrics = measure(REST, frames, rebuilt, ALL)
    for k in range(3):
        misses = np.linalg.norm(rebuilt[k] - frames[k], axis=1)
        assert metrics.rms[k] == pytest.approx(np.sqrt((misses**2).mean()), rel=1e-12)
        assert metrics.max_deviation[k] == pytest.approx(misses.max(), rel=1e-12)
        assert metrics.worst_vertex[k] == misses.argmax()
        assert metrics.spread[k] == pytest.approx(
            np.sqrt(((frames[k] - frames[k].mean(axis=0)) ** 2).sum(axis=1).mean()), rel=1e-12
        )
        for found, vertices in ((metrics.volume, frames), (metrics.volume_reconstructed, rebuilt)):
            other = trimesh.Trimesh(vertices[k], REST.faces, process=False).volume
            assert found[k] == pytest.approx(other, rel=1e-11)


def test_an_exact_reconstruction_has_no_error():
    frames, _ = clip()
    metrics = measure(REST, frames, frames.copy(), ALL)
    assert (metrics.rms == 0).all()
    assert (metrics.max_deviation == 0).all()
    np.testing.assert_array_equal(metrics.volume, metrics.volume_reconstructed)


def test_volumes_of_an_open_model_are_not_numbers():
    frames, rebuilt = clip()
    metrics = measure(TriMesh(REST.vertices, REST.faces[1:]), frames, rebuilt, ALL)
    assert np.isnan(metrics.volume).all()
    assert np.isnan(metrics.volume_reconstructed).all()
    np.testing.assert_allclose(metrics.rms, measure(REST, frames, rebuilt, ALL).rms)


def test_only_data_vertices_count():
    frames, rebuilt = clip()
    counted = np.array([0, 4, 9])
    rebuilt[:, 5] += 100
    metrics = measure(REST, frames, rebuilt, counted)
    expected = np.sqrt(((rebuilt - frames)[:, counted] ** 2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(metrics.rms, expected, rtol=1e-12)
    assert set(metrics.worst_vertex) <= {0, 4, 9}


def test_volumes_are_not_known_where_vertices_are_missing():
    frames, rebuilt = clip()
    for counted in (np.arange(1, len(REST.vertices)), np.array([0, 4, 9])):
        metrics = measure(REST, frames, rebuilt, counted)
        assert np.isnan(metrics.volume).all()
        assert np.isnan(metrics.volume_reconstructed).all()
    everything = measure(REST, frames, rebuilt, np.arange(len(REST.vertices)))
    np.testing.assert_array_equal(everything.volume, measure(REST, frames, rebuilt, ALL).volume)


def test_captured_frames_have_the_volumes_of_others():
    """None of a double-sided sheet; and a vertex that is in no face is none that is missing."""
    frames, rebuilt = clip()
    flat = TriMesh(REST.vertices * [1, 1, 0], np.vstack([REST.faces, REST.faces[:, ::-1]]))
    stray = TriMesh(np.vstack([REST.vertices, [[9.0, 9, 9]]]), REST.faces)
    more = np.pad(frames, ((0, 0), (0, 1), (0, 0))), np.pad(rebuilt, ((0, 0), (0, 1), (0, 0)))
    for rest, (given, found) in (
        (REST, (frames, rebuilt)),
        (flat, (frames, rebuilt)),
        (stray, more),
    ):
        is_data = np.broadcast_to(rest.is_used, given.shape[:2])
        plain = measure(rest, given, found, rest.used_vertices)
        kept = metrics.measure(rest, given, found, is_data, is_kept=is_data)[0]
        np.testing.assert_allclose(kept.volume, plain.volume, rtol=1e-9, atol=0)
        np.testing.assert_allclose(
            kept.volume_reconstructed, plain.volume_reconstructed, rtol=1e-9, atol=0
        )
        assert np.isnan(kept.volume).all() == (rest is flat)


def test_errors_by_area_are_over_all_data_and_over_what_was_kept():
    generator, areas = np.random.default_rng(1), lumped_areas(REST) * np.arange(len(REST.vertices))
    squares = generator.random((3, len(areas)))
    is_data = generator.random(squares.shape) < 0.8
    is_kept = is_data & (generator.random(squares.shape) < 0.8)
    is_kept[1], areas[0] = is_data[1], 0
    is_data[2] = is_kept[2] = areas == 0
    found = metrics.measure_kept(np.where(is_data, squares, np.nan), is_data, is_kept, areas)
    for column, mask in ((found.area_rms, is_data), (found.area_rms_kept, is_kept)):
        expected = [np.average(squares[k][mask[k]], weights=areas[mask[k]]) for k in range(2)]
        np.testing.assert_allclose(column, [*np.sqrt(expected), np.nan], rtol=1e-12, atol=0)
    assert found.area_rms[1] == found.area_rms_kept[1]
    even = metrics.measure_kept(squares, is_data, is_kept, np.full(len(areas), 2e99))
    np.testing.assert_allclose(even.area_rms_kept, even.rms_kept, rtol=1e-12, atol=0)
    nothing = metrics.measure_kept(squares, is_data, is_kept, np.zeros(len(areas)))
    assert np.isnan([nothing.area_rms, nothing.area_rms_kept]).all()


def test_metrics_do_not_change_with_a_rigid_motion():
    frames, rebuilt = clip()
    turn = rotation(1)
    moved = measure(REST, frames @ turn.T + 50, rebuilt @ turn.T + 50, ALL)
    still = measure(REST, frames, rebuilt, ALL)
    np.testing.assert_allclose(moved.rms, still.rms, rtol=1e-10)
    np.testing.assert_allclose(moved.volume, still.volume, rtol=1e-10)
    np.testing.assert_array_equal(moved.worst_vertex, still.worst_vertex)


def test_squared_errors_are_nan_for_missing_data():
    frames, rebuilt = clip()
    expected = np.linalg.norm(rebuilt - frames, axis=2) ** 2
    found = metrics.measure(REST, frames, rebuilt, ALL)[1]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    counted = np.array([0, 4, 9])
    some = metrics.measure(REST, frames, rebuilt, counted)[1]
    np.testing.assert_allclose(some[:, counted], expected[:, counted], rtol=1e-12)
    assert np.isnan(np.delete(some, counted, axis=1)).all()
