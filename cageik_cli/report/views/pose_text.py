"""What a pose came to, as a page of text and as JSON."""

import json
from collections.abc import Iterator
from dataclasses import asdict

from cageik_cli.posing.summary import AnchorSummary, PoseSummary
from cageik_cli.report.figures import format_change, format_length, format_metric, format_percent
from cageik_cli.util.text import single_line

SCHEMA_VERSION = 1

MAX_SHOWN_HANDLES = 12
"""Handles that have a line each."""

MIN_WHOLE_MOTION = 0.5
"""A model moves along when all of it does, by this share of what moves most."""

MIN_FIXED_POINT_PERCENT = 1e-3
"""Percents below it are written with their power of ten."""

MAX_VOLUME_CHANGE = 10.0
"""Percent of the volume; beyond, a pose whose parts did not turn may be better if they do."""

MAX_CAGE_MOTION = 5.0
"""A cage moves wildly when it goes so many times as far as any handle."""

MAX_HANDLE_DISTANCE = 5.0
"""Diagonals; a handle that goes farther has hardly its target in the model's units."""

NO_MOTION_TOL = 1e-6
"""Shares of the diagonal that are no motion."""


def format_pose_rows(figures: PoseSummary) -> list[tuple[str, str]]:
    """Labelled lines: each handle, then the mesh, the cage and the system."""
    return [
        *_handle_rows(figures.anchors),
        (
            "moved most",
            f"vertex {figures.vertex} by "
            f"{format_length(figures.moved)}{_format_frame_suffix(figures.frame)}, "
            f"cage vertex {figures.cage_vertex} by {format_length(figures.cage_moved)}",
        ),
        (
            "mesh moved",
            f"{format_percent(figures.rms_percent)} % of the diagonal "
            f"(rms {format_length(figures.rms)})",
        ),
        ("volume change", _format_volume(figures)),
        *_changed_rows(figures),
        *_acceleration_rows(figures),
        ("system", f"condition number {figures.condition_number:.4g}"),
        *_advice_rows(figures),
    ]


def format_pose_json(figures: PoseSummary) -> str:
    """The same as JSON."""
    record = {"schema": SCHEMA_VERSION, "tool": "cageik pose", **asdict(figures)}
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def _handle_rows(anchors: tuple[AnchorSummary, ...]) -> Iterator[tuple[str, str]]:
    """How each went; of many, those that end farthest from their targets."""
    worst = sorted(anchors, key=lambda anchor: -anchor.residual)[:MAX_SHOWN_HANDLES]
    for anchor in anchors if len(anchors) <= MAX_SHOWN_HANDLES else worst:
        yield (
            "handle",
            f"{_format_handle_name(anchor)}: moved {format_length(anchor.moved)}, ends "
            f"{format_miss(anchor.residual_percent)} % of the diagonal from its target"
            f"{_format_frame_suffix(anchor.frame)}",
        )
    if len(anchors) > MAX_SHOWN_HANDLES:
        yield "handles", f"{len(anchors) - MAX_SHOWN_HANDLES} more, no farther from their targets"


def _format_handle_name(anchor: AnchorSummary) -> str:
    """A handle's name, and the set that it is in, of several."""
    return (
        f"{single_line(anchor.name)} ({anchor.layer})" if anchor.layer else single_line(anchor.name)
    )


def _acceleration_rows(figures: PoseSummary) -> Iterator[tuple[str, str]]:
    """The handle that the edit makes accelerate most, beside what it did before."""
    known = [
        (anchor.acceleration, anchor.acceleration_before, _format_handle_name(anchor))
        for anchor in figures.anchors
        if anchor.acceleration is not None and anchor.acceleration_before is not None
    ]
    if not known:
        return
    after, before, name = max(known, key=lambda found: found[0] - found[1])
    if after - before <= NO_MOTION_TOL * figures.diagonal:
        yield "acceleration", "of no handle larger than before the edit"
        return
    yield (
        "acceleration",
        f"of {name}, at most {format_metric(after)} a frame², before the edit "
        f"{format_metric(before)}",
    )


def _advice_rows(figures: PoseSummary) -> Iterator[tuple[str, str]]:
    """What to do when the pose is hardly what was meant."""
    still = NO_MOTION_TOL * figures.diagonal
    if not any(anchor.moved > still or anchor.residual > still for anchor in figures.anchors):
        yield "note", "nothing moves: every handle is where it is to be"
    elif figures.moved_least > max(still, MIN_WHOLE_MOTION * figures.moved):
        least = format_length(figures.moved_least)
        yield "note", f"all of the model moves, by {least} at least; pin what is to stay"
    far = max(figures.anchors, key=lambda anchor: anchor.moved)
    if far.moved > MAX_HANDLE_DISTANCE * figures.diagonal:
        yield (
            "note",
            f"{_format_handle_name(far)} goes {far.moved / figures.diagonal:.3g} times the "
            f"model's diagonal, "
            f"more than {MAX_HANDLE_DISTANCE:g}; give targets in the units and axes of the "
            f"model's file",
        )
    if figures.cage_moved > max(MAX_CAGE_MOTION * far.moved, figures.diagonal):
        yield (
            "note",
            f"cage vertex {figures.cage_vertex} moves {format_length(figures.cage_moved)}, more "
            f"than "
            f"{MAX_CAGE_MOTION:g} times as far as any handle: they ask for more than the cage "
            f"can do; "
            "leave some out, raise --alpha (to 1e-3, say), or look at the cage with cageik check",
        )
    if abs(figures.volume_change_percent or 0.0) > MAX_VOLUME_CHANGE and not figures.rigidity:
        yield (
            "note",
            f"the volume changes by more than {MAX_VOLUME_CHANGE:g} %: what turns is sheared; let "
            "it turn with --rigidity 10",
        )


def format_miss(percent: float) -> str:
    """How far from its target a handle ends, in percent, as it is printed everywhere."""
    return f"{percent:.1e}" if percent < MIN_FIXED_POINT_PERCENT else format_metric(percent)


def _format_frame_suffix(frame: str) -> str:
    return f" in {single_line(frame)}" if frame else ""


def _format_volume(figures: PoseSummary) -> str:
    if figures.volume_change_percent is None:
        return "not defined, the model is open"
    return f"{format_change(figures.volume_change_percent)} %{' at most' if figures.frame else ''}"


def _changed_rows(figures: PoseSummary) -> list[tuple[str, str]]:
    """Which frames were changed; nothing of a single pose."""
    if not figures.frame:
        return []
    if figures.changed is None:
        return [("changed", "no frame")]
    first, last = map(single_line, figures.changed)
    return [("changed", f"{first} to {last}; all other frames are as they were")]
