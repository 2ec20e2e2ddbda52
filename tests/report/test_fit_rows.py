"""What a fit gains, where that can be told."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from cageik_cli.fit.settings import StrengthLimit
from cageik_cli.method.solve.summary import VertexBound
from cageik_cli.report import fit_rows
from cageik_cli.report.fit_rows import list_fit_notes, measure_gap_closed
from tests.store.bindings import record
from tests.texts import texts


@pytest.mark.parametrize(("percent", "closed"), [(0.0, None), (9e-4, None), (0.2, 100)])
def test_no_share_of_a_gap_is_told_where_no_error_is_possible_by_counting(
    monkeypatch, percent, closed
):
    """A bound of rounding says that frames are few, or repeat."""
    monkeypatch.setattr(fit_rows, "is_fitted_to_clip", lambda result: True)
    compared = SimpleNamespace(unfitted=SimpleNamespace(rms=1.0), fitted=SimpleNamespace(rms=0.2))
    result = SimpleNamespace(
        fit=SimpleNamespace(report=SimpleNamespace(fitted=compared)),
        bound=VertexBound(percent, points=60, vertices=500),
    )
    assert measure_gap_closed(result) == (closed and pytest.approx(closed))


@pytest.mark.parametrize(("distinct", "is_noted"), [(0, False), (1, True), (29, True)])
def test_few_distinct_frames_are_noted_unless_only_the_whole_moves(distinct, is_noted):
    fit = record()
    report = replace(fit.report, limit=StrengthLimit.FRAMES, distinct_frames=distinct)
    notes = texts(list_fit_notes(replace(fit, report=report)))
    assert any("too few to choose how close" in note for note in notes) == is_noted
