"""The quality of weights on a page, by type of coordinates and accuracy."""

from dataclasses import replace

import pytest

from cageik_cli.report.html.frames_table import build_quality_rows
from cageik_cli.report.record import build_report


@pytest.mark.parametrize(
    ("settings", "panels", "words"),
    [
        ({"coordinates": "harmonic", "accuracy": "fine"}, 8, ["0.001 or less", "never negative"]),
        ({"coordinates": "mean-value"}, 0, ["closed form", "negative near concave parts"]),
        ({"coordinates": "harmonic", "accuracy": "other"}, 8, ["never negative"]),
    ],
)
def test_weights_are_explained_by_their_kind(closed, settings, panels, words):
    report = build_report(closed.result)
    binding = replace(report.binding, panels=panels)
    rows = build_quality_rows(replace(report, settings=settings, binding=binding))
    text = " ".join(f"{row.meaning} {row.expected}" for row in rows)
    assert [word for word in words if word not in text] == []
    assert ("Panels" in [row.label for row in rows]) == bool(panels)


def test_an_unknown_accuracy_has_no_expected_value(closed):
    report = build_report(closed.result)
    binding = replace(report.binding, panels=8)
    rows = build_quality_rows(replace(report, settings={"accuracy": "other"}, binding=binding))
    (row,) = [row for row in rows if row.label.startswith("Estimated weight error")]
    assert row.expected == ""
