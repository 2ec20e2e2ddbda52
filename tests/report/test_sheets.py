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


def sheet(thickness: float, count: int = 8) -> TriMesh:
    """A square from -0.4 to 0.4, cut into cells and closed on both sides."""
    step = np.linspace(-0.4, 0.4, count)
    x, y = (axis.ravel() for axis in np.meshgrid(step, step, indexing="ij"))
    low = np.column_stack([x, y, np.full(len(x), -thickness / 2)])
    cell = np.arange(count**2).reshape(count, count)
    a, b, c, d = cell[:-1, :-1], cell[1:, :-1], cell[1:, 1:], cell[:-1, 1:]
    under = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, c, b), (a, d, c))])
    over = under[:, ::-1] + len(low)
    rim = np.concatenate([cell[0], cell[1:, -1], cell[-1, -2::-1], cell[-2:0:-1, 0]])
    one, two = rim, np.roll(rim, -1)
    sides = [[two, one, two + len(low)], [two + len(low), one, one + len(low)]]
    walls = np.concatenate([np.stack(side, axis=1) for side in sides])
    mesh = TriMesh(
        np.vstack([low, low + np.array([0, 0, thickness])]), np.concatenate([under, over, walls])
    )
    return mesh if mesh.volume >= 0 else mesh.flip()


def wave(mesh: TriMesh) -> np.ndarray:
    x, y, z = mesh.vertices.T
    return np.stack(
        [np.column_stack([x, y, z + 0.1 * k * np.sin(7 * x) * np.cos(9 * y)]) for k in range(4)]
    )


def test_the_test_sheet_is_closed():
    thick = sheet(0.1)
    assert thick.is_closed
    assert thick.volume == pytest.approx(0.8 * 0.8 * 0.1)


@pytest.mark.parametrize(("thickness", "has_volume"), [(0.0, False), (1e-4, False), (0.05, True)])
def test_only_bodies_have_a_change_of_volume(make_case, thickness, has_volume):
    mesh = sheet(thickness)
    result = make_case(wave(mesh), mesh.faces).result
    report = build_report(result, Limits((Limit("volume_change", Decimal(2)),)))
    summary = report.summary
    assert (summary.volume_change_percent_max is not None) == has_volume
    assert (summary.volume_drift_percent_max is not None) == has_volume
    assert (report.clip.closed, report.clip.body) == (True, has_volume)
    assert any("a sheet" in note for note in report.notes) == (not has_volume)
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
