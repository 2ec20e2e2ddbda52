"""The summary of a pose or an edit, as text for a terminal and as JSON."""

import json
from collections.abc import Iterator
from dataclasses import asdict

from cageik_cli.editing.summary import MIN_MOTION, AnchorSummary, PoseSummary
from cageik_cli.report.figures import format_change, format_length, format_metric, format_percent
from cageik_cli.util.messages import Row, Said, say
from cageik_cli.util.text import format_count, format_decimals, single_line

MAX_SHOWN_HANDLES = 12
"""Handles that have a line each; of more, the farthest from their targets are shown."""

NO_MOTION_TOL = 1e-6
"""Share of the diagonal; smaller distances count as no motion."""

MIN_WHOLE_SHARE = 0.5
"""The whole model moves if its least motion is more than this share of its largest."""

MAX_VERTEX_RATIO = 1.25
"""Vertices that move more times as far as any handle need a pin."""

MAX_HANDLE_DISTANCE = 5.0
"""Diagonals; a handle that moves farther probably has its target in other units."""

MAX_CAGE_RATIO = 5.0
"""A cage that moves more times as far as any handle cannot follow the handles."""

MAX_BEYOND_PERCENT = 2.0
"""Diagonals, percent: what is beyond the radii may move so far, as the cage bends softly."""

MAX_VOLUME_PERCENT = 5.0
"""Larger changes of the volume, percent, are worth a look."""


def format_pose_rows(summary: PoseSummary) -> list[Row]:
    """Return labelled lines: cage edits, each handle, then the mesh, the cage and the system."""
    beyond, volume, changed, system = [], [], [], []
    if summary.beyond_moved_percent is not None:
        percent = format_miss(summary.beyond_moved_percent)
        beyond.append(("beyond radius", f"vertices moved by at most {percent} % of the diagonal"))
    if summary.has_surface:
        change = "not defined, the model is open"
        if summary.volume_change_percent is not None:
            most = "largest " if summary.frame else ""
            change = (
                f"{most}{format_change(summary.volume_change_percent)} %"
                f"{_format_frame_suffix(summary.volume_frame)}"
            )
        volume.append(("volume change", change))
    if summary.frame:  # of an animation
        text = "no frames"
        if summary.changed is not None:
            first, last = map(single_line, summary.changed)
            text = f"{first} to {last}; all other frames are unchanged"
        changed.append(("changed", text))
    if summary.condition_number is not None:  # of handles, which alone are solved for
        condition = f"condition number {summary.condition_number:.4g}"
        system.append(("system", f"{condition} (how much it amplifies noise)"))
    return [
        *_cage_edit_rows(summary),
        *_handle_rows(summary),
        (
            "moved most",
            f"vertex {summary.vertex} by "
            f"{format_length(summary.moved)}{_format_frame_suffix(summary.frame)}, "
            f"cage vertex {summary.cage_vertex} by {format_length(summary.cage_moved)}",
        ),
        (
            "mesh moved",
            f"{format_decimals(summary.moved_share_percent, 1)} % of it by more than "
            f"{100 * MIN_MOTION:g} % of the diagonal{_format_frame_suffix(summary.share_frame)}, "
            f"rms {format_percent(summary.rms_percent)} % ({format_length(summary.rms)})",
        ),
        *beyond,
        *volume,
        *changed,
        *system,
        *(("note", advice) for advice in _advise(summary)),
    ]


def list_brief_pose_rows(summary: PoseSummary) -> list[Row]:
    """Return the largest cage edit, the worst handle, what says whether a pose is as intended."""
    kinds = ("cage edit", "cage edits", "handle", "handles")
    rows = [row for row in format_pose_rows(summary) if row[0] not in kinds]
    read = [row for row in rows if row[0] in ("moved most", "beyond radius", "changed", "note")]
    listed = [*_cage_edit_rows(summary, max_shown=1), *_handle_rows(summary, max_shown=1)]
    return [*listed[:1], *read, *listed[1:], *(row for row in rows if row not in read)]


def format_pose_json(summary: PoseSummary) -> str:
    """Format the summary as JSON."""
    record = {"schema": 1, "tool": "cageik pose", **asdict(summary)}
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def _cage_edit_rows(summary: PoseSummary, max_shown: int = MAX_SHOWN_HANDLES) -> Iterator[Row]:
    """Say how far each cage edit moves the cage; of many, those that move it farthest."""
    edits = summary.cage_edits
    largest = sorted(edits, key=lambda edit: -edit.moved)[:max_shown]
    for edit in edits if len(edits) <= max_shown else largest:
        count = format_count(edit.vertices, "vertex of the cage")
        moved = f"at most {format_length(edit.moved)}{_format_frame_suffix(edit.frame)}"
        by = f"{count} by {moved} (vertex {edit.vertex})" if edit.moved else "no motion"
        yield "cage edit", f"{single_line(edit.name)}: {by}"
    if len(edits) > max_shown:
        yield "cage edits", f"{len(edits) - max_shown} more, which move the cage less"


