"""What a pose came to, as a page of text and as JSON."""

import json
from collections.abc import Iterator
from dataclasses import asdict

from cageik_cli.layout import shown
from cageik_cli.pose_figures import AnchorFigures, PoseFigures
from cageik_cli.report.figures import change_text, figure_text, percent_text, units_text

SCHEMA = 1

SHOWN = 12
"""Handles that have a line each."""


def pose_rows(figures: PoseFigures) -> list[tuple[str, str]]:
    """Labelled lines: each handle, then the mesh, the cage and the system."""
    return [
        *_handles(figures.anchors),
        (
            "moved most",
            f"vertex {figures.vertex} by {units_text(figures.moved)}{_at(figures.frame)}, "
            f"cage vertex {figures.cage_vertex} by {units_text(figures.cage_moved)}",
        ),
        (
            "mesh moved",
            f"{percent_text(figures.rms_percent)} % of the diagonal "
            f"(rms {units_text(figures.rms)})",
        ),
        ("volume change", _volume(figures)),
        *_changed(figures),
        *_smoothness(figures.anchors),
        ("system", f"condition number {figures.condition_number:.4g}"),
    ]


def pose_json(figures: PoseFigures) -> str:
    """The same as JSON."""
    record = {"schema": SCHEMA, "tool": "cageik pose", **asdict(figures)}
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def _handles(anchors: tuple[AnchorFigures, ...]) -> Iterator[tuple[str, str]]:
    """How each went; of many, those that end farthest from their targets."""
    worst = sorted(anchors, key=lambda anchor: -anchor.residual)[:SHOWN]
    for anchor in anchors if len(anchors) <= SHOWN else worst:
        yield (
            "handle",
            f"{shown(anchor.name)}: moved {units_text(anchor.moved)}, ends "
            f"{anchor.residual_percent:.1e} % of the diagonal from its target{_at(anchor.frame)}",
        )
    if len(anchors) > SHOWN:
        yield "handles", f"{len(anchors) - SHOWN} more, no farther from their targets"


def _smoothness(anchors: tuple[AnchorFigures, ...]) -> Iterator[tuple[str, str]]:
    """The handle that the edit makes accelerate most, beside what it did before."""
    known = [
        (anchor.acceleration, anchor.acceleration_before, shown(anchor.name))
        for anchor in anchors
        if anchor.acceleration is not None and anchor.acceleration_before is not None
    ]
    if known:
        after, before, name = max(known, key=lambda found: found[0] - found[1])
        yield (
            "acceleration",
            f"of {name}, at most {figure_text(after)} a frame², before the edit "
            f"{figure_text(before)}",
        )


def _at(frame: str) -> str:
    return f" in {shown(frame)}" if frame else ""


def _volume(figures: PoseFigures) -> str:
    if figures.volume_change_percent is None:
        return "not defined, the model is open"
    return f"{change_text(figures.volume_change_percent)} %{' at most' if figures.frame else ''}"


def _changed(figures: PoseFigures) -> list[tuple[str, str]]:
    """Which frames were changed; nothing of a single pose."""
    if not figures.frame:
        return []
    if figures.changed is None:
        return [("changed", "no frame")]
    first, last = map(shown, figures.changed)
    return [("changed", f"{first} to {last}; all other frames are as they were")]
