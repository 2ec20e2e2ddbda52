"""Every metric of a report, computed again from the frames and the result."""

import dataclasses

import numpy as np
import pytest
import trimesh

from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.report.record import build_report
from tests.texts import texts

RTOL = 1e-9


def volumes(positions, faces):
    return np.array([trimesh.Trimesh(v, faces, process=False).volume for v in positions])


def column(report, name):
    return np.array([getattr(frame, name) for frame in report.frames])


def test_metrics_of_each_frame(closed, report):
    misses = np.linalg.norm(closed.reconstruction - closed.frames, axis=2)
    diagonal = np.linalg.norm(np.ptp(closed.frames[0], axis=0))
    volume = volumes(closed.frames, closed.faces)
    reconstruction = volumes(closed.reconstruction, closed.faces)
    expected = {
        "rms": np.sqrt((misses**2).sum(axis=1) / 18),
        "rms_percent": 100 * np.sqrt((misses**2).mean(axis=1)) / diagonal,
        "max_deviation": misses.max(axis=1),
        "max_deviation_percent": 100 * misses.max(axis=1) / diagonal,
        "volume": volume,
        "volume_reconstructed": reconstruction,
        "volume_change": 100 * (reconstruction - volume) / volume,
        "volume_drift": 100 * (volume - volume[0]) / volume[0],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(column(report, name), values, rtol=RTOL, atol=1e-10)
    np.testing.assert_array_equal(column(report, "index"), range(5))
    np.testing.assert_array_equal(column(report, "worst_vertex")[1:], misses.argmax(axis=1)[1:])
    assert tuple(column(report, "name")) == closed.result.frames
    assert column(report, "volume_drift")[-1] > 1


def best_possible(frames, cage_vertices):
    """100 times the error that a truncated decomposition leaves of frames moved to the first."""
    rest = frames[0] - frames[0].mean(axis=0)
    columns = []
    for frame in frames - frames.mean(axis=1, keepdims=True):
        left, _, right = np.linalg.svd(rest.T @ frame)
        flip = np.diag([1, 1, np.linalg.det(left @ right)])
        columns.append(frame @ (left @ flip @ right).T - rest)
    values = np.linalg.svd(np.hstack(columns), compute_uv=False)[cage_vertices:]
    return 100 * np.sqrt((values**2).sum() / (len(rest) * len(frames)))


def test_the_summary(closed, report):
    squares = ((closed.reconstruction - closed.frames) ** 2).sum(axis=2)
    diagonal = np.linalg.norm(np.ptp(closed.frames[0], axis=0))
    rms = np.sqrt(squares.mean())
    area_rms = np.sqrt(np.average(squares.mean(axis=0), weights=lumped_areas(closed.result.rest)))
    means = closed.frames.mean(axis=1, keepdims=True)
    kg_error = 100 * np.sqrt(squares.sum()) / np.linalg.norm(closed.frames - means)
    change = column(report, "volume_change")
    worst, largest = np.sqrt(squares.mean(axis=1)).argmax(), np.abs(change).argmax()
    furthest, vertex = np.unravel_index(squares.argmax(), squares.shape)
    names = closed.result.frames
    found = dataclasses.asdict(report.summary)
    exact = {
        "worst_frame": names[worst],
        "worst_frame_index": worst,
        "max_deviation_frame": names[furthest],
        "max_deviation_vertex": vertex,
        "volume_change_frame": names[largest],
        "floats_per_frame": 3 * 8,
        "fixed_floats": 18 * 8,
        "frames_skipped": 0,
        "gap_closed_percent": None,
        "held_out_rms_percent": None,
        "worst_part": None,
    }
    assert {name: found.pop(name) for name in exact} == exact
    best = best_possible(closed.frames, cage_vertices=8) / diagonal
    assert closed.result.bound.rms_percent == pytest.approx(best, abs=1e-6)
    assert found.pop("best_possible_percent") is None  # five frames
    assert found == pytest.approx(
        {
            "rms": rms,
            "rms_percent": 100 * rms / diagonal,
            "area_rms": area_rms,
            "area_rms_percent": 100 * area_rms / diagonal,
            "worst_frame_rms": np.sqrt(squares.mean(axis=1).max()),
            "worst_frame_rms_percent": 100 * np.sqrt(squares.mean(axis=1).max()) / diagonal,
            "max_deviation": np.sqrt(squares.max()),
            "max_deviation_percent": 100 * np.sqrt(squares.max()) / diagonal,
            "volume_change_percent_max": change[largest],
            "volume_drift_percent_max": max(column(report, "volume_drift"), key=abs),
            "radius_rms_percent": 100 * rms,  # of a ball of radius 1
            "e_rms": 1154.7005383792516 * rms / diagonal,
            "kg_error": kg_error,
        },
        rel=RTOL,
    )


def test_clip_binding_and_provenance(closed, report):
    result = closed.result
    assert dataclasses.asdict(report.clip) == {
        "frames": 5,
        "vertices": 18,
        "cage_vertices": 8,
        "diagonal": pytest.approx(np.linalg.norm(np.ptp(closed.frames[0], axis=0))),
        "radius": pytest.approx(1.0),
        "closed": True,
        "fps": 24.0,
        "start": 1,
        "frame_step": 1,
        "body": True,
        "metres_per_unit": 1.0,
    }
    assert set(dataclasses.asdict(report.binding)) == {
        "partition_of_unity", "linear_precision", "min_weight", "panels", "estimated_error",
        "projected", "condition_number",
    }  # fmt: skip
    assert report.binding.partition_of_unity < 1e-12
    assert (report.schema, report.result, report.gates) == (1, "cages.h5", ())
    assert report.tool == {"name": "cageik", "version": result.version}
    assert (report.sources, report.settings) == (result.sources, result.settings)


def test_an_open_model_has_no_volumes_and_a_note(opened, closed):
    report = build_report(opened.result)
    for name in ("volume", "volume_reconstructed", "volume_change", "volume_drift"):
        assert set(column(report, name)) == {None}
    summary = report.summary
    assert summary.volume_change_percent_max is None
    assert summary.volume_change_frame is None
    assert summary.volume_drift_percent_max is None
    assert not report.clip.closed
    assert len([note for note in texts(report.notes) if "volume" in note]) == 1
    # The rest depends on the vertices alone.
    assert summary.rms == pytest.approx(build_report(closed.result).summary.rms, rel=RTOL)


def test_a_frame_of_one_point_has_metrics(make_case, animation):
    frames = np.array([animation.frames[0], np.zeros((18, 3))])
    report = build_report(make_case(frames, animation.rest.faces).result)
    assert report.frames[1].volume == 0
    assert report.frames[1].volume_change is None
    assert report.frames[1].volume_drift == pytest.approx(-100)
    assert report.summary.kg_error > 0
