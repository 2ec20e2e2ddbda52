"""Closed models without volume: their change of volume is noise, and no figure."""

from decimal import Decimal

import numpy as np
import pytest

from cageik_cli.geometry.mesh import MIN_VOLUME_RATIO, TriMesh
from cageik_cli.report.html.page import render_page
from cageik_cli.report.limits import Limit, Limits
from cageik_cli.report.record import build_report
from cageik_cli.report.views.text import format_text
from tests.shapes import ball, box
from tests.texts import texts


def wave(mesh: TriMesh) -> np.ndarray:
    x, y, z = mesh.vertices.T
    return np.stack(
        [np.column_stack([x, y, z + 0.1 * k * np.sin(7 * x) * np.cos(9 * y)]) for k in range(4)]
    )


@pytest.mark.parametrize(("thickness", "has_volume"), [(0.0, False), (1e-4, False), (0.2, True)])
def test_only_bodies_have_a_change_of_volume(make_case, thickness, has_volume):
    """A ball is squashed."""
    body = ball(2, 0.4)
    mesh = TriMesh(body.vertices * [1, 1, thickness], body.faces)
    result = make_case(wave(mesh), mesh.faces).result
    report = build_report(result, Limits((Limit("volume_change", Decimal(2)),)))
    summary = report.summary
    assert (summary.volume_change_percent_max is not None) == has_volume
    assert (summary.volume_drift_percent_max is not None) == has_volume
    assert (report.clip.closed, report.clip.body) == (True, has_volume)
    assert any("a sheet" in note for note in texts(report.notes)) == (not has_volume)
    says = "not defined, the model is a sheet without volume"
    assert (says in format_text(report)) == (not has_volume)
    assert ("the model is a sheet without volume" in render_page(report)) == (not has_volume)
    if not has_volume:
        assert [gate.passed for gate in report.gates] == [None]


def test_a_frame_without_volume_has_no_change_and_the_others_have(make_case):
    """A body that is folded flat for one frame."""
    mesh = ball(2, 0.8)
    flat = mesh.vertices * [1, 1, 1e-7]
    frames = np.stack([mesh.vertices, flat, 0.9 * mesh.vertices])
    report = build_report(make_case(frames, mesh.faces).result)
    first, second, third = report.frames
    assert second.volume_change is None
    assert None not in (first.volume_change, third.volume_change, second.volume_drift)


def test_the_ratio_is_of_volume_to_area_times_diagonal():
    cube = box()
    assert cube.least_volume == pytest.approx(MIN_VOLUME_RATIO * 24 * np.sqrt(12))
    assert cube.is_body
    assert cube.flip().is_body
    assert not TriMesh(cube.vertices, cube.faces[1:]).is_body
