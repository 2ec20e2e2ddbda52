"""What a fit gains, where that can be told."""

from types import SimpleNamespace

import pytest

from cageik_cli.report import fit_rows
from cageik_cli.report.fit_rows import measure_gap_closed


@pytest.mark.parametrize(("frames", "closed"), [(20, None), (21, 80)])
def test_no_share_of_a_gap_is_told_where_no_error_is_possible_by_counting(
    monkeypatch, frames, closed
):
    """60 cage vertices give every displacement of 20 frames, which have 60 columns."""
    monkeypatch.setattr(fit_rows, "is_fitted_to_clip", lambda result: True)
    compared = SimpleNamespace(unfitted=SimpleNamespace(rms=1.0), fitted=SimpleNamespace(rms=0.2))
    result = SimpleNamespace(
        fit=SimpleNamespace(report=SimpleNamespace(fitted=compared)),
        bound=SimpleNamespace(vertices=500, points=60, rms_percent=0.0),
        frames=range(frames),
        gaps=(),
    )
    assert measure_gap_closed(result) == (closed and pytest.approx(closed))