def _handle_rows(summary: PoseSummary, max_shown: int = MAX_SHOWN_HANDLES) -> Iterator[Row]:
    """Describe the motion of each handle; of many, those that end farthest from their targets."""
    anchors = summary.anchors
    worst = sorted(anchors, key=lambda anchor: -anchor.residual)[:max_shown]
    for anchor in anchors if len(anchors) <= max_shown else worst:
        motion = (
            "held"
            if _is_held(anchor, summary.diagonal)
            else f"moved {format_length(anchor.moved)}, misses its target by "
            f"{format_miss(anchor.residual_percent)} % of the diagonal"
            f"{_format_frame_suffix(anchor.frame)}"
        )
        yield "handle", f"{_format_handle_name(anchor)}: {motion}"
    if len(anchors) > max_shown:
        rest = len(anchors) - max_shown
        yield "handles", f"{rest} more, at least as close to their targets"


def _is_held(anchor: AnchorSummary, diagonal: float) -> bool:
    """Whether an anchor stayed where it was, on its target."""
    return max(anchor.moved, anchor.residual) <= NO_MOTION_TOL * diagonal


def _format_handle_name(anchor: AnchorSummary) -> str:
    """Return a handle's name, with that of its set if there are several."""
    return (
        f"{single_line(anchor.name)} ({anchor.layer})" if anchor.layer else single_line(anchor.name)
    )


def _advise(summary: PoseSummary) -> Iterator[Said]:
    """Advise when the pose is probably not the intended one."""
    yield from _advise_on_volume(summary)
    if summary.cage_edits:
        yield from _advise_on_cage_edits(summary)
        return
    is_held = all(_is_held(anchor, summary.diagonal) for anchor in summary.anchors)
    far = max(summary.anchors, key=lambda anchor: anchor.moved)
    still = NO_MOTION_TOL * summary.diagonal
    if is_held:
        yield "no motion: all handles are already at their targets"
    elif summary.moved_least > max(still, MIN_WHOLE_SHARE * summary.moved):
        least = format_length(summary.moved_least)
        yield f"the whole model moves, by at least {least}; pin the parts that must stay"
    if not is_held:
        yield from _advise_on_far_vertices(summary, far)
    if far.moved > MAX_HANDLE_DISTANCE * summary.diagonal:
        yield (
            f"{_format_handle_name(far)} moves {far.moved / summary.diagonal:.3g} times the "
            f"model's diagonal (expected at most {MAX_HANDLE_DISTANCE:g}); give targets in the "
            "units and axes of the model's file"
        )
    if summary.cage_moved > max(MAX_CAGE_RATIO * far.moved, summary.diagonal):
        yield (
            f"cage vertex {summary.cage_vertex} moves {format_length(summary.cage_moved)}, "
            f"more than {MAX_CAGE_RATIO:g} times as far as any handle: the cage cannot "
            "follow the handles; "
            + say(
                "remove some handles, raise `alpha=` (for example to 1e-3), or check the "
                "cage with cageik check"
            )
        )
    if (summary.beyond_moved_percent or 0.0) > MAX_BEYOND_PERCENT:
        percent = format_miss(summary.beyond_moved_percent or 0.0)
        yield (
            f"vertices beyond the radii move by up to {percent} % of the diagonal: the cage is too "
            "coarse for them; give larger ones, or use a finer cage"
        )


def _advise_on_volume(summary: PoseSummary) -> Iterator[Said]:
    """Say where the volume changes much, and what keeps it."""
    if abs(summary.volume_change_percent or 0.0) <= MAX_VOLUME_PERCENT:
        return
    change = format_change(summary.volume_change_percent or 0.0)
    found = f"the volume changes by {change} %{_format_frame_suffix(summary.volume_frame)}"
    if summary.hold or summary.condition_number is None:
        yield f"{found}; move less far, or give handles another `radius`"
    elif summary.rigidity:
        yield f"{found}; hold the rest, which is off in the file or the command"
    else:
        yield f"{found}: parts that turn are sheared; " + say(
            "hold the rest, which is off in the file or by `hold=False`, or let them rotate with "
            "`rigidity=10`"
        )


def _advise_on_cage_edits(summary: PoseSummary) -> Iterator[Said]:
    """Say so if a cage edit moves nothing, or so far that it is probably in other units."""
    for edit in summary.cage_edits:
        if edit.moved > MAX_HANDLE_DISTANCE * summary.diagonal:
            yield (
                f"cage edit {single_line(edit.name)} moves {edit.moved / summary.diagonal:.3g} "
                f"times the model's diagonal (expected at most {MAX_HANDLE_DISTANCE:g}); give "
                "offsets in the units and axes of the model's file"
            )
    if not any(edit.moved for edit in summary.cage_edits):
        yield "no motion: all offsets of the cage edits are zero in the frames that they act in"


def _advise_on_far_vertices(summary: PoseSummary, far: AnchorSummary) -> Iterator[Said]:
    """Advise a pin if a vertex moves much further than any handle."""
    still = NO_MOTION_TOL * summary.diagonal
    if summary.moved > max(still, MAX_VERTEX_RATIO * far.moved):
        than = (
            f"{summary.moved / far.moved:.3g} times as far as any handle"
            if far.moved > still
            else "but no handle moves"
        )
        yield (
            f"vertex {summary.vertex} moves by {format_length(summary.moved)}"
            f"{_format_frame_suffix(summary.frame)}, {than}; pin a point near it, or give the "
            "handles a smaller `radius`"
        )


def format_miss(percent: float) -> str:
    """Format the distance of a handle from its target, in percent, as in all views."""
    return f"{percent:.1e}" if percent < 1e-3 else format_metric(percent)


def _format_frame_suffix(frame: str) -> str:
    return f" in {single_line(frame)}" if frame else ""
