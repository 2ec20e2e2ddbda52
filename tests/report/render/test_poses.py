"""The poses of a page and the errors of vertices, compared with the frames."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.report.record import build_report
from cageik_cli.report.render.model_views import load_poses
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings


def vertex_errors(case):
    return np.linalg.norm(case.reconstruction - case.frames, axis=2)


def diagonal(case):
    return np.linalg.norm(np.ptp(case.frames[0], axis=0))


def test_the_poses_are_the_frames_of_their_names(closed):
    poses = load_poses(closed.result)
    rest, worst, median, best = poses.poses
    order = np.argsort((vertex_errors(closed) ** 2).mean(axis=1))
    # The rest pose, which is exact, is not the best frame.
    assert order[0] == 0
    numbers = {"worst": order[-1], "median": order[2], "best": order[1]}
    assert [pose.label for pose in poses.poses] == ["rest", "worst", "median", "best"]
    assert rest.name == "rest pose"
    for pose in (worst, median, best):
        k = numbers[pose.label]
        assert pose.name == closed.result.frames[k]
        np.testing.assert_allclose(
            pose.reconstruction, closed.reconstruction[k], rtol=0, atol=1e-12
        )
        # Misses are held in single precision.
        np.testing.assert_allclose(pose.original, closed.frames[k], rtol=0, atol=1e-6)
        expected = 100 * vertex_errors(closed)[k] / diagonal(closed)
        np.testing.assert_allclose(pose.deviation, expected, rtol=1e-5, atol=1e-5)


def test_the_rest_pose_is_reconstructed(closed):
    rest = load_poses(closed.result).poses[0]
    np.testing.assert_array_equal(rest.original, closed.frames[0])
    np.testing.assert_allclose(rest.reconstruction, rest.original, rtol=0, atol=1e-12)
    assert rest.deviation.max() < 1e-10
    np.testing.assert_array_equal(rest.cage, closed.result.cage.vertices)


def test_the_vertex_errors_and_the_meshes(closed):
    poses = load_poses(closed.result)
    expected = 100 * np.sqrt((vertex_errors(closed) ** 2).mean(axis=0)) / diagonal(closed)
    np.testing.assert_allclose(poses.vertex_rms, expected, rtol=1e-9)
    np.testing.assert_array_equal(poses.faces, closed.faces)
    np.testing.assert_array_equal(poses.cage.faces, closed.result.cage.faces)
    assert poses.up_axis == "Y"


def test_a_result_without_weights_has_no_poses(folder):
    settings = ExtractSettings(
        ("frames",), folder / "cage.obj", folder / "c.h5", keep_weights=False
    )
    assert load_poses(extract(settings)) is None


@pytest.mark.parametrize("missing", [(), (3, 7)])
def test_the_metrics_of_vertices(closed, missing):
    result, case_rms = closed.result, np.sqrt((vertex_errors(closed) ** 2).mean(axis=0))
    rms = result.vertex_rms.copy()
    rms[list(missing)] = np.nan
    vertices = build_report(replace(result, vertex_rms=rms)).vertices
    known = np.setdiff1d(np.arange(18), missing)
    percent = 100 * case_rms / diagonal(closed)
    assert sum(vertices.counts) == len(known)
    assert vertices.edges_percent[0] == 0
    assert vertices.edges_percent[-1] == pytest.approx(percent[known].max())
    assert len(vertices.edges_percent) == len(vertices.counts) + 1
    edges = np.array(vertices.edges_percent)
    assert (np.diff(edges) > 0).all()
    for k, count in enumerate(vertices.counts[:-1]):
        assert count == ((percent[known] >= edges[k]) & (percent[known] < edges[k + 1])).sum()
    worst = known[np.argsort(-case_rms[known])][:10]
    assert [entry["vertex"] for entry in vertices.worst] == worst.tolist()
    for entry in vertices.worst:
        assert entry["rms"] == pytest.approx(case_rms[entry["vertex"]])
        assert entry["rms_percent"] == pytest.approx(percent[entry["vertex"]])
        assert entry["position"] == tuple(closed.frames[0][entry["vertex"]])


def test_vertices_without_error_are_in_the_first_bin(closed):
    vertices = build_report(replace(closed.result, vertex_rms=np.zeros(18))).vertices
    assert vertices.counts[0] == 18
    assert vertices.edges_percent[-1] == 1
