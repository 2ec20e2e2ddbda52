"""What a pose came to, as a page of text and as JSON."""

import json
from collections.abc import Iterator
from dataclasses import asdict

from cageik_cli.posing.summary import AnchorFigures, PoseFigures
from cageik_cli.report.figures import change_text, figure_text, percent_text, units_text
from cageik_cli.util.text import shown

SCHEMA = 1

SHOWN = 12
"""Handles that have a line each."""

ALONG = 0.5
"""A model moves along when all of it does, by this share of what moves most."""

SMALL = 1e-3
"""Percents below it are written with their power of ten."""

LARGEST_CHANGE = 10.0
"""Percent of the volume; beyond, a pose whose parts did not turn may be better if they do."""

WILDEST = 5.0
"""A cage moves wildly when it goes so many times as far as any handle."""

FARTHEST = 5.0
"""Diagonals; a handle that goes farther has hardly its target in the model's units."""

STILL = 1e-6
"""Shares of the diagonal that are no motion."""


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
        *_smoothness(figures),
        ("system", f"condition number {figures.condition_number:.4g}"),
        *_advice(figures),
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
            f"{_named(anchor)}: moved {units_text(anchor.moved)}, ends "
            f"{miss_text(anchor.residual_percent)} % of the diagonal from its target"
            f"{_at(anchor.frame)}",
        )
    if len(anchors) > SHOWN:
        yield "handles", f"{len(anchors) - SHOWN} more, no farther from their targets"


def _named(anchor: AnchorFigures) -> str:
    """A handle's name, and the set that it is in, of several."""
    return f"{shown(anchor.name)} ({anchor.layer})" if anchor.layer else shown(anchor.name)


def _smoothness(figures: PoseFigures) -> Iterator[tuple[str, str]]:
    """The handle that the edit makes accelerate most, beside what it did before."""
    known = [
        (anchor.acceleration, anchor.acceleration_before, _named(anchor))
        for anchor in figures.anchors
        if anchor.acceleration is not None and anchor.acceleration_before is not None
    ]
    if not known:
        return
    after, before, name = max(known, key=lambda found: found[0] - found[1])
    if after - before <= STILL * figures.diagonal:
        yield "acceleration", "of no handle larger than before the edit"
        return
    yield (
        "acceleration",
        f"of {name}, at most {figure_text(after)} a frame², before the edit {figure_text(before)}",
    )


def _advice(figures: PoseFigures) -> Iterator[tuple[str, str]]:
    """What to do when the pose is hardly what was meant."""
    still = STILL * figures.diagonal
    if not any(anchor.moved > still or anchor.residual > still for anchor in figures.anchors):
        yield "note", "nothing moves: every handle is where it is to be"
    elif figures.moved_least > max(still, ALONG * figures.moved):
        least = units_text(figures.moved_least)
        yield "note", f"all of the model moves, by {least} at least; pin what is to stay"
    far = max(figures.anchors, key=lambda anchor: anchor.moved)
    if far.moved > FARTHEST * figures.diagonal:
        yield (
            "note",
            f"{_named(far)} goes {far.moved / figures.diagonal:.3g} times the model's diagonal, "
            f"more than {FARTHEST:g}; give targets in the units and axes of the model's file",
        )
    if figures.cage_moved > max(WILDEST * far.moved, figures.diagonal):
        yield (
            "note",
            f"cage vertex {figures.cage_vertex} moves {units_text(figures.cage_moved)}, more than "
            f"{WILDEST:g} times as far as any handle: they ask for more than the cage can do; "
            "leave some out, raise --alpha (to 1e-3, say), or look at the cage with cageik check",
        )
    if abs(figures.volume_change_percent or 0.0) > LARGEST_CHANGE and not figures.rigidity:
        yield (
            "note",
            f"the volume changes by more than {LARGEST_CHANGE:g} %: what turns is sheared; let "
            "it turn with --rigidity 10",
        )


def miss_text(percent: float) -> str:
    """How far from its target a handle ends, in percent, as it is printed everywhere."""
    return f"{percent:.1e}" if percent < SMALL else figure_text(percent)


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
